"""Start poses for hands with a thumb: thumb and fingers on the two ends of an antipodal pair of the object."""

from __future__ import annotations

import numpy as np

from neuralgrasps.hands.hand import Finger, Hand
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.kinematics.forward_kernels import forward_fast

_STEPS = 10  # postures between the preshape and the closed hand
_PAD_M = 0.008  # from the middle of a fingertip to its skin, about


def thumb_and_fingers(hand: Hand) -> tuple[Finger, tuple[Finger, ...]] | None:
    """The thumb and the fingers that it can oppose; None for hands without one."""
    thumb = [f for f in hand.fingers if f.is_thumb and f.links]
    others = tuple(f for f in hand.fingers if not f.is_thumb and f.links)
    return (thumb[0], others) if thumb and others else None


def tip_points(packed: PackedHand, finger: Finger) -> tuple[int, np.ndarray]:
    """The finger's outermost link that has a surface, and the middle of its points (3,) in the link's frame."""
    solid = [i for i in finger.links if packed.link_point_start[i] < packed.link_point_start[i + 1]]
    link = solid[-1] if solid else finger.links[-1]
    return link, packed.link_centre[link]


def opposition(
    hand: Hand, packed: PackedHand, q: np.ndarray, share: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where the tips of freely closing hands are when `width` fits between the thumb and the fingers.

    Args:
        q: (N, J) preshapes. share: (N, F) weights of the fingers that the thumb is to oppose, rows sum to 1.
        width: (N,) metres.
    Returns:
        thumb (N, 3) and finger (N, 3) points in H, whether (N,) the tips come that near, and the joints (N, J) then.
    """
    found = thumb_and_fingers(hand)
    assert found is not None
    thumb, fingers = found
    path = np.linspace(0.0, 1.0, _STEPS)[:, None] * _time_to_close(hand, q)[:, None, None] * hand.closing_rate
    closing = np.clip(q[:, None] + path, hand.tree.lower, hand.tree.upper)
    X_HL = forward_fast(hand.tree, closing)

    def tip(finger: Finger) -> np.ndarray:
        link, middle = tip_points(packed, finger)
        return X_HL[:, :, link, :3, :3] @ middle + X_HL[:, :, link, :3, 3]

    thumb_H = tip(thumb)
    fingers_H = sum(share[:, i, None, None] * tip(f) for i, f in enumerate(fingers))
    gap = np.linalg.norm(fingers_H - thumb_H, axis=-1) - 2.0 * _PAD_M - width[:, None]
    fits = gap[:, 0] > 0.0
    met = fits & (gap < 0.0).any(axis=1)
    step = np.where(met, (gap < 0.0).argmax(axis=1), 1)
    rows = np.arange(len(q))
    # between the last step that is too wide and the first that is too narrow
    before, after = gap[rows, step - 1], gap[rows, step]
    t = np.where(met, before / np.maximum(before - after, 1e-9), 0.0)[:, None]

    def between(points: np.ndarray) -> np.ndarray:
        return points[rows, step - 1] * (1.0 - t) + points[rows, step] * t

    return between(thumb_H), between(fingers_H), met, between(closing)


def _time_to_close(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(N,) time until the first closing joint meets its limit."""
    rate = hand.closing_rate
    end = np.where(rate > 0, hand.tree.upper, hand.tree.lower)
    moving = rate != 0
    return np.min((end - q)[:, moving] / rate[moving], axis=1)


def pose_on_pair(
    thumb_H: np.ndarray, fingers_H: np.ndarray, thumb_side_O: np.ndarray, finger_side_O: np.ndarray, roll: np.ndarray
) -> np.ndarray:
    """X_OH (N, 4, 4) that lay the line from thumb to fingers on the pair, middle on middle, turned by `roll` (N,)."""
    R_HA = _frames(fingers_H - thumb_H, np.zeros(len(roll)))
    R_OA = _frames(finger_side_O - thumb_side_O, roll)
    X_OH = np.tile(np.eye(4), (len(roll), 1, 1))
    R = R_OA @ R_HA.transpose(0, 2, 1)
    X_OH[:, :3, :3] = R
    X_OH[:, :3, 3] = 0.5 * (thumb_side_O + finger_side_O) - (R @ (0.5 * (thumb_H + fingers_H))[..., None])[..., 0]
    return X_OH


def _frames(x: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """(N, 3, 3) rotations whose first column is along `x` (N, 3), turned about it by `roll`."""
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    y = perpendicular(x, roll)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def perpendicular(axes: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Unit vectors perpendicular to unit `axes` (N, 3), turned about them by `angle` (N,) rad."""
    helper = np.where(np.abs(axes[:, :1]) < 0.7, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    u = np.cross(axes, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axes, u)
    return np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
