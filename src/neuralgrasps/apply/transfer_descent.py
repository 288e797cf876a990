"""Move a hand so that its contact map becomes the asked one: Levenberg-Marquardt over pose and joints, compiled.

The hand need not touch or hold anything: what comes out is nearly a grasp, overlaps a little, and is closed afterwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.apply.transfer_kernels import Target
from neuralgrasps.apply.transfer_nearest import Nearest, nearest_parts, new_nearest, points_in_hand
from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sdf_grid import grid_distance, grid_distance_gradient
from neuralgrasps.grasps.contact import link_is_farther, link_pose_in_object
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.least_squares import (
    Work,
    add_row,
    assemble,
    damped_step,
    hold_limits,
    huber,
    link_twists,
    moved_hand,
    new_work,
    turned_back,
)
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.posed_parts import gradient_in_H, part_poses_H
from neuralgrasps.objects.object_model import ObjectModel

NEAR = 0.05  # differences of closeness below this count squared, above as they are
DEPTH_WEIGHT = 1000.0  # of a probe's squared depth in the object, per square metre; the map's cost is at most about 1
DEPTH_WIDTH_M = 0.005
STIFFNESS = 0.02  # cost of moving a joint over its whole range
_TRIES = 5  # steps, each more damped than the last, before the descent ends
_GAIN = 2e-3  # share of the cost that a step must be worth


class MapProblem(NamedTuple):
    """What the descent lowers: the difference to a `Target`'s map, and depths of the hand's points in the object.

    Attributes:
        points, closeness, weight, inv_radius: of the `Target`.
        stiffness: (J,) cost of moving a joint by 1 rad or m, squared.
        values, origin, inv_spacing: the object's `SdfGrid`.
    """

    points: np.ndarray
    closeness: np.ndarray
    weight: np.ndarray
    inv_radius: float
    stiffness: np.ndarray
    values: np.ndarray
    origin: np.ndarray
    inv_spacing: float


class DescentWork(NamedTuple):
    """What an evaluation overwrites: `fit` of least squares, the map's points, X_OL (3, 4) of one link."""

    fit: Work
    nearest: Nearest
    X_OL: np.ndarray


def map_problem(hand: Hand, obj: ObjectModel, target: Target) -> MapProblem:
    """The problem of a hand, an object and a target."""
    span = np.maximum(hand.tree.upper - hand.tree.lower, 1e-6)
    return MapProblem(
        *target,
        stiffness=STIFFNESS / span**2,
        values=obj.sdf.values,
        origin=obj.sdf.origin,
        inv_spacing=obj.sdf.inv_spacing,
    )


@njit(cache=True, error_model="numpy")
def new_descent(packed, problem):  # type: ignore[no-untyped-def]
    """Room for the descents of a hand."""
    points = problem.points.shape[0]
    return DescentWork(new_work(packed, points), new_nearest(points), np.empty((3, 4)))


@njit(cache=True, error_model="numpy")
def _map_rows(packed, problem, X_OH, X_PH, nearest, G, h):  # type: ignore[no-untyped-def]
    """Mean cost of the map's differences; adds their rows to the links' sums."""
    total, count = 0.0, problem.points.shape[0]
    points_in_hand(X_OH, problem.points, nearest.points_A)
    nearest_parts(packed, X_PH, nearest)
    for m in range(count):
        d = nearest.distance[m]
        closeness = math.exp(-max(d, 0.0) * problem.inv_radius)
        r = closeness - problem.closeness[m]
        cost, w = huber(r, NEAR)
        share = 0.5 * problem.weight[m] / (NEAR * count)
        total += share * cost
        if d < 0.0 or closeness < 1e-3:
            continue
        x, y, z = nearest.points_A[0, m], nearest.points_A[1, m], nearest.points_A[2, m]
        gx, gy, gz = gradient_in_H(packed, X_PH, nearest.part[m], x, y, z)
        link, slope = packed.part_link[nearest.part[m]], closeness * problem.inv_radius
        # the hand comes nearer along the gradient, and the point closer
        add_row(G[link], h[link], slope * gx, slope * gy, slope * gz, x, y, z, r, share * w)
    return total


