"""From stored grasps to one complete motion: transfer, straight approach, straight lift."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.planning.candidates import RankedCandidates, rank_candidates
from neuralgrasps.planning.collision import CollisionChecker, CollisionConfig
from neuralgrasps.planning.ik import ik_solver
from neuralgrasps.planning.path import PathConfig, plan_path
from neuralgrasps.planning.straight import follow_line, line_path
from neuralgrasps.planning.timing import kept_within, time_path
from neuralgrasps.planning.world import PlanningWorld
from neuralgrasps.seeds import child_seed
from neuralgrasps.sim.grip import grip_target

NO_APPROACH, NO_LIFT = "no straight approach", "no straight lift"
NOT_PROVEN = "does not lift it in physics"
_HOPELESS = (NO_LIFT, NOT_PROVEN)  # however far the hand is open
NO_PATH = "no path to the standoff"
"""The count of `PickResult` for grasps that only the path planner failed at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PickConfig:
    """How a pick is planned.

    Attributes:
        standoff_m: length of the straight approach along the hand's approach axis; steps: waypoints on it.
        lift_m: height of the straight lift.
        clearance_m: least distance of the hand to the table and other objects at the grasp.
        back_off_m: where the open hand would touch the object at the grasp, it stays so far back along its approach.
        solutions: arm postures tried per grasp, from that many `starts` of inverse kinematics.
        max_grasps: grasps tried; None: all.
        time_limit_s: no further grasp is begun so long after the first one was done, so that compiling kernels on first
            use takes nothing from it. Below it the result depends on the seed only.
        speed: share of the velocity limits for the transfer; accelerations are scaled by its square.
        approach_speed, lift_speed: of the hand, m/s. grip: share of the hand's effort limits, see
            `grip_target`.
        preference_weight: of the caller's preference among grasps, see `rank_candidates`.
        path: of the path planner. collision: margins; an open hand keeps 1.5 mm from the object until it closes.
    """

    standoff_m: float = 0.10
    steps: int = 10
    lift_m: float = 0.20
    clearance_m: float = 0.004
    back_off_m: float = 0.003
    solutions: int = 6
    starts: int = 24
    max_grasps: int | None = None
    time_limit_s: float = 5.0
    speed: float = 0.7
    approach_speed: float = 0.08
    lift_speed: float = 0.12
    grip: float = 1.0
    preference_weight: float = 1.0
    path: PathConfig = field(default_factory=PathConfig)
    collision: CollisionConfig = field(default_factory=lambda: CollisionConfig(near_target_margin_m=0.0015))

    def __post_init__(self) -> None:
        for name in ("standoff_m", "lift_m", "time_limit_s", "speed", "approach_speed", "lift_speed"):
            if not getattr(self, name) > 0:
                raise InputError(f"pick: {name} is {getattr(self, name)}; expected a positive number.")
        for name in ("clearance_m", "back_off_m"):
            if not getattr(self, name) >= 0:
                raise InputError(f"pick: {name} is {getattr(self, name)}; expected 0 or more.")
        for name in ("steps", "solutions", "starts"):
            if getattr(self, name) < 1:
                raise InputError(f"pick: {name} is {getattr(self, name)}; expected at least 1.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickPlan:
    """One complete motion.

    Attributes:
        grasp: the grasp, a set of one; index: its place among the grasps that were given.
        X_BH: (4, 4) hand base at the grasp.
        transfer, approach, lift: from the start to the standoff, on to the grasp, up.
        q_pregrasp, q_grasp, q_squeeze: (J,) hand postures before, at and after closing.
        clearance_m: of the hand to the table and other objects.
    """

    grasp: GraspSet
    index: int
    X_BH: np.ndarray
    transfer: Trajectory
    approach: Trajectory
    lift: Trajectory
    q_pregrasp: np.ndarray
    q_grasp: np.ndarray
    q_squeeze: np.ndarray
    clearance_m: float

    def __repr__(self) -> str:
        motion_s = self.transfer.duration_s + self.approach.duration_s + self.lift.duration_s
        return (
            f"PickPlan({self.grasp.hand} takes {self.grasp.object} by grasp {self.index}, {motion_s:.1f} s of motion)"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickResult:
    """What `plan_pick` found.

    Attributes:
        plan: the plan, or None. reason: why there is none, "" otherwise.
        counts: how many grasps, or arm postures, ended at which step.
        blocked: the start itself is in collision; no grasp can help.
        tried: grasps that were begun. complete: all grasps were tried or a plan was found (no limit cut it short).
        cpu_s: CPU-seconds of this thread, without those of the proof, proof_cpu_s. seed: the seed.
    """

    plan: PickPlan | None
    reason: str
    counts: Mapping[str, int]
    blocked: bool
    tried: int
    complete: bool
    cpu_s: float
    proof_cpu_s: float
    seed: int


def plan_pick(
    manipulator: Manipulator,
    grasps: GraspSet,
    world: PlanningWorld,
    q_start: np.ndarray,
    *,
    config: PickConfig | None = None,
    preference: np.ndarray | None = None,
    proof: Callable[[GraspSet], bool] | None = None,
    seed: int = 0,
) -> PickResult:
    """Walk the grasps from best to worst, to the first with a complete motion.

    For each: arm postures at the grasp (inverse kinematics), straight retreat and lift by continuation, every step
    checked, and a collision-free path from the start to the standoff.

    Args:
        grasps: of `world.target` by the manipulator's hand. q_start: (D,) planned joints now.
        preference: (N,) see `rank_candidates`.
        proof: asked of a grasp (a set of one) that can be reached, before its path is planned; see `LiftProof`.
    Raises:
        InputError: no grasps, grasps of another hand or object, no target, a start outside the limits.
    """
    config = config or PickConfig()
    if not isinstance(grasps, GraspSet):
        raise InputError(f"grasps are {type(grasps).__name__}; expected a GraspSet: synthesise, or grasps_on_table.")
    q_start = np.asarray(q_start, float)
    _check(manipulator, grasps, world, q_start)
    return _Walk(manipulator, grasps, world, q_start, config, proof, seed).run(preference)


def opened_postures(hand: Hand, q_pregrasp: np.ndarray) -> np.ndarray:
    """(3, J) postures to approach with, the widest first: open in all closing joints, half way, and the pre-grasp."""
    q_open = np.where(hand.closing_rate != 0, hand.q_open, q_pregrasp)
    return np.stack([q_open, 0.5 * (q_open + q_pregrasp), q_pregrasp])


def _check(manipulator: Manipulator, grasps: GraspSet, world: PlanningWorld, q_start: np.ndarray) -> None:
    if world.target is None:
        raise InputError("the planning world has no target; set PlanningWorld.target to the object to pick.")
    if len(grasps) == 0:
        raise InputError(
            f"the list of grasps of '{grasps.object}' by '{grasps.hand}' is empty; make some with synthesise."
        )
    if grasps.hand != manipulator.hand.name or grasps.object != world.target.obj.name:
        raise InputError(
            f"grasps are of '{grasps.object}' by '{grasps.hand}', but the robot '{manipulator.name}' should pick "
            f"'{world.target.obj.name}'; give grasps of that pair."
        )
    check_shape("q_start", q_start.shape, (len(manipulator.arm_dofs),))
    _check_limits(manipulator)
    outside = (q_start < manipulator.lower - 1e-6) | (q_start > manipulator.upper + 1e-6) | ~np.isfinite(q_start)
    if outside.any():
        listed = ", ".join(
            f"{manipulator.arm_names[j]} {q_start[j]:.3f} not in {manipulator.lower[j]:.3f}..{manipulator.upper[j]:.3f}"
            for j in np.flatnonzero(outside)
        )
        raise InputError(f"the start of robot '{manipulator.name}' is outside its joint limits: {listed}.")


def _check_limits(manipulator: Manipulator) -> None:
    m = manipulator
    usable = (m.lower < m.upper) & (m.velocity > 0) & (m.acceleration > 0)
    if not usable.all():
        listed = ", ".join(
            f"{m.arm_names[j]} {m.lower[j]:g}..{m.upper[j]:g}, velocity {m.velocity[j]:g}, "
            f"acceleration {m.acceleration[j]:g}"
            for j in np.flatnonzero(~usable)
        )
        raise InputError(
            f"limits of robot '{m.name}' contradict each other: {listed}; expected lower < upper, the others positive."
        )


class _Walk:
    """The state of one `plan_pick`."""

    def __init__(
        self,
        manipulator: Manipulator,
        grasps: GraspSet,
        world: PlanningWorld,
        q_start: np.ndarray,
        config: PickConfig,
        proof: Callable[[GraspSet], bool] | None,
        seed: int,
    ) -> None:
        assert world.target is not None
        self.manipulator, self.grasps, self.world = manipulator, grasps, world
        self.q_start, self.config, self.seed = q_start, config, seed
        self.target = world.target
        self.solver = ik_solver(manipulator)
        self.counts: Counter[str] = Counter()
        self.proof, self.proof_cpu, self.proof_wall = proof, 0.0, 0.0
        self.hand = manipulator.hand
        self.checker = CollisionChecker(manipulator, world, manipulator.hand.q_open, config=config.collision)

    def run(self, preference: np.ndarray | None) -> PickResult:
        cpu, wall = time.thread_time(), np.inf
        touching = self.checker.describe(self.q_start)
        if touching:
            return self._result(None, f"the arm's start is in collision: {touching}.", 0, True, cpu, blocked=True)
        ranked = rank_candidates(
            self.manipulator, self.grasps, self.world, clearance_m=self.config.clearance_m, preference=preference,
            preference_weight=self.config.preference_weight,
        )  # fmt: skip
        self.counts.update(ranked.dropped)
        plan, tried, complete = None, 0, True
        for k in range(len(ranked.index)):
            late = time.perf_counter() - wall - self.proof_wall > self.config.time_limit_s
            if late or (self.config.max_grasps is not None and tried >= self.config.max_grasps):
                complete = False
                break
            tried += 1
            if (plan := self._try(ranked, k)) is not None:
                break
            wall = min(wall, time.perf_counter())
        return self._result(plan, "" if plan else self._why(ranked, complete), tried, complete, cpu)

    def _result(
        self, plan: PickPlan | None, reason: str, tried: int, complete: bool, cpu: float, *, blocked: bool = False
    ) -> PickResult:
        return PickResult(
            plan=plan,
            reason=reason,
            counts={k: v for k, v in self.counts.items() if v},
            blocked=blocked,
            tried=tried,
            complete=complete,
            cpu_s=time.thread_time() - cpu - self.proof_cpu,
            proof_cpu_s=self.proof_cpu,
            seed=self.seed,
        )

    def _why(self, ranked: RankedCandidates, complete: bool) -> str:
        steps = ", ".join(f"{count} {what}" for what, count in self.counts.items() if count)
        end = "" if complete else f" The limit of {self.config.time_limit_s:g} s or of grasps was reached."
        return f"none of {len(self.grasps)} grasps has a complete motion: {steps}.{end}"

    def _try(self, ranked: RankedCandidates, k: int) -> PickPlan | None:
        index = int(ranked.index[k])
        X_BH = self.target.X_BO @ self.grasps.X_OH[index]
        ended = "out of reach"
        for back_m in (0.0, self.config.back_off_m):
            X_BH[:3, 3] -= back_m * self._approach(X_BH)
            postures = self.solver.solutions(
                X_BH, max_solutions=self.config.solutions, starts=self.config.starts, q_near=self.q_start
            )
            if not len(postures):
                continue
            if ended == "out of reach":
                ended = "robot touches something at the grasp"
            for q_open in opened_postures(self.hand, self.grasps.q_pregrasp[index]):
                checker = self.checker.with_hand(q_open)
                free = checker.for_approach().is_free(postures)
                if not free.any():
                    continue
                plan, ended = self._move(ranked, k, X_BH, checker, postures[free])
                if plan is not None:
                    return plan
                if ended in _HOPELESS:
                    break
            if ended in _HOPELESS:
                break
        self.counts[ended] += 1
        return None

    def _move(
        self, ranked: RankedCandidates, k: int, X_BH: np.ndarray, checker: CollisionChecker, postures: np.ndarray
    ) -> tuple[PickPlan | None, str]:
        """The first complete motion to one of some arm postures at a grasp, or where the last one ended."""
        index, near = int(ranked.index[k]), checker.for_approach()
        X_HO = inverse_np(X_BH) @ self.target.X_BO
        lift_checker = self.checker.for_lift(self.grasps.q[index], X_HO)
        back = self._line(X_BH, -self.config.standoff_m * self._approach(X_BH))
        up = self._line(X_BH, np.array([0.0, 0.0, self.config.lift_m]))
        ended = NO_APPROACH
        for attempt, q in enumerate(postures):
            retreat = follow_line(self.solver, q, back)
            if not (retreat.complete and near.path_is_free(retreat.q)):
                continue
            lift = follow_line(self.solver, q, up)
            if not (lift.complete and lift_checker.path_is_free(lift.q)):
                ended = NO_LIFT
                continue
            if not self._proven(index, X_BH, checker.q_hand):
                return None, NOT_PROVEN
            seed = child_seed(self.seed, "path", index, attempt)
            path = plan_path(checker, self.q_start, retreat.q[-1:], config=self.config.path, seed=seed)
            if path.solved:
                clearance_m = float(ranked.clearance_m[k])
                timed = self._timed(index, X_BH, checker.q_hand, path.q, retreat.q[::-1], lift.q, clearance_m)
                return timed, ""
            ended = NO_PATH
        return None, ended

    def _proven(self, index: int, X_BH: np.ndarray, q_open: np.ndarray) -> bool:
        """Whether the grasp lifts the object, from where and as open as the hand will come."""
        if self.proof is None:
            return True
        cpu, wall = time.thread_time(), time.perf_counter()
        X_OH = self.grasps.X_OH[index].copy()
        back_m = np.linalg.norm((self.target.X_BO @ X_OH)[:3, 3] - X_BH[:3, 3])
        X_OH[:3, 3] -= np.round(back_m, 6) * X_OH[:3, :3] @ self.hand.X_HP[:3, 2]
        held = self.proof(replace(self.grasps[index], X_OH=X_OH[None], q_pregrasp=q_open[None]))
        self.proof_cpu += time.thread_time() - cpu
        self.proof_wall += time.perf_counter() - wall
        return held

    def _approach(self, X_BH: np.ndarray) -> np.ndarray:
        """(3,) direction in B in which the hand comes."""
        return np.asarray(X_BH[:3, :3] @ self.hand.X_HP[:3, 2])

    def _line(self, X_BH: np.ndarray, shift_B: np.ndarray) -> np.ndarray:
        end = X_BH.copy()
        end[:3, 3] += shift_B
        return line_path(X_BH, end, self.config.steps)

    def _timed(
        self,
        index: int,
        X_BH: np.ndarray,
        q_open: np.ndarray,
        path: np.ndarray,
        approach: np.ndarray,
        lift: np.ndarray,
        clearance_m: float,
    ) -> PickPlan:
        m, config = self.manipulator, self.config
        timed = partial(time_path, joint_names=m.arm_names, velocity=m.velocity, acceleration=m.acceleration)
        inside = partial(kept_within, lower=m.lower, upper=m.upper)
        return PickPlan(
            grasp=self.grasps[index],
            index=index,
            X_BH=X_BH,
            transfer=inside(timed(path, speed=config.speed)),
            approach=inside(timed(approach, hand_m=config.standoff_m, max_hand_speed=config.approach_speed)),
            lift=inside(timed(lift, hand_m=config.lift_m, max_hand_speed=config.lift_speed)),
            q_pregrasp=q_open,
            q_grasp=self.grasps.q[index],
            q_squeeze=grip_target(self.hand, self.grasps.q[index], self.grasps.q_squeeze[index], grip=config.grip),
            clearance_m=clearance_m,
        )
