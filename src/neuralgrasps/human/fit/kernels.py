"""What a fit of a human hand to seen joints and depth points lowers, compiled, with its derivatives. Torch-free.

It is minus twice the logarithm of a posterior, without units. Unknown are the hand's pose, its joints and one size: a
point x of the hand of size 1, in its base frame, comes to R s x + t in the camera's. All rows are made in the frame and
size of that hand of size 1; rows of one link are summed as a 7 x 7 matrix (base twist and log of the size) before the
kinematics, so that joints do not raise the cost of a point. The derivatives are exact but for points whose ray grazes
the front of the hand (`_GRAZING`), and up to 0.3 mm by which the search along a ray ends early.
"""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sdf_grid import grid_distance_gradient
from neuralgrasps.hands.least_squares import (
    add_sized_row,
    assemble,
    bounded_cost,
    link_twists,
    new_work,
    posture_rows,
    slow_cost,
    turned_back,
)
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.posed_parts import gradient_in_H, nearest_of_parts, part_poses_H

ROWS = 7  # of one link: base twist [v, w] and logarithm of the size
_AWAY = 0.3  # cosine of the ray and a surface's normal, from which on a point cannot be seen there
_GRAZING = 0.3  # the same from which on a ray's residual changes no faster with the surface
_BEFORE_M, _MARCH = 0.15, 24


@njit(cache=True, inline="always", error_model="numpy")
def in_hand(X_CH, scale, p):  # type: ignore[no-untyped-def]
    """A camera point (3,) in the base frame of the hand of size 1."""
    dx, dy, dz = (p[0] - X_CH[0, 3]) / scale, (p[1] - X_CH[1, 3]) / scale, (p[2] - X_CH[2, 3]) / scale
    return turned_back(X_CH, dx, dy, dz)


@njit(cache=True, error_model="numpy")
def _joint_rows(problem, X_CH, scale, X_HL, G, h):  # type: ignore[no-untyped-def]
    total, square = 0.0, scale * scale
    for k in range(problem.joint_link.shape[0]):
        weight = problem.joint_weight[k]
        if weight == 0.0:
            continue
        link, c = problem.joint_link[k], problem.joint_L[k]
        x, y, z = moved_point(X_HL[link], c[0], c[1], c[2])
        jx, jy, jz = in_hand(X_CH, scale, problem.joints_C[k])
        ex, ey, ez = x - jx, y - jy, z - jz
        cost, w = slow_cost(square * (ex * ex + ey * ey + ez * ez), problem.joint_width)
        total += weight * cost
        w *= weight * square
        # e = s (x - R^T (j - t) / s): its share in the size is s x, the row's own
        add_sized_row(G[link], h[link], 1.0, 0.0, 0.0, x, y, z, 0.0, ex, w)
        add_sized_row(G[link], h[link], 0.0, 1.0, 0.0, x, y, z, 0.0, ey, w)
        add_sized_row(G[link], h[link], 0.0, 0.0, 1.0, x, y, z, 0.0, ez, w)
    return total


@njit(cache=True, error_model="numpy")
def _front(packed, X_PH, centre_H, part, x, y, z, dx, dy, dz):  # type: ignore[no-untyped-def]
    """(part, point (3)) where a ray of unit direction d to (x, y, z) in H meets the hand first; -1 where it does not.

    The search starts 0.15 m before the point and goes on by exact distances.
    """
    along = -_BEFORE_M
    for _ in range(_MARCH):
        px, py, pz = x + along * dx, y + along * dy, z + along * dz
        r, part = nearest_of_parts(packed, X_PH, centre_H, part, px, py, pz)
        if r < 3e-4:
            return part, px, py, pz
        along += r
        if along > 0.0:
            break
    return -1, x, y, z


