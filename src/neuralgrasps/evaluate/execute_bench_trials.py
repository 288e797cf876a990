"""The pieces of work of `bench execute`: scenes that can be solved, and what every method makes of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import cast

import numpy as np

from neuralgrasps.apply.pick_up import PickUpConfig, Stage, go_home, plan_in
from neuralgrasps.apply.simulated_robot import SimulatedRobot
from neuralgrasps.apply.table_scenes import TableScene, draw_scene, scene_world, table_plane
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.execute import ExecuteConfig, PoseMethod, Trial, execute_trial, run_trial
from neuralgrasps.evaluate.execute_poses import PaperPoses
from neuralgrasps.evaluate.pose_bench_methods import Library, open_library, open_library_run
from neuralgrasps.evaluate.pose_views import HARD_NOISE
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.path import PathConfig
from neuralgrasps.planning.pick import NO_PATH, PickConfig, PickResult
from neuralgrasps.seeds import child_rng, child_seed

_DRAWS = 12  # scenes drawn, at most, for one that can be solved
_LONG = PickUpConfig(
    stages=(Stage(200, 1.0), Stage(200, None)),
    plan=PickConfig(solutions=32, starts=200, time_limit_s=30.0, path=PathConfig(max_checks=50_000, time_limit_s=10.0)),
)
"""The long run that says whether any plan exists, of a grasp that is proven to lift or not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneRecord:
    """One scene that can be solved.

    Attributes:
        pair: "fetch+fetch"; object: the target; index: its number. draws: scenes drawn until this one.
        found: the planner found a plan with the true pose, as it is used; else only the long run did.
        plan_cpu_s: CPU time of that planner; grasps_cpu_s: of finding grasps that clear the table, and of proofs.
        tried: grasps begun. wall_s: of drawing and solving it.
        reasons: why each scene drawn before could not be solved.
    """

    pair: str
    object: str
    index: int
    draws: int
    found: bool
    plan_cpu_s: float
    grasps_cpu_s: float
    tried: int
    wall_s: float
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRecord:
    """One trial of one method, as `Trial` and `Attempt` have it, without arrays.

    Attributes:
        index: of its scene; place: order in the scene, in clutter.
        method: one of `VARIANTS`. plan_cpu_s: of the first attempt's planner, nan without. wall_s: of the whole trial.
        paths, collisions: executed paths, and those found in collision when checked again at 1 mm; contacts: which.
    """

    pair: str
    object: str
    index: int
    place: int
    method: str
    success: bool
    success_retry: bool
    cause: str
    detail: str
    pose_right: bool
    pose_error_mm: float
    pose_error_deg: float
    plan_cpu_s: float
    look_cpu_s: float
    grasps_cpu_s: float
    wall_s: float
    paths: int
    collisions: int
    contacts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What one piece of work gave."""

    scenes: list[SceneRecord] = field(default_factory=list)
    trials: list[TrialRecord] = field(default_factory=list)


VARIANTS = ("ours", "true", "baseline", "contact", "camera off", "unproven")
"""What is tried on each scene: the pose methods; ours with a camera 5 mm and 0.5 degrees off whose depth is 0.3 % too
large, with a smooth error of 3 mm and more noise; ours without proofs."""
_CAMERA_OFF = (0.005, np.deg2rad(0.5))
_UNPROVEN = PickUpConfig(stages=tuple(Stage(count, None) for count in (8, 40, 120)))


def config_of(variant: str) -> ExecuteConfig:
    """How the trials of one of the `VARIANTS` are run."""
    if variant == "camera off":
        return ExecuteConfig(
            recheck=True, camera_off_m=_CAMERA_OFF[0], camera_off_rad=_CAMERA_OFF[1], sensor=HARD_NOISE
        )
    if variant == "unproven":
        return ExecuteConfig(recheck=True, pick=_UNPROVEN)
    return ExecuteConfig(pose=cast(PoseMethod, variant), recheck=True)


@lru_cache(maxsize=4)
def robot_of(arm: str, hand: str) -> Manipulator:
    """A robot by the names or files of its arm and hand, opened once per process."""
    return mount(load_arm(arm), load_hand(hand))


def stored_grasps(library: Library, hand: str, obj: ObjectModel) -> GraspSet | None:
    """The shipped run's grasps of a pair; None where it has none."""
    if library.run is None:
        return None
    return open_library_run(library).grasps.get((hand, obj.name))


def measure_single(
    library: Library,
    target: int,
    arm: str,
    hand: str,
    indices: Sequence[int],
    methods: Sequence[str],
    seed: int,
) -> Found:
    """Scenes of one object that can be solved, and trials of every method on each."""
    manipulator, obj = robot_of(arm, hand), open_library(library)[target]
    stored, found = stored_grasps(library, manipulator.hand.name, obj), Found()
    _compile(manipulator, obj, stored)
    for index in indices:
        scene, drawn = solvable_scene(manipulator, obj, stored, index, seed)
        found.scenes.append(drawn)
        if scene is None:
            continue
        for method in methods:
            paper = _paper(library, manipulator, child_seed(seed, "paper", obj.name, index))
            begun = time.perf_counter()
            trial = execute_trial(
                scene,
                manipulator,
                grasps=stored,
                paper=paper if method in ("baseline", "contact") else None,
                config=config_of(method),
                seed=child_seed(seed, "trial", obj.name, index),
            )
            record = _record(trial, manipulator, index, 0, time.perf_counter() - begun)
            found.trials.append(replace(record, method=method))
    return found


@lru_cache(maxsize=1)
def _compiled() -> set[str]:
    return set()


