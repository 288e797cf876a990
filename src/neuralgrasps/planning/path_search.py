"""RRT-Connect by OMPL, with our collision check behind its motion validator."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from ompl import base, geometric, util

from neuralgrasps.planning.checks import CountedChecker, JointLimits


class _Validator(base.MotionValidator):  # type: ignore[misc]
    """Asks our check for edges; states of the search are joints in seconds at top speed."""

    def __init__(self, information: base.SpaceInformation, edge_is_free: CountedChecker, velocity: np.ndarray) -> None:
        super().__init__(information)
        self.edge_is_free, self.velocity, self.count = edge_is_free, velocity, len(velocity)

    def checkMotion(self, a: base.State, b: base.State) -> bool:
        q0, q1 = np.array(a[0 : self.count]), np.array(b[0 : self.count])
        return self.edge_is_free(q0 * self.velocity, q1 * self.velocity)


def search_path(
    edge_is_free: CountedChecker,
    q_start: np.ndarray,
    q_goals: np.ndarray,
    *,
    step_s: float,
    max_checks: int,
    time_limit_s: float | None,
    seed: int,
) -> np.ndarray | None:
    """Waypoints (T, D) from the start (D,) to one of the goals (G, D), or None within the limits.

    OMPL draws the seeds of its generators from one generator of the process, which is set here, so that the result
    depends on `seed` alone. The start and all goals must be free. `step_s` and the limits: see `PathConfig`.
    """
    robot = edge_is_free.checker.manipulator
    space = _space(robot, q_start, q_goals)
    information = base.SpaceInformation(space)
    validator = _Validator(information, edge_is_free, robot.velocity)
    information.setMotionValidator(validator)
    information.setStateValidityChecker(_anything)  # the start and goals are checked before, samples as ends of edges
    stop = _limit(edge_is_free, max_checks, time_limit_s)
    level = util.getLogLevel()
    util.setLogLevel(util.LogLevel.LOG_NONE)  # it warns of being seeded again, and reports each search
    try:
        util.RNG.setSeed(1 + seed % (2**31 - 2))
        information.setup()
        states = _search(information, space, q_start / robot.velocity, q_goals / robot.velocity, step_s, stop)
    finally:
        util.setLogLevel(level)
    if states is None:
        return None
    q = states * robot.velocity
    goal = np.abs(q_goals - q[-1]).max(axis=1).argmin()
    q[0], q[-1] = q_start, q_goals[goal]  # without the rounding of the units
    return np.asarray(q)


def _search(
    information: base.SpaceInformation,
    space: base.RealVectorStateSpace,
    start: np.ndarray,
    goals: np.ndarray,
    step_s: float,
    stop: Callable[[], bool],
) -> np.ndarray | None:
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    targets = base.GoalStates(information)
    for goal in goals:
        targets.addState(_state(space, goal))
    problem.setGoal(targets)
    planner = geometric.RRTConnect(information)
    planner.setRange(step_s)
    planner.setProblemDefinition(problem)
    planner.setup()
    status = planner.solve(base.PlannerTerminationCondition(stop))
    if status.getStatus() != base.PlannerStatus.PlannerStatusType.EXACT_SOLUTION:
        return None
    return np.array([state[0 : len(start)] for state in problem.getSolutionPath().getStates()])


def _limit(edges: CountedChecker, max_checks: int, time_limit_s: float | None) -> Callable[[], bool]:
    """Whether the search has used what it may."""
    last = edges.checks + max_checks
    end = np.inf if time_limit_s is None else time.perf_counter() + time_limit_s
    return lambda: edges.checks >= last or time.perf_counter() > end


def _space(robot: JointLimits, q_start: np.ndarray, q_goals: np.ndarray) -> base.RealVectorStateSpace:
    """Joints in seconds at top speed; of joints without end one turn about the start and goals, at least."""
    ends = np.vstack([q_start, q_goals])
    low, high = ends.min(axis=0), ends.max(axis=0)
    pad = np.maximum(np.pi - 0.5 * (high - low), 0.0)
    lower = np.where(robot.continuous, np.maximum(low - pad, robot.lower), robot.lower)
    upper = np.where(robot.continuous, np.minimum(high + pad, robot.upper), robot.upper)
    lower, upper = np.minimum(lower, low) / robot.velocity, np.maximum(upper, high) / robot.velocity
    space = base.RealVectorStateSpace(len(lower))
    bounds = base.RealVectorBounds(len(lower))
    for j in range(len(lower)):
        bounds.setLow(j, float(lower[j]) - 1e-9)
        bounds.setHigh(j, float(upper[j]) + 1e-9)
    space.setBounds(bounds)
    return space


def _state(space: base.RealVectorStateSpace, values: np.ndarray) -> base.State:
    state = space.allocState()
    state[0 : len(values)] = values.tolist()
    return state


def _anything(state: base.State) -> bool:
    return True
