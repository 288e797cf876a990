"""Geometric quality of grasps, measured against the true mesh rather than the grid that made them."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel

_NEAR_M = 0.006  # points farther outside by the grid cannot be inside the mesh


def measured_penetration(hand: Hand, obj: ObjectModel, grasps: GraspSet, *, spacing: float = 0.004) -> np.ndarray:
    """Deepest hand surface point inside the object's mesh, per grasp.

    Args:
        hand, obj: what `grasps` was made for. spacing: of the hand's surface points, metres.
    Returns:
        (N,) float64 metres, 0 = no point inside; exact distances to the mesh.
    """
    surface = sample_hand_surface(hand, spacing=spacing)
    X_OL = grasps.X_OH[:, None] @ forward_fast(hand.tree, grasps.q)
    X = X_OL[:, surface.links]
    points_O = (X[..., :3, :3] @ surface.points_L[..., None])[..., 0] + X[..., :3, 3]
    near = query_grid_numpy(obj.sdf, points_O) < _NEAR_M
    depth = np.zeros(points_O.shape[:2])
    if near.any():
        depth[near] = -signed_distance(obj.mesh, points_O[near])
    return np.maximum(depth.max(axis=1, initial=0.0), 0.0)
