"""Things on a table in front of a robot, drawn at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.arms.arm import Arm, ArmCamera
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, rpy_matrix, transform_points_np
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld, box_top, table_box
from neuralgrasps.seeds import child_rng

_NEAR, _FAR, _SIDE = 0.45, 0.80, 0.35  # the work area, in reaches of the arm from its shoulder
_RIM_M = 0.15  # of table around it
_GAP_M = 0.015  # between things that stand side by side
_DRAWS = 400
_STAND_M = (0.35, 0.15, 0.75)  # of a camera beside the table: beyond the work area, and above the table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorkArea:
    """Where on its table an arm works: a rectangle of B, x from `near_m` to `far_m`, y within `side_m` of 0."""

    near_m: float
    far_m: float
    side_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableScene:
    """Objects at rest on a table, in the robot base B.

    Attributes:
        table: its top. objects: K things; seed: it was drawn with.
    """

    table: BoxObstacle
    objects: tuple[PlacedObject, ...]
    seed: int


def work_area(arm: Arm) -> WorkArea:
    """The part of a table in front of an arm that it reaches from above and from the side."""
    X_BL = forward_numpy(arm.tree, arm.q_home)
    chain = [arm.flange]
    while arm.tree.parents[chain[-1]] >= 0:
        chain.append(int(arm.tree.parents[chain[-1]]))
    turning = [i for i in reversed(chain) if arm.tree.joint_types[i] == 1]  # REVOLUTE
    first = chain.index(turning[0])
    reach = sum(float(np.linalg.norm(arm.tree.X_parent_joint[i][:3, 3])) for i in chain[:first])
    shoulder = float(X_BL[turning[0], 0, 3])
    return WorkArea(near_m=shoulder + _NEAR * reach, far_m=shoulder + _FAR * reach, side_m=_SIDE * reach)


def scene_table(arm: Arm) -> BoxObstacle:
    """A table under the whole work area."""
    area = work_area(arm)
    return table_box(
        arm.table_height_m,
        centre=((area.near_m + area.far_m) / 2, 0.0),
        size=(area.far_m - area.near_m + 2 * _RIM_M, 2 * (area.side_m + _RIM_M)),
    )


def camera_beside(arm: Arm) -> ArmCamera:
    """A camera on a stand beyond the table, to the arm's left, that looks down at the whole work area."""
    area = work_area(arm)
    middle = np.array([(area.near_m + area.far_m) / 2, 0.0, arm.table_height_m])
    eye = middle + np.array([area.far_m - middle[0] + _STAND_M[0], area.side_m + _STAND_M[1], _STAND_M[2]])
    return ArmCamera(link=0, X_LC=look_at(eye, middle), intrinsics=Intrinsics.from_fov(np.deg2rad(45.0), 640, 480))


def draw_scene(objects: Sequence[ObjectModel], arm: Arm, *, seed: int) -> TableScene:
    """The objects at random places of the arm's work area, each in a random stable pose, none near another.

    Args:
        objects: one for a single scene; several stand at least 15 mm apart.
    Raises:
        InputError: they do not fit.
    """
    area, placed = work_area(arm), list[PlacedObject]()
    for k, obj in enumerate(objects):
        rng = child_rng(seed, "table scene", k, obj.name)
        poses, shares = resting_poses(obj.mesh.vertices, obj.com_O)
        for _ in range(_DRAWS):
            X_BO = _draw_pose(poses, shares, area, arm.table_height_m, rng)
            new = PlacedObject(obj=obj, X_BO=X_BO)
            if all(_apart(new, other) for other in placed):
                placed.append(new)
                break
        else:
            raise InputError(
                f"{len(objects)} objects do not fit on the table of arm '{arm.name}' ({_GAP_M * 1e3:g} mm apart); "
                "take fewer."
            )
    return TableScene(table=scene_table(arm), objects=tuple(placed), seed=seed)


def _draw_pose(
    poses: np.ndarray, shares: np.ndarray, area: WorkArea, height_m: float, rng: np.random.Generator
) -> np.ndarray:
    pose = poses[rng.choice(len(poses), p=shares)]
    turn = make_transform_np(rpy_matrix([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
    turn[:3, 3] = [rng.uniform(area.near_m, area.far_m), rng.uniform(-area.side_m, area.side_m), height_m]
    return np.asarray(turn @ pose)


def _apart(a: PlacedObject, b: PlacedObject) -> bool:
    return min(_gap(a, b), _gap(b, a)) >= _GAP_M


def _gap(a: PlacedObject, b: PlacedObject) -> float:
    points = transform_points_np(inverse_np(b.X_BO) @ a.X_BO, a.obj.points_O)
    return float(query_grid_numpy(b.obj.sdf, points).min())


def table_plane(scene: TableScene) -> Plane:
    """The table's top in B."""
    return box_top(scene.table)


def scene_world(scene: TableScene, target: int | None, poses: Sequence[np.ndarray] | None = None) -> PlanningWorld:
    """The scene as it truly is, for planning.

    Args:
        target: the object to pick; None: all are obstacles. poses: K poses X_BO instead of the drawn ones.
    """
    placed = [PlacedObject(obj=p.obj, X_BO=p.X_BO if poses is None else poses[k]) for k, p in enumerate(scene.objects)]
    return PlanningWorld(
        boxes=(scene.table,),
        target=None if target is None else placed[target],
        objects=tuple(p for k, p in enumerate(placed) if k != target),
    )
