"""Inverse kinematics: planned joints that bring the hand of a robot to a pose.

Damped least squares on the pose error, with the damping of a step in proportion to the squared error that is left,
joints at a limit taken out of the step while it pushes outward, and starts looked up by hand pose in a table of random
postures. Everything is compiled for one chain; a robot is packed once, in an `IkSolver`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.planning.chain import chain_poses, pack_chain, sliding_dofs
from neuralgrasps.planning.ik_kernels import IkSettings, first_bad_pose, solve_all
from neuralgrasps.planning.posture_table import build_posture_table, nearest_postures
from neuralgrasps.planning.reach import ReachBound, bound_reach, within_reach
from neuralgrasps.seeds import child_rng

_RIGID = 1e-4  # largest error of the entries of a rotation matrix


@dataclass(frozen=True, slots=True, kw_only=True)
class IkConfig:
    """How inverse kinematics is solved.

    Attributes:
        position_tolerance_m, rotation_tolerance_rad: a pose within both counts as reached.
        rotation_weight_m: metres that one radian of error counts as much as.
        damping: of a step, per square metre of error left.
        max_step: largest change of one joint in one step, rad or metres.
        max_iterations: steps per start; patience: steps without 10 % less squared error before a start is given up.
        apart: solutions that differ by less than this in every joint are one, rad or metres.
        postures: size of the table that starts are looked up in.
    """

    position_tolerance_m: float = 1e-4
    rotation_tolerance_rad: float = math.radians(0.1)
    rotation_weight_m: float = 0.3
    damping: float = 0.3
    max_step: float = 0.5
    max_iterations: int = 60
    patience: int = 6
    apart: float = 0.05
    postures: int = 10_000

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise InputError(f"IkConfig: {name} is {value}; expected a positive number.")

    @property
    def settings(self) -> IkSettings:
        """The numbers that kernels read."""
        return IkSettings(
            float(self.position_tolerance_m),
            float(self.rotation_tolerance_rad),
            float(self.rotation_weight_m),
            float(self.damping),
            float(self.max_step),
            int(self.max_iterations),
            int(self.patience),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IkResult:
    """What K starts led to, for each of N hand poses.

    Attributes:
        q: (N, K, D) planned joints where a start ended, within limits; continuous joints at the turn nearest `q_near`.
        converged: (N, K) bool, the hand is at its pose within the tolerances.
        distinct: (N, K) bool, converged, and not the same as an earlier solution of the same pose.
        position_error_m, rotation_error_rad: (N, K) what was left; inf for starts that were not needed.
        iterations: (N, K) steps taken; -1 for starts that were not needed.
    """

    q: np.ndarray
    converged: np.ndarray
    distinct: np.ndarray
    position_error_m: np.ndarray
    rotation_error_rad: np.ndarray
    iterations: np.ndarray

    @property
    def reached(self) -> np.ndarray:
        """(N,) bool: some start converged."""
        return np.asarray(self.converged.any(axis=1))

    def solutions(self, n: int = 0) -> np.ndarray:
        """(S, D) distinct solutions of pose `n`."""
        return np.asarray(self.q[n][self.distinct[n]])


class IkSolver:
    """Inverse kinematics of one robot, packed once; a call on one pose costs little more than its arithmetic.

    Args:
        manipulator: the robot; joints that are not planned are at home.
        config: tolerances and effort.
        seed: of the table of postures.
    Raises:
        RobotDescriptionError: limits that cannot be used, or no planned joint moves the hand.
    """

    def __init__(self, manipulator: Manipulator, *, config: IkConfig | None = None, seed: int = 0) -> None:
        self.manipulator = manipulator
        self.config = config or IkConfig()
        self.settings = self.config.settings
        self.chain = pack_chain(manipulator)
        self.slides = sliding_dofs(self.chain)
        self.q_home = np.ascontiguousarray(manipulator.q_home[manipulator.arm_dofs], float)
        rng = child_rng(seed, "inverse kinematics")
        self.table = build_posture_table(self.chain, int(self.config.postures), rng)
        self.reach: ReachBound = bound_reach(self.chain)

    @property
    def num_dofs(self) -> int:
        """D, the number of planned joints."""
        return len(self.q_home)

    def solve(
        self,
        X_BH: np.ndarray,
        *,
        starts: int | np.ndarray = 16,
        q_near: np.ndarray | None = None,
        max_solutions: int | None = None,
    ) -> IkResult:
        """Planned joints for hand poses.

        Args:
            X_BH: (N, 4, 4) or (4, 4) hand base in the robot base.
            starts: how many to look up in the table, or (K, D) for all poses, or (N, K, D).
            q_near: (D,) whose turns continuous joints come back nearest to; default home.
            max_solutions: leave a pose after this many distinct solutions; default: all starts are run.
        Raises:
            ShapeError: arrays of another shape. InputError: a pose that is not rigid, values that are not finite.
        """
        X = self.checked_poses(X_BH)
        q0 = self._checked_starts(starts, X)
        near = self.q_home if q_near is None else self.checked_posture("q_near", q_near)
        shape = q0.shape[:2]
        out = (
            np.empty(q0.shape),
            np.empty(shape, bool),
            np.empty(shape, bool),
            *np.empty((2, *shape)),
            np.empty(shape, np.int64),
        )
        enough = q0.shape[1] if max_solutions is None else self._checked_wish(max_solutions)
        solve_all(self.chain, X, q0, near, enough, self.config.apart, self.settings, out)
        return IkResult(
            q=out[0],
            converged=out[1],
            distinct=out[2],
            position_error_m=out[3],
            rotation_error_rad=out[4],
            iterations=out[5],
        )

    def solutions(
        self, X_BH: np.ndarray, *, max_solutions: int = 4, starts: int = 16, q_near: np.ndarray | None = None
    ) -> np.ndarray:
        """Distinct solutions (S, D), S <= `max_solutions`, for one hand pose (4, 4); none where none was found.

        The quick way for one pose after another: the table's `starts` nearest postures are tried in turn and the rest
        is left when there are enough solutions. With `q_near` (D,) that posture is tried before all, and the solutions
        come in the order of the time it takes to move there from it at full speed.

        Raises:
            ShapeError, InputError: as `solve`.
        """
        X = self.checked_poses(X_BH)
        if len(X) != 1:
            raise ShapeError(f"X_BH holds {len(X)} poses; expected one (4, 4). Use solve for many.")
        near = self.q_home if q_near is None else self.checked_posture("q_near", q_near)
        count, enough = self._checked_count(starts), self._checked_wish(max_solutions)
        packed = (self.chain, self.reach, self.table)
        q = _search(packed, X, near, q_near is not None, count, enough, self.config.apart, self.settings)
        if q_near is None or len(q) < 2:
            return np.asarray(q)
        seconds = (np.abs(q - near) / self.manipulator.velocity).max(axis=1)
        return np.asarray(q[np.argsort(seconds, kind="stable")])

    def starts(self, X_BH: np.ndarray, count: int) -> np.ndarray:
        """Postures (N, count, D) of the table whose hand poses are near `X_BH` (N, 4, 4), nearest first."""
        count = self._checked_count(count)
        return _starts(self.table, self.checked_poses(X_BH), self.settings.rotation_weight, count)

    def spread(self, count: int) -> np.ndarray:
        """Postures (count, D) of the table that lie far from each other; the first is the one nearest home."""
        count = self._checked_count(count)
        unit = (self.table.q - self.chain.lower) / (self.chain.upper - self.chain.lower)
        home = (self.q_home - self.chain.lower) / (self.chain.upper - self.chain.lower)
        first = int(np.argmin(((unit - home) ** 2).sum(axis=1)))
        return np.asarray(self.table.q[farthest_points(unit, count, start=first)])

    def may_reach(self, X_BH: np.ndarray) -> np.ndarray:
        """(N,) bool: False where the hand poses (N, 4, 4) are farther away than the stretched arm, certainly.

        True says nothing: limits and orientation may still forbid the pose.
        """
        return np.asarray(within_reach(self.reach, self.checked_poses(X_BH)))

    def hand_pose(self, q_arm: np.ndarray) -> np.ndarray:
        """X_BH (N, 4, 4) at planned joints (N, D)."""
        q = np.ascontiguousarray(q_arm, float)
        if q.ndim != 2 or q.shape[1] != self.num_dofs:
            raise ShapeError(f"q_arm has shape {q.shape}; expected (N, {self.num_dofs}).")
        X = np.zeros((len(q), 4, 4))
        X[:, :3], X[:, 3, 3] = chain_poses(self.chain, q), 1.0
        return X

    def checked_poses(self, X_BH: np.ndarray) -> np.ndarray:
        """(N, 4, 4) contiguous float64 of one or more hand poses; `ShapeError` or `InputError` if they are none."""
        X = np.ascontiguousarray(X_BH, float)
        if X.ndim == 2:
            X = X[None]
        if X.ndim != 3 or X.shape[1:] != (4, 4):
            raise ShapeError(f"X_BH has shape {np.shape(X_BH)}; expected (N, 4, 4) or (4, 4).")
        index, what = first_bad_pose(X, _RIGID)
        if what:
            wrong = "is not finite" if what == 1 else "is not rigid"
            raise InputError(f"X_BH[{index}] {wrong}; expected a rotation matrix, a position, and the row 0 0 0 1.")
        return X

    def checked_posture(self, name: str, q: np.ndarray) -> np.ndarray:
        """(D,) contiguous float64 of one posture; `ShapeError` or `InputError` if it is none."""
        q = np.ascontiguousarray(q, float)
        if q.shape != self.q_home.shape:
            names = ", ".join(self.manipulator.arm_names)
            raise ShapeError(f"{name} has shape {q.shape}; expected ({self.num_dofs},): one value per joint ({names}).")
        if not np.isfinite(q).all():
            raise InputError(f"{name} is not finite; expected rad or metres.")
        return q

    def _checked_count(self, count: int) -> int:
        if not 1 <= count <= len(self.table.q):
            raise InputError(
                f"{count} starts were asked for; expected 1 to {len(self.table.q)}, the size of the table."
            )
        return int(count)

    def _checked_wish(self, max_solutions: int) -> int:
        if max_solutions < 1:
            raise InputError(f"max_solutions is {max_solutions}; expected at least 1.")
        return int(max_solutions)

    def _checked_starts(self, starts: int | np.ndarray, X: np.ndarray) -> np.ndarray:
        if isinstance(starts, int | np.integer):
            return _starts(self.table, X, self.settings.rotation_weight, self._checked_count(int(starts)))
        q = np.asarray(starts, float)
        if q.ndim == 2:
            q = np.broadcast_to(q, (len(X), *q.shape))
        if q.ndim != 3 or len(q) != len(X) or q.shape[2] != self.num_dofs:
            raise ShapeError(
                f"starts has shape {np.shape(starts)}; expected (K, {self.num_dofs}) or ({len(X)}, K, {self.num_dofs})."
            )
        if not np.isfinite(q).all():
            raise InputError("starts is not finite; expected rad or metres.")
        return np.ascontiguousarray(q)


@lru_cache(maxsize=8)
def ik_solver(manipulator: Manipulator, *, config: IkConfig | None = None, seed: int = 0) -> IkSolver:
    """The `IkSolver` of a robot, packed on first use in this process."""
    return IkSolver(manipulator, config=config, seed=seed)


def solve_ik(
    manipulator: Manipulator,
    X_BH: np.ndarray,
    *,
    starts: int | np.ndarray = 16,
    q_near: np.ndarray | None = None,
    config: IkConfig | None = None,
) -> IkResult:
    """`IkSolver.solve` with the robot's solver of this process."""
    return ik_solver(manipulator, config=config).solve(X_BH, starts=starts, q_near=q_near)