def _compile(manipulator: Manipulator, obj: ObjectModel, stored: GraspSet | None) -> None:
    """One plan that is not measured, so that no time holds the compiling of this process."""
    if manipulator.name not in _compiled():
        _compiled().add(manipulator.name)
        _plan(manipulator, draw_scene([obj], manipulator.arm, seed=1), stored, PickUpConfig(), 0)


def solvable_scene(
    manipulator: Manipulator, obj: ObjectModel, stored: GraspSet | None, index: int, seed: int
) -> tuple[TableScene | None, SceneRecord]:
    """Draw scenes until one can be solved: the planner finds a plan with the true pose, or a far longer run does."""
    reasons: list[str] = []
    begun = time.perf_counter()
    for draw in range(_DRAWS):
        scene = draw_scene([obj], manipulator.arm, seed=child_seed(seed, "scene", obj.name, index, draw))
        result, why, made = _plan(manipulator, scene, stored, PickUpConfig(), seed)
        if result is not None and result.blocked:
            raise InputError(f"robot '{manipulator.name}' at home: {result.reason} Give it another home in arm.toml.")
        solved = result is not None and result.plan is not None
        if solved or _solved_in_long_run(manipulator, scene, stored, seed):
            return scene, SceneRecord(
                pair=manipulator.name, object=obj.name, index=index, draws=draw + 1, found=solved,
                plan_cpu_s=result.cpu_s if result else float("nan"), grasps_cpu_s=made,
                tried=result.tried if result else 0, wall_s=time.perf_counter() - begun, reasons=tuple(reasons),
            )  # fmt: skip
        reasons.append(why)
    return None, SceneRecord(
        pair=manipulator.name, object=obj.name, index=index, draws=_DRAWS, found=False, plan_cpu_s=float("nan"),
        grasps_cpu_s=float("nan"), tried=0, wall_s=time.perf_counter() - begun, reasons=tuple(reasons),
    )  # fmt: skip


def _plan(
    manipulator: Manipulator, scene: TableScene, stored: GraspSet | None, config: PickUpConfig, seed: int
) -> tuple[PickResult | None, str, float]:
    """As `plan_in`, with the true poses, from home."""
    q_home = manipulator.q_home[manipulator.arm_dofs]
    return plan_in(manipulator, scene_world(scene, 0), table_plane(scene), q_home, stored, config, seed)


def _solved_in_long_run(manipulator: Manipulator, scene: TableScene, stored: GraspSet | None, seed: int) -> bool:
    for again in range(3):
        result, _, _ = _plan(manipulator, scene, stored, _LONG, child_seed(seed, "long run", again))
        if result is not None and result.plan is not None:
            return True
        if result is None or not result.counts.get(NO_PATH):  # another seed of the path planner changes nothing
            return False
    return False


def measure_clutter(library: Library, arm: str, hand: str, indices: Sequence[int], count: int, seed: int) -> Found:
    """Scenes of `count` objects each, picked from near to far; each is taken away after its turn."""
    manipulator, objects, found = robot_of(arm, hand), open_library(library), Found()
    for index in indices:
        rng = child_rng(seed, "clutter", index)
        chosen = [objects[k] for k in rng.permutation(len(objects))[:count]]
        scene = draw_scene(chosen, manipulator.arm, seed=child_seed(seed, "clutter scene", index))
        config = ExecuteConfig(pose="ours", recheck=True)
        robot = SimulatedRobot(manipulator, scene, config=config.sim, seed=child_seed(seed, "clutter sensor", index))
        robot.settle()
        order = sorted(
            range(count), key=lambda k: float(scene.objects[k].X_BO[0, 3] ** 2 + scene.objects[k].X_BO[1, 3] ** 2)
        )
        for place, target in enumerate(order):
            obj, begun = chosen[target], time.perf_counter()
            trial = run_trial(
                robot, scene, target, grasps=stored_grasps(library, manipulator.hand.name, obj), paper=None,
                config=config, seed=child_seed(seed, "clutter trial", index, place),
            )  # fmt: skip
            found.trials.append(
                replace(_record(trial, manipulator, index, place, time.perf_counter() - begun), pair="clutter")
            )
            if robot.diverged:
                break
            robot.take_away(target)
            seen = next((a.world for a in reversed(trial.attempts) if a.world is not None), None)
            if seen is not None:
                go_home(robot, seen, seed=child_seed(seed, "clutter home", index, place))
    return found


def _paper(library: Library, manipulator: Manipulator, seed: int) -> PaperPoses | None:
    return None if library.run is None else PaperPoses(run=open_library_run(library), hand=manipulator.hand, seed=seed)


def _record(trial: Trial, manipulator: Manipulator, index: int, place: int, wall_s: float) -> TrialRecord:
    first = trial.attempts[0]
    checks = [check for attempt in trial.attempts for check in attempt.rechecks]
    return TrialRecord(
        pair=manipulator.name, object=trial.object, index=index, place=place, method=trial.pose_method,
        success=trial.success, success_retry=trial.success_retry, cause=trial.cause, detail=trial.detail,
        pose_right=first.pose_right, pose_error_mm=first.pose_error_mm, pose_error_deg=first.pose_error_deg,
        plan_cpu_s=first.pick.cpu_s if first.pick is not None else float("nan"), look_cpu_s=first.look_cpu_s,
        grasps_cpu_s=first.grasps_cpu_s, wall_s=wall_s, paths=len(checks),
        collisions=sum(not check.free for check in checks),
        contacts=tuple(check.first_contact for check in checks if not check.free),
    )  # fmt: skip
