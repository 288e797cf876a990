"""Where pose scenes take place: a table in a room, and a camera that looks at what stands on it."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh, box_mesh, merge_meshes
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix

CAMERA = Intrinsics.from_fov(np.deg2rad(45.0), 640, 480)
"""The camera of the scenes: 640 x 480, 45 degrees high."""
_TABLE_HEIGHT_M = 0.72
_SLAB_M = 0.03
_ROOM_M = 6.0


def random_room(rng: np.random.Generator, X_WC: np.ndarray, *, table: bool = True) -> Mesh:
    """A table about the origin with its top at z = 0, a floor 0.72 m below, and a wall beyond, as one mesh in W.

    The table measures 0.9 to 1.6 m by 0.8 to 1.2 m; no edge is nearer than 0.35 m to the origin. The wall is 1 to
    2.5 m from the origin, on the far side as seen from the camera, turned by up to 40 degrees.
    """
    parts = [_sheet([0.0, 0.0, -_TABLE_HEIGHT_M], [1, 0, 0], [0, 1, 0])]
    away = -X_WC[:2, 3] / max(float(np.linalg.norm(X_WC[:2, 3])), 1e-9)
    angle = np.arctan2(away[1], away[0]) + np.deg2rad(rng.uniform(-40.0, 40.0))
    facing = np.array([np.cos(angle), np.sin(angle), 0.0])
    parts.append(_sheet(rng.uniform(1.0, 2.5) * facing, [-facing[1], facing[0], 0.0], [0, 0, 1]))
    half = 0.5 * rng.uniform([0.9, 0.8], [1.6, 1.2])
    spin, offset = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-1.0, 1.0, 2) * (half - 0.35)
    if table:
        X = make_transform_np(rpy_matrix([0.0, 0.0, spin]))
        X[:3, 3] = X[:3, :3] @ [*offset, -0.5 * _SLAB_M]
        parts.append(box_mesh([*half, 0.5 * _SLAB_M]).transformed(X))
    return merge_meshes(parts)


def random_view(
    centre_W: np.ndarray,
    radius_m: float,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    *,
    elevation_deg: tuple[float, float] = (25.0, 65.0),
) -> np.ndarray:
    """A camera pose X_WC 0.5 to 1.2 m from `centre_W` (3,), at a random azimuth, its target off by up to 8 %.

    The ball of `radius_m` about the centre stays in the image: the target moves less, and the camera farther off,
    where it would not.
    """
    half_fov = np.arctan(0.5 * min(intrinsics.width / intrinsics.fx, intrinsics.height / intrinsics.fy))
    distance = max(rng.uniform(0.5, 1.2), 1.05 * radius_m / np.sin(half_fov))
    around, up = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(*elevation_deg))
    eye = centre_W + distance * np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
    slack = distance * np.tan(half_fov - np.arcsin(min(radius_m / distance, 1.0)))
    jitter = rng.uniform(-1.0, 1.0, 3) * min(0.08 * distance, max(slack, 0.0) / np.sqrt(3.0))
    return look_at(eye, centre_W + jitter)


def _sheet(centre: list[float] | np.ndarray, along: list[float] | np.ndarray, across: list[float] | np.ndarray) -> Mesh:
    """A large square about `centre`, spanned by two unit vectors."""
    a, b = _ROOM_M * np.asarray(along, float), _ROOM_M * np.asarray(across, float)
    corners = np.asarray(centre, float) + np.stack([-a - b, a - b, a + b, -a + b])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
