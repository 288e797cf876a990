"""Distance between two convex parts: Gilbert, Johnson and Keerthi's search (1988), with certificates.

Each step holds a point v of the Minkowski difference A - B and a supporting plane of it. |v| is never less than the
distance, the plane never more: an answer "at least `need`" is always proved by a plane, whatever the rounding. A search
that does not finish counts as touching. Spheres and capsules are their core and a radius.
"""

from __future__ import annotations

import math

from neuralgrasps.geometry.shape_kernels import box_sdf, capsule_sdf, cylinder_sdf
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.planning.collision_arrays import END_VERTEX, FIRST_VERTEX, KIND, SIZE, plain_kernel

_BOX, _SPHERE, _CAPSULE, _CYLINDER = (
    int(k) for k in (PartKind.BOX, PartKind.SPHERE, PartKind.CAPSULE, PartKind.CYLINDER)
)
_STEPS = 48
_TINY = 1e-18  # m^2; nearer than a nanometre is touching
_RELATIVE = 1e-9  # of |v|^2: no further progress


@plain_kernel
def _support(parts, part_info, vertices, poses, i, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Point of part i's core that lies farthest along (dx, dy, dz)."""
    lx = poses[i, 0] * dx + poses[i, 4] * dy + poses[i, 8] * dz
    ly = poses[i, 1] * dx + poses[i, 5] * dy + poses[i, 9] * dz
    lz = poses[i, 2] * dx + poses[i, 6] * dy + poses[i, 10] * dz
    x, y, z = 0.0, 0.0, 0.0
    kind = part_info[i, KIND]
    if kind == _BOX:
        x = math.copysign(parts[i, SIZE], lx)
        y = math.copysign(parts[i, SIZE + 1], ly)
        z = math.copysign(parts[i, SIZE + 2], lz)
    elif kind == _CAPSULE:
        z = math.copysign(parts[i, SIZE + 1], lz)
    elif kind == _CYLINDER:
        across = math.sqrt(lx * lx + ly * ly)
        if across > 0.0:
            x, y = parts[i, SIZE] * lx / across, parts[i, SIZE] * ly / across
        z = math.copysign(parts[i, SIZE + 1], lz)
    elif kind != _SPHERE:
        best = -math.inf
        for v in range(part_info[i, FIRST_VERTEX], part_info[i, END_VERTEX]):
            along = vertices[v, 0] * lx + vertices[v, 1] * ly + vertices[v, 2] * lz
            if along > best:
                best, x, y, z = along, vertices[v, 0], vertices[v, 1], vertices[v, 2]
    return (
        poses[i, 0] * x + poses[i, 1] * y + poses[i, 2] * z + poses[i, 3],
        poses[i, 4] * x + poses[i, 5] * y + poses[i, 6] * z + poses[i, 7],
        poses[i, 8] * x + poses[i, 9] * y + poses[i, 10] * z + poses[i, 11],
    )


@plain_kernel
def _core_radius(parts, part_info, i):  # type: ignore[no-untyped-def]
    """Radius, metres, that part i has around its core."""
    return parts[i, SIZE] if part_info[i, KIND] in (_SPHERE, _CAPSULE) else 0.0


@plain_kernel
def point_gap(parts, part_info, poses, i, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance, metres, from (x, y, z) to part i; minus infinity, which says nothing, to spheres and hulls."""
    dx, dy, dz = x - poses[i, 3], y - poses[i, 7], z - poses[i, 11]
    u = poses[i, 0] * dx + poses[i, 4] * dy + poses[i, 8] * dz
    v = poses[i, 1] * dx + poses[i, 5] * dy + poses[i, 9] * dz
    w = poses[i, 2] * dx + poses[i, 6] * dy + poses[i, 10] * dz
    kind = part_info[i, KIND]
    gap = -math.inf
    if kind == _BOX:
        gap = box_sdf(u, v, w, parts[i, SIZE], parts[i, SIZE + 1], parts[i, SIZE + 2])
    elif kind == _CYLINDER:
        gap = cylinder_sdf(u, v, w, parts[i, SIZE], parts[i, SIZE + 1])
    elif kind == _CAPSULE:
        gap = capsule_sdf(u, v, w, parts[i, SIZE], parts[i, SIZE + 1])
    return gap


@plain_kernel
def convex_gap(parts, part_info, vertices, poses, a, b, need, simplex):  # type: ignore[no-untyped-def]
    """Distance between parts a and b, as far as `need` asks for it.

    Args:
        parts (P, 7 or more), part_info (P, 5), vertices (V, 3): tables as in `CheckArrays`.
        poses: (P, 12) upper three rows of each part's X, row by row, all in one frame.
        need: metres; the search ends as soon as the distance is proved to be at least this.
        simplex: (4, 3) work space.
    Returns:
        metres: a proved lower bound that is >= need; else the distance, < need, to a nanometre; 0 where they overlap.
    """
    radius = _core_radius(parts, part_info, a) + _core_radius(parts, part_info, b)
    want = need + radius
    vx, vy, vz = poses[a, 3] - poses[b, 3], poses[a, 7] - poses[b, 7], poses[a, 11] - poses[b, 11]
    squared = vx * vx + vy * vy + vz * vz
    if squared < _TINY:
        vx, squared = 1.0, 1.0
    count = 0
    for step in range(_STEPS):
        ax, ay, az = _support(parts, part_info, vertices, poses, a, -vx, -vy, -vz)
        bx, by, bz = _support(parts, part_info, vertices, poses, b, vx, vy, vz)
        wx, wy, wz = ax - bx, ay - by, az - bz
        along = vx * wx + vy * wy + vz * wz
        length = math.sqrt(squared)
        if along > 0.0 and along >= want * length:
            return along / length - radius
        if step > 0 and squared - along <= _RELATIVE * squared:
            return max(along / length - radius, 0.0)
        for i in range(count):  # a corner twice: no progress is left in these numbers
            if simplex[i, 0] == wx and simplex[i, 1] == wy and simplex[i, 2] == wz:
                return max(along / length - radius, 0.0)
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = wx, wy, wz
        count, vx, vy, vz = _nearest_on_simplex(simplex, count + 1)
        squared = vx * vx + vy * vy + vz * vz
        if count == 4 or squared < _TINY:
            return 0.0
    return 0.0


@plain_kernel
def _nearest_on_simplex(s, count):  # type: ignore[no-untyped-def]
    """(corners kept, x, y, z): the point of a simplex nearest to the origin; `s` is cut to the corners it needs.

    Four corners stay only if the origin is inside.
    """
    if count == 1:
        return 1, s[0, 0], s[0, 1], s[0, 2]
    if count == 2:
        return _nearest_on_segment(s)
    if count == 3:
        return _nearest_on_triangle(s)
    return _nearest_on_tetrahedron(s)


@plain_kernel
def _nearest_on_segment(s):  # type: ignore[no-untyped-def]
    ux, uy, uz = s[1, 0] - s[0, 0], s[1, 1] - s[0, 1], s[1, 2] - s[0, 2]
    t = -(s[0, 0] * ux + s[0, 1] * uy + s[0, 2] * uz)
    length = ux * ux + uy * uy + uz * uz
    if t <= 0.0 or length == 0.0:
        return 1, s[0, 0], s[0, 1], s[0, 2]
    if t >= length:
        s[0, 0], s[0, 1], s[0, 2] = s[1, 0], s[1, 1], s[1, 2]
        return 1, s[0, 0], s[0, 1], s[0, 2]
    t /= length
    return 2, s[0, 0] + t * ux, s[0, 1] + t * uy, s[0, 2] + t * uz


@plain_kernel
def _nearest_on_triangle(s):  # type: ignore[no-untyped-def]
    """By the regions of Ericson, Real-Time Collision Detection (2005), 5.1.5."""
    ax, ay, az = s[0, 0], s[0, 1], s[0, 2]
    ux, uy, uz = s[1, 0] - ax, s[1, 1] - ay, s[1, 2] - az
    wx, wy, wz = s[2, 0] - ax, s[2, 1] - ay, s[2, 2] - az
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    nn = nx * nx + ny * ny + nz * nz
    px, py, pz = -ax, -ay, -az
    b = nx * (py * wz - pz * wy) + ny * (pz * wx - px * wz) + nz * (px * wy - py * wx)
    c = nx * (uy * pz - uz * py) + ny * (uz * px - ux * pz) + nz * (ux * py - uy * px)
    if nn > 0.0 and b > 0.0 and c > 0.0 and b + c < nn:
        height = (px * nx + py * ny + pz * nz) / nn
        return 3, -height * nx, -height * ny, -height * nz
    return _nearest_edge(s)


@plain_kernel
def _nearest_edge(s):  # type: ignore[no-untyped-def]
    """The nearest point on the three edges of a triangle, `s` cut to it."""
    best, first, second, place = math.inf, 0, 0, 0.0
    for i in range(3):
        j = (i + 1) % 3
        ux, uy, uz = s[j, 0] - s[i, 0], s[j, 1] - s[i, 1], s[j, 2] - s[i, 2]
        length = ux * ux + uy * uy + uz * uz
        t = 0.0
        if length > 0.0:
            t = min(max(-(s[i, 0] * ux + s[i, 1] * uy + s[i, 2] * uz) / length, 0.0), 1.0)
        x, y, z = s[i, 0] + t * ux, s[i, 1] + t * uy, s[i, 2] + t * uz
        if x * x + y * y + z * z < best:
            best, first, second, place = x * x + y * y + z * z, i, j, t
    a0, a1, a2 = s[first, 0], s[first, 1], s[first, 2]
    b0, b1, b2 = s[second, 0], s[second, 1], s[second, 2]
    if place >= 1.0:
        s[0, 0], s[0, 1], s[0, 2] = b0, b1, b2
        return 1, b0, b1, b2
    s[0, 0], s[0, 1], s[0, 2] = a0, a1, a2
    if place <= 0.0:
        return 1, a0, a1, a2
    s[1, 0], s[1, 1], s[1, 2] = b0, b1, b2
    return 2, a0 + place * (b0 - a0), a1 + place * (b1 - a1), a2 + place * (b2 - a2)


@plain_kernel
def _nearest_on_tetrahedron(s):  # type: ignore[no-untyped-def]
    """The best of the faces that the origin is outside of; none: it is inside."""
    best, face, kept, x, y, z = math.inf, -1, 0, 0.0, 0.0, 0.0
    t0, t1, t2, t3 = _row(s, 0), _row(s, 1), _row(s, 2), _row(s, 3)
    corners = (t0, t1, t2, t3)
    for i in range(4):
        if not _is_outside(corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4], corners[(i + 3) % 4]):
            continue
        for k in range(3):
            s[k, 0], s[k, 1], s[k, 2] = corners[(i + 1 + k) % 4]
        n, px, py, pz = _nearest_on_triangle(s)
        if px * px + py * py + pz * pz < best:
            best, face, kept, x, y, z = px * px + py * py + pz * pz, i, n, px, py, pz
    if face < 0:
        return 4, 0.0, 0.0, 0.0
    for k in range(3):
        s[k, 0], s[k, 1], s[k, 2] = corners[(face + 1 + k) % 4]
    kept, x, y, z = _nearest_on_triangle(s)
    return kept, x, y, z


@plain_kernel
def _row(s, i):  # type: ignore[no-untyped-def]
    return s[i, 0], s[i, 1], s[i, 2]


@plain_kernel
def _is_outside(opposite, a, b, c):  # type: ignore[no-untyped-def]
    """Whether the origin lies on the other side of the face a, b, c than the corner `opposite`; flat ones always."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    origin = -(a[0] * nx + a[1] * ny + a[2] * nz)
    other = (opposite[0] - a[0]) * nx + (opposite[1] - a[1]) * ny + (opposite[2] - a[2]) * nz
    return origin * other <= 0.0
