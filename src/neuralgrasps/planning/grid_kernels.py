"""Lower bounds of distances from grids, for collision checks."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit


@njit(cache=True, error_model="numpy")
def grid_lower_bound(grids, a, x, y, z, enough):  # type: ignore[no-untyped-def]
    """A distance, metres, that thing a of `Grids` is not nearer than to (x, y, z) in its own frame; negative inside.

    Away from the thing's box it is the distance to the box where that is at least `enough` or where the point is
    outside the grid; else the trilinear value of the grid less its error.
    """
    dx = max(grids.low[a, 0] - x, x - grids.high[a, 0], 0.0)
    dy = max(grids.low[a, 1] - y, y - grids.high[a, 1], 0.0)
    dz = max(grids.low[a, 2] - z, z - grids.high[a, 2], 0.0)
    outside = math.sqrt(dx * dx + dy * dy + dz * dz)
    if outside >= enough and outside > 0.0:
        return outside
    inv = grids.inv_spacing[a]
    u, v, w = (x - grids.origin[a, 0]) * inv, (y - grids.origin[a, 1]) * inv, (z - grids.origin[a, 2]) * inv
    nx, ny, nz = grids.sides[a, 0], grids.sides[a, 1], grids.sides[a, 2]
    if not (0.0 <= u <= nx - 1.0 and 0.0 <= v <= ny - 1.0 and 0.0 <= w <= nz - 1.0):
        return outside
    i, j, k = min(np.int64(u), nx - 2), min(np.int64(v), ny - 2), min(np.int64(w), nz - 2)
    u -= i
    v -= j
    w -= k
    at = grids.start[a] + (i * ny + j) * nz + k
    f = grids.values
    e = at + ny * nz
    low = (f[at] * (1.0 - w) + f[at + 1] * w) * (1.0 - v) + (f[at + nz] * (1.0 - w) + f[at + nz + 1] * w) * v
    high = (f[e] * (1.0 - w) + f[e + 1] * w) * (1.0 - v) + (f[e + nz] * (1.0 - w) + f[e + nz + 1] * w) * v
    return max(low * (1.0 - u) + high * u - grids.error[a], outside)
