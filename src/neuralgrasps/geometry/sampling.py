"""Points on surfaces, and even subsets of points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, MeshError, ShapeError
from neuralgrasps.geometry.mesh_topology import Mesh, face_areas_normals

_EVEN_ROUNDS = 24  # 5 are usual; points that coincide never come apart

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def farthest_points(points: ArrayLike, count: int, *, start: int = 0) -> IndexArray:
    """Indices (count,) of points, each the farthest from all chosen before it; deterministic, ties to the lowest index.

    No index comes twice, even where points coincide.

    Args:
        points: (N, D).
        count: how many, 1 <= count <= N.
        start: index of the first one.
    Raises:
        ShapeError, InputError: `points` is not (N, D), or `count` or `start` does not fit N.
    """
    p = np.asarray(points)
    if p.ndim != 2:
        raise ShapeError(f"points has shape {p.shape}; expected (N, D).")
    if not 1 <= count <= len(p):
        raise InputError(f"count is {count}; expected 1 to the number of points, {len(p)}.")
    if not 0 <= start < len(p):
        raise InputError(f"start is {start}; expected an index below {len(p)}.")
    columns = np.ascontiguousarray(p.T, dtype=np.float64)
    if columns.shape[0] == 3:
        return _farthest_points_3d(columns[0], columns[1], columns[2], count, start)
    return _farthest_points(columns, count, start)


@njit(cache=True, error_model="numpy")
def _farthest_points_3d(x, y, z, count, start):  # type: ignore[no-untyped-def]
    n = x.shape[0]
    chosen = np.empty(count, dtype=np.int64)
    nearest = np.full(n, np.inf)
    last = start
    chosen[0] = last
    for c in range(1, count):
        px, py, pz = x[last], y[last], z[last]
        nearest[last] = -1.0  # never again, not even among equal points
        for i in range(n):
            dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
            nearest[i] = min(nearest[i], dx * dx + dy * dy + dz * dz)
        last = _argmax(nearest)
        chosen[c] = last
    return chosen


@njit(cache=True, error_model="numpy")
def _farthest_points(columns, count, start):  # type: ignore[no-untyped-def]
    dims, n = columns.shape
    chosen = np.empty(count, dtype=np.int64)
    nearest = np.full(n, np.inf)
    squared = np.empty(n)
    last = start
    chosen[0] = last
    for c in range(1, count):
        squared[:] = 0.0
        nearest[last] = -1.0
        for d in range(dims):
            value = columns[d, last]
            for i in range(n):
                squared[i] += (columns[d, i] - value) ** 2
        for i in range(n):
            nearest[i] = min(nearest[i], squared[i])
        last = _argmax(nearest)
        chosen[c] = last
    return chosen


@njit(cache=True, error_model="numpy")
def _argmax(values):  # type: ignore[no-untyped-def]
    best = 0
    for i in range(values.shape[0]):
        if values[i] > values[best]:
            best = i
    return best


def sample_surface(mesh: Mesh, count: int, seed: int) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Points drawn uniformly over the area: (count, 3) points, (count, 3) face normals, (count,) face indices."""
    areas, normals = face_areas_normals(mesh)
    total = np.cumsum(areas)
    if not len(total) or not total[-1] > 0:
        raise MeshError("sample_surface: the mesh has no area.")
    rng = np.random.default_rng(seed)
    face = np.searchsorted(total, rng.random(count) * total[-1], side="right")
    face = np.minimum(face, len(areas) - 1).astype(np.int32)
    u, v = rng.random((2, count))
    root = np.sqrt(u)[:, None]
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]], 1, 0)
    points = (1 - root) * a + root * (1 - v[:, None]) * b + root * v[:, None] * c
    return points, normals[face], face


