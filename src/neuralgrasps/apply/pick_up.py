"""Picking one object up with any `Robot`: look, estimate its pose, choose grasps, plan, move, close, lift, hold."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from neuralgrasps.apply.robot import Robot, check_start
from neuralgrasps.apply.sight import Sighting, TableView, locate, view_table
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.collision import CollisionChecker
from neuralgrasps.planning.ik import ik_solver
from neuralgrasps.planning.lift_proof import LiftProof, lift_proof
from neuralgrasps.planning.path import plan_path
from neuralgrasps.planning.pick import PickConfig, PickPlan, PickResult, plan_pick
from neuralgrasps.planning.reach import beyond_reach
from neuralgrasps.planning.resting_plane import nearest_resting_plane
from neuralgrasps.planning.table_grasps import grasps_on_table
from neuralgrasps.planning.timing import kept_within, time_path
from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld

_MEASURED = 0.01  # rad or metres that a joint that is at its limit may be measured to be beyond it
_OWN_M = 0.012  # points so near to an object that was recognised are its own
PoseEstimator = Callable[[ObjectModel, TableView, Sighting], np.ndarray]
"""Another estimate of X_BO in place of ours: (object, view, our sighting) -> X_BO (4, 4)."""
PoseRefiner = Callable[[ObjectModel, TableView, Sighting, np.ndarray], np.ndarray]
"""A second estimate, once a grasp is planned: the last argument is its X_BH (4, 4)."""


@dataclass(frozen=True, slots=True)
class Stage:
    """Grasps that a pick is planned with.

    Attributes:
        count: so many that clear the table; more are made when fewer are stored.
        friction: a grasp must lift the object in physics with so much of its friction; None: it need not be proven.
    """

    count: int
    friction: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PickUpConfig:
    """How an object is picked up.

    Attributes:
        plan: of the motion. stages: which grasps it is planned with; a further stage when those before led to no plan.
        settle_s: pause before closing. close_s: time of closing; force: share of the hand's effort limits it may use.
        hold_s: how long the object is held up.
    """

    plan: PickConfig = field(default_factory=PickConfig)
    stages: tuple[Stage, ...] = (Stage(8, 0.75), Stage(40, 0.75), Stage(40, 1.0), Stage(120, 1.0))
    settle_s: float = 0.3
    close_s: float = 1.2
    force: float = 1.0
    hold_s: float = 2.0


Planner = Callable[
    [Manipulator, PlanningWorld, Plane, np.ndarray, PickUpConfig, int], tuple[PickResult | None, str, float]
]
"""Another choice of grasps: (robot, world, table in B, start (D,), config, seed) -> as `plan_in`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickProposal:
    """What a look led to: the plan, or why there is none.

    Attributes:
        frame: what was seen; None when nothing was looked at. view, sighting: what was made of it.
        X_BO: (4, 4) the pose that was planned with, or None. world: what was planned in.
        result: of the planner. reason: why there is no plan, "" when there is.
        look_cpu_s, grasps_cpu_s: CPU-seconds of looking, and of finding and proving grasps.
    """

    frame: Frame | None
    view: TableView | None
    sighting: Sighting | None
    X_BO: np.ndarray | None
    world: PlanningWorld | None
    result: PickResult | None
    reason: str
    look_cpu_s: float
    grasps_cpu_s: float

    @property
    def plan(self) -> PickPlan | None:
        return None if self.result is None else self.result.plan

    def __repr__(self) -> str:
        return f"PickProposal({self.plan!r})" if self.plan is not None else f"PickProposal(no plan: {self.reason})"


