"""Exact signed distance from points to a triangle mesh (libigl)."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.mesh_topology import Mesh, face_areas_normals, face_bodies, is_manifold

FloatArray = NDArray[np.float64]


def signed_distance(mesh: Mesh, points: ArrayLike) -> FloatArray:
    """Signed distance of points (M, 3) to the surface, metres, negative inside; (M,) float64.

    The magnitude is exact. The sign is the pseudonormal's (Baerentzen & Aanaes 2005) for a closed manifold of one body,
    else the winding number's (Barill et al. 2018: approximate to 0.01, only its side of 1/2 is used), which is
    right for open seams, small holes and overlapping bodies. Inside overlapping bodies the magnitude is the distance to
    the nearest triangle of any body. Uses all cores.
    """
    p = _as_points(points)
    if not len(p):
        return np.zeros(0)
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int64)
    if has_exact_pseudonormals(mesh):
        return igl.signed_distance(p, vertices, faces, sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[0]
    return np.where(contains(mesh, p), -1.0, 1.0) * unsigned_distance(mesh, p)


def unsigned_distance(mesh: Mesh, points: ArrayLike) -> FloatArray:
    """Distance of points (M, 3) to the surface, metres; (M,) float64, exact."""
    return np.sqrt(closest_points(mesh, points)[0])


def closest_points(mesh: Mesh, points: ArrayLike) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """For points (M, 3): (M,) squared distance, (M,) nearest face and (M, 3) nearest surface point."""
    p = _as_points(points)
    if not len(p):
        return np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    return igl.point_mesh_squared_distance(p, mesh.vertices, mesh.faces.astype(np.int64))


def contains(mesh: Mesh, points: ArrayLike) -> NDArray[np.bool_]:
    """(M,) whether points (M, 3) are inside: winding number over 1/2."""
    p = _as_points(points)
    if not len(p):
        return np.zeros(0, dtype=bool)
    return igl.fast_winding_number(mesh.vertices, mesh.faces.astype(np.int64), p) > 0.5


def has_exact_pseudonormals(mesh: Mesh) -> bool:
    """Whether the sign may be read off the surface's own normals: one closed manifold body, every face with area."""
    if not is_manifold(mesh) or face_bodies(mesh.faces, len(mesh.vertices))[0] != 1:
        return False
    areas, _ = face_areas_normals(mesh)
    return bool(areas.min() > 1e-14 * float(mesh.extents.max()) ** 2)


def _as_points(points: ArrayLike) -> FloatArray:
    p = np.ascontiguousarray(points, dtype=np.float64)
    check_shape("points", p.shape, (3,))
    return p.reshape(-1, 3)
