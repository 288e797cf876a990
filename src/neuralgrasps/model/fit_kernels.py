"""What a fit of a hand's pose and joints to points on its surface lowers, on exact distances, compiled. Torch-free.

It is minus the logarithm of a posterior: exact distances of the observed points, surface that should have
been observed, a Gaussian of postures, and what is true of grasps (the hand stays out of the object, its tips touch it).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.hands.least_squares import (
    add_row,
    assemble,
    bounded_cost,
    huber,
    link_twists,
    new_work,
    object_rows,
    posture_rows,
    turned_back,
)
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.posed_parts import gradient_in_H, nearest_of_parts, part_poses_H


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


@njit(cache=True, error_model="numpy")
def _point_rows(packed, problem, X_OH, X_PH, centre_H, hint, G, h):  # type: ignore[no-untyped-def]
    total, count = 0.0, problem.points_O.shape[0]
    for m in range(count):
        p = problem.points_O[m]
        dx, dy, dz = p[0] - X_OH[0, 3], p[1] - X_OH[1, 3], p[2] - X_OH[2, 3]
        x, y, z = turned_back(X_OH, dx, dy, dz)
        r, part = nearest_of_parts(packed, X_PH, centre_H, hint[m], x, y, z)
        hint[m] = part
        share = problem.object_weight[m]
        if share > 0.0:
            cost, w = bounded_cost(r * r, problem.width)
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
        nx, ny, nz = turned_back(X_OH, dx, dy, dz)
        add_row(G[link], h[link], nx, ny, nz, x, y, z, r, weight * w)
    return total


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
    return total + posture_rows(problem.q_mean, problem.q_precision, problem.q_freedom, problem.q_unit, q, A, b)


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
