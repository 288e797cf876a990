"""Geometric quality of grasps, measured against the true mesh rather than the grid that made them."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import HandSurface, sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel

_CHUNK = 64  # grasps measured at a time, for memory
_NEAR_M = 0.006  # points farther outside by the grid cannot be inside the mesh


def measured_penetration(hand: Hand, obj: ObjectModel, grasps: GraspSet, *, spacing: float = 0.004) -> np.ndarray:
    """Deepest hand surface point inside the object's mesh, per grasp.

    Args:
        hand, obj: what `grasps` was made for. spacing: of the hand's surface points, metres.
    Returns:
        (N,) float64 metres, 0 = no point inside; exact distances to the mesh.
    """
    surface = sample_hand_surface(hand, spacing=spacing)
    depth = np.zeros(len(grasps))
    for first in range(0, len(grasps), _CHUNK):
        part = slice(first, first + _CHUNK)
        depth[part] = _depths(hand, surface, obj, grasps.X_OH[part], grasps.q[part])
    return depth


def _depths(hand: Hand, surface: HandSurface, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    X = (X_OH[:, None] @ forward_fast(hand.tree, q))[:, surface.links]
    points_O = (X[..., :3, :3] @ surface.points_L[..., None])[..., 0] + X[..., :3, 3]
    near = query_grid_numpy(obj.sdf, points_O) < _NEAR_M
    depth = np.zeros(points_O.shape[:2])
    if near.any():
        depth[near] = -signed_distance(obj.mesh, points_O[near])
    return np.maximum(depth.max(axis=1, initial=0.0), 0.0)
