"""`CollisionChecker`: is a posture of the robot free, and is the straight joint motion between two?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.planning import collision_report
from neuralgrasps.planning.collision_arrays import (
    BODY,
    IS_HAND,
    MEETS_CARRIED,
    OTHERS,
    TARGET,
    CheckArrays,
    Work,
    make_work,
)
from neuralgrasps.planning.collision_kernels import config_is_free, configs_are_free, edge_is_free, path_is_free
from neuralgrasps.planning.collision_robot import RobotTables, robot_tables
from neuralgrasps.planning.collision_world import (
    box_rows,
    cloud_thing,
    grid_tables,
    object_shape,
    thinned_thing,
    whole_thing,
)
from neuralgrasps.planning.world import PlanningWorld


@dataclass(frozen=True, slots=True, kw_only=True)
class CollisionConfig:
    """Least distances, metres, by phase, and how densely motions are checked.

    Attributes:
        margin_m: transfer: arm and hand to boxes, other objects and the cloud; and the arm in all phases.
        target_margin_m: transfer: arm and hand to the target; the arm in all phases, also when the target is carried.
        self_margin_m: between links that may touch; less for pairs that are near at home.
        near_margin_m: approach and lift: the hand (exact) to boxes, others and the cloud; and the carried target.
        near_target_margin_m: approach: the hand's surface points to the target.
        sink_m: lift: how much deeper the carried target may get into what it touches at its start.
        max_step_rad: joints turn no more than this between two checks of a motion (sliding joints: metres).
        max_step_m: and no point of the robot moves farther than about this; twice the margin leaves no gap.
        near_step_m: the same in the approach and the lift.
    """

    margin_m: float = 0.010
    target_margin_m: float = 0.005
    self_margin_m: float = 0.010
    near_margin_m: float = 0.002
    near_target_margin_m: float = 0.0005
    sink_m: float = 0.001
    max_step_rad: float = 0.02
    max_step_m: float = 0.02
    near_step_m: float = 0.004

    def __post_init__(self) -> None:
        for name in ("margin_m", "self_margin_m", "near_margin_m", "sink_m"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a length in metres, 0 or more.")
        for name in ("max_step_rad", "max_step_m", "near_step_m"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a positive number.")


class CollisionChecker:
    """Checks one manipulator against one world, in one phase; a new one is for the transfer.

    Joint limits are not checked. Links that are fixed to the base are not checked against the world, which does not
    move against them, but against the moving links. Not safe for use by several threads at once.

    Args:
        manipulator: the robot. world: obstacles in B. q_hand: (J,) hand joints during the motion.
        config: margins.
    Raises:
        ShapeError: q_hand does not have the hand's joints.

    Attributes:
        manipulator, world, q_hand, config, phase ("transfer", "approach" or "lift").
        arrays: `CheckArrays` and work: `Work`, for the kernels in `collision_kernels`.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        world: PlanningWorld,
        q_hand: np.ndarray,
        *,
        config: CollisionConfig | None = None,
    ) -> None:
        self.manipulator, self.world = manipulator, world
        self.q_hand = np.asarray(q_hand, float)
        manipulator.hand.check_q(self.q_hand)
        self.config = config or CollisionConfig()
        self._scene = _scene(world)
        self._wide, _ = self._arrays(self.q_hand)
        self._set_phase("transfer", self._wide)

    def with_hand(self, q_hand: np.ndarray) -> CollisionChecker:
        """The same world for other hand joints (J,), in the transfer."""
        self.manipulator.hand.check_q(np.asarray(q_hand, float))
        wide, _ = self._arrays(np.asarray(q_hand, float))
        return self._in_phase("transfer", q_hand, wide, wide)

    def for_transfer(self) -> CollisionChecker:
        """The long way: spheres for arm and hand, wide margins, the target an obstacle."""
        return self._in_phase("transfer", self.q_hand, self._wide, self._wide)

    def for_approach(self) -> CollisionChecker:
        """The last straight way: the hand by its exact shape, with small margins; the arm as in the transfer."""
        return self._in_phase("approach", self.q_hand, self._wide, self._near(self._wide))

    def for_lift(self, q_hand: np.ndarray, X_HO: np.ndarray) -> CollisionChecker:
        """The way up, the hand at q_hand (J,), the target held at X_HO (4, 4) and carried along.

        The target starts at its pose in the world. Where it is nearer to an obstacle than the margin there, it must not
        come nearer by more than `sink_m`.

        Raises:
            InputError: the world has no target.
        """
        if self.world.target is None:
            raise InputError("the world has no target to lift; expected PlanningWorld(target=...).")
        self.manipulator.hand.check_q(np.asarray(q_hand, float))
        wide, robot = self._arrays(np.asarray(q_hand, float))
        held = _carried(self, self._near(wide), robot, np.asarray(X_HO, float))
        return self._in_phase("lift", q_hand, wide, held)

    def is_free(self, q_arm: np.ndarray) -> np.ndarray:
        """(N,) bool for planned joints (N, D): is every margin kept?"""
        q = self._rows(q_arm)
        out = np.empty(len(q), np.bool_)
        configs_are_free(self.arrays, q, self.work, out)
        return out

    def edge_is_free(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether the straight joint motion from q0 to q1 (D,) is free, ends included, at steps as `config` states."""
        a, b = self._rows(np.asarray(q0)[None]), self._rows(np.asarray(q1)[None])
        return bool(edge_is_free(self.arrays, a[0], b[0], self.work))

    def path_is_free(self, q_arm: np.ndarray) -> bool:
        """Whether the joint motion through waypoints (T, D), straight between them, is free; each piece as an edge."""
        return bool(path_is_free(self.arrays, self._rows(q_arm), self.work))

    def clearance(self, q_arm: np.ndarray, *, cap_m: float = 0.10) -> float:
        """Least distance, metres, of the moving links (and what is carried) to the world; 0 in touch, at most `cap_m`.

        Exact for boxes; for objects and the cloud that of the spheres (of the hand's points in the approach), which
        is less than the true one by what they stand out.
        """
        gaps = collision_report.world_gaps(self.arrays, self._rows(np.asarray(q_arm)[None])[0], self.work, cap_m)
        return float(min(gaps.min(initial=cap_m), cap_m))

    def describe(self, q_arm: np.ndarray) -> str:
        """What is too near at planned joints (D,), the worst first, in words; "" where the posture is free."""
        q = self._rows(np.asarray(q_arm)[None])[0]
        if config_is_free(self.arrays, q, self.work):
            return ""
        return collision_report.describe(self, q)

    def _rows(self, q_arm: np.ndarray) -> np.ndarray:
        q = np.ascontiguousarray(q_arm, float)
        check_shape("q_arm", q.shape, (None, len(self.manipulator.arm_dofs)))
        return q

    def _arrays(self, q_hand: np.ndarray) -> tuple[CheckArrays, RobotTables]:
        """The transfer's arrays at hand joints."""
        c, scene = self.config, self._scene
        robot = robot_tables(self.manipulator, q_hand, self_margin_m=c.self_margin_m)
        wide = [c.margin_m, c.target_margin_m, c.margin_m, c.margin_m]
        tables = {name: getattr(robot, name) for name in CheckArrays._fields if hasattr(robot, name)}
        tables["parts"] = np.concatenate([robot.parts, scene.box_rows])
        tables["part_info"] = np.concatenate([robot.part_info, scene.box_info])
        arrays = CheckArrays(
            **tables,
            grids=scene.grids,
            grid_info=scene.grid_info,
            kinds=scene.kinds,
            target_values=scene.target_values,
            other_values=scene.other_values,
            cloud_values=scene.cloud_values,
            margins=np.array([wide, wide]),
            carried_points=np.zeros((0, 3)),
            carried_limits=np.zeros(0),
            carried_body=0,
            num_parts=len(robot.parts),
            exact_hand=False,
            max_step_rad=c.max_step_rad,
            max_step_m=c.max_step_m,
        )
        return arrays, robot

    def _near(self, arrays: CheckArrays) -> CheckArrays:
        """The approach's arrays from the transfer's."""
        c = self.config
        margins = arrays.margins.copy()
        margins[1] = [c.near_margin_m, c.near_target_margin_m, c.near_margin_m, c.near_margin_m]
        return arrays._replace(margins=margins, exact_hand=True, max_step_m=c.near_step_m)

    def _set_phase(self, phase: str, arrays: CheckArrays) -> None:
        self.phase, self.arrays = phase, arrays
        self.work: Work = make_work(arrays)

    def _in_phase(self, phase: str, q_hand: np.ndarray, wide: CheckArrays, arrays: CheckArrays) -> CollisionChecker:
        other = object.__new__(CollisionChecker)
        other.manipulator, other.world, other.config = self.manipulator, self.world, self.config
        other.q_hand, other._scene, other._wide = np.asarray(q_hand, float), self._scene, wide
        other._set_phase(phase, arrays)
        return other


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Scene:
    """The obstacles' part of `CheckArrays`."""

    box_rows: np.ndarray
    box_info: np.ndarray
    grids: np.ndarray
    grid_info: np.ndarray
    kinds: np.ndarray
    target_values: np.ndarray
    other_values: np.ndarray
    cloud_values: np.ndarray


def _scene(world: PlanningWorld) -> _Scene:
    target = [] if world.target is None else [whole_thing(world.target.obj, world.target.X_BO)]
    others = [thinned_thing(p.obj, p.X_BO) for p in world.objects]
    if world.target is not None:  # the last row: what may be carried
        others.append(thinned_thing(world.target.obj, np.eye(4)))
    cloud = [cloud_thing(world.cloud_B)] if len(world.cloud_B) else []
    tables = [grid_tables(things) for things in (target, others, cloud)]
    counts = np.array([len(target), len(world.objects), len(cloud)])
    order = [*range(len(target) + len(world.objects)), *range(len(target) + len(others), len(target + others + cloud))]
    if world.target is not None:
        order.append(len(target) + len(world.objects))
    rows, info = box_rows(world.boxes)
    return _Scene(
        box_rows=rows,
        box_info=info,
        grids=np.concatenate([t[0] for t in tables])[order],
        grid_info=np.concatenate([t[1] for t in tables])[order],
        kinds=np.array([0, 0, *np.cumsum(counts)], np.int64),
        target_values=tables[0][2],
        other_values=tables[1][2],
        cloud_values=tables[2][2],
    )


def _carried(checker: CollisionChecker, near: CheckArrays, robot: RobotTables, X_HO: np.ndarray) -> CheckArrays:
    """The approach's arrays with the target held at X_HO, and the limits that its place in the world sets."""
    target, c = checker.world.target, checker.config
    assert target is not None
    X_KO, points_O = robot.X_KH @ X_HO, object_shape(target.obj).points_O
    start = collision_report.points_gaps(near, points_O, np.ascontiguousarray(target.X_BO, float))
    rows, _, _ = grid_tables([thinned_thing(target.obj, X_KO)])
    kinds, link_info = near.kinds.copy(), near.link_info.copy()
    kinds[TARGET] = kinds[OTHERS]  # it is no obstacle any more
    link_info[:, MEETS_CARRIED] = (link_info[:, IS_HAND] == 0) & (link_info[:, BODY] != robot.hand_body)
    return near._replace(
        link_info=link_info,
        grids=np.concatenate([near.grids[:-1], rows]),
        kinds=kinds,
        carried_points=np.ascontiguousarray(points_O @ X_KO[:3, :3].T + X_KO[:3, 3]),
        carried_limits=np.minimum(c.near_margin_m, start - c.sink_m),
        carried_body=robot.hand_body,
    )