def propose_pick(
    robot: Robot,
    obj: ObjectModel,
    *,
    grasps: GraspSet | None = None,
    others: Sequence[ObjectModel] = (),
    obstacles: Sequence[BoxObstacle] = (),
    estimator: PoseEstimator | None = None,
    refiner: PoseRefiner | None = None,
    planner: Planner | None = None,
    config: PickUpConfig | None = None,
    seed: int = 0,
) -> PickProposal:
    """Look, find the object, and plan; nothing moves.

    Args:
        grasps: stored grasps of the object by the robot's hand; None: all are made on the spot.
        others: further objects that may stand there. obstacles: boxes in B that the camera does not see, or need not.
        estimator: another pose estimate in place of `estimate_pose`'s. refiner: asked once a grasp is planned; with its
            pose the motion is planned again.
        planner: chooses grasps in place of `plan_in`; `grasps` are then not used.
    """
    planner = planner or partial(plan_stored, grasps)
    config, cpu = config or PickUpConfig(), time.thread_time()
    state, frame = robot.state(), robot.look()
    q = robot.manipulator.full_q(state.q_arm, state.q_hand)
    try:
        view = view_table(frame, robot.manipulator, q, seed=seed)
    except InputError as error:
        return _nothing(frame, None, None, str(error), time.thread_time() - cpu)
    sighting = locate(view, obj, others=others, seed=seed)
    if sighting.X_BO is None:
        return _nothing(frame, view, sighting, sighting.reason, time.thread_time() - cpu)
    X_BO = sighting.X_BO if estimator is None else estimator(obj, view, sighting)
    looked = time.thread_time() - cpu
    world = _world(obj, X_BO, view, sighting, obstacles)
    result, reason, made = planner(robot.manipulator, world, view.plane_B, state.q_arm, config, seed)
    if refiner is not None and result is not None and result.plan is not None:
        cpu = time.thread_time()
        X_BO = refiner(obj, view, sighting, result.plan.X_BH)
        looked += time.thread_time() - cpu
        world = _world(obj, X_BO, view, sighting, obstacles)
        result, reason, again = planner(robot.manipulator, world, view.plane_B, state.q_arm, config, seed)
        made += again
    return PickProposal(
        frame=frame, view=view, sighting=sighting, X_BO=X_BO, world=world, result=result, reason=reason,
        look_cpu_s=looked, grasps_cpu_s=made,
    )  # fmt: skip


def plan_stored(
    stored: GraspSet | None,
    manipulator: Manipulator,
    world: PlanningWorld,
    table_B: Plane,
    q_arm: np.ndarray,
    config: PickUpConfig,
    seed: int,
) -> tuple[PickResult | None, str, float]:
    """`plan_in` with the stored grasps first: a `Planner` once they are given."""
    return plan_in(manipulator, world, table_B, q_arm, stored, config, seed)


def plan_in(
    manipulator: Manipulator,
    world: PlanningWorld,
    table_B: Plane,
    q_arm: np.ndarray,
    stored: GraspSet | None,
    config: PickUpConfig,
    seed: int,
) -> tuple[PickResult | None, str, float]:
    """The plan among proven grasps, why there is none, and the CPU-seconds of finding and proving grasps."""
    assert world.target is not None
    hand, target, made, planned = manipulator.hand, world.target, 0.0, 0.0
    plane_O = table_B.moved(np.linalg.inv(target.X_BO))
    q_arm = within_limits(manipulator, q_arm)
    beyond_m = beyond_reach(ik_solver(manipulator).reach, hand, target.obj, target.X_BO)
    if beyond_m > 0:
        return None, f"'{target.obj.name}' is out of reach, by {1e3 * beyond_m:.0f} mm at least.", 0.0
    result: PickResult | None = None
    before: tuple[int, float | None] = (0, None)
    for stage in _stages(target, plane_O, config):
        cpu = time.thread_time()
        found = grasps_on_table(hand, target.obj, plane_O, stored=stored, want=stage.count)
        proof = None if stage.friction is None else proof_of_lift(manipulator, world, plane_O, stage.friction, config)
        made += time.thread_time() - cpu
        if len(found.grasps) == 0:
            return None, f"no grasp clears the table: {found.reason}", made
        if (len(found.grasps), stage.friction) == before:
            continue
        before = (len(found.grasps), stage.friction)
        result = plan_pick(manipulator, found.grasps, world, q_arm, config=config.plan, proof=proof, seed=seed)
        planned, made = planned + result.cpu_s, made + result.proof_cpu_s
        if proof is not None:
            proof.keep()
        if result.plan is not None or result.blocked:
            break
    if result is None:
        raise InputError("PickUpConfig.stages is empty; expected at least one Stage.")
    return replace(result, cpu_s=planned), result.reason, made


def _stages(target: PlacedObject, plane_O: Plane, config: PickUpConfig) -> tuple[Stage, ...]:
    """All stages; only the first, without proof, for a pose that the object does not rest in: leaning, or wrong.

    There is no trial of a grasp of what would not stay as it is before the hand comes.
    """
    if config.stages and nearest_resting_plane(target.obj, plane_O) is None:
        return (Stage(config.stages[0].count, None),)
    return config.stages


def proof_of_lift(
    manipulator: Manipulator, world: PlanningWorld, plane_O: Plane, friction: float, config: PickUpConfig
) -> LiftProof:
    """The proof that a grasp lifts the world's target with a share of its friction, as the config closes the hand."""
    assert world.target is not None
    grip = min(config.plan.grip, config.force)
    return lift_proof(manipulator.hand, world.target.obj, plane_O, friction_scale=friction, grip=grip)