@njit(cache=True, error_model="numpy")
def _cloud_rows(packed, problem, X_CH, scale, work):  # type: ignore[no-untyped-def]
    """Distances of the cloud's points to the hand; along the ray to its front where the nearest surface faces away."""
    total, square = 0.0, scale * scale
    ox, oy, oz = in_hand(X_CH, scale, (0.0, 0.0, 0.0))  # the camera
    for m in range(problem.cloud_C.shape[0]):
        x, y, z = in_hand(X_CH, scale, problem.cloud_C[m])
        r, part = nearest_of_parts(packed, work.X_PH, work.centre_H, work.hint[m], x, y, z)
        work.hint[m] = part
        gx, gy, gz = gradient_in_H(packed, work.X_PH, part, x, y, z)
        dx, dy, dz, more = x - ox, y - oy, z - oz, r
        far = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / far, dy / far, dz / far
        if gx * dx + gy * dy + gz * dz > _AWAY:
            front, hx, hy, hz = _front(packed, work.X_PH, work.centre_H, part, x, y, z, dx, dy, dz)
            if front >= 0:
                part = front
                gx, gy, gz = gradient_in_H(packed, work.X_PH, part, hx, hy, hz)
                along = min(gx * dx + gy * dy + gz * dz, -_GRAZING)
                r = dx * (x - hx) + dy * (y - hy) + dz * (z - hz)
                gx, gy, gz, more = gx / along, gy / along, gz / along, 0.0  # the ray stays, where it hits moves
                x, y, z = hx, hy, hz
        cost, w = bounded_cost(square * r * r, problem.cloud_width)
        total += problem.cloud_weight * cost
        w *= problem.cloud_weight * square
        if w < 1e-3:
            continue
        link = packed.part_link[part]
        # the point stays, the hand moves; growing, the surface at x - r g moves by itself
        add_sized_row(work.G[link], work.h[link], -gx, -gy, -gz, x, y, z, more, r, w)
    return total


@njit(cache=True, error_model="numpy")
def _gap_in_view(problem, cx, cy, cz):  # type: ignore[no-untyped-def]
    """(gap, direction (3)) of a camera point in front of what is measured: the shorter way to where it may be.

    It may go back to the measured depth, or aside to the nearest pixel that allows it; gap <= 0: nothing forbids it.
    """
    fx, fy = problem.camera[0], problem.camera[1]
    u = math.floor(cx / cz * fx + problem.camera[2] + 0.5)
    v = math.floor(cy / cz * fy + problem.camera[3] + 0.5)
    if v < 0 or v >= problem.depth.shape[0] or u < 0 or u >= problem.depth.shape[1]:
        return 0.0, 0.0, 0.0, 0.0
    z = problem.depth[v, u]
    if z == 0.0 or cz >= z:
        return 0.0, 0.0, 0.0, 0.0
    back = z - cz
    row, column = problem.near[v, u, 0], problem.near[v, u, 1]
    if row == v and column == u:
        return back, 0.0, 0.0, -1.0
    ax, ay = (column - problem.camera[2]) / fx, (row - problem.camera[3]) / fy
    dx, dy = cx - ax * cz, cy - ay * cz
    aside = math.sqrt(dx * dx + dy * dy)
    if back <= aside:
        return back, 0.0, 0.0, -1.0
    return aside, dx / aside, dy / aside, -(ax * dx + ay * dy) / aside


@njit(cache=True, error_model="numpy")
def _view_rows(problem, X_CH, scale, X_HL, G, h):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(problem.probe_link.shape[0]):
        link, c = problem.probe_link[k], problem.probe_L[k]
        x, y, z = moved_point(X_HL[link], c[0], c[1], c[2])
        cx, cy, cz = moved_point(X_CH, scale * x, scale * y, scale * z)
        if cz < 0.05:
            continue
        gap, dx, dy, dz = _gap_in_view(problem, cx, cy, cz)
        r = gap - problem.free_slack
        if r <= 0.0:
            continue
        cost, w = bounded_cost(r * r, problem.free_width)
        total += problem.free_weight * cost
        nx, ny, nz = turned_back(X_CH, dx, dy, dz)
        add_sized_row(G[link], h[link], nx, ny, nz, x, y, z, 0.0, r / scale, problem.free_weight * w * scale * scale)
    return total


