"""Straight motions of the hand: poses on a line, and the joints that follow them without a jump."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.planning.chain import chain_jacobian, chain_pose
from neuralgrasps.planning.ik import IkSolver, ik_solver
from neuralgrasps.planning.ik_kernels import (
    FLOOR,
    add_pull,
    damped_step,
    nearest_turn,
    pose_error,
    rotation_vector,
    take_step,
    work_arrays,
)

_COMPLETE, _MISSED, _JUMPED, _BOWED = 0, 1, 2, 3


@dataclass(frozen=True, slots=True, kw_only=True)
class LineConfig:
    """How a path of hand poses is followed.

    Attributes:
        position_tolerance_m, rotation_tolerance_rad: a pose within both counts as reached.
        max_step_m: largest change of a sliding joint between two poses.
        max_iterations: steps per pose.
        limit_zone: joints within this of a limit, rad or metres, are drawn away from it where the hand allows; at most
            a sixth of their range.
        pull: share of that distance per pose.
        max_bow_m: how far the hand may be from the line half way between two poses, joints moving evenly.
    """

    position_tolerance_m: float = 2e-5
    rotation_tolerance_rad: float = 2e-4
    max_step_m: float = 0.1
    max_iterations: int = 25
    limit_zone: float = 0.3
    pull: float = 0.2
    max_bow_m: float = 1e-3

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 <= value < math.inf or (value == 0.0 and name not in ("limit_zone", "pull")):
                raise InputError(f"LineConfig: {name} is {value}; expected a positive number.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineResult:
    """Joints along a path of T hand poses.

    Attributes:
        q: (S, D) one row per pose that was reached, S = T when complete.
        complete: every pose was reached.
        reason: why not; "" when complete.
    """

    q: np.ndarray
    complete: bool
    reason: str


def line_path(X_start: np.ndarray, X_end: np.ndarray, steps: int) -> np.ndarray:
    """Poses (steps + 1, 4, 4) from `X_start` to `X_end` (4, 4), both included: even along a line, and in one turn.

    Raises:
        InputError: no step.
    """
    if steps < 1:
        raise InputError(f"line_path: steps is {steps}; expected at least 1.")
    X_start, X_end = np.ascontiguousarray(X_start, float), np.ascontiguousarray(X_end, float)
    for name, X in (("X_start", X_start), ("X_end", X_end)):
        if X.shape != (4, 4):
            raise ShapeError(f"{name} has shape {X.shape}; expected (4, 4).")
    X = np.empty((steps + 1, 4, 4))
    _write_line(X_start, X_end, X)
    return X


@njit(cache=True, error_model="numpy")
def _write_line(A, B, out):  # type: ignore[no-untyped-def]
    """Poses from `A` to `B` (4, 4) into `out` (T, 4, 4)."""
    RA, last = np.ascontiguousarray(A[:3, :3]), out.shape[0] - 1
    E = np.ascontiguousarray(B[:3, :3]) @ RA.T
    x, y, z = rotation_vector(E[0, 0], E[0, 1], E[0, 2], E[1, 0], E[1, 1], E[1, 2], E[2, 0], E[2, 1], E[2, 2])
    angle = math.sqrt(x * x + y * y + z * z)
    K = np.zeros((3, 3))
    if angle > 0.0:
        K[0, 1], K[0, 2], K[1, 2] = -z / angle, y / angle, -x / angle
        K[1, 0], K[2, 0], K[2, 1] = z / angle, -y / angle, x / angle
    KA, KKA = K @ RA, K @ K @ RA
    for t in range(last):
        s = t / last
        out[t] = A
        out[t, :3, 3] += s * (B[:3, 3] - A[:3, 3])
        out[t, :3, :3] += math.sin(s * angle) * KA + (1.0 - math.cos(s * angle)) * KKA  # Rodrigues
    out[last] = B


def follow_line(
    robot: Manipulator | IkSolver,
    q_arm: np.ndarray,
    X_BH_path: np.ndarray,
    *,
    max_step_rad: float = 0.35,
    config: LineConfig | None = None,
) -> LineResult:
    """Planned joints along a path of hand poses, each row solved from the one before it.

    Where the arm has joints to spare, those near a limit are drawn away from it on the way.

    Args:
        robot: the robot, or its solver.
        q_arm: (D,) posture at, or near, the first pose; at the pose already, it is the first row as it is.
        X_BH_path: (T, 4, 4) hand base in the robot base; see `line_path`.
        max_step_rad: largest change of a turning joint from row to row, also from `q_arm` to the first.
        config: tolerances.
    Returns:
        The rows up to the first pose that was missed, or not reached evenly, and why.
    Raises:
        ShapeError: arrays of another shape. InputError: a pose that is not rigid, joints that are not finite.
    """
    solver = robot if isinstance(robot, IkSolver) else ik_solver(robot)
    config = config or LineConfig()
    if not max_step_rad > 0.0:
        raise InputError(f"follow_line: max_step_rad is {max_step_rad}; expected a positive number.")
    X, q0 = solver.checked_poses(X_BH_path), solver.checked_posture("q_arm", q_arm)
    chain = solver.chain
    zone = np.minimum(config.limit_zone, (chain.upper - chain.lower) / 6.0)
    longest = np.where(solver.slides, config.max_step_m, max_step_rad)
    settings = solver.settings._replace(
        position_tolerance=float(config.position_tolerance_m),
        rotation_tolerance=float(config.rotation_tolerance_rad),
        max_iterations=int(config.max_iterations),
    )
    q = np.empty((len(X), len(q0)))
    done, what, joint, a, b = _follow(
        chain, X, q0, zone, float(config.pull), longest, float(config.max_bow_m), settings, q
    )
    reason = "" if what == _COMPLETE else f"pose {done + 1} of {len(X)}: "
    if what == _MISSED:
        reason += f"the hand stays {1e3 * a:.1f} mm and {math.degrees(b):.1f} deg away"
    elif what == _BOWED:
        reason += f"on the way there the hand leaves the line by {1e3 * a:.1f} mm; at most {1e3 * b:.1f} is allowed"
    elif what == _JUMPED:
        unit = "m" if solver.slides[joint] else "rad"
        reason += (
            f"joint '{solver.manipulator.arm_names[joint]}' would jump by {a:.2f} {unit}; at most {b:.2f} is allowed"
        )
    return LineResult(q=q[:done], complete=what == _COMPLETE, reason=reason)


@njit(cache=True, error_model="numpy")
def _follow(chain, X, q0, zone, pull, longest, max_bow, settings, out):  # type: ignore[no-untyped-def]
    """Rows of `out` (T, D) for poses `X` (T, 4, 4): (rows done, why, joint, its step or m, limit or rad)."""
    work, wish = work_arrays(chain), np.empty(q0.shape[0])
    before = q0
    for t in range(X.shape[0]):
        q = out[t]
        q[:] = before
        reached, position, rotation = _reach_next(chain, X[t], q, zone, pull if t > 0 else 0.0, wish, settings, work)
        nearest_turn(chain, q, before)
        if not reached:
            return t, _MISSED, 0, position, rotation
        for d in range(q.shape[0]):
            if abs(q[d] - before[d]) > longest[d]:
                return t, _JUMPED, d, abs(q[d] - before[d]), longest[d]
        bow = _bow(chain, X[t - 1], X[t], before, q, wish, work) if t > 0 else 0.0
        if bow > max_bow:
            return t, _BOWED, 0, bow, max_bow
        before = q
    return X.shape[0], _COMPLETE, 0, 0.0, 0.0


@njit(cache=True, error_model="numpy")
def _bow(chain, A, B, q0, q1, middle, work):  # type: ignore[no-untyped-def]
    """Metres between the middle of two hand poses and the hand half way from `q0` to `q1`."""
    for d in range(q0.shape[0]):
        middle[d] = 0.5 * (q0[d] + q1[d])
    chain_pose(chain, middle, work.lines, work.pose)
    squared = 0.0
    for r in range(3):
        squared += (work.pose[r, 3] - 0.5 * (A[r, 3] + B[r, 3])) ** 2
    return math.sqrt(squared)


@njit(cache=True, error_model="numpy")
def _reach_next(chain, X, q, zone, pull, wish, settings, work):  # type: ignore[no-untyped-def]
    """Move `q` (D,) to the hand pose `X`, the first step also away from limits: (reached, metres, rad left)."""
    position, rotation = np.inf, np.inf
    for iteration in range(settings.max_iterations + 1):
        chain_pose(chain, q, work.lines, work.pose)
        position, rotation = pose_error(work.pose, X, settings.rotation_weight, work.error)
        if position <= settings.position_tolerance and rotation <= settings.rotation_tolerance:
            return True, position, rotation
        if iteration == settings.max_iterations:
            break
        cost = position * position + (settings.rotation_weight * rotation) ** 2
        chain_jacobian(chain, work.lines, work.pose, settings.rotation_weight, work.jacobian)
        damped_step(chain, q, settings.damping * cost + FLOOR, work)
        if iteration == 0:
            for d in range(q.shape[0]):
                wish[d] = 0.0
                if not chain.free[d]:
                    low, high = q[d] - chain.lower[d], chain.upper[d] - q[d]
                    wish[d] = pull * (max(zone[d] - low, 0.0) - max(zone[d] - high, 0.0))
            add_pull(wish, work)
        take_step(chain, q, settings.max_step, work.step)
    return False, position, rotation