def within_limits(manipulator: Manipulator, q_arm: np.ndarray) -> np.ndarray:
    """Measured joints (D,) without what noise takes them beyond a limit; a larger excess stays, as an error."""
    inside = np.clip(q_arm, manipulator.lower, manipulator.upper)
    return np.where(np.abs(q_arm - inside) <= _MEASURED, inside, q_arm)


def _world(
    obj: ObjectModel, X_BO: np.ndarray, view: TableView, sighting: Sighting, obstacles: Sequence[BoxObstacle]
) -> PlanningWorld:
    """The table and other boxes, the target, what was recognised, and the points that none of these explain."""
    placed = (PlacedObject(obj=obj, X_BO=X_BO), *sighting.others)
    unknown_B = sighting.unknown_B
    for thing in placed:
        near = query_grid_numpy(thing.obj.sdf, transform_points_np(inverse_np(thing.X_BO), unknown_B)) < _OWN_M
        unknown_B = unknown_B[~near]
    return PlanningWorld(boxes=(view.box, *obstacles), target=placed[0], objects=placed[1:], cloud_B=unknown_B)


def _nothing(
    frame: Frame, view: TableView | None, sighting: Sighting | None, reason: str, cpu_s: float
) -> PickProposal:
    return PickProposal(
        frame=frame, view=view, sighting=sighting, X_BO=None, world=None, result=None, reason=reason,
        look_cpu_s=cpu_s, grasps_cpu_s=0.0,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of a pick: its name, and what the robot does."""

    name: str
    run: Callable[[Robot], None]


def pick_steps(plan: PickPlan, config: PickUpConfig) -> Iterator[Step]:
    """The steps of a plan in their order: open, transfer, approach, close, lift, hold."""

    def approach(robot: Robot) -> None:
        robot.execute(plan.approach)
        robot.wait(config.settle_s)

    def close(robot: Robot) -> None:
        robot.move_hand(plan.q_squeeze, duration_s=config.close_s, force=config.force)

    yield Step(name="open", run=lambda robot: robot.move_hand(plan.q_pregrasp, duration_s=0.5))
    yield Step(name="transfer", run=lambda robot: robot.execute(plan.transfer))
    yield Step(name="approach", run=approach)
    yield Step(name="close", run=close)
    yield Step(name="lift", run=lambda robot: robot.execute(plan.lift))
    yield Step(name="hold", run=lambda robot: robot.wait(config.hold_s))


def carry_out(robot: Robot, plan: PickPlan, *, config: PickUpConfig | None = None) -> None:
    """Do all steps of a plan.

    Raises:
        InputError: the arm is not where the plan begins.
    """
    check_start(robot.manipulator, plan.transfer, robot.state().q_arm)
    for step in pick_steps(plan, config or PickUpConfig()):
        step.run(robot)


def pick_up(
    robot: Robot,
    obj: ObjectModel,
    *,
    grasps: GraspSet | None = None,
    others: Sequence[ObjectModel] = (),
    obstacles: Sequence[BoxObstacle] = (),
    config: PickUpConfig | None = None,
    seed: int = 0,
) -> PickProposal:
    """Look, plan and, when there is a plan, carry it out; the robot does not move otherwise.

    Arguments as for `propose_pick`. Whether the object is held is for the robot's owner to check.
    """
    proposal = propose_pick(robot, obj, grasps=grasps, others=others, obstacles=obstacles, config=config, seed=seed)
    if proposal.plan is not None:
        carry_out(robot, proposal.plan, config=config)
    return proposal


def set_down(robot: Robot, plan: PickPlan) -> None:
    """After a lift: the same way down, open the hand, and back to the standoff."""
    robot.execute(plan.lift.reversed())
    robot.move_hand(plan.q_pregrasp, duration_s=0.8)
    robot.execute(plan.approach.reversed())


def go_home(robot: Robot, world: PlanningWorld, *, speed: float = 0.7, seed: int = 0) -> str:
    """Open the hand and move the arm back to its home; why it did not, or "".

    Args:
        world: what is around, with no target in the hand.
    """
    manipulator = robot.manipulator
    q_open = manipulator.hand.q_open
    robot.move_hand(q_open, duration_s=0.5)
    path = plan_path(
        CollisionChecker(manipulator, world, q_open), within_limits(manipulator, robot.state().q_arm),
        manipulator.q_home[manipulator.arm_dofs][None], seed=seed,
    )  # fmt: skip
    if not path.solved:
        return path.reason
    motion = time_path(
        path.q,
        joint_names=manipulator.arm_names,
        velocity=manipulator.velocity,
        acceleration=manipulator.acceleration,
        speed=speed,
    )
    robot.execute(kept_within(motion, manipulator.lower, manipulator.upper))
    return ""
