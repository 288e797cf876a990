"""Lower bounds of distances from grids, for collision checks."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.planning.collision_arrays import ERROR, HIGH, INV_SPACING, LOW, ORIGIN, plain_kernel


@plain_kernel
def grid_lower_bound(grids, grid_info, values, a, x, y, z, enough):  # type: ignore[no-untyped-def]
    """A distance, metres, that thing a is not nearer than to (x, y, z) in its own frame; negative inside.

    Away from the thing's box it is the distance to the box where that is at least `enough` or where the point is
    outside the grid; else the trilinear value of the grid less its error. Tables as in `CheckArrays`.
    """
    dx = max(grids[a, LOW] - x, x - grids[a, HIGH], 0.0)
    dy = max(grids[a, LOW + 1] - y, y - grids[a, HIGH + 1], 0.0)
    dz = max(grids[a, LOW + 2] - z, z - grids[a, HIGH + 2], 0.0)
    outside = dx * dx + dy * dy + dz * dz
    if outside > 0.0:
        outside = math.sqrt(outside)
        if outside >= enough:
            return outside
    inv = grids[a, INV_SPACING]
    u, v, w = (x - grids[a, ORIGIN]) * inv, (y - grids[a, ORIGIN + 1]) * inv, (z - grids[a, ORIGIN + 2]) * inv
    nx, ny, nz = grid_info[a, 1], grid_info[a, 2], grid_info[a, 3]
    if not (0.0 <= u <= nx - 1.0 and 0.0 <= v <= ny - 1.0 and 0.0 <= w <= nz - 1.0):
        return outside
    i, j, k = min(np.int64(u), nx - 2), min(np.int64(v), ny - 2), min(np.int64(w), nz - 2)
    u -= i
    v -= j
    w -= k
    at = np.uint64(grid_info[a, 0] + (i * ny + j) * nz + k)
    row, page, one = np.uint64(nz), np.uint64(ny * nz), np.uint64(1)  # unsigned: no test for negative indices
    f = values
    low = (f[at] * (1.0 - w) + f[at + one] * w) * (1.0 - v) + (f[at + row] * (1.0 - w) + f[at + row + one] * w) * v
    at += page
    high = (f[at] * (1.0 - w) + f[at + one] * w) * (1.0 - v) + (f[at + row] * (1.0 - w) + f[at + row + one] * w) * v
    return max(low * (1.0 - u) + high * u - grids[a, ERROR], outside)
