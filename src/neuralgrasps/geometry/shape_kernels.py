"""Exact signed distances to simple solids as numba scalar kernels, the twins of `neuralgrasps.geometry.shapes`.

Solids are centred on the origin of their own frame, axis along z; metres, negative inside. All inline into callers.
"""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, inline="always", error_model="numpy")
def box_sdf(x, y, z, hx, hy, hz):  # type: ignore[no-untyped-def]
    """Box of half sizes hx, hy, hz."""
    dx = abs(x) - hx
    dy = abs(y) - hy
    dz = abs(z) - hz
    ox = max(dx, 0.0)
    oy = max(dy, 0.0)
    oz = max(dz, 0.0)
    return math.sqrt(ox * ox + oy * oy + oz * oz) + min(max(dx, max(dy, dz)), 0.0)


@njit(cache=True, inline="always", error_model="numpy")
def sphere_sdf(x, y, z, radius):  # type: ignore[no-untyped-def]
    """Sphere of `radius`."""
    return math.sqrt(x * x + y * y + z * z) - radius


@njit(cache=True, inline="always", error_model="numpy")
def capsule_sdf(x, y, z, radius, half_length):  # type: ignore[no-untyped-def]
    """All points within `radius` of the segment from z = -half_length to half_length."""
    oz = max(abs(z) - half_length, 0.0)
    return math.sqrt(x * x + y * y + oz * oz) - radius


@njit(cache=True, inline="always", error_model="numpy")
def cylinder_sdf(x, y, z, radius, half_height):  # type: ignore[no-untyped-def]
    """Cylinder with flat caps at z = +-half_height."""
    dr = math.sqrt(x * x + y * y) - radius
    dz = abs(z) - half_height
    orr = max(dr, 0.0)
    oz = max(dz, 0.0)
    return math.sqrt(orr * orr + oz * oz) + min(max(dr, dz), 0.0)


@njit(cache=True, error_model="numpy")
def segment_distance_squared(x, y, z, a, b):  # type: ignore[no-untyped-def]
    """Squared distance from (x, y, z) to the segment between a (3,) and b (3,), which may coincide."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    px, py, pz = x - a[0], y - a[1], z - a[2]
    length = ux * ux + uy * uy + uz * uz
    t = 0.0
    if length > 0.0:
        t = min(max((px * ux + py * uy + pz * uz) / length, 0.0), 1.0)
    dx, dy, dz = px - t * ux, py - t * uy, pz - t * uz
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def triangle_distance_squared(x, y, z, triangle):  # type: ignore[no-untyped-def]
    """Squared distance from (x, y, z) to a triangle (3, 3), which may be a sliver.

    The foot on the plane if it falls inside, else the nearest edge.
    """
    a, b, c = triangle[0], triangle[1], triangle[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    px, py, pz = x - a[0], y - a[1], z - a[2]
    if nn > 0.0:
        # Barycentric weights of b and c, times nn: n . (p x v) and n . (u x p).
        wb = nx * (py * vz - pz * vy) + ny * (pz * vx - px * vz) + nz * (px * vy - py * vx)
        wc = nx * (uy * pz - uz * py) + ny * (uz * px - ux * pz) + nz * (ux * py - uy * px)
        if wb >= 0.0 and wc >= 0.0 and wb + wc <= nn:
            height = px * nx + py * ny + pz * nz
            return height * height / nn
    return min(
        segment_distance_squared(x, y, z, a, b),
        min(segment_distance_squared(x, y, z, b, c), segment_distance_squared(x, y, z, c, a)),
    )


@njit(cache=True, error_model="numpy")
def convex_sdf(x, y, z, planes, triangles):  # type: ignore[no-untyped-def]
    """Convex polytope: planes (P, 4) with n . x + d <= 0 inside, n unit length; triangles (T, 3, 3) wound outward.

    Inside it is the largest plane distance; outside the distance to the nearest triangle that faces the point.
    """
    deepest = -math.inf
    for i in range(planes.shape[0]):
        deepest = max(deepest, planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z + planes[i, 3])
    if deepest <= 0.0:
        return deepest
    nearest = math.inf
    for i in range(triangles.shape[0]):
        if faces_point(x, y, z, triangles[i]):
            nearest = min(nearest, triangle_distance_squared(x, y, z, triangles[i]))
    if nearest == math.inf:  # on the surface to rounding, and no triangle faces it
        return deepest
    return math.sqrt(nearest)


@njit(cache=True, error_model="numpy")
def faces_point(x, y, z, triangle):  # type: ignore[no-untyped-def]
    """Whether (x, y, z) is on the outer side of the triangle's plane, or in it."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nx * (x - a[0]) + ny * (y - a[1]) + nz * (z - a[2]) >= 0.0
