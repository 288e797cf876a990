"""Hands whose fingers stand around an axis: found by their symmetry, and closed, opened and preshaped alike.

A rotation that carries every finger onto another one of the same build is strong evidence: its axis is the palm's, and
each finger closes by turning about the tangent of its place on the circle, whichever way its joints count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.hands.closing import MovableHand, sliding_joints
from neuralgrasps.hands.contact import ALLOWED_DEPTH, SelfContact
from neuralgrasps.kinematics.tree import REVOLUTE

OPEN_TILT = np.radians(30.0)  # of the line from a finger's root to its tip, outwards from the palm's axis
FLAT_TILT = np.radians(100.0)  # a hand lying flat at zero opens no wider
TIPS_WEIGHT = 2.0  # where the tips are says more about the palm's side than the joints' ranges do
_STEPS = 25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RadialHand:
    """Fingers around an axis.

    Attributes:
        axis_H (3,): the palm's outward normal, unit; centre_H (3,): a point on the axis, metres.
        radial_H (F, 3): unit directions from the axis to each finger, perpendicular to it.
        closing (J,): signed share of each joint in closing, largest magnitude 1.
        q_open, q_closed (J,): widest sensible posture; the one where fingers meet or joints end.
        certainty: how clearly the palm's side shows, 0 = not at all.
    """

    axis_H: np.ndarray
    centre_H: np.ndarray
    radial_H: np.ndarray
    closing: np.ndarray
    q_open: np.ndarray
    q_closed: np.ndarray
    certainty: float


def radial_hand(model: MovableHand, contact: SelfContact, *, normal_H: np.ndarray | None = None) -> RadialHand | None:
    """The hand as fingers around an axis, or None if it is not one (a sliding jaw never is).

    Args:
        model: the hand; its tree's limits are the ranges to work in.
        contact: tells which postures collide.
        normal_H: the palm's normal where known; decides its side only.
    """
    found = _symmetry_axis(model)
    if found is None:
        return None
    axis, centre = found
    roots = np.array([_features(model, f)[0] for f in range(len(model.fingers))]) - centre
    radial = roots - np.outer(roots @ axis, axis)
    if np.linalg.norm(radial, axis=1).min() < 1e-3:
        return None
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    inward = _inward_senses(model, axis, radial)
    if inward is None:
        return None
    side, certainty = _palm_side(model, axis, inward)
    if normal_H is not None:
        side = 1.0 if axis @ normal_H >= 0 else -1.0
    axis, sense = side * axis, np.where(sliding_joints(model.tree), 1.0, side) * inward
    q_open = _open_posture(model, contact, axis, radial, sense)
    end = np.where(sense > 0, model.tree.upper, np.where(sense < 0, model.tree.lower, q_open))
    room = np.abs(end - q_open)
    return RadialHand(
        axis_H=axis,
        centre_H=centre,
        radial_H=radial,
        closing=sense * room / max(room.max(), 1e-9),
        q_open=q_open,
        q_closed=contact.last_free(q_open, end),
        certainty=certainty,
    )


# -- symmetry --------------------------------------------------------------------


def _features(model: MovableHand, finger: int) -> np.ndarray:
    """(K, 3) points that tell where a finger is, in H at `q0`: the middles of its links' surfaces, then its tip."""
    X = model.poses(model.q0)
    solid = [i for i in model.fingers[finger] if i in model.clouds]
    boxes = [(model.clouds[i][0].min(axis=0) + model.clouds[i][0].max(axis=0)) / 2 for i in solid]
    middles = [X[i, :3, :3] @ p + X[i, :3, 3] for i, p in zip(solid, boxes, strict=True)]
    return np.array([*middles, model.tips(model.q0)[finger]])


def _joint_axes(model: MovableHand, finger: int) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) axes in H at `q0` and (K,) types of the joints that move along a finger."""
    tree, X = model.tree, model.poses(model.q0)
    joints = [i for i in model.fingers[finger] if tree.coupling[i].any()]
    return np.array([X[i, :3, :3] @ tree.axes[i] for i in joints]).reshape(-1, 3), tree.joint_types[joints]


def alike(model: MovableHand, a: int, b: int) -> bool:
    """Are two fingers built alike: the same joints, and the same distances between their parts?"""
    points = [_features(model, f) for f in (a, b)]
    types = [_joint_axes(model, f)[1] for f in (a, b)]
    if len(points[0]) != len(points[1]) or not np.array_equal(types[0], types[1]):
        return False
    lengths = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in points]
    return bool(np.allclose(lengths[0], lengths[1], atol=0.002 + 0.02 * lengths[0].max()))


def _symmetry_axis(model: MovableHand) -> tuple[np.ndarray, np.ndarray] | None:
    """Unit axis and a point on it of a rotation that moves every finger onto another one; None without one.

    Fingers of unequal length or build still count if their innermost links stand around an axis.
    """
    count = len(model.fingers)
    if count < 2:
        return None
    axes, types = zip(*(_joint_axes(model, f) for f in range(count)), strict=True)
    if not all(len(t) for t in types) or (count == 2 and types[0][-1] != REVOLUTE):
        return None
    points = [_features(model, f) for f in range(count)]
    if all(alike(model, 0, f) for f in range(1, count)):
        found = _common_axis(np.stack(points), np.stack(axes))
        if found is not None:
            return found
    if len({int(t[0]) for t in types}) > 1:
        return None
    return _common_axis(np.stack([p[:1] for p in points]), np.stack([a[:1] for a in axes]))


def _common_axis(points: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The axis for points (F, K, 3) and joint axes (F, M, 3) of F fingers."""
    count = len(points)
    offsets = points - points.mean(axis=0)  # a rotation's orbits lie in planes across its axis
    across = offsets.reshape(-1, 3)
    if count == 2:  # two points leave a turn open; the fingers bend about axes across the palm's
        across = np.concatenate([across, axes[0][-1:] * np.linalg.norm(across, axis=1).max()])
    axis = np.linalg.svd(across)[2][2]
    centre = points.mean(axis=(0, 1))
    for order in range(count, 1, -1):
        if count % order == 0 and _is_symmetry(points, axes, axis, centre, order):
            return axis, centre
    return None