def ik_starts(manipulator: Manipulator, count: int, *, X_BH: np.ndarray | None = None, seed: int = 0) -> np.ndarray:
    """Postures to start from: (N, count, D) near hand poses `X_BH` (N, 4, 4), or (count, D) spread over the limits."""
    solver = ik_solver(manipulator, seed=seed)
    return solver.spread(count) if X_BH is None else solver.starts(X_BH, count)


@njit(cache=True, error_model="numpy")
def _starts(table, X, weight, count):  # type: ignore[no-untyped-def]
    """Starts (N, count, D) for hand poses (N, 4, 4)."""
    out = np.empty((X.shape[0], count, table.q.shape[1]))
    distances = np.empty(table.q.shape[0], np.float32)
    for n in range(X.shape[0]):
        nearest_postures(table, X[n], weight, distances, out[n])
    return out


@njit(cache=True, error_model="numpy")
def _search(packed, X, near, near_first, count, enough, apart, settings):  # type: ignore[no-untyped-def]
    """Distinct solutions (S, D) for one hand pose `X` (1, 4, 4)."""
    chain, reach, table = packed
    dofs, first = near.shape[0], 1 if near_first else 0
    if not within_reach(reach, X)[0]:
        return np.empty((0, dofs))
    starts = np.empty((1, count + first, dofs))
    starts[0, 0] = near
    nearest_postures(table, X[0], settings.rotation_weight, np.empty(table.q.shape[0], np.float32), starts[0, first:])
    shape = (1, count + first)
    q, converged, distinct = np.empty((1, count + first, dofs)), np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    out = (q, converged, distinct, np.empty(shape), np.empty(shape), np.empty(shape, np.int64))
    solve_all(chain, X, starts, near, enough, apart, settings, out)
    return q[0][distinct[0]]
