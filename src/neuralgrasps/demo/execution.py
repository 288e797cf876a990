"""The grasps at work: a simulated arm looks at each object, plans, and lifts it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from neuralgrasps.apply.table_scenes import TableScene, scene_table, scene_world
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.demo.measure import Progress
from neuralgrasps.evaluate.execute import ExecuteConfig, Trial, execute_trial
from neuralgrasps.evaluate.execute_bench_trials import robot_of, solvable_scene
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.parallel import run_tasks
from neuralgrasps.planning.pick import plan_pick
from neuralgrasps.planning.world import PlacedObject
from neuralgrasps.report.content import ExecutionFigure
from neuralgrasps.report.film import open_film
from neuralgrasps.report.scene import make_scene
from neuralgrasps.report.scene_painter import ScenePainter
from neuralgrasps.report.scene_views import lamp_direction, lit_zone, main_view
from neuralgrasps.report.trial_pictures import moving_picture, strip_pictures, trial_figure, trial_record
from neuralgrasps.seeds import child_seed

ARMED = ("fetch", "panda")
"""Hands that come with an arm of the same name."""
_EVERY_S = 0.04
_LOOP_SIZE = (400, 300)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lift:
    """One object on the table: the numbers of the trial, and its card for the page."""

    robot: str
    record: Mapping[str, Any]
    figure: ExecutionFigure


def lift_objects(
    objects: Mapping[str, ObjectModel],
    grasp_sets: Sequence[GraspSet],
    *,
    seed: int,
    workers: int,
    progress: Progress | None = None,
) -> tuple[Lift, ...]:
    """One trial per object by the first arm whose hand has grasps; no trial where no hand has an arm.

    Args:
        objects: by name. grasp_sets: of several hands. seed: of scenes and sensors. workers: processes.
    """
    robot = next((name for name in ARMED if any(g.hand == name for g in grasp_sets)), None)
    tasks = [(robot, objects[g.object], g, seed) for g in grasp_sets if robot is not None and g.hand == robot]
    lifts: dict[int, Lift] = {}
    for done, (index, lift) in enumerate(run_tasks(_lift, tasks, workers=workers), start=1):
        if lift is not None:
            lifts[index] = lift
        if progress is not None:
            progress(done, len(tasks), tasks[index][1].name)
    return tuple(lifts[k] for k in sorted(lifts))


def _lift(robot: str, obj: ObjectModel, grasps: GraspSet, seed: int) -> Lift | None:
    """None when no scene that was drawn has a solution."""
    manipulator = robot_of(robot, robot)
    scene, _ = solvable_scene(manipulator, obj, grasps, 0, seed)
    if scene is None:
        return None
    config = ExecuteConfig(record_every_s=_EVERY_S)
    trial = execute_trial(scene, manipulator, grasps=grasps, config=config, seed=child_seed(seed, "lift", obj.name))
    return Lift(robot=robot, record=trial_record(trial), figure=lift_figure(trial, manipulator))


def lift_figure(trial: Trial, manipulator: Manipulator) -> ExecutionFigure:
    """The card of a trial: its pictures, its film and its numbers, under the object's name."""
    pictures: dict[str, np.ndarray] = {}
    moving = b""
    if trial.recording is not None and len(trial.recording) > 1:
        film = open_film(trial, manipulator)
        pictures, moving = strip_pictures(film), moving_picture(film, _LOOP_SIZE)
    figure = trial_figure(trial_record(trial), pictures, number=0, moving=moving)
    return replace(figure, title=figure.title.partition(",")[0])


def compile_planning(obj: ObjectModel) -> None:
    """Compile what planning needs: one grasp from above."""
    manipulator = robot_of(ARMED[0], ARMED[0])
    scene = _standing(obj)
    grasp = _from_above(manipulator.hand.X_HP, manipulator.hand.q_open, scene.objects[0])
    q_home = manipulator.q_home[manipulator.arm_dofs]
    plan_pick(manipulator, grasp, scene_world(scene, 0), q_home)


def compile_pictures(obj: ObjectModel) -> None:
    """Compile what draws scenes."""
    manipulator, scene = robot_of(ARMED[0], ARMED[0]), _standing(obj)
    drawn = make_scene(manipulator, [obj], scene.table)
    moment = manipulator.q_home, scene.objects[0].X_BO[None]
    view = main_view(drawn, [moment], size=(64, 48))
    centre, radius = lit_zone(drawn)
    painter = ScenePainter(drawn, lamp=lamp_direction(view), centre=centre, radius=radius)
    painter.paint(painter.light(*moment), view)


def _standing(obj: ObjectModel) -> TableScene:
    table = scene_table(robot_of(ARMED[0], ARMED[0]).arm)
    X_BO = resting_poses(obj.mesh.vertices, obj.com_O)[0][0].copy()
    X_BO[:3, 3] += table.X_BX[:3, 3] + [0.0, 0.0, table.half[2]]
    return TableScene(table=table, objects=(PlacedObject(obj=obj, X_BO=X_BO),), seed=0)


def _from_above(X_HP: np.ndarray, q_open: np.ndarray, placed: PlacedObject) -> GraspSet:
    """A grasp with the palm facing down, a hand's breadth above the object's middle."""
    X_BP = np.eye(4)
    X_BP[:3, :3] = np.diag([1.0, -1.0, -1.0])
    X_BP[:3, 3] = placed.X_BO[:3, :3] @ placed.obj.com_O + placed.X_BO[:3, 3] + [0.0, 0.0, 0.12]
    contacts = np.full((1, 0, 3), np.nan)
    return GraspSet(
        hand=ARMED[0],
        object=placed.obj.name,
        X_OH=(np.linalg.inv(placed.X_BO) @ X_BP @ np.linalg.inv(X_HP))[None],
        q=0.5 * q_open[None],
        q_pregrasp=q_open[None],
        q_squeeze=0.5 * q_open[None],
        contact_points_O=contacts,
        contact_normals_O=contacts,
        contact_links=np.full((1, 0), -1, np.int32),
        epsilon=np.zeros(1),
        penetration_m=np.zeros(1),
    )