def _is_symmetry(points: np.ndarray, axes: np.ndarray, axis: np.ndarray, centre: np.ndarray, order: int) -> bool:
    angle = 2 * np.pi / order
    K = np.cross(np.eye(3), axis)
    R = np.eye(3) - np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)  # rows of K are e_i x axis = -(axis x e_i)
    moved = (points - centre) @ R.T + centre
    error = np.linalg.norm(moved[:, None] - points[None], axis=3).max(axis=2)  # (F, F)
    target = error.argmin(axis=1)
    size = np.linalg.norm(points - centre, axis=2).max()
    if error.min(axis=1).max() > 0.002 + 0.03 * size or len(set(target)) < len(target):
        return False
    turned = np.abs(np.einsum("fki,fki->fk", axes @ R.T, axes[target]))
    return bool((target != np.arange(len(target))).all() and turned.min() > 0.98)


# -- closing, side, postures ---------------------------------------------------------


def _inward_senses(model: MovableHand, axis: np.ndarray, radial: np.ndarray) -> np.ndarray | None:
    """(J,) sign of each joint that bends (slides) a finger towards the axis if the palm faces along `axis`; else 0.

    A joint that moves several links counts by its innermost one: outer ones may turn back to stay parallel.
    """
    tree, X = model.tree, model.poses(model.q0)
    sense = np.zeros(tree.num_dofs)
    for f, finger in enumerate(model.fingers):
        bends = False
        for i in finger:
            outward = np.cross(axis, radial[f]) if tree.joint_types[i] == REVOLUTE else radial[f]
            share = float(outward @ X[i, :3, :3] @ tree.axes[i])
            for j in np.flatnonzero(tree.coupling[i]):
                if abs(share) > 0.7:
                    bends = True
                    if sense[j] == 0:
                        sense[j] = -np.sign(share * tree.coupling[i, j])
        if not bends:
            return None
    return sense


def _palm_side(model: MovableHand, axis: np.ndarray, inward: np.ndarray) -> tuple[float, float]:
    """+1 or -1 times `axis` is the palm's side, and how clear that is.

    Evidence: the tips' place relative to the palm link, and that joints bend further inwards than outwards.
    """
    tree, tips = model.tree, model.tips(model.q0)
    roots = np.array([model.poses(model.q0)[f[0], :3, 3] for f in model.fingers])
    length = max(float(np.linalg.norm(tips - roots, axis=1).max()), 1e-6)
    height = float((tips.mean(axis=0) - model.palm_centre(model.q0)) @ axis) / length
    bends = (inward != 0) & ~sliding_joints(tree)
    up, down = (tree.upper - model.q0)[bends], (model.q0 - tree.lower)[bends]
    excess = (inward[bends] * (up - down) / np.maximum(up + down, 1e-9)).mean() if bends.any() else 0.0
    score = TIPS_WEIGHT * float(np.clip(height, -1, 1)) + float(excess)
    return (1.0 if score >= 0 else -1.0), abs(score)


def _open_posture(
    model: MovableHand, contact: SelfContact, axis: np.ndarray, radial: np.ndarray, sense: np.ndarray
) -> np.ndarray:
    """Widest posture without collision in which the fingers lean outwards by `OPEN_TILT`, or as far as they do at zero.

    The joints at the fingers' roots open, all by the same angle; outer ones stay straight.
    """
    tree, ends = model.tree, np.where(sense > 0, model.tree.lower, model.tree.upper)
    closed = np.where(sense > 0, tree.upper, tree.lower)
    nearly_closed = np.abs(closed - model.q0) < 0.3 * (tree.upper - tree.lower)
    q = np.where((sense != 0) & (nearly_closed | sliding_joints(tree)), ends, model.q0)
    first = [next(j for i in f for j in np.flatnonzero(tree.coupling[i]) if sense[j] != 0) for f in model.fingers]
    turning = np.array([j for j in sorted({int(j) for j in first}) if not sliding_joints(tree)[j]], int)
    if not len(turning):
        return q
    lowest = float((sense * ends)[turning].max())  # inward angles, common to all fingers
    highest = float((sense * closed)[turning].min())
    limit = float(np.clip(_tilt(model, axis, radial, model.q0), OPEN_TILT, FLAT_TILT)) + 1e-6
    angles = np.unique(np.append(np.linspace(lowest, highest, _STEPS), np.clip(0.0, lowest, highest)))
    for angle in angles:
        q[turning] = sense[turning] * angle
        if _tilt(model, axis, radial, q) <= limit and contact.depth(q) <= ALLOWED_DEPTH:
            return q
    q[turning] = model.q0[turning]
    return q


def _tilt(model: MovableHand, axis: np.ndarray, radial: np.ndarray, q: np.ndarray) -> float:
    """Largest outward lean of a finger from its root to its tip, radians; negative inwards."""
    X = model.poses(q)
    roots = np.array([X[_first_moving(model, f), :3, 3] for f in range(len(model.fingers))])
    reach = model.tips(q) - roots
    return float(np.arctan2((reach * radial).sum(axis=1), reach @ axis).max())


def _first_moving(model: MovableHand, finger: int) -> int:
    links: Sequence[int] = model.fingers[finger]
    return next((i for i in links if model.tree.coupling[i].any()), links[0])
