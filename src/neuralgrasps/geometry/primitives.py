"""Closed triangle meshes of boxes, spheres, capsules, cylinders (centred, axis along z) and convex hulls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from neuralgrasps.errors import MeshError
from neuralgrasps.geometry.mesh_topology import Mesh

FloatArray = NDArray[np.float64]


def box_mesh(half: ArrayLike) -> Mesh:
    """Box of half sizes (3,): 8 vertices, 12 faces."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(signs * np.asarray(half, dtype=np.float64), faces)


def _revolve(radii: FloatArray, heights: FloatArray, segments: int) -> Mesh:
    """Revolve a profile from the bottom pole to the top pole about z; the first and last radius are 0 (the poles)."""
    angle = np.arange(segments) * (2 * np.pi / segments)
    rings = len(radii) - 2
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring_xy = radii[1:-1, None, None] * circle
    ring_z = np.broadcast_to(heights[1:-1, None, None], (rings, segments, 1))
    vertices = np.concatenate(
        [[[0, 0, heights[0]]], np.concatenate([ring_xy, ring_z], axis=2).reshape(-1, 3), [[0, 0, heights[-1]]]]
    )
    i = np.arange(segments)
    j = (i + 1) % segments
    top = len(vertices) - 1
    faces = [np.stack([np.zeros_like(i), 1 + j, 1 + i], axis=1)]
    for ring in range(rings - 1):
        low, high = 1 + ring * segments, 1 + (ring + 1) * segments
        faces += [np.stack([low + i, low + j, high + j], axis=1), np.stack([low + i, high + j, high + i], axis=1)]
    last = 1 + (rings - 1) * segments
    faces.append(np.stack([last + i, last + j, np.full_like(i, top)], axis=1))
    return Mesh(vertices, np.concatenate(faces))


def sphere_mesh(radius: float, *, segments: int = 32) -> Mesh:
    """Sphere with vertices on the surface, `segments` around and segments / 2 from pole to pole."""
    polar = np.linspace(0, np.pi, segments // 2 + 1)
    return _revolve(radius * np.sin(polar), -radius * np.cos(polar), segments)


def capsule_mesh(radius: float, half_length: float, *, segments: int = 32) -> Mesh:
    """Capsule along z: a cylinder of half length `half_length` between two half spheres."""
    if half_length == 0:  # two rings in one place would leave faces without area
        return sphere_mesh(radius, segments=segments)
    polar = np.linspace(0, np.pi / 2, segments // 4 + 1)
    low_r, low_z = radius * np.sin(polar), -half_length - radius * np.cos(polar)
    return _revolve(np.concatenate([low_r, low_r[::-1]]), np.concatenate([low_z, -low_z[::-1]]), segments)


def cylinder_mesh(radius: float, half_height: float, *, segments: int = 32) -> Mesh:
    """Cylinder along z of half height `half_height`; `segments` around."""
    return _revolve(np.array([0, radius, radius, 0.0]), half_height * np.array([-1, -1, 1, 1.0]), segments)


def convex_hull(points: ArrayLike) -> tuple[FloatArray, NDArray[np.int32]]:
    """Convex hull of (N, 3) points: (V, 3) vertices and (F, 3) faces wound counter-clockwise from outside.

    Raises:
        MeshError: fewer than 4 points, or all points in one plane.
    """
    p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(p) < 4 or not np.isfinite(p).all():
        raise MeshError(f"convex_hull got {len(p)} points; expected at least 4 finite ones.")
    centre = p.mean(axis=0)
    try:
        hull = ConvexHull(p - centre)
    except QhullError as error:
        raise MeshError("convex_hull: the points lie in one plane; expected points that enclose a volume.") from error
    triangles = hull.simplices
    a, b, c = (hull.points[triangles[:, k]] for k in range(3))
    flip = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles = np.where(flip[:, None], triangles[:, [0, 2, 1]], triangles)
    used = np.unique(triangles)
    index = np.zeros(len(p), dtype=np.int32)
    index[used] = np.arange(len(used), dtype=np.int32)
    return p[used], index[triangles]


def hull_planes(vertices: ArrayLike, faces: ArrayLike) -> FloatArray:
    """Distinct face planes of a convex mesh: (P, 4) rows (n, d), n unit and outward, n . x + d <= 0 inside."""
    v, f = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    a, b, c = (v[f[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    solid = length > 1e-9 * length.max()
    normal = cross[solid] / length[solid, None]
    offset = -np.einsum("ij,ij->i", normal, a[solid])
    extent = max(float(np.ptp(v, axis=0).max()), 1e-12)
    _, first = np.unique(np.round(np.column_stack([normal, offset / extent]), 9), axis=0, return_index=True)
    return np.column_stack([normal, offset])[np.sort(first)]
