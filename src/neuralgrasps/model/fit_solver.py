"""Levenberg-Marquardt over a hand's pose and joints, compiled. Torch-free."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.hands.least_squares import damped_step, hold_limits, moved_hand, new_work
from neuralgrasps.model.fit_kernels import evaluate


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
            if damped_step(A, b, damping, 1e-10, damped, step):
                moved_hand(packed, X_OH, q, step, X_new, q_new)
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