@njit(cache=True, error_model="numpy")
def _object_rows(problem, X_CH, scale, X_HL, nearest, G, h):  # type: ignore[no-untyped-def]
    """Depths of the probes in the object, and the links that touch it; `nearest` (L, 7) is work space."""
    total, square = 0.0, scale * scale
    for link in range(nearest.shape[0]):
        nearest[link, 0] = math.inf
    for k in range(problem.probe_link.shape[0]):
        link, c = problem.probe_link[k], problem.probe_L[k]
        x, y, z = moved_point(X_HL[link], c[0], c[1], c[2])
        cx, cy, cz = moved_point(X_CH, scale * x, scale * y, scale * z)
        ox, oy, oz = moved_point(problem.X_OC, cx, cy, cz)
        d, gx, gy, gz = grid_distance_gradient(
            problem.sdf_values, problem.sdf_origin, problem.sdf_inv_spacing, ox, oy, oz
        )
        deep = d + problem.deep_slack
        if d >= nearest[link, 0] and deep >= 0.0:
            continue
        gx, gy, gz = turned_back(problem.X_OC, gx, gy, gz)
        nx, ny, nz = turned_back(X_CH, gx, gy, gz)
        if deep < 0.0:
            total += problem.deep_weight * deep * deep
            add_sized_row(G[link], h[link], nx, ny, nz, x, y, z, 0.0, deep / scale, problem.deep_weight * square)
        if d < nearest[link, 0]:
            near = nearest[link]
            near[0], near[1], near[2], near[3], near[4], near[5], near[6] = d, nx, ny, nz, x, y, z
    for link in range(nearest.shape[0]):
        weight, near = problem.touch_weight[link], nearest[link]
        if weight == 0.0 or near[0] == math.inf or near[0] <= 0.0:
            continue
        cost, w = bounded_cost(near[0] * near[0], problem.touch_width)
        total += weight * cost
        add_sized_row(
            G[link], h[link], near[1], near[2], near[3], near[4], near[5], near[6], 0.0, near[0] / scale,
            weight * w * square,
        )  # fmt: skip
    return total


@njit(cache=True, error_model="numpy")
def _prior_rows(problem, q, scale, A, b):  # type: ignore[no-untyped-def]
    """The t distribution of postures, and the usual size."""
    total = posture_rows(problem.q_mean, problem.q_precision, problem.q_freedom, 1.0, q, A, b)
    last, off = 6 + q.shape[0], math.log(scale) - problem.log_scale
    if problem.free_scale:
        A[last, last] += problem.log_scale_weight
        b[last] += problem.log_scale_weight * off
        return total + problem.log_scale_weight * off * off
    A[last, :last] = 0.0  # a size that is known stays
    A[last, last] = 1.0
    b[last] = 0.0
    return total


@njit(cache=True, error_model="numpy")
def hand_cost_rows(packed, problem, X_CH, q, scale, work, A, b):  # type: ignore[no-untyped-def]
    """Cost at a pose, joints and size, and the Gauss-Newton matrix (lower triangle) and gradient of half of it.

    The unknowns are [v, w] in the base frame of the hand of size 1, the joints, and the size's logarithm.
    """
    pose_links(packed, q, work.X_HL)
    work.G[:] = 0.0
    work.h[:] = 0.0
    A[:] = 0.0
    b[:] = 0.0
    total = _joint_rows(problem, X_CH, scale, work.X_HL, work.G, work.h)
    if problem.cloud_C.shape[0] > 0:
        part_poses_H(packed, work.X_HL, work.X_PH, work.centre_H)
        total += _cloud_rows(packed, problem, X_CH, scale, work)
    if problem.free_weight > 0.0:
        total += _view_rows(problem, X_CH, scale, work.X_HL, work.G, work.h)
    if problem.deep_weight > 0.0:
        total += _object_rows(problem, X_CH, scale, work.X_HL, work.nearest, work.G, work.h)
    link_twists(packed, work.X_HL, work.twists)
    assemble(work.G, work.h, work.twists, A, b)
    return total + _prior_rows(problem, q, scale, A, b)


@njit(cache=True, error_model="numpy")
def hand_cost(packed, problem, X_CH, q, scale):  # type: ignore[no-untyped-def]
    """(cost, (7 + J,) its derivative by [base twist | q | log size]); for checks."""
    size = 7 + q.shape[0]
    work = new_work(packed, problem.cloud_C.shape[0], ROWS)
    b = np.empty(size)
    cost = hand_cost_rows(packed, problem, X_CH, q, scale, work, np.empty((size, size)), b)
    return cost, 2.0 * b
