"""Kernels of inverse kinematics: one damped step of a chain, and the loop that drives a hand to a pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.planning.chain import chain_jacobian, chain_pose

FLOOR = 1e-6  # m^2; least damping: keeps a singular posture solvable, too small to slow the last steps


class IkSettings(NamedTuple):
    """Numbers of the solver; units and meaning as in `IkConfig`."""

    position_tolerance: float
    rotation_tolerance: float
    rotation_weight: float
    damping: float
    max_step: float
    max_iterations: int
    patience: int


class Work(NamedTuple):
    """Scratch memory of one solver; see `work_arrays`."""

    lines: np.ndarray  # (M, 6) axes of the joints
    pose: np.ndarray  # (3, 4) of the hand
    error: np.ndarray  # (6,) metres
    jacobian: np.ndarray  # (D, 6)
    active: np.ndarray  # (D,) bool
    system: np.ndarray  # (6, 6)
    dual: np.ndarray  # (6,)
    step: np.ndarray  # (D,)


@njit(cache=True, error_model="numpy")
def work_arrays(chain):  # type: ignore[no-untyped-def]
    """A `Work` for `chain`."""
    dofs = chain.lower.shape[0]
    return Work(
        np.empty((chain.is_turn.shape[0], 6)),
        np.empty((3, 4)),
        np.empty(6),
        np.empty((dofs, 6)),
        np.empty(dofs, np.bool_),
        np.empty((6, 6)),
        np.empty(6),
        np.empty(dofs),
    )


@njit(cache=True, error_model="numpy")
def rotation_vector(r00, r01, r02, r10, r11, r12, r20, r21, r22):  # type: ignore[no-untyped-def]
    """(x, y, z) rad of a rotation matrix: its axis times its angle in [0, pi]."""
    x, y, z = 0.5 * (r21 - r12), 0.5 * (r02 - r20), 0.5 * (r10 - r01)
    s, c = math.sqrt(x * x + y * y + z * z), 0.5 * (r00 + r11 + r22 - 1.0)
    if s > 1e-6:
        k = math.atan2(s, c) / s
        return k * x, k * y, k * z
    if c > 0.0:
        return x, y, z
    # half a turn: R + I = 2 a a', whose longest column gives the axis a up to its sign
    if r00 >= r11 and r00 >= r22:
        x, y, z = r00 + 1.0, r10, r20
    elif r11 >= r22:
        x, y, z = r01, r11 + 1.0, r21
    else:
        x, y, z = r02, r12, r22 + 1.0
    k = math.pi / math.sqrt(x * x + y * y + z * z)
    return k * x, k * y, k * z


@njit(cache=True, error_model="numpy")
def pose_error(pose, X, weight, out):  # type: ignore[no-untyped-def]
    """Write `out` (6,): what is left from `pose` to `X` (3, 4) in B, metres, and rad times `weight`; (m, rad) norms."""
    out[0], out[1], out[2] = X[0, 3] - pose[0, 3], X[1, 3] - pose[1, 3], X[2, 3] - pose[2, 3]
    wx, wy, wz = rotation_vector(
        X[0, 0] * pose[0, 0] + X[0, 1] * pose[0, 1] + X[0, 2] * pose[0, 2],
        X[0, 0] * pose[1, 0] + X[0, 1] * pose[1, 1] + X[0, 2] * pose[1, 2],
        X[0, 0] * pose[2, 0] + X[0, 1] * pose[2, 1] + X[0, 2] * pose[2, 2],
        X[1, 0] * pose[0, 0] + X[1, 1] * pose[0, 1] + X[1, 2] * pose[0, 2],
        X[1, 0] * pose[1, 0] + X[1, 1] * pose[1, 1] + X[1, 2] * pose[1, 2],
        X[1, 0] * pose[2, 0] + X[1, 1] * pose[2, 1] + X[1, 2] * pose[2, 2],
        X[2, 0] * pose[0, 0] + X[2, 1] * pose[0, 1] + X[2, 2] * pose[0, 2],
        X[2, 0] * pose[1, 0] + X[2, 1] * pose[1, 1] + X[2, 2] * pose[1, 2],
        X[2, 0] * pose[2, 0] + X[2, 1] * pose[2, 1] + X[2, 2] * pose[2, 2],
    )
    out[3], out[4], out[5] = weight * wx, weight * wy, weight * wz
    return (
        math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]),
        math.sqrt(wx * wx + wy * wy + wz * wz),
    )


@njit(cache=True, error_model="numpy")
def _factor(jacobian, active, damping, system):  # type: ignore[no-untyped-def]
    """Cholesky factor, lower triangle with inverted diagonal, of `sum of active J_d' J_d + damping I` in `system`."""
    for r in range(6):
        for c in range(r + 1):
            system[r, c] = 0.0
        system[r, r] = damping
    for d in range(jacobian.shape[0]):
        if active[d]:
            for r in range(6):
                for c in range(r + 1):
                    system[r, c] += jacobian[d, r] * jacobian[d, c]
    for c in range(6):
        for k in range(c):
            system[c, c] -= system[c, k] * system[c, k]
        system[c, c] = 1.0 / math.sqrt(max(system[c, c], 1e-30))
        for r in range(c + 1, 6):
            for k in range(c):
                system[r, c] -= system[r, k] * system[c, k]
            system[r, c] *= system[c, c]


@njit(cache=True, error_model="numpy")
def _solve(system, right, out):  # type: ignore[no-untyped-def]
    """`out` (6,): the factored `system` solved for `right` (6,)."""
    for r in range(6):
        out[r] = right[r]
        for k in range(r):
            out[r] -= system[r, k] * out[k]
        out[r] *= system[r, r]
    for r in range(5, -1, -1):
        for k in range(r + 1, 6):
            out[r] -= system[k, r] * out[k]
        out[r] *= system[r, r]


@njit(cache=True, error_model="numpy")
def damped_step(chain, q, damping, work):  # type: ignore[no-untyped-def]
    """Write `work.step`: the damped least squares step for `work.error`; joints at a limit do not push against it."""
    jacobian, active, step = work.jacobian, work.active, work.step
    dofs = q.shape[0]
    active[:] = True
    while True:
        _factor(jacobian, active, damping, work.system)
        _solve(work.system, work.error, work.dual)
        again = False
        for d in range(dofs):
            step[d] = 0.0
            if active[d]:
                for r in range(6):
                    step[d] += jacobian[d, r] * work.dual[r]
                if not chain.free[d] and (
                    (step[d] < 0.0 and q[d] <= chain.lower[d]) or (step[d] > 0.0 and q[d] >= chain.upper[d])
                ):
                    active[d] = False
                    again = True
        if not again:
            return


@njit(cache=True, error_model="numpy")
def add_pull(wish, work):  # type: ignore[no-untyped-def]
    """Add to `work.step` what of `wish` (D,) leaves the hand where the step takes it; after `damped_step`."""
    jacobian, active, step = work.jacobian, work.active, work.step
    work.error[:] = 0.0
    for d in range(wish.shape[0]):
        if active[d]:
            for r in range(6):
                work.error[r] += jacobian[d, r] * wish[d]
    _solve(work.system, work.error, work.dual)
    for d in range(wish.shape[0]):
        if active[d]:
            step[d] += wish[d]
            for r in range(6):
                step[d] -= jacobian[d, r] * work.dual[r]


@njit(cache=True, error_model="numpy")
def solve_from(chain, X, q, settings, work):  # type: ignore[no-untyped-def]
    """Move `q` (D,) in place until the hand is at `X` (3, 4); (converged, position error, rotation error, iterations).

    Joints stay within limits; those of `chain.free` turn as they like and are brought back by `nearest_turn`.
    """
    best, stalled = np.inf, 0
    position, rotation = np.inf, np.inf
    for iteration in range(settings.max_iterations + 1):
        chain_pose(chain, q, work.lines, work.pose)
        position, rotation = pose_error(work.pose, X, settings.rotation_weight, work.error)
        if position <= settings.position_tolerance and rotation <= settings.rotation_tolerance:
            return True, position, rotation, iteration
        cost = position * position + (settings.rotation_weight * rotation) ** 2
        if cost < 0.9 * best:
            best, stalled = cost, 0
        else:
            stalled += 1
        if stalled > settings.patience or iteration == settings.max_iterations:
            break
        chain_jacobian(chain, work.lines, work.pose, settings.rotation_weight, work.jacobian)
        damped_step(chain, q, settings.damping * cost + FLOOR, work)
        take_step(chain, q, settings.max_step, work.step)
    return False, position, rotation, iteration


@njit(cache=True, error_model="numpy")
def take_step(chain, q, max_step, step):  # type: ignore[no-untyped-def]
    """q += step, shortened so that no joint moves more than `max_step`, and held within limits."""
    most = max_step
    for d in range(q.shape[0]):
        most = max(most, abs(step[d]))
    scale = max_step / most
    for d in range(q.shape[0]):
        q[d] += scale * step[d]
    _hold(chain, q)


@njit(cache=True, error_model="numpy")
def _hold(chain, q):  # type: ignore[no-untyped-def]
    """Bring joints that do not turn freely, in place, within limits."""
    for d in range(q.shape[0]):
        if not chain.free[d]:
            q[d] = min(max(q[d], chain.lower[d]), chain.upper[d])


@njit(cache=True, error_model="numpy")
def nearest_turn(chain, q, near):  # type: ignore[no-untyped-def]
    """Bring joints that turn freely, in place, to the whole turn nearest to `near` (D,) that is within limits."""
    turn = 2.0 * math.pi
    for d in range(q.shape[0]):
        if chain.free[d]:
            q[d] -= turn * math.floor((q[d] - near[d]) / turn + 0.5)
            if q[d] < chain.lower[d]:
                q[d] += turn * math.ceil((chain.lower[d] - q[d]) / turn)
            elif q[d] > chain.upper[d]:
                q[d] -= turn * math.ceil((q[d] - chain.upper[d]) / turn)
            q[d] = min(max(q[d], chain.lower[d]), chain.upper[d])  # rounding


@njit(cache=True, error_model="numpy")
def _is_new(chain, q, found, count, apart):  # type: ignore[no-untyped-def]
    """Whether `q` (D,) differs by `apart` in some joint, whole turns aside, from the first `count` of `found`."""
    turn = 2.0 * math.pi
    for k in range(count):
        most = 0.0
        for d in range(q.shape[0]):
            gap = q[d] - found[k, d]
            if chain.turns[d]:
                gap -= turn * math.floor(gap / turn + 0.5)
            most = max(most, abs(gap))
        if most < apart:
            return False
    return True


@njit(cache=True, error_model="numpy")
def solve_all(chain, X, starts, near, enough, apart, settings, out):  # type: ignore[no-untyped-def]
    """`solve_from` for every target and start.

    Args:
        chain: the packed chain.
        X: (N, 3 or 4, 4) hand poses in B. starts: (N, K, D). near: (D,) posture whose turns are preferred.
        enough: leave a target after this many distinct solutions. apart: two solutions nearer than this are one.
        settings: numbers of the solver.
        out: q (N, K, D), converged, distinct, position, rotation, iterations (N, K), all written.
    """
    q, converged, distinct, position, rotation, iterations = out
    work = work_arrays(chain)
    found = np.empty((starts.shape[1], starts.shape[2]))
    for n in range(X.shape[0]):
        made = 0
        for k in range(starts.shape[1]):
            q[n, k] = starts[n, k]
            _hold(chain, q[n, k])
            converged[n, k], distinct[n, k] = False, False
            position[n, k], rotation[n, k], iterations[n, k] = np.inf, np.inf, -1
            if made >= enough:
                continue
            converged[n, k], position[n, k], rotation[n, k], iterations[n, k] = solve_from(
                chain, X[n], q[n, k], settings, work
            )
            nearest_turn(chain, q[n, k], near)
            if converged[n, k] and _is_new(chain, q[n, k], found, made, apart):
                distinct[n, k] = True
                found[made] = q[n, k]
                made += 1


@njit(cache=True, error_model="numpy")
def first_bad_pose(X, tolerance):  # type: ignore[no-untyped-def]
    """(index, what) of the first of `X` (N, 4, 4) that is not rigid: 1 not finite, 2 not a rotation; else (-1, 0)."""
    for n in range(X.shape[0]):
        P = X[n]
        if not np.isfinite(P.sum()):
            return n, 1
        off = abs(P[3, 0]) + abs(P[3, 1]) + abs(P[3, 2]) + abs(P[3, 3] - 1.0)
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            # rows of a rotation: unit, and each the cross product of the other two
            off = max(off, abs(P[a, 0] * P[a, 0] + P[a, 1] * P[a, 1] + P[a, 2] * P[a, 2] - 1.0))
            off = max(off, abs(P[b, 1] * P[c, 2] - P[b, 2] * P[c, 1] - P[a, 0]))
            off = max(off, abs(P[b, 2] * P[c, 0] - P[b, 0] * P[c, 2] - P[a, 1]))
            off = max(off, abs(P[b, 0] * P[c, 1] - P[b, 1] * P[c, 0] - P[a, 2]))
        if not off <= tolerance:
            return n, 2
    return -1, 0
