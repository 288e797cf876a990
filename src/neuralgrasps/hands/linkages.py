"""Struts of linkages, which look like fingers in an open tree, and fingertips that linkages keep parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import KinematicTree

Clouds = Mapping[int, tuple[np.ndarray, np.ndarray]]
SHORT = 0.7  # a strut reaches at most this share of its finger's length
PINNED = 0.012  # metres: its end stays this near to the finger that it is pinned to
TURNED = np.radians(8.0)  # fingertips of a jaw that turn more than this do not stay parallel
_STEPS = 5


def without_struts(
    tree: KinematicTree, fingers: Sequence[tuple[int, ...]], clouds: Clouds, moved: np.ndarray
) -> tuple[tuple[int, ...], ...]:
    """The fingers that are not struts: short branches without a joint of their own, pinned to a longer finger.

    Args:
        fingers: links of each branch, proximal first; clouds: surface points of links; moved (L, J): what joints move.
    """
    postures = tree.lower + np.linspace(0.05, 0.95, _STEPS)[:, None] * (tree.upper - tree.lower)
    X = forward_numpy(tree, postures)
    points = [_posed(X, f, clouds) for f in fingers]
    reach = [_reach(X, f, p) for f, p in zip(fingers, points, strict=True)]

    def is_strut(f: int) -> bool:
        own = moved[list(fingers[f])].any(axis=0)
        for g, finger in enumerate(fingers):
            if g == f or reach[f] > SHORT * reach[g] or (own & ~moved[list(finger)].any(axis=0)).any():
                continue
            if all(_end_gap(X[k], fingers[f], points[f][k], points[g][k]) < PINNED for k in range(_STEPS)):
                return True
        return False

    return tuple(finger for f, finger in enumerate(fingers) if not is_strut(f))


def _posed(X: np.ndarray, finger: Sequence[int], clouds: Clouds) -> np.ndarray:
    """(postures, points, 3) surface points of a finger in H."""
    return np.concatenate(
        [clouds[i][0] @ X[:, i, :3, :3].transpose(0, 2, 1) + X[:, i, None, :3, 3] for i in finger if i in clouds],
        axis=1,
    )


def _reach(X: np.ndarray, finger: Sequence[int], points: np.ndarray) -> float:
    return float(np.linalg.norm(points[0] - X[0, finger[0], :3, 3], axis=1).max())


def _end_gap(X: np.ndarray, finger: Sequence[int], own: np.ndarray, other: np.ndarray) -> float:
    """Distance of a branch's far end from the surface points of another, metres."""
    far = own[np.argmax(np.linalg.norm(own - X[finger[0], :3, 3], axis=1))]
    return float(KDTree(other).query(far)[0])


def tips_stay_parallel(tree: KinematicTree, tip_links: Sequence[int], q_open: np.ndarray, q_closed: np.ndarray) -> bool:
    """Does no fingertip turn in the base while the hand closes?"""
    X = forward_numpy(tree, q_open + np.linspace(0.0, 1.0, _STEPS)[:, None] * (q_closed - q_open))
    for link in tip_links:
        R = X[:, link, :3, :3] @ X[0, link, :3, :3].T
        if np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1)).max() > TURNED:
            return False
    return True
