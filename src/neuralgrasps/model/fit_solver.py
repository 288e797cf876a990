"""Levenberg-Marquardt over a hand's pose and joints, compiled. Torch-free."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.model.fit_kernels import evaluate, new_work
from neuralgrasps.model.spd import add_damped, solve_spd


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
def hold_limits(packed, q, A, b):  # type: ignore[no-untyped-def]
    """Joints pressed against a limit stay there."""
    for j in range(q.shape[0]):
        if (q[j] <= packed.lower[j] and b[6 + j] > 0.0) or (q[j] >= packed.upper[j] and b[6 + j] < 0.0):
            A[6 + j, : 6 + j] = 0.0
            A[7 + j :, 6 + j] = 0.0
            b[6 + j] = 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def fit_hand(packed, problem, X_OH, q, iterations):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt in place; (cost, iterations done, converged).

    Args:
        packed: the hand; problem: a `FitProblem`.
        X_OH: (4, 4), q: (J,): start, overwritten by the result; joints stay within their limits.
    """
    size = 6 + q.shape[0]
    A, b, A_new, b_new = np.empty((size, size)), np.empty(size), np.empty((size, size)), np.empty(size)
    damped, step = np.empty((size, size)), np.empty(size)
    X_new, q_new = X_OH.copy(), q.copy()
    work = new_work(packed, problem.points_O.shape[0])
    damping = 1e-2
    cost = evaluate(packed, problem, X_OH, q, work, A, b)
    for iteration in range(iterations):
        hold_limits(packed, q, A, b)
        improved, trial = False, cost
        for _ in range(6):
            add_damped(A, damping, 1e-10, damped)
            if solve_spd(damped, b, step):
                for i in range(size):
                    step[i] = -step[i]
                moved_pose(X_OH, step, X_new)
                for j in range(q.shape[0]):
                    q_new[j] = min(max(q[j] + step[6 + j], packed.lower[j]), packed.upper[j])
                trial = evaluate(packed, problem, X_new, q_new, work, A_new, b_new)
                if trial < cost:
                    improved = True
                    break
            damping *= 5.0
        if not improved:
            return cost, iteration + 1, True
        gain = cost - trial
        X_OH[:] = X_new
        q[:] = q_new
        A, A_new = A_new, A
        b, b_new = b_new, b
        cost = trial
        damping = max(0.2 * damping, 1e-6)
        if gain < 1e-4 * cost + 1e-14:
            return cost, iteration + 1, True
    return cost, iterations, False


@njit(cache=True, error_model="numpy", nogil=True)
def score_starts(packed, problem, X_OH, q, out):  # type: ignore[no-untyped-def]
    """`fit_cost` of N starts X_OH (N, 4, 4), q (N, J) into `out` (N,)."""
    size = 6 + q.shape[1]
    work = new_work(packed, problem.points_O.shape[0])
    A, b = np.empty((size, size)), np.empty(size)
    for i in range(q.shape[0]):
        out[i] = evaluate(packed, problem, X_OH[i], q[i], work, A, b)


@njit(cache=True, error_model="numpy", nogil=True)
def fit_starts(packed, problem, X_OH, q, iterations, cost, stopped):  # type: ignore[no-untyped-def]
    """`fit_hand` of N starts in place; their costs into `cost` (N,), whether they converged into `stopped` (N,)."""
    for i in range(q.shape[0]):
        cost[i], _, stopped[i] = fit_hand(packed, problem, X_OH[i], q[i], iterations)
