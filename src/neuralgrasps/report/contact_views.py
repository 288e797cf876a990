"""Where to look from to see what a grasp does: the direction that shows most of its contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.geometry.camera import pixel_rays
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.report.views import frame_camera, view_direction

ZONE_M = 0.016  # what lies nearer to a contact than this shows the contact
_SIZE = (96, 72)
_CANDIDATES = tuple(
    view_direction(azimuth, elevation)
    for elevation, shift, step in ((8, 0, 30), (24, 15, 30), (42, 0, 30), (56, 20, 60))
    for azimuth in range(shift, 360 + shift, step)
)
_PLEASING_RAD, _SPREAD_RAD = 0.38, 0.36  # elevation at which things look best, and how far from it they still do
_WEIGHTS = np.array([1.9, 1.1, 0.7, 0.5])  # fingers at contacts, object at contacts, object, hand
_PLEASING_WEIGHT = 0.8
_ENOUGH = 0.5  # of the most that any view shows of a contact


def contact_direction(
    hand_meshes: Sequence[Mesh],
    fingers: Sequence[int],
    object_mesh: Mesh,
    contacts: np.ndarray,
    contact_fingers: np.ndarray,
) -> np.ndarray:
    """Direction from which most of each touching finger, and of the object below it, is seen near their contacts.

    Forty-two views are drawn small. Every finger that touches counts alike, however large its contact.

    Args:
        hand_meshes: K meshes, world frame, z up; fingers: the finger of each, -1 for the palm.
        object_mesh: world frame.
        contacts: (C, 3) contact points, world; contact_fingers: (C,) the finger of each, -1 for the palm.
    Returns:
        (3,) unit vector from the scene towards the camera.
    """
    meshes = [*hand_meshes, object_mesh]
    owner = np.append(np.asarray(fingers, int), _OBJECT)
    points = np.concatenate([m.vertices for m in meshes])
    tree = KDTree(contacts) if len(contacts) else None
    seen = [_seen(meshes, owner, points, d, tree, np.asarray(contact_fingers, int)) for d in _CANDIDATES]
    touching = np.unique(contact_fingers)
    of_finger = _mean_share(np.array([[s[0].get(int(f), 0) for f in touching] for s in seen], float))
    of_object = _mean_share(np.array([[s[1].get(int(f), 0) for f in touching] for s in seen], float))
    in_all = np.sqrt(_share(np.array([s[2] for s in seen], float)))
    elevation = np.array([math.asin(d[2]) for d in _CANDIDATES])
    pleasing = np.exp(-(((elevation - _PLEASING_RAD) / _SPREAD_RAD) ** 2))
    score = np.column_stack([of_finger, of_object, in_all]) @ _WEIGHTS + _PLEASING_WEIGHT * pleasing
    return _CANDIDATES[int(np.argmax(score))]


_OBJECT = -2
_Count = dict[int, int]


def _seen(
    meshes: Sequence[Mesh], owner: np.ndarray, points: np.ndarray, direction: np.ndarray, tree: KDTree | None,
    contact_fingers: np.ndarray,
) -> tuple[_Count, _Count, tuple[int, int]]:  # fmt: skip
    """Pixels of each finger near its own contacts, of the object near them, and of object and hand in all."""
    X_WC, intrinsics = frame_camera(points, direction, _SIZE)
    image = rasterise(meshes, np.tile(np.linalg.inv(X_WC), (len(meshes), 1, 1)), intrinsics)
    hit = image.mesh_index >= 0
    of = owner[image.mesh_index[hit]]
    total = (int((of == _OBJECT).sum()), int((of != _OBJECT).sum()))
    if tree is None:
        return {}, {}, total
    points_C = (pixel_rays(intrinsics) * image.depth[..., None])[hit]
    distance, nearest = tree.query(points_C @ X_WC[:3, :3].T + X_WC[:3, 3], distance_upper_bound=ZONE_M)
    near = np.isfinite(distance)
    finger, of = contact_fingers[nearest[near]], of[near]
    return _counted(finger[of == finger]), _counted(finger[of == _OBJECT]), total


def _counted(values: np.ndarray) -> _Count:
    return dict(zip(*(a.tolist() for a in np.unique(values, return_counts=True)), strict=True))


def _share(counts: np.ndarray) -> np.ndarray:
    """Counts (D, K) of D directions over the largest of each column."""
    return counts / np.maximum(counts.max(axis=0), 1.0)


def _mean_share(counts: np.ndarray) -> np.ndarray:
    """(D,) mean of the columns' square roots, and a third of the least: a little of each finger beats all of one."""
    if counts.shape[1] == 0:
        return np.zeros(len(counts))
    roots = np.sqrt(np.minimum(_share(counts) / _ENOUGH, 1.0))
    return roots.mean(axis=1) + roots.min(axis=1) / 3
