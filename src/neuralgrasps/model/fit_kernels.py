"""What a fit of a hand's pose and joints to points on its surface lowers, on exact distances, compiled. Torch-free.

It is minus the logarithm of a posterior: exact distances of the observed points, surface that should have
been observed, a Gaussian of postures, and what is true of grasps (the hand stays out of the object, its tips touch it).
Rows of one link are summed as a 6 x 6 matrix before the kinematics: joints do not raise the cost of a point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, turned_vector
from neuralgrasps.geometry.sdf_grid import grid_distance_gradient
from neuralgrasps.geometry.shape_kernels import box_sdf, capsule_sdf
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.part_gradient import part_distance_gradient
from neuralgrasps.hands.parts import part_distance
from neuralgrasps.kinematics.tree import FIXED, REVOLUTE

_BOX, _CAPSULE = int(PartKind.BOX), int(PartKind.CAPSULE)


class FitProblem(NamedTuple):
    """What a hand is fitted to; all lengths metres, all weights such that the cost is in square metres.

    Attributes:
        points_O: (M, 3) points that should lie on the hand's surface, object frame; width: Huber's, beyond it linear.
        object_weight: (M,) 0, or the weight of a point that may as well be the object's; it says little far off.
        material: (K,) surface points of the hand that should have an observed point near; cover: (K,) their weights.
        seen_O: (S, 3) points that `material` looks for; cover_free: metres that are no gap yet; cover_width:
            Huber's for the rest.
        q_mean: (J,), q_precision: (J, J) inverse covariance of postures; q_freedom: of their t distribution; q_unit:
            square metres per unit of twice its negative logarithm.
        probe: (R,) surface points whose distances to the object are looked at, sorted by link.
        touch_mean, touch_weight: (L,) usual least distance of a link's probes to the object, and its weight (0: none).
        touch_width: Cauchy's, for touching: some grasps do not touch with a link that usually does.
        depth_weight: of each squared depth of a probe beyond `depth_free`; 0 leaves the object out.
        depth_width: Huber's for it.
        sdf_values, sdf_origin, sdf_inv_spacing: the object's grid, as in `geometry.sdf_grid`.
    """

    points_O: np.ndarray
    object_weight: np.ndarray
    width: float
    material: np.ndarray
    cover: np.ndarray
    seen_O: np.ndarray
    cover_free: float
    cover_width: float
    q_mean: np.ndarray
    q_precision: np.ndarray
    q_freedom: float
    q_unit: float
    probe: np.ndarray
    touch_mean: np.ndarray
    touch_weight: np.ndarray
    touch_width: float
    depth_weight: float
    depth_width: float
    depth_free: float
    sdf_values: np.ndarray
    sdf_origin: np.ndarray
    sdf_inv_spacing: float


@njit(cache=True, inline="always", error_model="numpy")
def huber(r, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a residual: r^2 up to `width`, linear beyond."""
    a = abs(r)
    if a <= width:
        return r * r, 1.0
    return width * (2.0 * a - width), width / a


