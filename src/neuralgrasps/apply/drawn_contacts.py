"""Contacts that someone drew on an object: where they lie on its surface, and how near a hand comes to them."""

from __future__ import annotations

import numpy as np

from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.mesh_distance import closest_points
from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.objects.object_model import ObjectModel

TOUCHED_M = 0.005
"""A drawn point is touched by a hand whose surface comes as near as this: half a fingertip's contact."""

_DECAY_M = 0.02


def on_surface(obj: ObjectModel, points_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) surface points nearest to points (M, 3), object frame, and how far these are off it, (M,) metres."""
    squared, _, nearest = closest_points(obj.mesh, points_O)
    return np.asarray(nearest), np.sqrt(squared)


def reach(hand: Hand, X_OH: np.ndarray, q: np.ndarray, points_O: np.ndarray) -> np.ndarray:
    """(N, M) distance of points (M, 3) to the surface of a hand in poses X_OH (N, 4, 4), q (N, J); metres, 0 inside."""
    check_shape("points_O", points_O.shape, (None, 3))
    closeness = contact_map_packed(points_O, pack_shapes(hand), X_OH, q, radius=_DECAY_M)
    return np.asarray(-_DECAY_M * np.log(np.maximum(closeness.astype(np.float64), 1e-30)))


def touched_text(distance_m: np.ndarray) -> str:
    """ "1 of 2", for the distances (M,) of drawn points to one grasp's hand."""
    return f"{int((distance_m <= TOUCHED_M).sum())} of {len(distance_m)}"
