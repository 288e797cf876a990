"""Collision-free joint paths: a straight line, a detour, else a search by samples; then shortcuts and round corners."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, ShapeError, check_shape
from neuralgrasps.planning.checks import ConfigurationChecker, CountedChecker, JointLimits
from neuralgrasps.planning.path_search import search_path
from neuralgrasps.planning.path_shape import round_corners, shorten
from neuralgrasps.seeds import child_rng, child_seed

_SPREADS_S = (0.2, 0.4, 0.6, 0.8)  # of detours about the half-way posture, in turn: each joint's way over its top speed
_SLACK = 1e-6  # rad or metres that a start or goal may be outside its limits


@dataclass(frozen=True, slots=True, kw_only=True)
class PathConfig:
    """How a path is looked for. Lengths of edges are in seconds: each joint's way over its top speed, 2-norm.

    Attributes:
        detours: paths of two straight lines that are tried before the search.
        step_s: longest edge that the search tries at once.
        max_checks: edges that the search may check; what it finds within them depends on the seed only.
        time_limit_s: wall time after which the search ends as well; None: no such limit.
        shortcuts: random shortcuts tried.
        corner_s: corners are rounded within this length of each side, or less where that is not free; 0: not at all.
    """

    detours: int = 60
    step_s: float = 1.0
    max_checks: int = 2000
    time_limit_s: float | None = None
    shortcuts: int = 25
    corner_s: float = 0.4

    def __post_init__(self) -> None:
        if not self.step_s > 0 or self.max_checks < 1:
            raise InputError(
                f"path: step_s is {self.step_s} and max_checks {self.max_checks}; expected positive numbers."
            )
        if self.time_limit_s is not None and not self.time_limit_s > 0:
            raise InputError(f"path: time_limit_s is {self.time_limit_s}; expected a positive number or None.")
        if min(self.detours, self.shortcuts, self.corner_s) < 0:
            raise InputError("path: detours, shortcuts and corner_s must not be negative.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathResult:
    """What `plan_path` found.

    Attributes:
        q: (T, D) waypoints from the start to the goal, joined by straight joint lines that are free; the start alone,
            (1, D), when not solved.
        solved: whether a goal was reached. reason: why not, else "".
        goal: index into the goals; -1 when not solved.
        straight: whether the path is one straight line.
        checks: edges that were checked. cpu_s: CPU-seconds of this thread.
    """

    q: np.ndarray
    solved: bool
    reason: str
    goal: int
    straight: bool
    checks: int
    cpu_s: float


def plan_path(
    checker: ConfigurationChecker,
    q_start: np.ndarray,
    q_goals: np.ndarray,
    *,
    config: PathConfig | None = None,
    seed: int = 0,
) -> PathResult:
    """A collision-free path to any of some goals.

    The straight line to each goal is tried first, nearest first; then detours by one random posture; then RRT-Connect
    searches between the start and all goals at once. What is found is shortened and its corners are rounded, every
    edge checked again.

    Args:
        checker: its `manipulator` gives the limits.
        q_start: (D,) planned joints; q_goals: (G, D) or (D,).
        seed: the same seed gives the same path, whatever ran before (while `time_limit_s` is None).
    Raises:
        InputError: contradictory limits, postures outside them or not finite, no goals.
        ShapeError: shapes do not fit the limits.
    Source:
        Kuffner and LaValle, "RRT-Connect", 2000, as OMPL has it.
    """
    config = config or PathConfig()
    cpu = time.thread_time()
    q_start, q_goals = np.asarray(q_start, float), np.atleast_2d(np.asarray(q_goals, float))
    _check_input(checker.manipulator, q_start, q_goals)
    counted = CountedChecker(checker)
    q, reason, straight = _solve(counted, q_start, q_goals, config, seed)
    goal = -1 if q is None else int(np.abs(q_goals - q[-1]).max(axis=1).argmin())
    return PathResult(
        q=q_start[None].copy() if q is None else q,
        solved=q is not None,
        reason=reason,
        goal=goal,
        straight=straight,
        checks=counted.checks,
        cpu_s=time.thread_time() - cpu,
    )


def _solve(
    counted: CountedChecker, q_start: np.ndarray, q_goals: np.ndarray, config: PathConfig, seed: int
) -> tuple[np.ndarray | None, str, bool]:
    """The path, why there is none, and whether it is one straight line."""
    checker, robot = counted.checker, counted.checker.manipulator
    if touching := _touching(checker, q_start):
        return None, f"the start is in collision: {touching}.", False
    order = np.argsort(np.linalg.norm((q_goals - q_start) / robot.velocity, axis=1), kind="stable")
    free = order[np.asarray(checker.is_free(q_goals[order]), bool)]
    if len(free) == 0:
        count = f"all {len(q_goals)} goals are" if len(q_goals) > 1 else "the goal is"
        return None, f"{count} in collision: {checker.describe(q_goals[order[0]])}.", False
    for k in free:
        if counted(q_start, q_goals[k]):
            return np.stack([q_start, q_goals[k]]), "", True
    found = _detour(counted, q_start, q_goals[free], config.detours, child_rng(seed, "detours"))
    if found is None:
        found = _search(counted, q_start, q_goals[free], config, seed)
    if found is None:
        return None, f"no path was found within {_limits(config)}.", False
    rng = child_rng(seed, "shortcuts")
    short = shorten(found, counted, robot.velocity, rng=rng, tries=config.shortcuts)
    rounded = round_corners(short, counted, robot.velocity, cut_s=config.corner_s)
    for q in (rounded, short, found):
        if counted.all_free(q):
            return q, "", len(q) == 2
    return None, "the path that was found did not pass a second check.", False


def _detour(
    counted: CountedChecker, q_start: np.ndarray, q_goals: np.ndarray, tries: int, rng: np.random.Generator
) -> np.ndarray | None:
    """Two free lines by a posture about half-way to one of the goals, all in turn; this often spares a search."""
    robot = counted.checker.manipulator
    for k in range(tries):
        goal = q_goals[k % len(q_goals)]
        away = _SPREADS_S[k % len(_SPREADS_S)] * robot.velocity * rng.standard_normal(len(q_start))
        via = np.clip(0.5 * (q_start + goal) + away, robot.lower, robot.upper)
        if np.asarray(counted.checker.is_free(via[None]))[0] and counted(via, goal) and counted(q_start, via):
            return np.stack([q_start, via, goal])
    return None


def _search(
    counted: CountedChecker, q_start: np.ndarray, q_goals: np.ndarray, config: PathConfig, seed: int
) -> np.ndarray | None:
    return search_path(
        counted,
        q_start,
        q_goals,
        step_s=config.step_s,
        max_checks=config.max_checks,
        time_limit_s=config.time_limit_s,
        seed=child_seed(seed, "search"),
    )


def _limits(config: PathConfig) -> str:
    return f"{config.max_checks} edges" + ("" if config.time_limit_s is None else f" and {config.time_limit_s:g} s")


def _touching(checker: ConfigurationChecker, q: np.ndarray) -> str:
    """What touches at a posture, "" when it is free."""
    return "" if np.asarray(checker.is_free(q[None]))[0] else checker.describe(q) or "of the robot"


def _check_input(robot: JointLimits, q_start: np.ndarray, q_goals: np.ndarray) -> None:
    count = len(robot.lower)
    bad = np.flatnonzero(~(robot.lower <= robot.upper))
    if len(bad):
        listed = ", ".join(f"joint {j}: {robot.lower[j]:g}..{robot.upper[j]:g}" for j in bad)
        raise InputError(f"joint limits contradict themselves ({listed}); expected lower <= upper.")
    if not ((robot.velocity > 0) & np.isfinite(robot.velocity)).all():
        raise InputError(f"velocity limits are {robot.velocity}; expected positive numbers.")
    if q_start.shape != (count,):
        raise ShapeError(f"q_start has shape {q_start.shape}; expected ({count},).")
    check_shape("q_goals", q_goals.shape, (None, count))
    if len(q_goals) == 0:
        raise InputError("there are no goals; give at least one posture.")
    for name, q in (("start", q_start[None]), ("goal", q_goals)):
        outside = ~((q >= robot.lower - _SLACK) & (q <= robot.upper + _SLACK))  # also what is not a number
        if outside.any():
            i, j = np.argwhere(outside)[0]
            raise InputError(
                f"{name} {i}: joint {j} is {q[i, j]:.4g}; its limits are {robot.lower[j]:.4g}..{robot.upper[j]:.4g}."
            )
