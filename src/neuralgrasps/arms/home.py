"""A posture to start from for an arm that nobody described."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.kinematics.tree import KinematicTree


def free_posture(
    tree: KinematicTree, parts: Sequence[ConvexPart], joints: np.ndarray, stated: Mapping[str, float]
) -> np.ndarray:
    """(Q,) the middle of the planned joints' ranges, others at rest; `stated` values as they are."""
    q = np.clip(0.0, tree.lower, tree.upper)
    q[joints] = 0.5 * (tree.lower + tree.upper)[joints]
    for name, value in stated.items():
        q[tree.dof_names.index(name)] = value
    return q