@njit(cache=True, error_model="numpy")
def _depth_rows(packed, problem, X_OH, X_HL, X_OL, G, h):  # type: ignore[no-untyped-def]
    """Cost of the depths of the hand's points in the object; adds their rows to the links' sums."""
    total, values, origin, inv_spacing = 0.0, problem.values, problem.origin, problem.inv_spacing
    for link in range(packed.link_radius.shape[0]):
        first, last = packed.link_point_start[link], packed.link_point_start[link + 1]
        if first == last:
            continue
        link_pose_in_object(X_OH, X_HL, link, X_OL)
        if link_is_farther(values, origin, inv_spacing, packed, X_OL, link, 0.0):
            continue
        for k in range(first, last):
            p = packed.point_L[k]
            ox, oy, oz = moved_point(X_OL, p[0], p[1], p[2])
            if grid_distance(values, origin, inv_spacing, ox, oy, oz) >= 0.0:
                continue
            d, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, ox, oy, oz)
            nx, ny, nz = turned_back(X_OH, gx, gy, gz)
            x, y, z = moved_point(X_HL[link], p[0], p[1], p[2])
            cost, w = huber(d, DEPTH_WIDTH_M)
            total += DEPTH_WEIGHT * cost
            add_row(G[link], h[link], nx, ny, nz, x, y, z, d, DEPTH_WEIGHT * w)
    return total


@njit(cache=True, error_model="numpy")
def evaluate_descent(packed, problem, X_OH, q, q_start, work, A, b):  # type: ignore[no-untyped-def]
    """Cost, and the Gauss-Newton matrix (lower triangle) and gradient of half of it."""
    fit = work.fit
    pose_links(packed, q, fit.X_HL)
    part_poses_H(packed, fit.X_HL, fit.X_PH, fit.centre_H)
    fit.G[:] = 0.0
    fit.h[:] = 0.0
    A[:] = 0.0
    b[:] = 0.0
    total = _map_rows(packed, problem, X_OH, fit.X_PH, work.nearest, fit.G, fit.h)
    total += _depth_rows(packed, problem, X_OH, fit.X_HL, work.X_OL, fit.G, fit.h)
    link_twists(packed, fit.X_HL, fit.twists)
    assemble(fit.G, fit.h, fit.twists, A, b)
    for j in range(q.shape[0]):
        A[6 + j, 6 + j] += problem.stiffness[j]
        b[6 + j] += problem.stiffness[j] * (q[j] - q_start[j])
        total += problem.stiffness[j] * (q[j] - q_start[j]) ** 2
    return total


@njit(cache=True, error_model="numpy")
def _descend_one(packed, problem, X_OH, q, iterations, work):  # type: ignore[no-untyped-def]
    size = 6 + q.shape[0]
    A, b, A_new, b_new = np.empty((size, size)), np.empty(size), np.empty((size, size)), np.empty(size)
    damped, step = np.empty((size, size)), np.empty(size)
    X_new, q_new, q_start = X_OH.copy(), q.copy(), q.copy()
    damping = 1e-2
    cost = evaluate_descent(packed, problem, X_OH, q, q_start, work, A, b)
    for _ in range(iterations):
        hold_limits(packed, q, A, b)
        improved, trial = False, cost
        for _ in range(_TRIES):
            if damped_step(A, b, damping, 1e-6, damped, step):
                moved_hand(packed, X_OH, q, step, X_new, q_new)
                trial = evaluate_descent(packed, problem, X_new, q_new, q_start, work, A_new, b_new)
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
        if gain < _GAIN * cost:
            break
    return cost


@njit(cache=True, error_model="numpy", nogil=True)
def descend(packed, problem, X_OH, q, iterations, cost):  # type: ignore[no-untyped-def]
    """Lower the cost of N hands X_OH (N, 4, 4), q (N, J) in place; what is left into `cost` (N,)."""
    work = new_descent(packed, problem)
    for i in range(q.shape[0]):
        cost[i] = _descend_one(packed, problem, X_OH[i], q[i], iterations, work)