@njit(cache=True, inline="always", error_model="numpy")
def _cauchy(r, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a residual: about r^2 well below `width`, growing as its logarithm beyond."""
    u = r * r / (width * width)
    return width * width * math.log1p(u), 1.0 / (1.0 + u)


@njit(cache=True, inline="always", error_model="numpy")
def _geman(r, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a residual: about r^2 well below `width`, never above width^2."""
    f = 1.0 / (1.0 + r * r / (width * width))
    return r * r * f, f * f


@njit(cache=True, error_model="numpy")
def part_poses_H(packed, X_HL, X_PH, centre_H):  # type: ignore[no-untyped-def]
    """X_PH (Np, 3, 4) and the centres (Np, 3) of the parts' spheres in H."""
    for part in range(packed.part_link.shape[0]):
        X = X_HL[packed.part_link[part]]
        P, c = packed.part_X_PL[part], packed.part_centre[part]
        centre_H[part, 0], centre_H[part, 1], centre_H[part, 2] = moved_point(X, c[0], c[1], c[2])
        for row in range(3):
            t = P[row, 3]
            for col in range(3):  # R_PH = R_PL R_HL^T, t_PH = t_PL - R_PH t_HL
                r = P[row, 0] * X[col, 0] + P[row, 1] * X[col, 1] + P[row, 2] * X[col, 2]
                X_PH[part, row, col] = r
                t -= r * X[col, 3]
            X_PH[part, row, 3] = t


@njit(cache=True, inline="always", error_model="numpy")
def _in_part(packed, X_PH, part, x, y, z):  # type: ignore[no-untyped-def]
    X, size = X_PH[part], packed.part_size[part]
    px, py, pz = moved_point(X, x, y, z)
    kind = packed.part_kind[part]
    if kind == _BOX:
        return box_sdf(px, py, pz, size[0], size[1], size[2])
    if kind == _CAPSULE:
        return capsule_sdf(px, py, pz, size[0], size[1])
    planes = packed.hull_planes[packed.hull_plane_start[part] : packed.hull_plane_start[part + 1]]
    triangles = packed.hull_triangles[packed.hull_tri_start[part] : packed.hull_tri_start[part + 1]]
    return part_distance(kind, size, planes, triangles, px, py, pz)


@njit(cache=True, error_model="numpy")
def nearest_of_parts(packed, X_PH, centre_H, first, x, y, z):  # type: ignore[no-untyped-def]
    """(signed distance, part) of the part nearest to (x, y, z) in H; `first` is a guess, the better the faster."""
    best, found = _in_part(packed, X_PH, first, x, y, z), first
    for part in range(centre_H.shape[0]):
        dx, dy, dz = x - centre_H[part, 0], y - centre_H[part, 1], z - centre_H[part, 2]
        reach = best + packed.part_radius[part]  # the part is no nearer than its sphere
        if part == first or reach <= 0.0 or dx * dx + dy * dy + dz * dz > reach * reach:
            continue
        d = _in_part(packed, X_PH, part, x, y, z)
        if d < best:
            best, found = d, part
    return best, found


@njit(cache=True, error_model="numpy")
def gradient_in_H(packed, X_PH, part, x, y, z):  # type: ignore[no-untyped-def]
    """Gradient (3) in H of the signed distance to one part at (x, y, z) in H."""
    X = X_PH[part]
    px, py, pz = moved_point(X, x, y, z)
    planes = packed.hull_planes[packed.hull_plane_start[part] : packed.hull_plane_start[part + 1]]
    triangles = packed.hull_triangles[packed.hull_tri_start[part] : packed.hull_tri_start[part + 1]]
    gx, gy, gz = part_distance_gradient(packed.part_kind[part], packed.part_size[part], planes, triangles, px, py, pz)
    return (
        X[0, 0] * gx + X[1, 0] * gy + X[2, 0] * gz,
        X[0, 1] * gx + X[1, 1] * gy + X[2, 1] * gz,
        X[0, 2] * gx + X[1, 2] * gy + X[2, 2] * gz,
    )


@njit(cache=True, error_model="numpy")
def add_row(G, h, nx, ny, nz, x, y, z, r, w):  # type: ignore[no-untyped-def]
    """Add a residual r of weight w, whose change is n . (velocity of the link's point p), to the link's sums."""
    s = (nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx)
    for i in range(6):
        f = w * s[i]
        h[i] += f * r
        for j in range(i + 1):
            G[i, j] += f * s[j]


@njit(cache=True, error_model="numpy")
def _point_rows(packed, problem, X_OH, X_PH, centre_H, hint, G, h):  # type: ignore[no-untyped-def]
    total, count = 0.0, problem.points_O.shape[0]
    for m in range(count):
        p = problem.points_O[m]
        dx, dy, dz = p[0] - X_OH[0, 3], p[1] - X_OH[1, 3], p[2] - X_OH[2, 3]
        x = X_OH[0, 0] * dx + X_OH[1, 0] * dy + X_OH[2, 0] * dz
        y = X_OH[0, 1] * dx + X_OH[1, 1] * dy + X_OH[2, 1] * dz
        z = X_OH[0, 2] * dx + X_OH[1, 2] * dy + X_OH[2, 2] * dz
        r, part = nearest_of_parts(packed, X_PH, centre_H, hint[m], x, y, z)
        hint[m] = part
        share = problem.object_weight[m]
        if share > 0.0:
            cost, w = _geman(r, problem.width)
            cost, w = share * cost, share * w
        else:
            cost, w = huber(r, problem.width)
        total += cost
        gx, gy, gz = gradient_in_H(packed, X_PH, part, x, y, z)
        link = packed.part_link[part]
        add_row(G[link], h[link], -gx, -gy, -gz, x, y, z, r, w / count)  # the point stays, the hand moves
    return total / count


@njit(cache=True, error_model="numpy")
def _cover_rows(packed, problem, X_OH, X_HL, G, h):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(problem.material.shape[0]):
        weight = problem.cover[k]
        if weight == 0.0:
            continue
        i = problem.material[k]
        link, c = packed.point_link[i], packed.point_L[i]
        x, y, z = moved_point(X_HL[link], c[0], c[1], c[2])
        ox, oy, oz = moved_point(X_OH, x, y, z)
        best, found = math.inf, 0
        for m in range(problem.seen_O.shape[0]):
            dx, dy, dz = ox - problem.seen_O[m, 0], oy - problem.seen_O[m, 1], oz - problem.seen_O[m, 2]
            d = dx * dx + dy * dy + dz * dz
            if d < best:
                best, found = d, m
        gap = math.sqrt(best)
        if gap <= max(problem.cover_free, 1e-9):
            continue
        r = gap - problem.cover_free
        cost, w = huber(r, problem.cover_width)
        total += weight * cost
        p = problem.seen_O[found]
        dx, dy, dz = (ox - p[0]) / gap, (oy - p[1]) / gap, (oz - p[2]) / gap
        nx = X_OH[0, 0] * dx + X_OH[1, 0] * dy + X_OH[2, 0] * dz
        ny = X_OH[0, 1] * dx + X_OH[1, 1] * dy + X_OH[2, 1] * dz
        nz = X_OH[0, 2] * dx + X_OH[1, 2] * dy + X_OH[2, 2] * dz
        add_row(G[link], h[link], nx, ny, nz, x, y, z, r, weight * w)
    return total


@njit(cache=True, error_model="numpy")
def object_rows(packed, problem, X_OH, X_HL, nearest, G, h):  # type: ignore[no-untyped-def]
    """Depths of the probes in the object, and the links that touch it; `nearest` (L, 7) is work space."""
    total = 0.0
    for link in range(nearest.shape[0]):
        nearest[link, 0] = math.inf
    for k in range(problem.probe.shape[0]):
        i = problem.probe[k]
        link, c = packed.point_link[i], packed.point_L[i]
        x, y, z = moved_point(X_HL[link], c[0], c[1], c[2])
        ox, oy, oz = moved_point(X_OH, x, y, z)
        d, gx, gy, gz = grid_distance_gradient(
            problem.sdf_values, problem.sdf_origin, problem.sdf_inv_spacing, ox, oy, oz
        )
        deep = d + problem.depth_free
        if d >= nearest[link, 0] and deep >= 0.0:
            continue
        nx = X_OH[0, 0] * gx + X_OH[1, 0] * gy + X_OH[2, 0] * gz
        ny = X_OH[0, 1] * gx + X_OH[1, 1] * gy + X_OH[2, 1] * gz
        nz = X_OH[0, 2] * gx + X_OH[1, 2] * gy + X_OH[2, 2] * gz
        if deep < 0.0:
            cost, w = huber(deep, problem.depth_width)
            total += problem.depth_weight * cost
            add_row(G[link], h[link], nx, ny, nz, x, y, z, deep, problem.depth_weight * w)
        if d < nearest[link, 0]:
            near = nearest[link]
            near[0], near[1], near[2], near[3], near[4], near[5], near[6] = d, nx, ny, nz, x, y, z
    for link in range(nearest.shape[0]):
        weight = problem.touch_weight[link]
        if weight > 0.0 and nearest[link, 0] < math.inf:
            near = nearest[link]
            r = near[0] - problem.touch_mean[link]
            cost, w = _cauchy(r, problem.touch_width)
            total += weight * cost
            add_row(G[link], h[link], near[1], near[2], near[3], near[4], near[5], near[6], r, weight * w)
    return total


@njit(cache=True, error_model="numpy")
def link_twists(packed, X_HL, out):  # type: ignore[no-untyped-def]
    """Velocity of each link's points per unit speed of each joint, as twists [v at H's origin, w] in H; (L, J, 6)."""
    for i in range(out.shape[0]):
        up = packed.parents[i]
        if up >= 0:
            out[i] = out[up]
        else:
            out[i] = 0.0
        if packed.joint_types[i] == FIXED:
            continue
        X, axis = X_HL[i], packed.axes[i]
        ax, ay, az = turned_vector(X, axis[0], axis[1], axis[2])
        for j in range(out.shape[1]):
            c = packed.coupling[i, j]
            if c == 0.0:
                continue
            t = out[i, j]
            if packed.joint_types[i] == REVOLUTE:
                x, y, z = X[0, 3], X[1, 3], X[2, 3]
                t[0] += c * (y * az - z * ay)
                t[1] += c * (z * ax - x * az)
                t[2] += c * (x * ay - y * ax)
                t[3] += c * ax
                t[4] += c * ay
                t[5] += c * az
            else:
                t[0] += c * ax
                t[1] += c * ay
                t[2] += c * az


@njit(cache=True, error_model="numpy")
def assemble(G, h, twists, A, b):  # type: ignore[no-untyped-def]
    """Normal equations (lower triangle) over [base twist in H | q] from the sums of the links (L, 6, 6), (L, 6)."""
    joints = twists.shape[1]
    Gt = np.empty(6)
    for link in range(G.shape[0]):
        g = G[link]
        if g[0, 0] + g[1, 1] + g[2, 2] == 0.0:
            continue
        for i in range(6):
            b[i] += h[link, i]
            for j in range(i + 1):
                A[i, j] += g[i, j]
                g[j, i] = g[i, j]
        for j in range(joints):
            t = twists[link, j]
            if t[0] == 0.0 and t[1] == 0.0 and t[2] == 0.0 and t[3] == 0.0 and t[4] == 0.0 and t[5] == 0.0:
                continue
            for i in range(6):
                s = 0.0
                for k in range(6):
                    s += g[i, k] * t[k]
                Gt[i] = s
                A[6 + j, i] += s
                b[6 + j] += t[i] * h[link, i]
            for k in range(j + 1):
                u = twists[link, k]
                A[6 + j, 6 + k] += (
                    u[0] * Gt[0] + u[1] * Gt[1] + u[2] * Gt[2] + u[3] * Gt[3] + u[4] * Gt[4] + u[5] * Gt[5]
                )


class Work(NamedTuple):
    X_HL: np.ndarray
    X_PH: np.ndarray
    centre_H: np.ndarray
    nearest: np.ndarray
    G: np.ndarray
    h: np.ndarray
    twists: np.ndarray
    hint: np.ndarray


@njit(cache=True, error_model="numpy")
def new_work(packed, points):  # type: ignore[no-untyped-def]
    links, joints, parts = packed.parents.shape[0], packed.lower.shape[0], packed.part_link.shape[0]
    return Work(
        np.empty((links, 4, 4)),
        np.empty((parts, 3, 4)),
        np.empty((parts, 3)),
        np.empty((links, 7)),
        np.empty((links, 6, 6)),
        np.empty((links, 6)),
        np.empty((links, joints, 6)),
        np.zeros(points, np.int64),
    )


@njit(cache=True, error_model="numpy")
def _posture_rows(problem, q, A, b):  # type: ignore[no-untyped-def]
    """Twice the negative logarithm of a multivariate t distribution: a few known grasps do not bound the others."""
    joints, squared = q.shape[0], 0.0
    for i in range(joints):
        pull = 0.0
        for j in range(joints):
            pull += problem.q_precision[i, j] * (q[j] - problem.q_mean[j])
        squared += pull * (q[i] - problem.q_mean[i])
    whole = problem.q_freedom + joints
    w = problem.q_unit * whole / (problem.q_freedom + squared)
    for i in range(joints):
        for j in range(joints):
            b[6 + i] += w * problem.q_precision[i, j] * (q[j] - problem.q_mean[j])
            if j <= i:
                A[6 + i, 6 + j] += w * problem.q_precision[i, j]
    return problem.q_unit * whole * math.log1p(squared / problem.q_freedom)


@njit(cache=True, error_model="numpy")
def evaluate(packed, problem, X_OH, q, work, A, b):  # type: ignore[no-untyped-def]
    """Cost at a pose and joints, and the Gauss-Newton matrix (lower triangle) and gradient of half of it."""
    pose_links(packed, q, work.X_HL)
    part_poses_H(packed, work.X_HL, work.X_PH, work.centre_H)
    work.G[:] = 0.0
    work.h[:] = 0.0
    A[:] = 0.0
    b[:] = 0.0
    total = _point_rows(packed, problem, X_OH, work.X_PH, work.centre_H, work.hint, work.G, work.h)
    total += _cover_rows(packed, problem, X_OH, work.X_HL, work.G, work.h)
    if problem.depth_weight > 0.0:
        total += object_rows(packed, problem, X_OH, work.X_HL, work.nearest, work.G, work.h)
    link_twists(packed, work.X_HL, work.twists)
    assemble(work.G, work.h, work.twists, A, b)
    return total + _posture_rows(problem, q, A, b)


@njit(cache=True, error_model="numpy")
def fit_cost(packed, problem, X_OH, q):  # type: ignore[no-untyped-def]
    """The quantity that `fit_hand` lowers, square metres; arguments as there."""
    size = 6 + q.shape[0]
    work = new_work(packed, problem.points_O.shape[0])
    return evaluate(packed, problem, X_OH, q, work, np.empty((size, size)), np.empty(size))


@njit(cache=True, error_model="numpy")
def fit_gradient(packed, problem, X_OH, q):  # type: ignore[no-untyped-def]
    """(6 + J,) derivative of `fit_cost` by the base twist [v, w] in H and the joints."""
    size = 6 + q.shape[0]
    b = np.empty(size)
    evaluate(packed, problem, X_OH, q, new_work(packed, problem.points_O.shape[0]), np.empty((size, size)), b)
    return 2.0 * b
