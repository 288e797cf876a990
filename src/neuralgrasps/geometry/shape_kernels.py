"""Exact signed distances to simple solids as numba scalar kernels, the twins of `neuralgrasps.geometry.shapes`.

Solids are centred on the origin of their own frame, axis along z; metres, negative inside. All inline into callers.
"""

from __future__ import annotations

import math

from neuralgrasps.compiled import njit


@njit(cache=True, inline="always", error_model="numpy")
def box_sdf(x, y, z, hx, hy, hz):  # type: ignore[no-untyped-def]
    """Box of half sizes hx, hy, hz."""
    dx = abs(x) - hx
    dy = abs(y) - hy
    dz = abs(z) - hz
    ox = max(dx, 0.0)
    oy = max(dy, 0.0)
    oz = max(dz, 0.0)
    return math.sqrt(ox * ox + oy * oy + oz * oz) + min(max(dx, dy, dz), 0.0)


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


@njit(cache=True, inline="always", error_model="numpy")
def segment_distance_squared(px, py, pz, ux, uy, uz):  # type: ignore[no-untyped-def]
    """Squared distance from p to the segment from the origin to u, which may have no length."""
    length = ux * ux + uy * uy + uz * uz
    t = 0.0
    if length > 0.0:
        t = min(max((px * ux + py * uy + pz * uz) / length, 0.0), 1.0)
    dx = px - t * ux
    dy = py - t * uy
    dz = pz - t * uz
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def triangle_distance_squared(x, y, z, triangles, i):  # type: ignore[no-untyped-def]
    """Squared distance from (x, y, z) to triangle i of (T, 3, 3), which may be a sliver.

    The foot on the plane if it falls inside, else the nearest edge.
    """
    ax, ay, az = triangles[i, 0, 0], triangles[i, 0, 1], triangles[i, 0, 2]
    ux, uy, uz = triangles[i, 1, 0] - ax, triangles[i, 1, 1] - ay, triangles[i, 1, 2] - az
    vx, vy, vz = triangles[i, 2, 0] - ax, triangles[i, 2, 1] - ay, triangles[i, 2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    if nn > 0.0:
        # Barycentric weights of corners 1 and 2, times nn: n . (p x v) and n . (u x p).
        wb = nx * (py * vz - pz * vy) + ny * (pz * vx - px * vz) + nz * (px * vy - py * vx)
        wc = nx * (uy * pz - uz * py) + ny * (uz * px - ux * pz) + nz * (ux * py - uy * px)
        if wb >= 0.0 and wc >= 0.0 and wb + wc <= nn:
            height = px * nx + py * ny + pz * nz
            return height * height / nn
    ab = segment_distance_squared(px, py, pz, ux, uy, uz)
    ac = segment_distance_squared(px, py, pz, vx, vy, vz)
    bc = segment_distance_squared(px - ux, py - uy, pz - uz, vx - ux, vy - uy, vz - uz)
    return min(ab, ac, bc)


@njit(cache=True, error_model="numpy")
def convex_sdf(x, y, z, planes, triangles):  # type: ignore[no-untyped-def]
    """Convex polytope: planes (P, 4) with n . x + d <= 0 inside, n unit length; triangles (T, 3, 3) wound outward.

    Inside it is the largest plane distance; outside the distance to the nearest triangle. A triangle whose plane is
    behind the point, or farther than the best so far, is skipped; a foot inside a facing triangle is the nearest point.
    """
    deepest = -math.inf
    for i in range(planes.shape[0]):
        deepest = max(deepest, planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z + planes[i, 3])
    if deepest <= 0.0:
        return deepest
    nearest = math.inf
    for i in range(triangles.shape[0]):
        ax, ay, az = triangles[i, 0, 0], triangles[i, 0, 1], triangles[i, 0, 2]
        ux, uy, uz = triangles[i, 1, 0] - ax, triangles[i, 1, 1] - ay, triangles[i, 1, 2] - az
        vx, vy, vz = triangles[i, 2, 0] - ax, triangles[i, 2, 1] - ay, triangles[i, 2, 2] - az
        px, py, pz = x - ax, y - ay, z - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        nn = nx * nx + ny * ny + nz * nz
        height = px * nx + py * ny + pz * nz
        if height <= 0.0 or height * height >= nearest * nn:
            continue
        wb = nx * (py * vz - pz * vy) + ny * (pz * vx - px * vz) + nz * (px * vy - py * vx)
        wc = nx * (uy * pz - uz * py) + ny * (uz * px - ux * pz) + nz * (ux * py - uy * px)
        if wb >= 0.0 and wc >= 0.0 and wb + wc <= nn:
            return height / math.sqrt(nn)
        ab = segment_distance_squared(px, py, pz, ux, uy, uz)
        ac = segment_distance_squared(px, py, pz, vx, vy, vz)
        bc = segment_distance_squared(px - ux, py - uy, pz - uz, vx - ux, vy - uy, vz - uz)
        nearest = min(nearest, ab, ac, bc)
    if nearest == math.inf:  # on the surface to rounding
        return deepest
    return math.sqrt(nearest)
