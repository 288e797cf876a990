"""Contact forces that squeeze the object without moving it.

min over f >= 0, sum f = 1 of |G f|^2 + weight |f|^2, where the columns of G are the wrenches of all cone edges. Among
all internal forces the small weight picks the most evenly spread, so that the answer is unique and does not depend on
the order of the contacts.

It is solved through its dual in 7 variables (r = G f and the multiplier v of the sum):
    min_{r, v}  |r|^2 / 2 + sum_i max(0, v - w_i.r)^2 / (2 weight) - v,      f_i = max(0, v - w_i.r) / weight,
which is convex, once differentiable and piecewise quadratic: Newton's method with a line search ends after finitely
many steps (5-15 in practice).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.wrench_space import fill_grasp_wrenches

WEIGHT = 1e-5
TOLERANCE = 1e-9  # largest entry of the dual gradient at the solution; forces sum to 1 within it
MAX_STEPS = 100


class ContactForces(NamedTuple):
    """Forces on the object that squeeze it, for a total normal force of 1 N.

    Attributes:
        forces: (C, 3) float64 force on the object at each contact, in the frame of the contacts, N.
        residual: |G f|, the net wrench they leave (N, torques divided by the characteristic length); about 0 in force
            closure (the weight leaves up to about 1e-5 / epsilon).
        converged: False when the solver stopped early; the forces are then still feasible in direction.
    """

    forces: np.ndarray
    residual: float
    converged: bool


class ForceScratch(NamedTuple):
    """What `edge_forces_using` overwrites: f, trial_f (>= W,), y, trial, step, gradient, column (7,), hessian (7, 7).

    The first `count` entries of f hold the answer.
    """

    f: np.ndarray
    trial_f: np.ndarray
    y: np.ndarray
    trial: np.ndarray
    step: np.ndarray
    gradient: np.ndarray
    column: np.ndarray
    hessian: np.ndarray


@njit(cache=True, error_model="numpy")
def new_force_scratch(count):  # type: ignore[no-untyped-def]
    """A `ForceScratch` for up to `count` wrenches."""
    return ForceScratch(
        np.empty(count),
        np.empty(count),
        np.empty(7),
        np.empty(7),
        np.empty(7),
        np.empty(7),
        np.empty(7),
        np.empty((7, 7)),
    )


@njit(cache=True, error_model="numpy")
def _dual(wrenches, count, y, weight, f):  # type: ignore[no-untyped-def]
    """Dual objective at y = (r, v); fills f (count,)."""
    total = 0.0
    for i in range(count):
        gap = y[6]
        for k in range(6):
            gap -= wrenches[i, k] * y[k]
        f[i] = max(0.0, gap) / weight
        total += f[i] * f[i]
    for k in range(6):
        y_k = y[k]
        total += y_k * y_k / weight
    return 0.5 * weight * total - y[6]


@njit(cache=True, error_model="numpy")
def _newton_system(wrenches, count, y, weight, f, gradient, hessian, column):  # type: ignore[no-untyped-def]
    for a in range(7):
        gradient[a] = y[a] if a < 6 else -1.0
        for b in range(7):
            hessian[a, b] = 1.0 if a == b and a < 6 else 0.0
    column[6] = -1.0
    for i in range(count):
        if f[i] <= 0.0:
            continue
        for k in range(6):
            column[k] = wrenches[i, k]
        for a in range(7):
            gradient[a] -= f[i] * column[a]
            for b in range(a + 1):
                hessian[a, b] += column[a] * column[b] / weight
    for a in range(7):
        for b in range(a):
            hessian[b, a] = hessian[a, b]


@njit(cache=True, error_model="numpy")
def _solve_in_place(matrix, vector):  # type: ignore[no-untyped-def]
    """vector <- matrix^-1 vector for a symmetric positive definite (7, 7), by Cholesky."""
    size = len(vector)
    for j in range(size):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
        matrix[j, j] = math.sqrt(max(matrix[j, j], 1e-300))
        for i in range(j + 1, size):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for i in range(size):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]


@njit(cache=True, error_model="numpy")
def edge_forces(wrenches, weight=WEIGHT):  # type: ignore[no-untyped-def]
    """The minimiser f of |G f|^2 + weight |f|^2 on the simplex.

    Args:
        wrenches: (W, 6) float64, W >= 1, rows of `wrench_space.grasp_wrenches`.
        weight: > 0, relative to the unit normal force of an edge.
    Returns:
        f (W,) float64 >= 0 with sum 1, and whether the dual gradient fell below `TOLERANCE`.
    """
    scratch = new_force_scratch(len(wrenches))
    converged = edge_forces_using(wrenches, len(wrenches), weight, scratch)
    return scratch.f, converged


@njit(cache=True, error_model="numpy")
def edge_forces_using(wrenches, count, weight, scratch):  # type: ignore[no-untyped-def]
    """`edge_forces` of the first `count` wrenches without allocating, for CPU and GPU; scratch.f holds the answer.

    Returns whether it converged.
    """
    f, trial_f, y, trial = scratch.f, scratch.trial_f, scratch.y, scratch.trial
    step, gradient, hessian = scratch.step, scratch.gradient, scratch.hessian
    # start from equal forces at a heavy weight, then lower it: few Newton steps per level
    level = max(1.0, weight)
    squared = 0.0
    for k in range(6):
        y[k] = 0.0
        for i in range(count):
            y[k] += wrenches[i, k] / count
        squared += y[k] * y[k]
    y[6] = level / count + squared
    converged = False
    while True:
        converged = False
        value = _dual(wrenches, count, y, level, f)
        for _ in range(MAX_STEPS):
            _newton_system(wrenches, count, y, level, f, gradient, hessian, scratch.column)
            largest = 0.0
            for a in range(7):
                largest = max(largest, abs(gradient[a]))
            if largest < TOLERANCE:
                converged = True
                break
            for a in range(7):
                step[a] = -gradient[a]
            if hessian[6, 6] == 0.0:
                for a in range(6):
                    step[a] = 0.0
                step[6] = level - y[6]
            else:
                _solve_in_place(hessian, step)
            slope = 0.0
            for a in range(7):
                slope += step[a] * gradient[a]
            size = 1.0
            trial_value = value
            for _ in range(40):
                for a in range(7):
                    trial[a] = y[a] + size * step[a]
                trial_value = _dual(wrenches, count, trial, level, trial_f)
                if trial_value <= value + 1e-4 * size * slope + 1e-15:
                    break
                size *= 0.5
            for a in range(7):
                y[a] = trial[a]
            for i in range(count):
                f[i] = trial_f[i]
            value = trial_value
        if level <= weight:
            break
        level = max(level * 0.1, weight)
    total = 0.0
    for i in range(count):
        total += f[i]
    if total > 0.0:
        for i in range(count):
            f[i] /= total
    return converged


@njit(cache=True, error_model="numpy")
def net_wrench(wrenches, count, f):  # type: ignore[no-untyped-def]
    """|G f| of the first `count` wrenches: what these forces leave unbalanced, see `ContactForces.residual`."""
    squared = 0.0
    for k in range(6):
        net = 0.0
        for i in range(count):
            net += f[i] * wrenches[i, k]
        squared += net * net
    return math.sqrt(squared)


@njit(cache=True, error_model="numpy")
def contact_forces(points, normals, com, friction, edges=8, torsion=0.0, length=1.0, weight=WEIGHT):  # type: ignore[no-untyped-def]
    """Squeezing forces of a grasp; the arguments are those of `grasp_wrenches`. Callable from numba and from Python.

    The torsional moments of soft fingers take part in the balance but are not returned.

    Returns:
        `ContactForces`; multiply the forces by the total normal force wanted.
    """
    contacts = len(points)
    rows = edges + (2 if torsion > 0.0 else 0)
    wrenches = np.empty((contacts * rows, 6))
    fill_grasp_wrenches(points, normals, contacts, com, friction, edges, torsion, length, wrenches)
    f, converged = edge_forces(wrenches, weight)
    forces = np.zeros((contacts, 3))
    for i in range(contacts * rows):
        for k in range(3):
            forces[i // rows, k] += f[i] * wrenches[i, k]
    return ContactForces(forces, net_wrench(wrenches, contacts * rows, f), converged)
