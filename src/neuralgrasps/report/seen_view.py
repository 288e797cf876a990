"""Where to look from so that a grasp is seen: the hand before the object, and what it touches turned to the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.geometry.camera import Intrinsics, pixel_rays
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.views import frame_camera, view_direction

Posed = tuple[Hand, np.ndarray, np.ndarray]
"""A hand, X_OH (4, 4) and q (J,)."""

_SIZE = (72, 54)
_DIRECTIONS = tuple(
    view_direction(azimuth + shift, elevation)
    for elevation, shift in ((14, 10), (30, 32), (50, 10))
    for azimuth in range(0, 360, 45)
)
_WEIGHTS = np.array([1.2, 0.5, 1.3, 0.5])  # hand, all of it unhidden, map of the bare object, map beside the hand
_PLEASING_RAD, _SPREAD_RAD, _PLEASING_WEIGHT = 0.45, 0.4, 0.25
_QUERY = 2.0  # the query counts so many times a grasp that is compared with it


def seen_direction(
    obj: ObjectModel, cards: Sequence[tuple[np.ndarray, Posed | None]], X_UO: np.ndarray | None = None
) -> np.ndarray:
    """One direction towards the camera, above the horizon, for all cards: what is seen of hands and contact maps.

    Hand and object are drawn small from 24 sides; in each, the hand's pixels that the object does not hide are counted,
    and the contact map on the object alone and beside the hand.

    Args:
        cards: the query first: contact map (P,) at `obj.points_O`, and its hand where it is one.
        X_UO: (4, 4) the object in a frame whose z is up; None: its own z is up.
    Returns:
        (3,) unit vector, in the upright frame.
    """
    X = np.eye(4) if X_UO is None else X_UO
    bare, tree = obj.mesh.transformed(X), KDTree(obj.points_O @ X[:3, :3].T + X[:3, 3])
    maps = [np.asarray(closeness, float) ** 2 for closeness, _ in cards]
    alone = [_mapped(bare, maps, tree, direction) for direction in _DIRECTIONS]
    score = np.zeros(len(_DIRECTIONS))
    for k, (_, posed) in enumerate(cards):
        seen = np.array([[0.0, 0.0, one[k], one[k]] for one in alone])
        if posed is not None:
            hand, X_OH, q = posed
            parts = [part.transformed(X @ X_OH) for part in hand_part_meshes(hand, q, segments=8)]
            for d, direction in enumerate(_DIRECTIONS):
                seen[d, [0, 1, 3]] = _beside(parts, bare, maps[k], tree, direction)
        shares = np.sqrt(seen / np.maximum(seen.max(axis=0), 1e-9))
        score += (_QUERY if k == 0 else 1.0) * (shares @ _WEIGHTS)
    elevation = np.array([math.asin(d[2]) for d in _DIRECTIONS])
    pleasing = np.exp(-(((elevation - _PLEASING_RAD) / _SPREAD_RAD) ** 2))
    score = score / (_QUERY + len(cards) - 1) + _PLEASING_WEIGHT * pleasing
    return _DIRECTIONS[int(np.argmax(score))]


def _mapped(bare: Mesh, maps: Sequence[np.ndarray], tree: KDTree, direction: np.ndarray) -> list[float]:
    """Of each map (P,), how much a view of the object alone shows, in pixels."""
    X_WC, intrinsics = frame_camera(bare.vertices, direction, _SIZE)
    image = rasterise([bare], np.linalg.inv(X_WC)[None], intrinsics)
    nearest = tree.query(_points(image.depth, image.mesh_index == 0, X_WC, intrinsics))[1]
    return [float(values[nearest].sum()) for values in maps]


def _beside(
    parts: Sequence[Mesh], bare: Mesh, values: np.ndarray, tree: KDTree, direction: np.ndarray
) -> tuple[float, float, float]:
    """Pixels of the hand that are seen, the share of it that the object does not hide, and what is seen of the map."""
    meshes = [*parts, bare]
    X_WC, intrinsics = frame_camera(np.concatenate([m.vertices for m in meshes]), direction, _SIZE)
    X_CW = np.tile(np.linalg.inv(X_WC), (len(meshes), 1, 1))
    image = rasterise(meshes, X_CW, intrinsics)
    of_object = image.mesh_index == len(parts)
    seen = int((image.mesh_index >= 0).sum() - of_object.sum())
    whole = int((rasterise(parts, X_CW[:-1], intrinsics).mesh_index >= 0).sum())
    nearest = tree.query(_points(image.depth, of_object, X_WC, intrinsics))[1]
    return float(seen), seen / max(whole, 1), float(values[nearest].sum())


def _points(depth: np.ndarray, mask: np.ndarray, X_WC: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(M, 3) world points of the pixels in `mask`."""
    points_C = pixel_rays(intrinsics)[mask] * depth[mask][:, None]
    return np.asarray(points_C @ X_WC[:3, :3].T + X_WC[:3, 3])
