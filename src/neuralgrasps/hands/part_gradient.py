"""Gradients of the exact distances to convex parts, compiled. Torch-free."""

from __future__ import annotations

import math

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.shape_kernels import convex_sdf
from neuralgrasps.hands.hand import PartKind

_BOX, _SPHERE, _CAPSULE, _CYLINDER = (
    int(k) for k in (PartKind.BOX, PartKind.SPHERE, PartKind.CAPSULE, PartKind.CYLINDER)
)
_STEP = 1e-6  # metres, of the difference quotient outside a hull


@njit(cache=True, inline="always", error_model="numpy")
def _unit(x, y, z):  # type: ignore[no-untyped-def]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-12:
        return 0.0, 0.0, 1.0
    return x / length, y / length, z / length


@njit(cache=True, inline="always", error_model="numpy")
def _box_gradient(x, y, z, hx, hy, hz):  # type: ignore[no-untyped-def]
    dx, dy, dz = abs(x) - hx, abs(y) - hy, abs(z) - hz
    if dx > 0.0 or dy > 0.0 or dz > 0.0:
        return _unit(math.copysign(max(dx, 0.0), x), math.copysign(max(dy, 0.0), y), math.copysign(max(dz, 0.0), z))
    if dx >= dy and dx >= dz:
        return math.copysign(1.0, x), 0.0, 0.0
    if dy >= dz:
        return 0.0, math.copysign(1.0, y), 0.0
    return 0.0, 0.0, math.copysign(1.0, z)


@njit(cache=True, inline="always", error_model="numpy")
def _cylinder_gradient(x, y, z, radius, half_height):  # type: ignore[no-untyped-def]
    rho = math.sqrt(x * x + y * y)
    dr, dz = rho - radius, abs(z) - half_height
    ux, uy = (x / rho, y / rho) if rho > 1e-12 else (1.0, 0.0)
    if dr > 0.0 or dz > 0.0:
        orr, oz = max(dr, 0.0), max(dz, 0.0)
        return _unit(orr * ux, orr * uy, math.copysign(oz, z))
    if dr >= dz:
        return ux, uy, 0.0
    return 0.0, 0.0, math.copysign(1.0, z)


@njit(cache=True, error_model="numpy")
def _hull_gradient(x, y, z, planes, triangles):  # type: ignore[no-untyped-def]
    deepest, face = -math.inf, 0
    for i in range(planes.shape[0]):
        d = planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z + planes[i, 3]
        if d > deepest:
            deepest, face = d, i
    if deepest <= 2.0 * _STEP:
        return planes[face, 0], planes[face, 1], planes[face, 2]
    gx = convex_sdf(x + _STEP, y, z, planes, triangles) - convex_sdf(x - _STEP, y, z, planes, triangles)
    gy = convex_sdf(x, y + _STEP, z, planes, triangles) - convex_sdf(x, y - _STEP, z, planes, triangles)
    gz = convex_sdf(x, y, z + _STEP, planes, triangles) - convex_sdf(x, y, z - _STEP, planes, triangles)
    return _unit(gx, gy, gz)


@njit(cache=True, error_model="numpy")
def part_distance_gradient(kind, size, planes, triangles, x, y, z):  # type: ignore[no-untyped-def]
    """Unit gradient (3) of `parts.part_distance` at (x, y, z), part frame; arguments as there.

    Where the distance has a crease, one of its one-sided gradients.
    """
    if kind == _BOX:
        return _box_gradient(x, y, z, size[0], size[1], size[2])
    if kind == _CAPSULE:
        return _unit(x, y, math.copysign(max(abs(z) - size[1], 0.0), z))
    if kind == _SPHERE:
        return _unit(x, y, z)
    if kind == _CYLINDER:
        return _cylinder_gradient(x, y, z, size[0], size[1])
    return _hull_gradient(x, y, z, planes, triangles)
