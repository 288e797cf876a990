"""Levenberg-Marquardt over a human hand's pose, joints and size, compiled. Torch-free."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.hands.least_squares import damped_step, hold_limits, moved_hand, new_work
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.posed_parts import nearest_of_parts, part_poses_H
from neuralgrasps.human.fit.kernels import ROWS, hand_cost_rows, in_hand

_MOST_GROWTH = 0.1  # of the log size in one step


@njit(cache=True, error_model="numpy")
def _step_to(packed, X_CH, q, scale, step, X_new, q_new):  # type: ignore[no-untyped-def]
    """Write the pose and joints after a step (27,), which is overwritten; returns the new size."""
    for i in range(3):
        step[i] *= scale  # it is in lengths of the hand of size 1
    moved_hand(packed, X_CH, q, step, X_new, q_new)
    growth = min(max(step[6 + q.shape[0]], -_MOST_GROWTH), _MOST_GROWTH)
    return scale * math.exp(growth)


@njit(cache=True, error_model="numpy", nogil=True)
def lower_cost(packed, problem, X_CH, q, scale, iterations, enough):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt in place; (cost, size, steps done).

    Args:
        packed: the hand of size 1; problem: a `HandProblem`.
        X_CH: (4, 4), q: (J,): start, overwritten by the result; joints stay within their limits. scale: start.
        enough: a step that gains a smaller share of the cost is the last one.
    """
    size = 7 + q.shape[0]
    A, b, A_new, b_new = np.empty((size, size)), np.empty(size), np.empty((size, size)), np.empty(size)
    damped, step = np.empty((size, size)), np.empty(size)
    X_new, q_new = X_CH.copy(), q.copy()
    work = new_work(packed, problem.cloud_C.shape[0], ROWS)
    damping = 1e-2
    cost = hand_cost_rows(packed, problem, X_CH, q, scale, work, A, b)
    for iteration in range(iterations):
        hold_limits(packed, q, A, b)
        improved, trial, scale_new = False, cost, scale
        for _ in range(5):
            if damped_step(A, b, damping, 1e-6, damped, step):
                scale_new = _step_to(packed, X_CH, q, scale, step, X_new, q_new)
                trial = hand_cost_rows(packed, problem, X_new, q_new, scale_new, work, A_new, b_new)
                if trial < cost:
                    improved = True
                    break
            damping *= 6.0
        if not improved:
            return cost, scale, iteration + 1
        gain = cost - trial
        X_CH[:] = X_new
        q[:] = q_new
        scale = scale_new
        A, A_new = A_new, A
        b, b_new = b_new, b
        cost = trial
        damping = max(0.2 * damping, 1e-6)
        if gain < enough * cost:
            return cost, scale, iteration + 1
    return cost, scale, iterations


@njit(cache=True, error_model="numpy", nogil=True)
def lower_costs(packed, problem, X_CH, q, scale, iterations, enough, cost):  # type: ignore[no-untyped-def]
    """`lower_cost` of N starts in place: X_CH (N, 4, 4), q (N, J), scale (N,); their costs into `cost` (N,)."""
    for i in range(q.shape[0]):
        cost[i], scale[i], _ = lower_cost(packed, problem, X_CH[i], q[i], scale[i], iterations, enough)


@njit(cache=True, error_model="numpy", nogil=True)
def curvature(packed, problem, X_CH, q, scale):  # type: ignore[no-untyped-def]
    """The Gauss-Newton matrix A (27, 27), and what the unknowns do to the 21 joints' places, J (63, 27), at a result.

    Joints pressed against a limit are cut off from the other unknowns, but keep their own diagonal: of the Gaussian of
    A, they move as if all else stood still.
    """
    size = 7 + q.shape[0]
    A, b, J = np.empty((size, size)), np.empty(size), np.zeros((3 * problem.joint_link.shape[0], size))
    work = new_work(packed, problem.cloud_C.shape[0], ROWS)
    hand_cost_rows(packed, problem, X_CH, q, scale, work, A, b)
    hold_limits(packed, q, A, b)
    for i in range(size):
        for j in range(i):
            A[j, i] = A[i, j]
    for k in range(problem.joint_link.shape[0]):
        link, c = problem.joint_link[k], problem.joint_L[k]
        y = moved_point(work.X_HL[link], c[0], c[1], c[2])
        rows = J[3 * k : 3 * k + 3]
        for i in range(3):
            rows[i, i] = scale
            rows[i, size - 1] = scale * y[i] if problem.free_scale else 0.0
            up, down = (i + 1) % 3, (i + 2) % 3  # (w x y)_i = w_up y_down - w_down y_up
            rows[i, 3 + up], rows[i, 3 + down] = scale * y[down], -scale * y[up]
            for j in range(q.shape[0]):
                t = work.twists[link, j]
                rows[i, 6 + j] = scale * (t[i] + t[3 + up] * y[down] - t[3 + down] * y[up])
    return A, J


@njit(cache=True, error_model="numpy", nogil=True)
def cloud_distances(packed, problem, X_CH, q, scale):  # type: ignore[no-untyped-def]
    """(M,) signed distances of the cloud's points to the hand, metres, and the links (M,) they are nearest to."""
    count = problem.cloud_C.shape[0]
    work, distance, link = new_work(packed, count, ROWS), np.empty(count), np.empty(count, np.int64)
    pose_links(packed, q, work.X_HL)
    part_poses_H(packed, work.X_HL, work.X_PH, work.centre_H)
    for m in range(count):
        x, y, z = in_hand(X_CH, scale, problem.cloud_C[m])
        r, part = nearest_of_parts(packed, work.X_PH, work.centre_H, 0, x, y, z)
        distance[m], link[m] = scale * r, packed.part_link[part]
    return distance, link
