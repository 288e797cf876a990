"""Trials of the whole loop in simulation: look, pose, plan, move, close, lift, hold, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from neuralgrasps.apply.pick_up import (
    PickProposal,
    PickUpConfig,
    Planner,
    go_home,
    pick_steps,
    plan_stored,
    propose_pick,
    set_down,
)
from neuralgrasps.apply.simulated_robot import SimulatedRobot
from neuralgrasps.apply.table_scenes import TableScene
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.evaluate.execute_poses import PaperPoses
from neuralgrasps.evaluate.pose import PoseErrors, diameter_m, pose_errors
from neuralgrasps.geometry.se3_numpy import transform_points_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.pick import PickPlan, PickResult
from neuralgrasps.planning.world import PlanningWorld, box_distance
from neuralgrasps.seeds import child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthNoise
from neuralgrasps.sim.recheck import PathCheck, recheck_path
from neuralgrasps.sim.tabletop import Recording
from neuralgrasps.sim.tabletop_model import TableTopConfig

PoseMethod = Literal["ours", "true", "baseline", "contact"]
Cause = Literal["", "infeasible", "perception", "no plan", "collision", "push-away", "slip"]

_LIFTED = 0.8  # share of the planned lift that the object must have risen by, after holding
_PUSHED_M = 0.02  # moved by more before the hand closes: pushed away
_SUNK_M = 0.005
_HIT_N = 1.0  # touching with less force is no hit


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecuteConfig:
    """How trials are run.

    Attributes:
        pose: where the object's pose comes from: "ours" (`estimate_pose` on the depth seen), "true" (the simulator),
            "baseline" and "contact" (the published estimates, Eq. 1 and 2).
        retries: further attempts, each with a new look, when the object is not held.
        pick: of the pick. sim: of the simulation.
        record_every_s: states kept for pictures; None keeps none.
        camera_off_m, camera_off_rad: error of the camera's calibration, see `SimulatedRobot`. sensor: its noise.
        recheck: look again at every executed path, each millimetre, with the physics engine's exact shapes.
        planner: chooses grasps in place of `plan_in`, with our pose or the true one.
    """

    pose: PoseMethod = "ours"
    retries: int = 1
    pick: PickUpConfig = field(default_factory=PickUpConfig)
    sim: TableTopConfig = field(default_factory=TableTopConfig)
    record_every_s: float | None = None
    recheck: bool = False
    camera_off_m: float = 0.0
    camera_off_rad: float = 0.0
    sensor: DepthNoise = STRUCTURED_LIGHT
    planner: Planner | None = None

    def __post_init__(self) -> None:
        if self.pose not in get_args(PoseMethod):
            raise unknown_name("pose method", self.pose, get_args(PoseMethod))
        if self.retries < 0:
            raise InputError(f"retries is {self.retries}; expected 0 or more.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attempt:
    """One look and, when there was a plan, one pick.

    Attributes:
        X_BO_true: (4, 4) the object before it. X_BO_estimate: (4, 4) what was planned with, or None.
        pose_right: ADD-S below 1 cm and MSSD below a tenth of the diameter. pose_error_mm, pose_error_deg: of the
            centre and the rotation, up to symmetry; nan without an estimate.
        frame: what the camera saw. pick: what the planner found, or None. reason: why there is no plan.
        look_cpu_s, grasps_cpu_s: see `PickProposal`.
        lifted_m: how far the object was above its start after holding. held: it was lifted, and still was at the end.
        pushed_m: how far it moved before the hand closed. touched: the hand touched it after closing.
        hits: what was touched that should not have been, with the phase and force.
        rechecks: of transfer, approach and lift, in the world they were planned in; empty unless asked for.
        world: what was planned in, from what was seen. confidence: of our pose estimate, where there was one.
    """

    X_BO_true: np.ndarray
    X_BO_estimate: np.ndarray | None
    pose_right: bool
    pose_error_mm: float
    pose_error_deg: float
    frame: Frame | None
    pick: PickResult | None
    reason: str
    look_cpu_s: float
    grasps_cpu_s: float
    lifted_m: float = 0.0
    held: bool = False
    pushed_m: float = 0.0
    touched: bool = False
    hits: tuple[str, ...] = ()
    rechecks: tuple[PathCheck, ...] = ()
    world: PlanningWorld | None = None
    confidence: float | None = None

    @property
    def success(self) -> bool:
        return self.held and not self.hits

    @property
    def plan(self) -> PickPlan | None:
        return None if self.pick is None else self.pick.plan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Trial:
    """One object on one table.

    Attributes:
        object, arm, hand: names. pose_method, seed: as run.
        success: the first attempt lifted and held it and hit nothing. success_retry: the first or a later one did.
        cause: why the first attempt failed, "" when it did not; detail: in words.
        attempts: in their order. recording: of all of them, or None.
    """

    object: str
    arm: str
    hand: str
    pose_method: PoseMethod
    seed: int
    success: bool
    success_retry: bool
    cause: Cause
    detail: str
    attempts: tuple[Attempt, ...]
    recording: Recording | None
    scene: TableScene

    def __repr__(self) -> str:
        if self.success_retry:
            lifted = next((a.lifted_m for a in self.attempts if a.success), 0.0)
            what = f"lifted {1e3 * lifted:.0f} mm{'' if self.success else ', at a later attempt'}"
        else:
            what = f"not lifted, {self.cause or 'no cause known'}"
        return f"Trial({self.object} by {self.hand}: {what})"


def execute_trial(
    scene: TableScene,
    manipulator: Manipulator,
    *,
    target: int = 0,
    grasps: GraspSet | None = None,
    paper: PaperPoses | None = None,
    config: ExecuteConfig | None = None,
    seed: int = 0,
) -> Trial:
    """Pick one object of a scene and see whether it was lifted.

    Args:
        target: which of the scene's objects. grasps: stored ones of it; None: made on the spot.
        paper: the published estimates; needed for their pose methods.
        seed: of the sensor, the estimate and the planner.
    """
    config = config or ExecuteConfig()
    robot = SimulatedRobot(
        manipulator,
        scene,
        config=config.sim,
        record_every_s=config.record_every_s,
        camera_off_m=config.camera_off_m,
        camera_off_rad=config.camera_off_rad,
        sensor=config.sensor,
        seed=seed,
    )
    robot.settle()
    return run_trial(robot, scene, target, grasps=grasps, paper=paper, config=config, seed=seed)


def run_trial(
    robot: SimulatedRobot,
    scene: TableScene,
    target: int,
    *,
    grasps: GraspSet | None,
    paper: PaperPoses | None,
    config: ExecuteConfig,
    seed: int,
) -> Trial:
    """`execute_trial` on a robot whose scene may have been worked on already, as in clutter."""
    obj, attempts = scene.objects[target].obj, list[Attempt]()
    for number in range(1 + config.retries):
        attempt = _attempt(robot, scene, target, grasps, paper, config, child_seed(seed, "attempt", number))
        attempts.append(attempt)
        if attempt.success or number == config.retries or robot.diverged:
            break
        if attempt.plan is not None and not _returned(robot, attempt, seed):
            break
    cause, detail = _cause(attempts[0])
    return Trial(
        object=obj.name, arm=robot.manipulator.arm.name, hand=robot.manipulator.hand.name, pose_method=config.pose,
        seed=seed, success=attempts[0].success, success_retry=any(a.success for a in attempts), cause=cause,
        detail=detail, attempts=tuple(attempts), recording=robot.recording(), scene=scene,
    )  # fmt: skip


def _returned(robot: SimulatedRobot, attempt: Attempt, seed: int) -> bool:
    """Put down what may be in the hand and go home past what was seen before the attempt; whether a way was found."""
    assert attempt.plan is not None and attempt.world is not None
    robot.phase("return")
    try:
        set_down(robot, attempt.plan)
        return not go_home(robot, attempt.world, seed=seed)
    except InputError:  # the arm is held up, so that the next motion would not begin where it is
        return False


def _attempt(
    robot: SimulatedRobot,
    scene: TableScene,
    target: int,
    grasps: GraspSet | None,
    paper: PaperPoses | None,
    config: ExecuteConfig,
    seed: int,
) -> Attempt:
    obj = scene.objects[target].obj
    X_BO_true = robot.object_pose(target)
    robot.phase("look")
    proposal = _propose(robot, scene, target, grasps, paper, config, seed)
    errors, sighting = _errors(obj, proposal.X_BO, X_BO_true), proposal.sighting
    attempt = Attempt(
        X_BO_true=X_BO_true,
        X_BO_estimate=proposal.X_BO,
        pose_right=errors.add_s_m < 0.01 and errors.mssd_m < 0.1 * diameter_m(obj),
        pose_error_mm=1e3 * errors.translation_m,
        pose_error_deg=float(np.rad2deg(errors.rotation_rad)),
        frame=proposal.frame,
        pick=proposal.result,
        reason=proposal.reason,
        look_cpu_s=proposal.look_cpu_s,
        grasps_cpu_s=proposal.grasps_cpu_s,
        world=proposal.world,
        confidence=None if sighting is None or sighting.pose is None else sighting.pose.confidence,
    )
    if proposal.plan is None:
        return attempt
    if config.recheck:
        assert proposal.world is not None
        attempt = replace(attempt, rechecks=_rechecks(robot.manipulator, proposal.plan, proposal.world))
    return _carried_out(robot, attempt, proposal.plan, target, config.pick)


def _rechecks(manipulator: Manipulator, plan: PickPlan, world: PlanningWorld) -> tuple[PathCheck, ...]:
    """Of the transfer and the approach with the open hand, and of the lift with the object in the closed one.

    A lift that begins with the object believed inside the table says nothing, and is left out.
    """
    assert world.target is not None
    check = partial(recheck_path, manipulator, world)
    X_HO = np.linalg.inv(plan.X_BH) @ world.target.X_BO
    free = (check(plan.transfer.q, q_hand=plan.q_pregrasp), check(plan.approach.q, q_hand=plan.q_pregrasp))
    if _sunk_m(world) > _SUNK_M:
        return free
    return (*free, check(plan.lift.q, q_hand=plan.q_grasp, carried=X_HO))


def _sunk_m(world: PlanningWorld) -> float:
    """How deep the target is believed to be in a box, metres."""
    assert world.target is not None
    points_B = transform_points_np(world.target.X_BO, world.target.obj.points_O)
    return max((-float(box_distance(box, points_B).min()) for box in world.boxes), default=0.0)


def _errors(obj: ObjectModel, X_BO: np.ndarray | None, X_BO_true: np.ndarray) -> PoseErrors:
    if X_BO is None:
        return PoseErrors(add_s_m=np.inf, mssd_m=np.inf, rotation_rad=np.nan, translation_m=np.nan)
    return pose_errors(obj, X_BO, X_BO_true)


def _propose(
    robot: SimulatedRobot,
    scene: TableScene,
    target: int,
    grasps: GraspSet | None,
    paper: PaperPoses | None,
    config: ExecuteConfig,
    seed: int,
) -> PickProposal:
    if config.pose == "true":
        return true_proposal(robot, target, grasps, config.pick, seed, planner=config.planner)
    if config.pose != "ours" and paper is None:
        raise InputError(f"pose method '{config.pose}' needs a trained field: give `paper`, or use 'ours'.")
    return propose_pick(
        robot,
        scene.objects[target].obj,
        grasps=grasps,
        others=[placed.obj for k, placed in enumerate(scene.objects) if k != target and robot.is_on_table(k)],
        estimator=None if config.pose == "ours" or paper is None else paper.baseline,
        refiner=paper.contact if config.pose == "contact" and paper is not None else None,
        planner=config.planner,
        config=config.pick,
        seed=seed,
    )


def true_proposal(
    robot: SimulatedRobot,
    target: int,
    grasps: GraspSet | None,
    config: PickUpConfig,
    seed: int,
    *,
    planner: Planner | None = None,
) -> PickProposal:
    """A plan with what the simulator knows."""
    world = robot.true_world(target)
    assert world.target is not None
    planner = planner or partial(plan_stored, grasps)
    result, reason, made = planner(robot.manipulator, world, robot.table_plane, robot.state().q_arm, config, seed)
    return PickProposal(
        frame=None, view=None, sighting=None, X_BO=world.target.X_BO, world=world, result=result, reason=reason,
        look_cpu_s=0.0, grasps_cpu_s=made,
    )  # fmt: skip


def _carried_out(robot: SimulatedRobot, attempt: Attempt, plan: PickPlan, target: int, config: PickUpConfig) -> Attempt:
    start = attempt.X_BO_true
    pushed, touched, hits = 0.0, False, list[str]()
    for step in pick_steps(plan, config):
        robot.phase(step.name)
        try:
            step.run(robot)
        except InputError as error:  # what it met before holds the arm up
            hits.append(f"{step.name}: {error}")
            break
        hits += robot.hits(target, least_n=_HIT_N)
        if step.name == "approach":
            pushed = float(np.linalg.norm(robot.object_pose(target)[:3, 3] - start[:3, 3]))
        if step.name == "close":
            touched = robot.hand_touches(target)
    com = np.append(robot.scene.objects[target].obj.com_O, 1.0)
    lifted = float((robot.object_pose(target) @ com - start @ com)[2])
    return replace(
        attempt, lifted_m=lifted, held=lifted >= _LIFTED * config.plan.lift_m, pushed_m=pushed, touched=touched,
        hits=tuple(hits),
    )  # fmt: skip


def _cause(attempt: Attempt) -> tuple[Cause, str]:
    if attempt.success:
        return "", ""
    off = f"the pose was {attempt.pose_error_mm:.0f} mm and {attempt.pose_error_deg:.0f} degrees off"
    if attempt.X_BO_estimate is None:
        return "perception", attempt.reason
    if attempt.plan is None:
        return ("no plan", attempt.reason) if attempt.pose_right else ("perception", f"{off}; {attempt.reason}")
    if not attempt.pose_right:
        return "perception", f"{off}."
    if attempt.hits:
        return "collision", "; ".join(attempt.hits)
    if attempt.pushed_m > _PUSHED_M or not attempt.touched:
        missed = "" if attempt.touched else ", and the closed hand did not touch it"
        return "push-away", f"it was pushed by {1e3 * attempt.pushed_m:.0f} mm before the hand closed{missed}."
    return "slip", f"the hand held it after closing, but it rose by {1e3 * max(attempt.lifted_m, 0.0):.0f} mm only."
