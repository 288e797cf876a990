"""Where a ray meets a convex part of a hand, and the part's normals: exact scalar kernels. Torch-free.

Part frame, metres. A ray is o + t d with d of any length; a hit is the least t at which it enters the solid, inf where
it does not. The origin lies outside.
"""

from __future__ import annotations

import math

from neuralgrasps.compiled import njit
from neuralgrasps.hands.hand import PartKind

_BOX, _SPHERE, _CAPSULE, _CYLINDER = (
    int(k) for k in (PartKind.BOX, PartKind.SPHERE, PartKind.CAPSULE, PartKind.CYLINDER)
)


@njit(cache=True, inline="always", error_model="numpy")
def _slab(low, high, o, d, half):  # type: ignore[no-untyped-def]
    """The part of [low, high] in which |o + t d| <= half; low > high where there is none."""
    if d == 0.0:
        return (low, high) if abs(o) <= half else (math.inf, -math.inf)
    a, b = (-half - o) / d, (half - o) / d
    return max(low, min(a, b)), min(high, max(a, b))


@njit(cache=True, inline="always", error_model="numpy")
def ray_box(ox, oy, oz, dx, dy, dz, hx, hy, hz):  # type: ignore[no-untyped-def]
    """Box of half sizes hx, hy, hz."""
    low, high = _slab(-math.inf, math.inf, ox, dx, hx)
    low, high = _slab(low, high, oy, dy, hy)
    low, high = _slab(low, high, oz, dz, hz)
    return low if 0.0 < low <= high else math.inf


@njit(cache=True, inline="always", error_model="numpy")
def ray_sphere(ox, oy, oz, dx, dy, dz, radius):  # type: ignore[no-untyped-def]
    """Sphere of `radius`."""
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    rest = b * b - a * (ox * ox + oy * oy + oz * oz - radius * radius)
    if rest < 0.0:
        return math.inf
    t = (-b - math.sqrt(rest)) / a
    return t if t > 0.0 else math.inf


@njit(cache=True, inline="always", error_model="numpy")
def _tube(ox, oy, dx, dy, radius):  # type: ignore[no-untyped-def]
    """First and last t in the tube of `radius` around the z axis; first > last where the ray passes it."""
    a = dx * dx + dy * dy
    c = ox * ox + oy * oy - radius * radius
    if a == 0.0:
        return (-math.inf, math.inf) if c <= 0.0 else (math.inf, -math.inf)
    b = ox * dx + oy * dy
    rest = b * b - a * c
    if rest < 0.0:
        return math.inf, -math.inf
    root = math.sqrt(rest)
    return (-b - root) / a, (-b + root) / a


@njit(cache=True, inline="always", error_model="numpy")
def ray_cylinder(ox, oy, oz, dx, dy, dz, radius, half_height):  # type: ignore[no-untyped-def]
    """Cylinder with flat caps at z = +-half_height."""
    low, high = _tube(ox, oy, dx, dy, radius)
    low, high = _slab(low, high, oz, dz, half_height)
    return low if 0.0 < low <= high else math.inf


@njit(cache=True, inline="always", error_model="numpy")
def ray_capsule(ox, oy, oz, dx, dy, dz, radius, half_length):  # type: ignore[no-untyped-def]
    """All points within `radius` of the segment from z = -half_length to half_length."""
    low, high = _tube(ox, oy, dx, dy, radius)
    if low > high:
        return math.inf
    # Beyond an end of the tube the ray can enter by that end's ball alone; along the axis, by the one it comes to.
    z = oz + low * dz if low > -math.inf else -math.inf * dz
    if abs(z) <= half_length:
        return low if low > 0.0 else math.inf
    return ray_sphere(ox, oy, oz - math.copysign(half_length, z), dx, dy, dz, radius)


@njit(cache=True, error_model="numpy")
def ray_hull(ox, oy, oz, dx, dy, dz, planes):  # type: ignore[no-untyped-def]
    """Convex polytope of planes (P, 4): n . p + d <= 0 inside."""
    low, high = 0.0, math.inf
    for i in range(planes.shape[0]):
        above = planes[i, 0] * ox + planes[i, 1] * oy + planes[i, 2] * oz + planes[i, 3]
        along = planes[i, 0] * dx + planes[i, 1] * dy + planes[i, 2] * dz
        if along < 0.0:
            low = max(low, -above / along)
        elif along > 0.0:
            high = min(high, -above / along)
        elif above > 0.0:
            return math.inf
        if low > high:
            return math.inf
    return low if low > 0.0 else math.inf


@njit(cache=True, inline="always", error_model="numpy")
def ray_part(kind, size, planes, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Any part; `kind`, `size` (3,) and `planes` (P, 4) as in `hands.parts.part_distance`."""
    if kind == _BOX:
        return ray_box(ox, oy, oz, dx, dy, dz, size[0], size[1], size[2])
    if kind == _CAPSULE:
        return ray_capsule(ox, oy, oz, dx, dy, dz, size[0], size[1])
    if kind == _SPHERE:
        return ray_sphere(ox, oy, oz, dx, dy, dz, size[0])
    if kind == _CYLINDER:
        return ray_cylinder(ox, oy, oz, dx, dy, dz, size[0], size[1])
    return ray_hull(ox, oy, oz, dx, dy, dz, planes)


@njit(cache=True, error_model="numpy")
def part_normal(kind, size, planes, x, y, z):  # type: ignore[no-untyped-def]
    """Outward unit normal (x, y, z) of a part at a point of its surface; on an edge, that of one of its faces."""
    if kind == _BOX:
        gx, gy, gz = abs(x) - size[0], abs(y) - size[1], abs(z) - size[2]
        if gx >= gy and gx >= gz:
            return math.copysign(1.0, x), 0.0, 0.0
        if gy >= gz:
            return 0.0, math.copysign(1.0, y), 0.0
        return 0.0, 0.0, math.copysign(1.0, z)
    if kind == _CYLINDER:
        r = math.sqrt(x * x + y * y)
        if abs(z) - size[1] > r - size[0]:
            return 0.0, 0.0, math.copysign(1.0, z)
        return x / r, y / r, 0.0
    if kind in (_SPHERE, _CAPSULE):
        if kind == _CAPSULE:
            z -= min(max(z, -size[1]), size[1])
        r = math.sqrt(x * x + y * y + z * z)
        return x / r, y / r, z / r
    best, face = -math.inf, 0
    for i in range(planes.shape[0]):
        above = planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z + planes[i, 3]
        if above > best:
            best, face = above, i
    return planes[face, 0], planes[face, 1], planes[face, 2]
