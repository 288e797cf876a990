"""Move a hand so that its contact map becomes the asked one: Levenberg-Marquardt over pose and joints, compiled.

The hand need not touch or hold anything: what comes out is nearly a grasp, overlaps a little, and is closed afterwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.apply.transfer_kernels import Target
from neuralgrasps.compiled import njit
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.least_squares import (
    add_damped,
    add_row,
    assemble,
    hold_limits,
    huber,
    link_twists,
    moved_pose,
    new_work,
    object_rows,
    solve_spd,
)
from neuralgrasps.hands.packed import PackedHand, pose_links
from neuralgrasps.hands.posed_parts import gradient_in_H, nearest_of_parts, part_poses_H
from neuralgrasps.objects.object_model import ObjectModel

NEAR = 0.05  # differences of closeness below this count squared, above as they are
DEPTH_WEIGHT = 1000.0  # of a probe's squared depth in the object, per square metre; the map's cost is at most about 1
DEPTH_WIDTH_M = 0.005
STIFFNESS = 0.02  # cost of moving a joint over its whole range


class MapProblem(NamedTuple):
    """What the descent lowers: the difference to a `Target`'s map, and probes of the hand in the object.

    Attributes:
        points, closeness, weight, inv_radius: of the `Target`. stiffness: (J,) cost of moving a joint by 1 rad or m,
            squared.
        others: see `fit_kernels.FitProblem`; no link is asked to touch.
    """

    points: np.ndarray
    closeness: np.ndarray
    weight: np.ndarray
    inv_radius: float
    stiffness: np.ndarray
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


def map_problem(hand: Hand, obj: ObjectModel, packed: PackedHand, target: Target) -> MapProblem:
    """The problem of a hand, its surface points `packed` as probes, an object and a target."""
    links, sdf = len(packed.link_radius), obj.sdf
    span = np.maximum(hand.tree.upper - hand.tree.lower, 1e-6)
    return MapProblem(
        *target,
        stiffness=STIFFNESS / span**2,
        probe=np.arange(len(packed.point_L)),
        touch_mean=np.zeros(links),
        touch_weight=np.zeros(links),
        touch_width=1.0,
        depth_weight=DEPTH_WEIGHT,
        depth_width=DEPTH_WIDTH_M,
        depth_free=0.0,
        sdf_values=sdf.values,
        sdf_origin=sdf.origin,
        sdf_inv_spacing=sdf.inv_spacing,
    )


@njit(cache=True, error_model="numpy")
def _map_rows(packed, problem, X_OH, X_PH, centre_H, hint, G, h):  # type: ignore[no-untyped-def]
    """Mean cost of the map's differences; adds their rows to the links' sums."""
    total, count = 0.0, problem.points.shape[0]
    for m in range(count):
        p = problem.points[m]
        dx, dy, dz = p[0] - X_OH[0, 3], p[1] - X_OH[1, 3], p[2] - X_OH[2, 3]
        x = X_OH[0, 0] * dx + X_OH[1, 0] * dy + X_OH[2, 0] * dz
        y = X_OH[0, 1] * dx + X_OH[1, 1] * dy + X_OH[2, 1] * dz
        z = X_OH[0, 2] * dx + X_OH[1, 2] * dy + X_OH[2, 2] * dz
        d, part = nearest_of_parts(packed, X_PH, centre_H, hint[m], x, y, z)
        hint[m] = part
        closeness = math.exp(-max(d, 0.0) * problem.inv_radius)
        r = closeness - problem.closeness[m]
        cost, w = huber(r, NEAR)
        share = 0.5 * problem.weight[m] / (NEAR * count)
        total += share * cost
        slope = closeness * problem.inv_radius
        if d < 0.0 or slope < 1e-3 * problem.inv_radius:
            continue
        gx, gy, gz = gradient_in_H(packed, X_PH, part, x, y, z)
        link = packed.part_link[part]
        # the hand comes nearer along the gradient, and the point closer
        add_row(G[link], h[link], slope * gx, slope * gy, slope * gz, x, y, z, r, share * w)
    return total


@njit(cache=True, error_model="numpy")
def _evaluate(packed, problem, X_OH, q, q_start, work, A, b):  # type: ignore[no-untyped-def]
    """Cost, and the Gauss-Newton matrix (lower triangle) and gradient of half of it."""
    pose_links(packed, q, work.X_HL)
    part_poses_H(packed, work.X_HL, work.X_PH, work.centre_H)
    work.G[:] = 0.0
    work.h[:] = 0.0
    A[:] = 0.0
    b[:] = 0.0
    total = _map_rows(packed, problem, X_OH, work.X_PH, work.centre_H, work.hint, work.G, work.h)
    total += object_rows(packed, problem, X_OH, work.X_HL, work.nearest, work.G, work.h)
    link_twists(packed, work.X_HL, work.twists)
    assemble(work.G, work.h, work.twists, A, b)
    for j in range(q.shape[0]):
        A[6 + j, 6 + j] += problem.stiffness[j]
        b[6 + j] += problem.stiffness[j] * (q[j] - q_start[j])
        total += problem.stiffness[j] * (q[j] - q_start[j]) ** 2
    return total


@njit(cache=True, error_model="numpy")
def _descend_one(packed, problem, X_OH, q, iterations):  # type: ignore[no-untyped-def]
    size = 6 + q.shape[0]
    A, b, A_new, b_new = np.empty((size, size)), np.empty(size), np.empty((size, size)), np.empty(size)
    damped, step = np.empty((size, size)), np.empty(size)
    X_new, q_new, q_start = X_OH.copy(), q.copy(), q.copy()
    work = new_work(packed, problem.points.shape[0])
    damping = 1e-2
    cost = _evaluate(packed, problem, X_OH, q, q_start, work, A, b)
    for _ in range(iterations):
        hold_limits(packed, q, A, b)
        improved, trial = False, cost
        for _ in range(5):
            add_damped(A, damping, 1e-6, damped)
            if solve_spd(damped, b, step):
                for i in range(size):
                    step[i] = -step[i]
                moved_pose(X_OH, step, X_new)
                for j in range(q.shape[0]):
                    q_new[j] = min(max(q[j] + step[6 + j], packed.lower[j]), packed.upper[j])
                trial = _evaluate(packed, problem, X_new, q_new, q_start, work, A_new, b_new)
                if trial < cost:
                    improved = True
                    break
            damping *= 6.0
        if not improved:
            break
        gain = cost - trial
        X_OH[:] = X_new
        q[:] = q_new
        A, A_new = A_new, A
        b, b_new = b_new, b
        cost = trial
        damping = max(0.2 * damping, 1e-6)
        if gain < 2e-3 * cost:
            break
    return cost


@njit(cache=True, error_model="numpy", nogil=True)
def descend(packed, problem, X_OH, q, iterations, cost):  # type: ignore[no-untyped-def]
    """Lower the cost of N hands X_OH (N, 4, 4), q (N, J) in place; what is left into `cost` (N,)."""
    for i in range(q.shape[0]):
        cost[i] = _descend_one(packed, problem, X_OH[i], q[i], iterations)
