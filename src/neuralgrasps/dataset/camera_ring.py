"""Virtual cameras all around an object, and what they see of it. Torch-free."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh, face_areas_normals
from neuralgrasps.geometry.raster import rasterise

VIEWS = 128
WIDTH, HEIGHT, FOV_Y_RAD = 320, 240, math.radians(45.0)
_STEP = 1.25  # of the rings' sizes
_MARGIN = 1.02  # the scene's ball is this much smaller than what a camera sees of it


def ring_intrinsics() -> Intrinsics:
    """320 x 240 pixels, 45 degrees high."""
    return Intrinsics.from_fov(FOV_Y_RAD, WIDTH, HEIGHT)


def even_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly over the sphere: a Fibonacci spiral (Swinbank & Purser 2006)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.arange(count) * (math.pi * (3.0 - math.sqrt(5.0)))
    around = np.sqrt(1.0 - z**2)
    return np.stack([around * np.cos(angle), around * np.sin(angle), z], axis=1)


def ring_level(reach_m: float, base_m: float) -> int:
    """The smallest k >= 0 for which a ball of `base_m` * 1.25^k holds one of `reach_m`."""
    level = max(0, math.ceil(math.log(max(reach_m / base_m, 1.0)) / math.log(_STEP)))
    return level if base_m * _STEP**level >= reach_m else level + 1  # log rounds


def ring_poses(centre_O: np.ndarray, base_m: float, level: int) -> np.ndarray:
    """X_OC (128, 4, 4): cameras that look at `centre_O` and have the ball of `base_m` * 1.25^`level` in view.

    Directions are fixed in the object frame, so that what they see of an object is rendered once for many scenes.
    """
    distance = _MARGIN * base_m * _STEP**level / math.sin(0.5 * FOV_Y_RAD)
    return np.stack([look_at(centre_O + distance * d, centre_O) for d in even_directions(VIEWS)])


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectViews:
    """What each camera of a ring sees of an object alone, cut to the pixels around it.

    Attributes:
        X_OC: (V, 4, 4) cameras.
        boxes: (V, 4) int64 first and one-past-last row and column of each cut; starts: (V + 1,) int64.
        depth: float32 z-depths, metres, inf beside the object; those of view v, row by row, at starts[v]:starts[v + 1].
        face: int32, alike: the face seen; -1 beside the object, -2 where the back of a face is seen.
    """

    X_OC: np.ndarray
    boxes: np.ndarray
    starts: np.ndarray
    depth: np.ndarray
    face: np.ndarray


def object_views(mesh: Mesh, X_OC: np.ndarray) -> ObjectViews:
    """Render a mesh by every camera X_OC (V, 4, 4) of a ring."""
    intrinsics = ring_intrinsics()
    normals_O = face_areas_normals(mesh)[1]
    offset = np.einsum("fk,fk->f", normals_O, mesh.vertices[mesh.faces[:, 0]])
    boxes, depths, faces = np.zeros((len(X_OC), 4), np.int64), [], []
    for view, X in enumerate(X_OC):
        image = rasterise([mesh], np.linalg.inv(X)[None], intrinsics)
        hit = image.face_index >= 0
        rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
        if len(rows):
            boxes[view] = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
        cut = np.s_[boxes[view, 0] : boxes[view, 1], boxes[view, 2] : boxes[view, 3]]
        behind = normals_O @ X[:3, 3] <= offset
        face = image.face_index[cut]
        faces.append(np.where((face >= 0) & behind[face], -2, face).ravel())
        depths.append(image.depth[cut].ravel())
    return ObjectViews(
        X_OC=X_OC,
        boxes=boxes,
        starts=np.cumsum([0] + [len(d) for d in depths]),
        depth=np.concatenate(depths),
        face=np.concatenate(faces).astype(np.int32),
    )
