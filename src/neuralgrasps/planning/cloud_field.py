"""Distances to observed points of things that nobody knows: a grid by an exact Euclidean distance transform."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.sdf_grid import SdfGrid

FINEST_M, COARSEST_M = 0.005, 0.010
_MOST_NODES = 450_000
_PADDING_M = 0.03  # grid beyond the points; farther out their box gives the distance
_INTERPOLATION = 0.29  # spacings: how much trilinear distances to nodes can be too large, see `cloud_grid`


def cloud_grid(points_B: np.ndarray, *, spacing_m: float | None = None) -> tuple[SdfGrid, float]:
    """Distances from the nodes of a grid to the nodes nearest to the points.

    Args:
        points_B: (M, 3) metres, M >= 1, all finite.
        spacing_m: of the grid; default 5 mm, up to 10 mm for clouds that are large (beyond that the grid grows).
    Returns:
        the grid, and by how much a trilinear value can exceed the distance to the nearest point, metres: how far any
        point is from its node (at most 0.87 spacings), and 0.29 spacings of interpolation. The distance to one node
        is convex, so that the trilinear value exceeds it, by 0.287 spacings at most, and so does that of the least.
    Raises:
        InputError: no points, or points that are not finite.
    """
    points = np.ascontiguousarray(points_B, float)
    check_shape("points_B", points.shape, (None, 3))
    if not len(points) or not np.isfinite(points).all():
        raise InputError(f"the cloud has {len(points)} points, some not finite; expected at least one, all finite.")
    low, high = points.min(axis=0) - _PADDING_M, points.max(axis=0) + _PADDING_M
    spacing = spacing_m
    if spacing is None:
        spacing = min(max(float(np.prod(high - low) / _MOST_NODES) ** (1 / 3), FINEST_M), COARSEST_M)
    sides = np.ceil((high - low) / spacing).astype(np.int64) + 1
    node = np.rint((points - low) / spacing).astype(np.int64)
    farthest = float(np.linalg.norm(low + spacing * node - points, axis=1).max())
    values = np.full(tuple(sides), np.inf, np.float32)
    values[tuple(node.T)] = 0.0
    _transform(values)
    np.sqrt(values, out=values)
    values *= spacing
    return SdfGrid(values, low, spacing), farthest + _INTERPOLATION * spacing


@njit(cache=True, error_model="numpy")
def _transform(values):  # type: ignore[no-untyped-def]
    """Squared distances, in spacings, to the nodes that are 0, in place; the others are infinite before.

    One pass per axis: the lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012); exact.
    """
    nx, ny, nz = values.shape
    room = max(nx, ny, nz)
    line, place, start = np.empty(room, np.float32), np.empty(room, np.int64), np.empty(room + 1)
    for i in range(nx):
        for j in range(ny):
            _transform_binary(values[i, j])
    for i in range(nx):
        for k in range(nz):
            _transform_line(values[i, :, k], line, place, start)
    for j in range(ny):
        for k in range(nz):
            _transform_line(values[:, j, k], line, place, start)


@njit(cache=True, error_model="numpy")
def _transform_binary(f):  # type: ignore[no-untyped-def]
    """The first pass, of zeros and infinities: a sweep each way."""
    n = f.shape[0]
    away = math.inf
    for i in range(n):
        away = 0.0 if f[i] == 0.0 else away + 1.0
        f[i] = away * away
    away = math.inf
    for i in range(n - 1, -1, -1):
        away = 0.0 if f[i] == 0.0 else away + 1.0
        f[i] = min(f[i], away * away)


@njit(cache=True, error_model="numpy")
def _transform_line(f, line, place, start):  # type: ignore[no-untyped-def]
    """f (n,) = min over i of (x - i)^2 + f[i]."""
    n, count = f.shape[0], 0
    for i in range(n):
        line[i] = f[i]
        if f[i] == math.inf:
            continue
        while count > 0:
            p = place[count - 1]
            begin = (line[i] - line[p] + i * i - p * p) / (2.0 * (i - p))
            if begin > start[count - 1]:
                break
            count -= 1
        if count == 0:
            begin = -math.inf
        place[count], start[count] = i, begin
        count += 1
    if count == 0:
        return
    k = 0
    for i in range(n):
        while k + 1 < count and start[k + 1] < i:
            k += 1
        f[i] = (i - place[k]) ** 2 + line[place[k]]
