"""Struts of linkages, which look like fingers in an open tree, and fingertips that linkages keep parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import KinematicTree

Clouds = Mapping[int, tuple[np.ndarray, np.ndarray]]
SHORT = 0.7  # a strut reaches at most this share of its finger's length
PINNED = 0.012  # metres: its end, or the hinge between them, stays this near to the finger that it is pinned to
HINGE_PLAY = 0.001  # metres: a hinge of links that joints move in step keeps its place in both this well
HINGE_BEYOND = 0.03  # metres: shapes of struts are often simplified and end this far from their hinge
HINGE_TRAVEL = 0.005  # metres: a hinge that does not move is a pivot in the palm that two fingers share
TURNED = np.radians(8.0)  # fingertips of a jaw that turn more than this do not stay parallel
_STEPS = 5


def without_struts(
    tree: KinematicTree, fingers: Sequence[tuple[int, ...]], clouds: Clouds, moved: np.ndarray
) -> tuple[tuple[int, ...], ...]:
    """The fingers that are not struts: short branches without a joint of their own, pinned to a longer finger.

    Pinned: the far end stays on the finger's surface, or the two turn about one hinge that moves with both.

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
            if not _in_one_plane(X, _last(fingers[f], clouds), points[f][0], points[g][0]):
                continue
            if all(_end_gap(X[k], fingers[f], points[f][k], points[g][k]) < PINNED for k in range(_STEPS)):
                return True
            if any(_is_hinged(X, fingers[f], points[f], i, clouds) for i in finger if i in clouds):
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


def _last(finger: Sequence[int], clouds: Clouds) -> int:
    return [i for i in finger if i in clouds][-1]


def _is_hinged(X: np.ndarray, strut: Sequence[int], points: np.ndarray, link: int, clouds: Clouds) -> bool:
    """Do a strut's last link and `link` of a finger turn against each other about a moving hinge near to both?"""
    last = _last(strut, clouds)
    X_relative = np.linalg.inv(X[:, link]) @ X[:, last]
    R, t = X_relative[:, :3, :3], X_relative[:, :3, 3]
    if np.arccos(np.clip((np.trace(R[-1] @ R[0].T) - 1) / 2, -1, 1)) < TURNED:
        return False
    # the point of the strut nearest to its end that stays in one place of the link: R p + t = place, in all postures
    far = points[0][np.argmax(np.linalg.norm(points[0] - X[0, strut[0], :3, 3], axis=1))]
    far = (far - X[0, last, :3, 3]) @ X[0, last, :3, :3]
    at_end = R @ far + t
    rows = np.concatenate([R, np.tile(-np.eye(3), (len(R), 1, 1))], axis=2).reshape(-1, 6)
    shift = np.linalg.lstsq(rows, (at_end.mean(axis=0) - at_end).ravel(), rcond=1e-6)[0]
    hinge, place = far + shift[:3], at_end.mean(axis=0) + shift[3:]
    if np.linalg.norm(R @ hinge + t - place, axis=1).max() > HINGE_PLAY:
        return False
    travel = X[:, last, :3, :3] @ hinge + X[:, last, :3, 3]
    if np.linalg.norm(travel - travel[0], axis=1).max() < HINGE_TRAVEL:
        return False
    own, other = clouds[last][0], clouds[link][0]
    return bool(KDTree(own).query(hinge)[0] < HINGE_BEYOND and KDTree(other).query(place)[0] < PINNED)


def _in_one_plane(X: np.ndarray, link: int, own: np.ndarray, other: np.ndarray) -> bool:
    """Do two branches overlap along the axis that `link` turns about? Fingers side by side have a gap there."""
    turned = X[-1, link, :3, :3] @ X[0, link, :3, :3].T
    axis = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    ours, theirs = own @ axis, other @ axis
    return bool(ours.min() <= theirs.max() and theirs.min() <= ours.max())


def tips_stay_parallel(tree: KinematicTree, tip_links: Sequence[int], q_open: np.ndarray, q_closed: np.ndarray) -> bool:
    """Does no fingertip turn in the base while the hand closes?"""
    X = forward_numpy(tree, q_open + np.linspace(0.0, 1.0, _STEPS)[:, None] * (q_closed - q_open))
    for link in tip_links:
        R = X[:, link, :3, :3] @ X[0, link, :3, :3].T
        if np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1)).max() > TURNED:
            return False
    return True
