"""A demonstrated grasp done by a robot in simulation: the object as it stood, the grasps in their order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.apply.ordered_pick import ordered_planner, place_of
from neuralgrasps.apply.table_scenes import TableScene, scene_table, work_area
from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.execute import ExecuteConfig, Trial, execute_trial
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.resting_plane import nearest_resting_plane
from neuralgrasps.planning.world import PlacedObject


def demonstrated_scene(
    demonstration: Demonstration, obj: ObjectModel, arm: Arm, *, at: tuple[float, float] | None = None, seed: int = 0
) -> TableScene:
    """The object before the robot as it stood before the camera that watched: the robot is where the camera was.

    The robot's x axis is the camera's view along the table. It stands on the side that was perceived: a wrong pose
    does not make the robot fail here (`VideoRecord.lifted_right` counts such trials apart).

    Args:
        at: (x, y) of the object's centre in B, metres; None: the middle of the arm's work area.
        seed: noted in the scene.
    Raises:
        InputError: the demonstration has no pose of the object on a table.
    """
    followed, table_O = demonstration.followed, demonstration.table_O
    if followed is None or followed.pose is None or table_O is None:
        raise InputError(f"the demonstration has no pose of '{obj.name}' on a table: nothing to put before a robot.")
    plane = nearest_resting_plane(obj, table_O) or table_O
    X = np.eye(4)
    X[:3, :3] = _facing(plane.normal, followed.pose.X_CO[:3, :3].T @ np.array([0.0, 0.0, 1.0]))
    if at is None:
        area = work_area(arm)
        at = ((area.near_m + area.far_m) / 2, 0.0)
    vertices_B = obj.mesh.vertices @ X[:3, :3].T
    X[:2, 3] = np.asarray(at) - (vertices_B.min(axis=0) + vertices_B.max(axis=0))[:2] / 2
    X[2, 3] = arm.table_height_m - vertices_B[:, 2].min()
    return TableScene(table=scene_table(arm), objects=(PlacedObject(obj=obj, X_BO=X),), seed=seed)


def execute_demonstration(
    demonstration: Demonstration,
    obj: ObjectModel,
    manipulator: Manipulator,
    *,
    config: ExecuteConfig | None = None,
    at: tuple[float, float] | None = None,
    seed: int = 0,
) -> Trial:
    """The robot looks at the object, finds it anew, and picks it with the first transferred grasp it can.

    Raises:
        InputError: nothing was transferred, or the grasps are of another hand.
    """
    grasps = demonstration.grasps
    if grasps is None or len(grasps) == 0:
        why = f": {demonstration.reason.rstrip('.')}" if demonstration.reason else ""
        raise InputError(f"no grasp was transferred{why}; there is nothing to execute.")
    if grasps.hand != manipulator.hand.name:
        raise InputError(
            f"the grasps are of hand '{grasps.hand}', the robot has '{manipulator.hand.name}'; transfer to that one."
        )
    scene = demonstrated_scene(demonstration, obj, manipulator.arm, at=at, seed=seed)
    config = replace(config or ExecuteConfig(), planner=ordered_planner(grasps))
    return execute_trial(scene, manipulator, config=config, seed=seed)


def executed_place(trial: Trial, demonstration: Demonstration) -> int | None:
    """Place in the order of transfer (0 = first) of the grasp that was carried out; None when there was no plan."""
    plan = trial.attempts[-1].plan
    grasps = demonstration.grasps
    return None if plan is None or grasps is None else place_of(plan.index, len(grasps))


def _facing(up_O: np.ndarray, ahead_O: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of O into a frame with z along `up_O` and x along what of `ahead_O` is level."""
    x = ahead_O - (ahead_O @ up_O) * up_O
    if np.linalg.norm(x) < 1e-3:  # seen from straight above
        x = np.cross(up_O, np.eye(3)[int(np.argmin(np.abs(up_O)))])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(up_O, x), up_O])
