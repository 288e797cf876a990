"""How far the surface of a fitted hand is from the true one."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.hands.surface import HandSurface, sample_hand_surface
from neuralgrasps.human.seen import FittedHand, Side
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

_SPACING_M = 0.004


def posed_surface(side: Side, scale: float, X_CH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(K, 3) points all over a human hand of a size, 4 mm apart at size 1, camera frame, metres."""
    surface = _surface(side)
    X_HL = forward_numpy(human_hand(side).tree, q)[surface.links]
    points_H = scale * ((X_HL[:, :3, :3] @ surface.points_L[:, :, None])[..., 0] + X_HL[:, :3, 3])
    return np.asarray(points_H @ X_CH[:3, :3].T + X_CH[:3, 3])


def surface_rms(fitted: FittedHand, true_points_C: np.ndarray) -> float:
    """Root mean square distance of points (K, 3) of the true surface to the fitted hand's surface, metres."""
    out = np.empty(len(true_points_C))
    shapes, points = pack_shapes(fitted.hand), np.ascontiguousarray(true_points_C, np.float64)
    hand_distance_many(shapes, np.ascontiguousarray(fitted.X_CH), np.ascontiguousarray(fitted.q), points, out)
    return float(np.sqrt(np.mean(out**2)))


@lru_cache(maxsize=4)
def _surface(side: Side) -> HandSurface:
    hand: Hand = human_hand(side)
    return sample_hand_surface(hand, spacing=_SPACING_M)
