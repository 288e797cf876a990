"""Convex parts that fill an object, for the physics simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import igl
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from neuralgrasps.errors import MeshError
from neuralgrasps.geometry.mesh import Mesh, is_manifold
from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_numpy
from neuralgrasps.objects.convex_split import Piece, halve, sample_triangles, split_solid

MAX_PARTS = 24
MAX_VERTICES = 64
_HULL_P95_M, _HULL_MAX_M = 0.001, 0.0025  # a hull this close needs no cutting
_TOLERANCE_M = 0.0015
_LOSS_M = 0.0006  # what a part may lose by its limit of vertices before it is halved
_SPLIT_FACES = 4000
_CLUSTER_SHARE = 0.015
_SAMPLES = 20000


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvexParts:
    """Hull vertices per part, and how well their union matches the surface.

    Attributes:
        vertices: (V, 3) per part, object frame.
        protrusion_p95_m, protrusion_max_m: how far the union's surface lies outside the object.
        gap_p95_m, gap_max_m: how far the object's surface lies outside the union.
        method: how they were made.
    """

    vertices: tuple[np.ndarray, ...]
    protrusion_p95_m: float
    protrusion_max_m: float
    gap_p95_m: float
    gap_max_m: float
    method: str


def make_convex_parts(mesh: Mesh, sdf: SdfGrid) -> ConvexParts:
    """The convex hull if 95 % of it is within 1 mm of the surface (all: 2.5 mm), else up to 24 parts cut by planes.

    Every part has at most 64 vertices, chosen among the hull's so that it loses as little as possible; large curved
    parts are halved while there is room.

    Raises:
        MeshError: the mesh is flat.
    """
    hull = [mesh.vertices[_hull(mesh.vertices).vertices]]
    samples = sample_triangles(_hull_triangles(hull[0]), _SAMPLES)
    outside = query_grid_numpy(sdf, samples)
    if float(np.quantile(outside, 0.95)) < _HULL_P95_M and float(outside.max()) < _HULL_MAX_M:
        return _measured(mesh, sdf, hull, "convex hull")
    pieces = split_solid(_decimated(mesh), sdf, tolerance_m=_TOLERANCE_M, max_parts=MAX_PARTS)
    corners = [p.corners for p in _halve_lossy(pieces)] or hull
    return _measured(mesh, sdf, corners, "plane cuts")


def _halve_lossy(pieces: Sequence[Piece]) -> list[Piece]:
    """Halve the piece that loses most by the limit of vertices, while one loses too much and there is room."""
    left = [(fewer_vertices(p.corners, MAX_VERTICES)[1], p) for p in pieces]
    while len(left) < MAX_PARTS:
        left.sort(key=lambda item: item[0])
        loss, piece = left[-1]
        halves = halve(piece) if loss > _LOSS_M else None
        if halves is None:
            break
        left = left[:-1] + [(fewer_vertices(h.corners, MAX_VERTICES)[1], h) for h in halves]
    return [piece for _, piece in left]


def _hull(points: np.ndarray) -> ConvexHull:
    try:
        return ConvexHull(points)
    except QhullError as error:
        raise MeshError("the mesh is flat; expected a surface that encloses a volume.") from error


def _hull_triangles(points: np.ndarray) -> np.ndarray:
    return points[ConvexHull(points).simplices]


def _decimated(mesh: Mesh) -> np.ndarray:
    """(T, 3, 3) triangles of a coarser surface: quadric edge collapse to 4,000 faces, or clustered if not manifold."""
    if len(mesh.faces) <= _SPLIT_FACES:
        return mesh.triangles
    if is_manifold(mesh):
        vertices, faces, _, _ = igl.qslim(mesh.vertices, mesh.faces.astype(np.int64), _SPLIT_FACES)
        return vertices[faces]
    cell = _CLUSTER_SHARE * float(mesh.extents.max())
    index = np.floor((mesh.vertices - mesh.bounds[0]) / cell).astype(np.int64)
    _, first, cluster = np.unique(index, axis=0, return_index=True, return_inverse=True)
    faces = cluster.reshape(-1)[mesh.faces]
    a, b, c = faces.T
    return mesh.vertices[first][faces[(a != b) & (b != c) & (c != a)]]


def _measured(mesh: Mesh, sdf: SdfGrid, corners: Sequence[np.ndarray], method: str) -> ConvexParts:
    parts = tuple(fewer_vertices(c, MAX_VERTICES)[0] for c in corners)
    outside, gap = union_deviation(mesh, sdf, parts)
    return ConvexParts(
        vertices=parts,
        protrusion_p95_m=float(np.quantile(outside, 0.95)),
        protrusion_max_m=float(outside.max()),
        gap_p95_m=float(np.quantile(gap, 0.95)),
        gap_max_m=float(gap.max()),
        method=method,
    )


def fewer_vertices(corners: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """At most `count` of hull vertices (V, 3) whose hull is close to the whole hull and never larger.

    Starts from the extremes along the axes and keeps adding the vertices that lie farthest outside.

    Returns:
        the vertices, and how far the farthest of the others lies outside their hull, metres.
    """
    if len(corners) <= count:
        return corners, 0.0
    extremes = np.unique([*corners.argmin(axis=0), *corners.argmax(axis=0), *_corner_extremes(corners)])
    chosen = [*extremes, *_off_their_plane(corners, extremes)]
    while True:
        planes = ConvexHull(corners[chosen]).equations
        height = corners @ planes[:, :3].T + planes[:, 3]
        outside = height.max(axis=1)
        if len(chosen) >= count or outside.max() < 2e-5:
            return corners[np.unique(chosen)], max(float(outside.max()), 0.0)
        # the farthest vertex of each facet that has one; the farthest few of them
        facet = height.argmax(axis=1)
        order = np.argsort(-outside, kind="stable")
        first = order[np.unique(facet[order], return_index=True)[1]]
        first = first[outside[first] > 2e-5]
        take = first[np.argsort(-outside[first], kind="stable")][: max(1, min(6, count - len(chosen)))]
        chosen += [int(i) for i in take]


def _off_their_plane(corners: np.ndarray, chosen: np.ndarray) -> list[int]:
    """The vertex farthest from the plane of the chosen ones, where these lie in one: a wedge's extremes may."""
    centre = corners[chosen].mean(axis=0)
    height = np.abs((corners - centre) @ np.linalg.svd(corners[chosen] - centre)[2][-1])
    return [int(height.argmax())] if height[chosen].max() < 1e-7 else []


