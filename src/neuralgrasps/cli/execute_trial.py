"""One trial of `execute` on a worker process: run it, write its numbers, plan, pictures and film into its folder."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from neuralgrasps.cli.terminal import plain
from neuralgrasps.files import write_whole

if TYPE_CHECKING:
    from neuralgrasps.apply.table_scenes import TableScene
    from neuralgrasps.arms.manipulator import Manipulator
    from neuralgrasps.evaluate.execute import PoseMethod, Trial
    from neuralgrasps.evaluate.pose_bench_methods import Library
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.objects.object_model import ObjectModel

TRIAL_FILE, FILM_FILE, LOOP_FILE, PLAN_FILE = "trial.json", "film.mp4", "loop.webp", "plan.yaml"
_RECORD_EVERY_S = 0.04


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotChoice:
    """An arm and a hand as typed: names or files. flange, missing_meshes: see `load_arm`."""

    arm: str
    hand: str
    flange: str | None = None
    missing_meshes: Literal["error", "skip"] = "error"

    def open(self) -> Manipulator:
        """The robot; errors say what is wrong with the files."""
        from neuralgrasps.arms.mount import mount
        from neuralgrasps.arms.zoo import load_arm
        from neuralgrasps.hands.zoo import load_hand

        arm = load_arm(self.arm, flange=self.flange, missing_meshes=self.missing_meshes)
        return mount(arm, load_hand(self.hand, missing_meshes=self.missing_meshes))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialTask:
    """What a worker is asked for.

    Attributes:
        key: of everything that the result depends on; a finished trial with the same key is kept.
        folder: where its files go. library: objects, and the run whose grasps are used; target: its place there.
        robot: arm and hand. index, total: number of the trial, and how many there are in all.
        pose, retries, clutter, seed: as typed; clutter: further objects. grasps: grasp file, or None.
        pictures, film: draw them; loop: a small animation too. speed: of the film.
    """

    key: str
    folder: Path
    library: Library
    target: int
    robot: RobotChoice
    index: int
    total: int
    pose: PoseMethod
    retries: int
    clutter: int
    seed: int
    grasps: Path | None
    pictures: bool
    film: bool
    loop: bool
    speed: float


def kept_record(task: TrialTask) -> dict[str, Any] | None:
    """The numbers of a trial that was finished before, with all the files that are asked for now; else None."""
    try:
        record = json.loads((task.folder / TRIAL_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(record, dict) or record.get("key") != task.key:
        return None
    wanted = [FILM_FILE] * task.film + [LOOP_FILE] * task.loop + ["lift.png"] * task.pictures
    has_motion = bool(record.get("recorded"))
    return record if not has_motion or all((task.folder / name).exists() for name in wanted) else None


def run_task(task: TrialTask) -> dict[str, Any]:
    """Run one trial; its numbers are written last, so that a trial with numbers is whole."""
    manipulator, objects = _robot(task.robot), _objects(task.library)
    obj = objects[task.target]
    begun = time.perf_counter()
    scene, redrawn, reasons = _scene(task, manipulator, obj, objects)
    trial = None if scene is None else _trial(task, manipulator, obj, scene)
    record = _record(task, obj, trial, redrawn, reasons) | {"wall_s": time.perf_counter() - begun}
    task.folder.mkdir(parents=True, exist_ok=True)
    if trial is not None:
        write_plan(task.folder / PLAN_FILE, trial, manipulator)
        if (task.pictures or task.film) and record["recorded"]:
            begun = time.process_time()
            _draw(task, trial, manipulator)
            record["pictures_cpu_s"] = time.process_time() - begun
    write_whole(task.folder / TRIAL_FILE, json.dumps(plain(record), indent=1) + "\n")
    return dict(plain(record))


@lru_cache(maxsize=2)
def _robot(choice: RobotChoice) -> Manipulator:
    return choice.open()


def _objects(library: Library) -> tuple[ObjectModel, ...]:
    from neuralgrasps.evaluate.pose_bench_methods import open_library

    return open_library(library)


def _scene(
    task: TrialTask, manipulator: Manipulator, obj: ObjectModel, objects: tuple[ObjectModel, ...]
) -> tuple[TableScene | None, int, tuple[str, ...]]:
    """The scene, how many were drawn in vain before, and why those have no solution."""
    from neuralgrasps.apply.table_scenes import draw_scene
    from neuralgrasps.evaluate.execute_bench_trials import solvable_scene
    from neuralgrasps.seeds import child_rng, child_seed

    if not task.clutter:
        scene, found = solvable_scene(manipulator, obj, _stored(task, manipulator, obj), task.index, task.seed)
        return scene, len(found.reasons), found.reasons
    rng = child_rng(task.seed, "execute clutter", obj.name, task.index)
    others = [o for k, o in enumerate(objects) if k != task.target]
    chosen = [others[k] for k in rng.permutation(len(others))[: task.clutter]]
    seed = child_seed(task.seed, "execute clutter scene", obj.name, task.index)
    return draw_scene([obj, *chosen], manipulator.arm, seed=seed), 0, ()


def _stored(task: TrialTask, manipulator: Manipulator, obj: ObjectModel) -> GraspSet | None:
    from neuralgrasps.evaluate.execute_bench_trials import stored_grasps
    from neuralgrasps.grasps.grasp_io import load_grasps

    if task.grasps is not None:
        return load_grasps(task.grasps)
    return stored_grasps(task.library, manipulator.hand.name, obj)


def _trial(task: TrialTask, manipulator: Manipulator, obj: ObjectModel, scene: TableScene) -> Trial:
    from neuralgrasps.evaluate.execute import ExecuteConfig, execute_trial
    from neuralgrasps.evaluate.execute_poses import PaperPoses
    from neuralgrasps.evaluate.pose_bench_methods import open_library_run
    from neuralgrasps.seeds import child_seed

    paper = None
    if task.pose in ("baseline", "contact"):
        seed = child_seed(task.seed, "paper", obj.name, task.index)
        paper = PaperPoses(run=open_library_run(task.library), hand=manipulator.hand, seed=seed)
    every = _RECORD_EVERY_S if task.pictures or task.film else None
    return execute_trial(
        scene,
        manipulator,
        grasps=_stored(task, manipulator, obj),
        paper=paper,
        config=ExecuteConfig(pose=task.pose, retries=task.retries, record_every_s=every),
        seed=child_seed(task.seed, "trial", obj.name, task.index),
    )


def _record(
    task: TrialTask, obj: ObjectModel, trial: Trial | None, redrawn: int, reasons: tuple[str, ...]
) -> dict[str, Any]:
    common = {
        "key": task.key, "object": obj.name, "trial": task.index, "arm": task.robot.arm, "hand": task.robot.hand,
        "pose": task.pose, "seed": task.seed, "scenes_without_plan": redrawn,
        "why_without_plan": sorted(set(reasons)),
    }  # fmt: skip
    from neuralgrasps.report.trial_pictures import trial_record

    if trial is None:
        detail = f"no plan exists in any of {redrawn} scenes drawn: {reasons[-1] if reasons else ''}"
        return common | {
            "success": False, "success_retry": False, "cause": "infeasible", "detail": detail, "attempts": [],
            "recorded": False,
        }  # fmt: skip
    return common | trial_record(trial)


def write_plan(path: Path, trial: Trial, manipulator: Manipulator) -> None:
    """The plan of a trial's first attempt as a YAML file; none when there was none."""
    from neuralgrasps.export.pick_plan import save_pick_plan
    from neuralgrasps.export.plan_origin import PlanOrigin
    from neuralgrasps.planning.world import box_top

    first = trial.attempts[0]
    if first.plan is not None and first.pick is not None:
        table_B = None if first.world is None else box_top(first.world.boxes[0])
        origin = PlanOrigin(
            X_BO=first.X_BO_estimate, confidence=first.confidence, table_B=table_B, seed=first.pick.seed
        )
        save_pick_plan(path, first.plan, manipulator, origin=origin)


def _draw(task: TrialTask, trial: Trial, manipulator: Manipulator) -> None:
    from neuralgrasps.report.figures import save_picture
    from neuralgrasps.report.film import FilmConfig, open_film
    from neuralgrasps.report.trial_pictures import moving_picture, strip_pictures
    from neuralgrasps.report.video import write_video

    film = open_film(trial, manipulator)
    if task.pictures:
        for name, picture in strip_pictures(film).items():
            save_picture(task.folder / f"{name}.png", picture)
    if task.loop:
        write_whole(task.folder / LOOP_FILE, moving_picture(film))
    if task.film:
        config = FilmConfig(speed=task.speed, number=task.index, total=task.total)
        write_video(task.folder / FILM_FILE, film.frames(config), fps=config.fps)
