"""Least squares over a hand's pose and joints, and a size where it is fitted: what every such fit is made of, compiled.

A fit lowers a sum of robust residuals of points of the links. Unknown are the base twist [v, w] in H, the joints q,
and, with seven rows, the logarithm of the size. Rows of one link are summed as a small matrix before the kinematics,
so that joints do not raise the cost of a point (`add_row`, `assemble`). One turn of the solver is then `hold_limits`,
`damped_step`, `moved_hand`. Torch-free.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, turned_vector
from neuralgrasps.geometry.sdf_grid import grid_distance_gradient
from neuralgrasps.kinematics.tree import FIXED, REVOLUTE


@njit(cache=True, inline="always", error_model="numpy")
def huber(r, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a residual: r^2 up to `width`, linear beyond."""
    a = abs(r)
    if a <= width:
        return r * r, 1.0
    return width * (2.0 * a - width), width / a


@njit(cache=True, inline="always", error_model="numpy")
def slow_cost(squared, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a squared residual: itself well below `width`, growing as its logarithm beyond (Cauchy)."""
    u = squared / (width * width)
    return width * width * math.log1p(u), 1.0 / (1.0 + u)


@njit(cache=True, inline="always", error_model="numpy")
def bounded_cost(squared, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a squared residual: itself well below `width`, never above width^2 (Geman and McClure)."""
    f = 1.0 / (1.0 + squared / (width * width))
    return squared * f, f * f


@njit(cache=True, inline="always", error_model="numpy")
def turned_back(X, x, y, z):  # type: ignore[no-untyped-def]
    """A vector turned by the inverse of X's rotation."""
    return (
        X[0, 0] * x + X[1, 0] * y + X[2, 0] * z,
        X[0, 1] * x + X[1, 1] * y + X[2, 1] * z,
        X[0, 2] * x + X[1, 2] * y + X[2, 2] * z,
    )


class Work(NamedTuple):
    """Memory of one fit, used again by every evaluation.

    Attributes:
        X_HL (L, 4, 4), X_PH (Np, 3, 4), centre_H (Np, 3): the posed links, parts, and the parts' spheres.
        nearest (L, 7): of `object_rows`. hint (M,): the part that each point was nearest to.
        G (L, rows, rows), h (L, rows): sums of the links. twists (L, J, 6): of `link_twists`.
    """

    X_HL: np.ndarray
    X_PH: np.ndarray
    centre_H: np.ndarray
    nearest: np.ndarray
    G: np.ndarray
    h: np.ndarray
    twists: np.ndarray
    hint: np.ndarray


@njit(cache=True, error_model="numpy")
def new_work(packed, points, rows=6):  # type: ignore[no-untyped-def]
    """Work space for a hand and a number of points; 7 rows where a size is fitted."""
    links, joints, parts = packed.parents.shape[0], packed.lower.shape[0], packed.part_link.shape[0]
    return Work(
        np.empty((links, 4, 4)),
        np.empty((parts, 3, 4)),
        np.empty((parts, 3)),
        np.empty((links, 7)),
        np.empty((links, rows, rows)),
        np.empty((links, rows)),
        np.empty((links, joints, 6)),
        np.zeros(points, np.int64),
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
def add_sized_row(G, h, nx, ny, nz, x, y, z, more, r, w):  # type: ignore[no-untyped-def]
    """`add_row` of a hand that may grow: when its size grows by its share, r changes by n . p + more."""
    s = (nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx, nx * x + ny * y + nz * z + more)
    for i in range(7):
        f = w * s[i]
        h[i] += f * r
        for j in range(i + 1):
            G[i, j] += f * s[j]


@njit(cache=True, error_model="numpy")
def object_rows(packed, problem, X_OH, X_HL, nearest, G, h):  # type: ignore[no-untyped-def]
    """Depths of probes in an object, and links that should touch it; their cost.

    Args:
        problem: has `probe`, `touch_mean`, `touch_weight`, `touch_width`, `depth_weight`, `depth_width`, `depth_free`
            and the object's grid as `model.fit_kernels.FitProblem`.
        nearest: (L, 7) work space.
    """
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
        nx, ny, nz = turned_back(X_OH, gx, gy, gz)
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
            cost, w = slow_cost(r * r, problem.touch_width)
            total += weight * cost
            add_row(G[link], h[link], near[1], near[2], near[3], near[4], near[5], near[6], r, weight * w)
    return total


@njit(cache=True, error_model="numpy")
def posture_rows(mean, precision, freedom, unit, q, A, b):  # type: ignore[no-untyped-def]
    """Twice the negative logarithm of a multivariate t distribution, times `unit`: known postures do not bound others.

    Args:
        mean: (J,), precision: (J, J) inverse covariance, freedom: of the distribution.
        A, b: normal equations, to which its rows are added.
    """
    joints, squared = q.shape[0], 0.0
    for i in range(joints):
        pull = 0.0
        for j in range(joints):
            pull += precision[i, j] * (q[j] - mean[j])
        squared += pull * (q[i] - mean[i])
    whole = freedom + joints
    w = unit * whole / (freedom + squared)
    for i in range(joints):
        for j in range(joints):
            b[6 + i] += w * precision[i, j] * (q[j] - mean[j])
            if j <= i:
                A[6 + i, 6 + j] += w * precision[i, j]
    return unit * whole * math.log1p(squared / freedom)


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
    """Normal equations (lower triangle) over [base twist in H | q | log size] from the sums of the links.

    Args:
        G: (L, rows, rows), h: (L, rows) with 6 rows, or 7 with the size; twists: (L, J, 6).
    """
    joints, rows = twists.shape[1], G.shape[1]
    last = 6 + joints
    Gt = np.empty(rows)
    for link in range(G.shape[0]):
        g = G[link]
        if g[0, 0] + g[1, 1] + g[2, 2] == 0.0:
            continue
        for i in range(rows):
            k = i if i < 6 else last
            b[k] += h[link, i]
            for j in range(i + 1):
                A[k, j if j < 6 else last] += g[i, j]
                g[j, i] = g[i, j]
        for j in range(joints):
            t = twists[link, j]
            if t[0] == 0.0 and t[1] == 0.0 and t[2] == 0.0 and t[3] == 0.0 and t[4] == 0.0 and t[5] == 0.0:
                continue
            for i in range(rows):
                s = 0.0
                for k in range(6):
                    s += g[i, k] * t[k]
                Gt[i] = s
            for i in range(6):
                A[6 + j, i] += Gt[i]
                b[6 + j] += t[i] * h[link, i]
            if rows > 6:
                A[last, 6 + j] += Gt[6]
            for k in range(j + 1):
                u = twists[link, k]
                A[6 + j, 6 + k] += (
                    u[0] * Gt[0] + u[1] * Gt[1] + u[2] * Gt[2] + u[3] * Gt[3] + u[4] * Gt[4] + u[5] * Gt[5]
                )


@njit(cache=True, error_model="numpy")
def hold_limits(packed, q, A, b):  # type: ignore[no-untyped-def]
    """Joints pressed against a limit stay there: cut off from the other unknowns, with their own diagonal as it was."""
    for j in range(q.shape[0]):
        if (q[j] <= packed.lower[j] and b[6 + j] > 0.0) or (q[j] >= packed.upper[j] and b[6 + j] < 0.0):
            A[6 + j, : 6 + j] = 0.0
            A[7 + j :, 6 + j] = 0.0
            b[6 + j] = 0.0


@njit(cache=True, error_model="numpy")
def damped_step(A, b, damping, least, damped, step):  # type: ignore[no-untyped-def]
    """Levenberg and Marquardt's step from the normal equations into `step`; `damped` is work space.

    The diagonal is raised by the share `damping` and by `least`. False where the step is of no use.
    """
    add_damped(A, damping, least, damped)
    if not solve_spd(damped, b, step):
        return False
    for i in range(step.shape[0]):
        step[i] = -step[i]
    return True


@njit(cache=True, error_model="numpy")
def moved_hand(packed, X, q, step, X_new, q_new):  # type: ignore[no-untyped-def]
    """The pose and joints after a step [v, w | q | ...] into `X_new`, `q_new`; joints stay within their limits."""
    moved_pose(X, step, X_new)
    for j in range(q.shape[0]):
        q_new[j] = min(max(q[j] + step[6 + j], packed.lower[j]), packed.upper[j])


@njit(cache=True, error_model="numpy")
def moved_pose(X, step, out):  # type: ignore[no-untyped-def]
    """X times the motion [v, w] = step[:6] (rotation vector w, translation v) into `out`."""
    wx, wy, wz = step[3], step[4], step[5]
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    a = math.sin(angle) / angle if angle > 1e-12 else 1.0
    c = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-6 else 0.5
    xx, yy, zz = wx * wx, wy * wy, wz * wz
    columns = (
        (1.0 - c * (yy + zz), c * wx * wy + a * wz, c * wx * wz - a * wy),
        (c * wx * wy - a * wz, 1.0 - c * (xx + zz), c * wy * wz + a * wx),
        (c * wx * wz + a * wy, c * wy * wz - a * wx, 1.0 - c * (xx + yy)),
    )
    for j in range(3):
        x, y, z = columns[j]
        for i in range(3):
            out[i, j] = X[i, 0] * x + X[i, 1] * y + X[i, 2] * z
    for i in range(3):
        out[i, 3] = X[i, 0] * step[0] + X[i, 1] * step[1] + X[i, 2] * step[2] + X[i, 3]


@njit(cache=True, error_model="numpy")
def add_damped(A, damping, least, out):  # type: ignore[no-untyped-def]
    """The lower triangle of A (n, n) with its diagonal raised by the share `damping`, and by `least`, into `out`."""
    for i in range(A.shape[0]):
        for j in range(i):
            out[i, j] = A[i, j]
        out[i, i] = A[i, i] * (1.0 + damping) + least


@njit(cache=True, error_model="numpy")
def solve_spd(A, b, out):  # type: ignore[no-untyped-def]
    """Solve A x = b by Cholesky from the lower triangle of A (n, n), which is overwritten; x into `out` (n,).

    Returns:
        False when A is not positive definite to rounding; `out` is then of no use.
    """
    n = A.shape[0]
    for j in range(n):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        if not s > 1e-300:
            return False
        pivot = math.sqrt(s)
        A[j, j] = pivot
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s / pivot
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= A[i, k] * out[k]
        out[i] = s / A[i, i]
    for i in range(n - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, n):
            s -= A[k, i] * out[k]
        out[i] = s / A[i, i]
    return True
