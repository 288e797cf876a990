"""Which surface of a posed hand a camera sees past the object and the hand itself, compiled. Torch-free."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, turned_vector
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.hands.packed import hand_distance, pose_links

_FACING = 0.25  # least cosine between a surface's normal and the way to the camera that counts as seen
_START_M = 0.004  # rays start so far off the surface
_CLEAR_M = 0.001  # and are blocked by what comes nearer than this
_REACH_M = 0.35  # nothing that matters is farther along a ray
_STEPS = 40


@njit(cache=True, error_model="numpy")
def _is_open(packed, X_HL, X_OH, sdf_values, sdf_origin, sdf_inv_spacing, x, y, z, dx, dy, dz, far):  # type: ignore[no-untyped-def]
    """Whether nothing is in the way from (x, y, z) in H along the unit vector (dx, dy, dz), by sphere tracing."""
    t = _START_M
    for _ in range(_STEPS):
        if t >= far:
            return True
        px, py, pz = x + t * dx, y + t * dy, z + t * dz
        ox, oy, oz = moved_point(X_OH, px, py, pz)
        d = grid_distance(sdf_values, sdf_origin, sdf_inv_spacing, ox, oy, oz)
        if d > _CLEAR_M:
            d = min(d, hand_distance(packed, X_HL, px, py, pz))
        if d <= _CLEAR_M:
            return False
        t += max(d, _CLEAR_M)
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def visible_points(packed, chosen, X_OH, q, eye_O, sdf_values, sdf_origin, sdf_inv_spacing, out):  # type: ignore[no-untyped-def]
    """Which of the hand's surface points `chosen` (K,) a camera at eye_O (3,) sees, into `out` (K,) bool.

    Surface seen at a grazing angle counts as unseen.
    """
    X_HL = np.empty((packed.parents.shape[0], 4, 4))
    pose_links(packed, q, X_HL)
    ex, ey, ez = eye_O[0] - X_OH[0, 3], eye_O[1] - X_OH[1, 3], eye_O[2] - X_OH[2, 3]
    hx = X_OH[0, 0] * ex + X_OH[1, 0] * ey + X_OH[2, 0] * ez
    hy = X_OH[0, 1] * ex + X_OH[1, 1] * ey + X_OH[2, 1] * ez
    hz = X_OH[0, 2] * ex + X_OH[1, 2] * ey + X_OH[2, 2] * ez
    for k in range(chosen.shape[0]):
        i = chosen[k]
        X, p, n = X_HL[packed.point_link[i]], packed.point_L[i], packed.point_normal_L[i]
        x, y, z = moved_point(X, p[0], p[1], p[2])
        nx, ny, nz = turned_vector(X, n[0], n[1], n[2])
        dx, dy, dz = hx - x, hy - y, hz - z
        far = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / far, dy / far, dz / far
        out[k] = nx * dx + ny * dy + nz * dz > _FACING and _is_open(
            packed, X_HL, X_OH, sdf_values, sdf_origin, sdf_inv_spacing, x, y, z, dx, dy, dz, min(far, _REACH_M)
        )
