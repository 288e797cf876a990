"""Geometric quality of grasps, measured against the true mesh rather than the grid that made them."""

from __future__ import annotations

import numpy as np

from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.grasps.penetration import mesh_depths, object_depths
from neuralgrasps.grasps.probe_points import probe_hand, probe_surface
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel


def measured_penetration(hand: Hand, obj: ObjectModel, grasps: GraspSet, *, spacing: float = 0.002) -> np.ndarray:
    """Deepest overlap of hand and object found at points of either surface, per grasp.

    Points of the hand are measured against the object's mesh and points of the mesh against the hand's parts; both lie
    about `spacing` apart, with rows along sharp edges. The distances are exact, but the depth is a lower bound: what
    dips in between the points is missed. Overlap of the hand with itself is not measured.

    Args:
        hand, obj: what `grasps` was made for. spacing: of the points, metres.
    Returns:
        (N,) float64 metres, 0 = no point inside.
    """
    if len(grasps) == 0:
        return np.zeros(0)
    packed, probe = probe_hand(hand, spacing=spacing), probe_surface(obj.mesh, spacing=spacing)
    X_OH, q = grasps.X_OH, grasps.q
    return np.maximum(
        mesh_depths(packed, obj.mesh, obj.sdf, X_OH=X_OH, q=q), object_depths(packed, probe, X_OH=X_OH, q=q)
    )
