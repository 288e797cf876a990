"""Where to look from: cameras that fill the frame, and the direction that shows a grasp best."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.raster import rasterise

FOV_Y_RAD = math.radians(26.0)  # long lens: little distortion, as in product photographs
_CONTACT_ZONE_M = 0.012
_UP = (0.0, 0.0, 1.0)


def view_direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """(3,) unit vector from the scene towards the camera; azimuth counts from x to y, elevation from the horizon."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def upright(up_O: np.ndarray) -> np.ndarray:
    """(4, 4) X_UO: the object turned by the smallest angle so that `up_O` becomes z."""
    a = np.asarray(up_O, float) / np.linalg.norm(up_O)
    X = np.eye(4)
    if a[2] < -1 + 1e-9:
        X[:3, :3] = np.diag([1.0, -1.0, -1.0])
        return X
    v = np.cross(a, [0.0, 0.0, 1.0])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    X[:3, :3] = np.eye(3) + cross + cross @ cross / (1 + a[2])
    return X


def frame_camera(
    points: np.ndarray, direction: np.ndarray, size: tuple[int, int], *, margin: float = 0.07
) -> tuple[np.ndarray, Intrinsics]:
    """The nearest camera in a direction that sees all points.

    Args:
        points: (M, 3) world, metres.
        direction: (3,) from the scene towards the camera.
        size: width and height of the picture, pixels.
        margin: free border as a share of the half picture, 0..1.
    Returns:
        X_WC (4, 4) and its intrinsics. Exact: the points touch the border of the margin on two opposite sides.
    """
    points = np.asarray(points, np.float64)
    if len(points) == 0:
        raise InputError("there is nothing to look at: the picture has no points.")
    intrinsics = Intrinsics.from_fov(FOV_Y_RAD, *size)
    R_WC = look_at(np.asarray(direction, np.float64), np.zeros(3), _UP)[:3, :3]
    x, y, z = (points @ R_WC).T
    tan_y = math.tan(0.5 * FOV_Y_RAD) * (1 - margin)
    tan_x = tan_y * size[0] / size[1]
    # |x - cx| <= tan_x (z + d) for all points is linear in (cx, d); the same in y.
    right, left = (x - tan_x * z).max(), (-x - tan_x * z).max()
    below, above = (y - tan_y * z).max(), (-y - tan_y * z).max()
    distance = max((right + left) / (2 * tan_x), (below + above) / (2 * tan_y))
    X_WC = np.eye(4)
    X_WC[:3, :3] = R_WC
    X_WC[:3, 3] = R_WC @ [0.5 * (right - left), 0.5 * (below - above), -distance]
    return X_WC, intrinsics


def best_direction(hand_meshes: Sequence[Mesh], object_mesh: Mesh) -> np.ndarray:
    """Direction from which a grasp shows most: contacts first, then object and hand.

    Twenty-four candidates around the scene are drawn small; each counts the visible pixels of the object near the
    hand, of the hand near the object, of the object and of the hand.

    Returns:
        (3,) unit vector from the scene towards the camera.
    """
    hand_points = np.concatenate([mesh.vertices[mesh.faces].mean(axis=1) for mesh in hand_meshes])
    object_points = object_mesh.vertices[object_mesh.faces].mean(axis=1)
    near_object = KDTree(object_points).query(hand_points, distance_upper_bound=_CONTACT_ZONE_M)[0]
    near_hand = KDTree(hand_points).query(object_points, distance_upper_bound=_CONTACT_ZONE_M)[0]
    scene = merge_meshes([*hand_meshes, object_mesh])
    is_contact = np.isfinite(np.concatenate([near_object, near_hand]))
    is_object = np.arange(len(scene.faces)) >= len(hand_points)
    candidates = [view_direction(a, e) for e, shift in ((12, 10), (26, 32), (42, 10)) for a in range(shift, 360, 45)]
    counts = np.array([_visible(scene, direction, is_contact, is_object) for direction in candidates], np.float64)
    shares = counts / np.maximum(counts.max(axis=0), 1.0)
    pleasing = np.array([math.exp(-(((math.asin(d[2]) - 0.42) / 0.35) ** 2)) for d in candidates])
    # Square roots favour views that show a little of everything over those that show one thing alone.
    score = np.sqrt(shares) @ [1.0, 0.7, 1.1, 0.5] + 0.4 * pleasing
    return candidates[int(np.argmax(score))]


def best_surface_direction(mesh: Mesh, values: np.ndarray) -> np.ndarray:
    """Direction from which most of the high `values` (V,) on a mesh are seen, weighted by their size."""
    weight = np.nan_to_num(values)[mesh.faces].mean(axis=1)
    best, best_score = view_direction(35, 25), -1.0
    for elevation in (18, 38):
        for azimuth in range(15, 375, 30):
            direction = view_direction(azimuth, elevation)
            X_WC, intrinsics = frame_camera(mesh.vertices, direction, (64, 64))
            face = rasterise([mesh], np.linalg.inv(X_WC)[None], intrinsics).face_index
            seen = face[face >= 0]
            score = float((weight[seen] ** 2).sum()) + 1e-3 * len(seen)
            if score > best_score * 1.0001:
                best, best_score = direction, score
    return best


def _visible(scene: Mesh, direction: np.ndarray, is_contact: np.ndarray, is_object: np.ndarray) -> list[int]:
    """Pixels of: object at contacts, hand at contacts, object, hand."""
    X_WC, intrinsics = frame_camera(scene.vertices, direction, (80, 60))
    face = rasterise([scene], np.linalg.inv(X_WC)[None], intrinsics).face_index
    face = face[face >= 0]
    contact, of_object = is_contact[face], is_object[face]
    return [
        int((contact & of_object).sum()),
        int((contact & ~of_object).sum()),
        int(of_object.sum()),
        int((~of_object).sum()),
    ]
