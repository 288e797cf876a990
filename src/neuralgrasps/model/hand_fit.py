"""Compiled least-squares fit of a hand's pose and joints to points on its surface, on exact distances. Torch-free."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.hands.packed import nearest_part, part_distance_H, pose_links
from neuralgrasps.kinematics.jacobian import point_jacobian

_STEP = 1e-6  # metres, of the difference quotient for the gradient of one part's distance


@njit(cache=True, error_model="numpy")
def _poses(packed, q, X_HL):  # type: ignore[no-untyped-def]
    pose_links(packed, q, X_HL)


@njit(cache=True, error_model="numpy")
def _to_hand(X_OH, x, y, z, out):  # type: ignore[no-untyped-def]
    dx, dy, dz = x - X_OH[0, 3], y - X_OH[1, 3], z - X_OH[2, 3]
    for k in range(3):
        out[k] = X_OH[0, k] * dx + X_OH[1, k] * dy + X_OH[2, k] * dz


@njit(cache=True, error_model="numpy")
def _link_point(X_HL, p_L, out):  # type: ignore[no-untyped-def]
    for k in range(3):
        out[k] = X_HL[k, 0] * p_L[0] + X_HL[k, 1] * p_L[1] + X_HL[k, 2] * p_L[2] + X_HL[k, 3]


@njit(cache=True, error_model="numpy")
def _huber(r, width):  # type: ignore[no-untyped-def]
    """(cost, weight) of a residual: r^2 up to `width`, linear beyond."""
    a = abs(r)
    if a <= width:
        return r * r, 1.0
    return width * (2.0 * a - width), width / a


@njit(cache=True, error_model="numpy")
def _nearest(points_H, p):  # type: ignore[no-untyped-def]
    """(distance, index) of the point (M, 3) nearest to p (3,)."""
    best, found = math.inf, -1
    for m in range(points_H.shape[0]):
        dx, dy, dz = points_H[m, 0] - p[0], points_H[m, 1] - p[1], points_H[m, 2] - p[2]
        d = dx * dx + dy * dy + dz * dz
        if d < best:
            best, found = d, m
    return math.sqrt(best), found


@njit(cache=True, error_model="numpy")
def fit_cost(packed, points_O, material, X_OH, q, q_prior, width, coverage, prior):  # type: ignore[no-untyped-def]
    """The quantity that `fit_hand` lowers, square metres; arguments as there."""
    X_HL = np.empty((packed.parents.shape[0], 4, 4))
    _poses(packed, q, X_HL)
    points_H = np.empty(points_O.shape)
    total = 0.0
    for m in range(points_O.shape[0]):
        p = points_H[m]
        _to_hand(X_OH, points_O[m, 0], points_O[m, 1], points_O[m, 2], p)
        total += _huber(nearest_part(packed, X_HL, p[0], p[1], p[2])[0], width)[0]
    total /= points_O.shape[0]
    if coverage > 0.0:
        p = np.empty(3)
        covered = 0.0
        for k in range(material.shape[0]):
            i = material[k]
            _link_point(X_HL[packed.point_link[i]], packed.point_L[i], p)
            covered += _huber(_nearest(points_H, p)[0], width)[0]
        total += coverage * covered / material.shape[0]
    for j in range(q.shape[0]):
        u = (q[j] - q_prior[j]) / (packed.upper[j] - packed.lower[j])
        total += prior * u * u
    return total


@njit(cache=True, error_model="numpy")
def _add_row(A, b, row, r, w):  # type: ignore[no-untyped-def]
    for i in range(row.shape[0]):
        f = w * row[i]
        if f != 0.0:
            b[i] += f * r
            for j in range(i + 1):
                A[i, j] += f * row[j]


@njit(cache=True, error_model="numpy")
def _normal_equations(packed, points_O, material, X_OH, q, q_prior, width, coverage, prior, A, b):  # type: ignore[no-untyped-def]
    """Gauss-Newton matrix and gradient of `fit_cost` / 2 over [base twist in H (v, w) | q]."""
    links, joints = packed.parents.shape[0], q.shape[0]
    X_HL = np.empty((links, 4, 4))
    _poses(packed, q, X_HL)
    A[:] = 0.0
    b[:] = 0.0
    row = np.empty(6 + joints)
    J = np.empty((3, joints))
    n = np.empty(3)
    points_H = np.empty(points_O.shape)
    scale = 1.0 / points_O.shape[0]
    for m in range(points_O.shape[0]):
        p = points_H[m]
        _to_hand(X_OH, points_O[m, 0], points_O[m, 1], points_O[m, 2], p)
        x, y, z = p[0], p[1], p[2]
        r, part = nearest_part(packed, X_HL, x, y, z)
        n[0] = part_distance_H(packed, X_HL, part, x + _STEP, y, z) - part_distance_H(
            packed, X_HL, part, x - _STEP, y, z
        )
        n[1] = part_distance_H(packed, X_HL, part, x, y + _STEP, z) - part_distance_H(
            packed, X_HL, part, x, y - _STEP, z
        )
        n[2] = part_distance_H(packed, X_HL, part, x, y, z + _STEP) - part_distance_H(
            packed, X_HL, part, x, y, z - _STEP
        )
        n /= -2.0 * _STEP  # the point is fixed in the world: it moves against the hand
        link = packed.part_link[part]
        point_jacobian(packed.parents, packed.joint_types, packed.axes, packed.coupling, X_HL, link, p, J)
        _fill(row, n, p, J)
        _add_row(A, b, row, r, scale * _huber(r, width)[1])
    if coverage > 0.0:
        scale = coverage / material.shape[0]
        p = np.empty(3)
        for k in range(material.shape[0]):
            i = material[k]
            link = packed.point_link[i]
            _link_point(X_HL[link], packed.point_L[i], p)
            r, m = _nearest(points_H, p)
            if r > 1e-9:
                for c in range(3):
                    n[c] = (p[c] - points_H[m, c]) / r
                point_jacobian(packed.parents, packed.joint_types, packed.axes, packed.coupling, X_HL, link, p, J)
                _fill(row, n, p, J)
                _add_row(A, b, row, r, scale * _huber(r, width)[1])
    for j in range(joints):
        span = packed.upper[j] - packed.lower[j]
        A[6 + j, 6 + j] += prior / (span * span)
        b[6 + j] += prior * (q[j] - q_prior[j]) / (span * span)
    for i in range(6 + joints):
        for j in range(i):
            A[j, i] = A[i, j]


@njit(cache=True, error_model="numpy")
def _fill(row, n, p, J):  # type: ignore[no-untyped-def]
    """Derivative of n . (motion of the link's point p): base twist [v, w], then joints."""
    row[0], row[1], row[2] = n[0], n[1], n[2]
    row[3] = p[1] * n[2] - p[2] * n[1]
    row[4] = p[2] * n[0] - p[0] * n[2]
    row[5] = p[0] * n[1] - p[1] * n[0]
    for j in range(J.shape[1]):
        row[6 + j] = n[0] * J[0, j] + n[1] * J[1, j] + n[2] * J[2, j]


@njit(cache=True, error_model="numpy")
def _moved(X, step, out):  # type: ignore[no-untyped-def]
    """X times the motion [v, w] = step[:6] (rotation vector w, translation v) into `out`."""
    wx, wy, wz = step[3], step[4], step[5]
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    a = math.sin(angle) / angle if angle > 1e-12 else 1.0
    c = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-6 else 0.5
    R = np.empty((3, 3))
    R[0, 0], R[1, 1], R[2, 2] = (
        1.0 - c * (wy * wy + wz * wz),
        1.0 - c * (wx * wx + wz * wz),
        1.0 - c * (wx * wx + wy * wy),
    )
    R[0, 1], R[1, 0] = c * wx * wy - a * wz, c * wx * wy + a * wz
    R[0, 2], R[2, 0] = c * wx * wz + a * wy, c * wx * wz - a * wy
    R[1, 2], R[2, 1] = c * wy * wz - a * wx, c * wy * wz + a * wx
    for i in range(3):
        for j in range(3):
            out[i, j] = X[i, 0] * R[0, j] + X[i, 1] * R[1, j] + X[i, 2] * R[2, j]
        out[i, 3] = X[i, 0] * step[0] + X[i, 1] * step[1] + X[i, 2] * step[2] + X[i, 3]


@njit(cache=True, error_model="numpy")
def fit_hand(packed, points_O, material, X_OH, q, q_prior, iterations, width, coverage, prior):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt on the exact signed distances of the points, in place; (cost, iterations done, converged).

    Args:
        packed: the hand.
        points_O: (M, 3) points that should lie on its surface, object frame, metres.
        material: (K,) indices of hand surface points that should have an observed point near them.
        X_OH: (4, 4), q: (J,): start, overwritten by the result; joints stay within their limits.
        q_prior: (J,) posture that joints are drawn to.
        width: metres, residuals beyond it count linearly.
        coverage: weight of `material`, against 1 for the points (0 when parts of the hand may be unseen).
        prior: square metres per squared share of a joint's range.
    """
    size = 6 + q.shape[0]
    A, b = np.empty((size, size)), np.empty(size)
    X_new, q_new = X_OH.copy(), q.copy()
    damping = 1e-2
    cost = fit_cost(packed, points_O, material, X_OH, q, q_prior, width, coverage, prior)
    for iteration in range(iterations):
        _normal_equations(packed, points_O, material, X_OH, q, q_prior, width, coverage, prior, A, b)
        for j in range(q.shape[0]):  # joints pressed against a limit stay there
            if (q[j] <= packed.lower[j] and b[6 + j] > 0.0) or (q[j] >= packed.upper[j] and b[6 + j] < 0.0):
                A[6 + j, :] = 0.0
                A[:, 6 + j] = 0.0
                b[6 + j] = 0.0
        improved = False
        for _ in range(8):
            damped = A.copy()
            for i in range(size):
                damped[i, i] += damping * A[i, i] + 1e-9
            step = np.linalg.solve(damped, -b)
            _moved(X_OH, step, X_new)
            for j in range(q.shape[0]):
                q_new[j] = min(max(q[j] + step[6 + j], packed.lower[j]), packed.upper[j])
            trial = fit_cost(packed, points_O, material, X_new, q_new, q_prior, width, coverage, prior)
            if trial < cost:
                improved = True
                break
            damping *= 4.0
        if not improved:
            return cost, iteration + 1, True
        gain = cost - trial
        X_OH[:] = X_new
        q[:] = q_new
        cost = trial
        damping = max(0.25 * damping, 1e-7)
        if gain < 1e-5 * cost + 1e-14:
            return cost, iteration + 1, True
    return cost, iterations, False


@njit(cache=True, error_model="numpy")
def score_starts(packed, points_O, material, X_OH, q, width, coverage, out):  # type: ignore[no-untyped-def]
    """`fit_cost` without prior of N starts X_OH (N, 4, 4), q (N, J) into `out` (N,)."""
    for i in range(q.shape[0]):
        out[i] = fit_cost(packed, points_O, material, X_OH[i], q[i], q[i], width, coverage, 0.0)
