"""What files of grasps ask of a `GraspSet`, and what is left of it in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand


def check_exportable(grasps: GraspSet, hand: Hand, names: Sequence[str] | None = None) -> list[str]:
    """Names of the N grasps, refused unless there are grasps, and of this hand.

    Raises:
        InputError: no grasps, a hand of another name, another number of names, names that are not unique.
        ShapeError: another number of joints than the hand has.
    """
    if not len(grasps):
        raise InputError(f"there are no grasps of '{grasps.object}' by '{grasps.hand}' to export; make some first.")
    if grasps.hand != hand.name:
        raise InputError(f"the grasps are of hand '{grasps.hand}', but hand '{hand.name}' was given with them.")
    hand.check_q(grasps.q)
    ids = [f"grasp_{i}" for i in range(len(grasps))] if names is None else [str(n) for n in names]
    if len(ids) != len(grasps) or len(set(ids)) < len(ids):
        raise InputError(f"{len(ids)} names, {len(set(ids))} of them different, for {len(grasps)} grasps; one each.")
    return ids


def bare_grasps(
    hand: Hand,
    object_name: str,
    *,
    X_OH: np.ndarray,
    q_pregrasp: np.ndarray,
    q: np.ndarray,
    q_squeeze: np.ndarray,
    quality: np.ndarray,
    source: str,
) -> GraspSet:
    """A set of grasps of which only poses, postures and a quality are known; `source` says whose quality it is."""
    count = len(X_OH)
    none = np.zeros((count, 0, 3))
    return GraspSet(
        hand=hand.name,
        object=object_name,
        X_OH=X_OH,
        q=q,
        q_pregrasp=q_pregrasp,
        q_squeeze=q_squeeze,
        contact_points_O=none,
        contact_normals_O=none,
        contact_links=np.zeros((count, 0), np.int32),
        epsilon=quality,
        penetration_m=np.zeros(count),
        config={"source": source, "epsilon": f"the quality in {source}"},
    )