def even_surface_points(mesh: Mesh, spacing: float, seed: int) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Points spread evenly, about `spacing` apart: no two closer than 0.7 spacing, no surface farther than about it.

    Returns:
        (K, 3) points, (K, 3) face normals, (K,) face indices; at least one point.
    """
    if not spacing > 0:
        raise InputError(f"spacing is {spacing}; expected a positive length in metres.")
    area = float(face_areas_normals(mesh)[0].sum())
    pool = max(64, math.ceil(20 * area / spacing**2))
    points, normals, face = sample_surface(mesh, pool, seed)
    chosen = _thin(points, 0.7 * spacing)
    return points[chosen], normals[chosen], face[chosen]


def _thin(points: FloatArray, distance: float) -> IndexArray:
    """Indices of a maximal subset, greedy in the given order, in which no two points are closer than `distance`."""
    cells = np.floor((points - points.min(axis=0)) / distance).astype(np.int64)
    return np.flatnonzero(_thin_kernel(points, cells, distance))


@njit(cache=True, error_model="numpy")
def _thin_kernel(points, cells, distance):  # type: ignore[no-untyped-def]
    """Dart throwing on a hash grid of the accepted points."""
    n = points.shape[0]
    size = 1
    while size < 2 * n:
        size *= 2
    head = np.full(size, -1, dtype=np.int64)
    following = np.full(n, -1, dtype=np.int64)
    keep = np.zeros(n, dtype=np.bool_)
    limit = distance * distance
    for p in range(n):
        free = True
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    q = head[_hash(cells[p, 0] + di, cells[p, 1] + dj, cells[p, 2] + dk, size)]
                    while q >= 0 and free:
                        dx = points[p, 0] - points[q, 0]
                        dy = points[p, 1] - points[q, 1]
                        dz = points[p, 2] - points[q, 2]
                        free = dx * dx + dy * dy + dz * dz >= limit
                        q = following[q]
        if free:
            keep[p] = True
            slot = _hash(cells[p, 0], cells[p, 1], cells[p, 2], size)
            following[p] = head[slot]
            head[slot] = p
    return keep


@njit(cache=True, error_model="numpy")
def _hash(i, j, k, size):  # type: ignore[no-untyped-def]
    return ((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) & (size - 1)


def cover(points: np.ndarray, radius: float) -> np.ndarray:
    """Indices of farthest points (K,), taken from the first on until every point (N, 3) has one within `radius`.

    The points lie in boxes; a box none of whose points is farther from the chosen ones than from the box to the new one
    is passed over. Ties go to the lower index, so the choice is that of the plain algorithm.
    """
    points = np.asarray(points, np.float64)
    cells = np.floor((points - points.min(axis=0)) / (4.0 * radius)).astype(np.int64)
    _, label = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(label.ravel(), kind="stable")
    counts = np.bincount(label.ravel())
    start = np.concatenate([[0], np.cumsum(counts)])
    packed = np.ascontiguousarray(points[order])
    low, high = np.minimum.reduceat(packed, start[:-1]), np.maximum.reduceat(packed, start[:-1])
    return _cover_kernel(packed, order, start, low, high, radius)


@njit(cache=True, error_model="numpy")
def _cover_kernel(points, order, start, low, high, radius):  # type: ignore[no-untyped-def]
    count, boxes, limit = points.shape[0], start.shape[0] - 1, radius * radius
    nearest, chosen = np.full(count, np.inf), np.empty(count, np.int64)
    top, top_at = np.full(boxes, np.inf), np.zeros(boxes, np.int64)  # farthest point of each box, and where it is
    last = 0
    while order[last] != 0:
        last += 1
    for used in range(count):
        chosen[used] = order[last]
        px, py, pz = points[last, 0], points[last, 1], points[last, 2]
        best, last = -1.0, 0
        for b in range(boxes):
            dx = max(low[b, 0] - px, 0.0, px - high[b, 0])
            dy = max(low[b, 1] - py, 0.0, py - high[b, 1])
            dz = max(low[b, 2] - pz, 0.0, pz - high[b, 2])
            if dx * dx + dy * dy + dz * dz < top[b]:
                top[b] = -1.0
                for i in range(start[b], start[b + 1]):
                    dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
                    d = min(nearest[i], dx * dx + dy * dy + dz * dz)
                    nearest[i] = d
                    if d > top[b]:
                        top[b], top_at[b] = d, i
            if top[b] > best or (top[b] == best and order[top_at[b]] < order[last]):
                best, last = top[b], top_at[b]
        if best < limit:
            return chosen[: used + 1]
    return chosen


def even_subset(points: np.ndarray, count: int) -> IndexArray:
    """Indices (count,), ascending, of points spread evenly: as far apart as a greedy choice in the given order allows.

    Points no closer than the distance at which there are just over `count` of them, to 1 %; of these the last ones in
    excess are left out. Points in random order give an unbiased choice.

    Args:
        points: (N, 3), N >= count.
    Raises:
        InputError: `count` is not between 1 and N.
    """
    points = np.ascontiguousarray(points, np.float64)
    if not 1 <= count <= len(points):
        raise InputError(f"count is {count}; expected 1 to the number of points, {len(points)}.")
    chosen = np.arange(len(points))
    low, high = 0.0, math.inf
    distance = float(np.ptp(points, axis=0).max()) / math.sqrt(count)
    for _ in range(_EVEN_ROUNDS):
        if len(chosen) <= 1.01 * count or not distance > 0.0:
            break
        kept = _thin(points, distance)
        if len(kept) >= count:
            low, chosen = distance, kept
        else:
            high = distance
        # on a surface the number goes with distance^-2; where that guess leaves the bracket, halve it
        distance *= math.sqrt(len(kept) / (1.004 * count))
        if not low < distance < high:
            distance = 0.5 * (low + high) if high < math.inf else 2.0 * low
    return chosen[:count]