def _corner_extremes(corners: np.ndarray) -> np.ndarray:
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return (corners @ signs.T).argmax(axis=0)


def union_deviation(mesh: Mesh, sdf: SdfGrid, parts: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """How far the union's surface lies outside the object, and the object's surface outside the union; >= 0, metres."""
    hulls = [ConvexHull(p) for p in parts]
    area = np.array([h.area for h in hulls])
    counts = np.maximum(100, (_SAMPLES * area / area.sum()).astype(int))
    points = np.concatenate([sample_triangles(p[h.simplices], n) for p, h, n in zip(parts, hulls, counts, strict=True)])
    owner = np.repeat(np.arange(len(parts)), counts)
    hidden = np.zeros(len(points), dtype=bool)
    for k, h in enumerate(hulls):
        inside = (points @ h.equations[:, :3].T + h.equations[:, 3]).max(axis=1) < -1e-6
        hidden |= inside & (owner != k)
    outside = np.maximum(query_grid_numpy(sdf, points[~hidden]), 0.0)
    surface = sample_triangles(mesh.triangles, _SAMPLES // 4)
    gap = np.min([(surface @ h.equations[:, :3].T + h.equations[:, 3]).max(axis=1) for h in hulls], axis=0)
    return outside, np.maximum(gap, 0.0)
