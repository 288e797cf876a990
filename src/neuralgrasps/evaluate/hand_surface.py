"""How far the surface of a fitted hand is from the true one."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.hands.surface import HandSurface, sample_hand_surface
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.seen import FittedHand, Side
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

_SPACING_M = 0.004
_INSIDE_M = 1e-4


def posed_surface(side: Side, scale: float, X_CH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(K, 3) points all over a human hand of a size, 4 mm apart at size 1, camera frame, metres.

    Points of one link that lie inside another, as at the thumb's root, are not on the hand's surface: left out.
    """
    surface = _surface(side)
    X_HL = forward_numpy(human_hand(side).tree, q)[surface.links]
    points_H = scale * ((X_HL[:, :3, :3] @ surface.points_L[:, :, None])[..., 0] + X_HL[:, :3, 3])
    points_H = points_H[_distances(scaled_hand(human_hand(side), scale), np.eye(4), q, points_H) > -_INSIDE_M]
    return np.asarray(points_H @ X_CH[:3, :3].T + X_CH[:3, 3])


def surface_rms(fitted: FittedHand, true_points_C: np.ndarray) -> float:
    """Root mean square distance of points (K, 3) of the true surface to the fitted hand's surface, metres."""
    return float(np.sqrt(np.mean(_distances(fitted.hand, fitted.X_CH, fitted.q, true_points_C) ** 2)))


def _distances(hand: Hand, X_CH: np.ndarray, q: np.ndarray, points_C: np.ndarray) -> np.ndarray:
    """(K,) signed distances of points to a posed hand."""
    out = np.empty(len(points_C))
    pose, posture, points = (np.array(a, np.float64) for a in (X_CH, q, points_C))  # compiled for writable arrays
    hand_distance_many(pack_shapes(hand), pose, posture, points, out)
    return out


@lru_cache(maxsize=4)
def _surface(side: Side) -> HandSurface:
    hand: Hand = human_hand(side)
    return sample_hand_surface(hand, spacing=_SPACING_M)
