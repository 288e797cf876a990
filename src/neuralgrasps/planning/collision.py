"""`CollisionChecker`: is a posture of the robot free, and is the straight joint motion between two?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.planning import collision_report
from neuralgrasps.planning.cloud_field import cloud_grids
from neuralgrasps.planning.collision_arrays import CarriedArrays, CheckArrays, Grids, Work, make_work
from neuralgrasps.planning.collision_kernels import config_is_free, configs_are_free, edge_is_free
from neuralgrasps.planning.collision_robot import pose_in_hand, robot_arrays
from neuralgrasps.planning.collision_world import (
    box_arrays,
    full_grid,
    no_grids,
    object_shape,
    stack_grids,
    thinned_grids,
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
    near_step_m: float = 0.005

    def __post_init__(self) -> None:
        for name in ("margin_m", "self_margin_m", "near_margin_m", "sink_m"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a length in metres, 0 or more.")
        for name in ("max_step_rad", "max_step_m", "near_step_m"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a positive number.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Scene:
    """Obstacles as arrays, shared by the phases."""

    box_X: np.ndarray
    box_half: np.ndarray
    target: Grids
    others: Grids
    cloud: Grids


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
        self._set_phase("transfer", self._arrays(self.q_hand))

    def for_transfer(self) -> CollisionChecker:
        """The long way: spheres for arm and hand, wide margins, the target an obstacle."""
        return self._in_phase("transfer", self.q_hand, self._arrays(self.q_hand))

    def for_approach(self) -> CollisionChecker:
        """The last straight way: the hand by its exact shape, with small margins; the arm as in the transfer."""
        return self._in_phase("approach", self.q_hand, self._near(self.q_hand))

    def for_lift(self, q_hand: np.ndarray, X_HO: np.ndarray) -> CollisionChecker:
        """The way up, the hand at q_hand (J,), the target held at X_HO (4, 4) and carried along.

        The target starts at its pose in the world. Where it is nearer to an obstacle than the margin there, it must not
        come nearer by more than `sink_m`.

        Raises:
            InputError: the world has no target.
        """
        target = self.world.target
        if target is None:
            raise InputError("the world has no target to lift; expected PlanningWorld(target=...).")
        self.manipulator.hand.check_q(np.asarray(q_hand, float))
        arrays = self._near(q_hand)
        carried = _carried(self, arrays, np.asarray(q_hand, float), np.asarray(X_HO, float))
        return self._in_phase("lift", q_hand, arrays._replace(target=no_grids(), carried=carried))

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

    def _arrays(self, q_hand: np.ndarray) -> CheckArrays:
        """The transfer's arrays at hand joints."""
        c, scene = self.config, self._scene
        wide = [c.margin_m, c.target_margin_m, c.margin_m, c.margin_m]
        return CheckArrays(
            robot=robot_arrays(self.manipulator, q_hand, self_margin_m=c.self_margin_m),
            box_X=scene.box_X,
            box_half=scene.box_half,
            target=scene.target,
            others=scene.others,
            cloud=scene.cloud,
            carried=_nothing(len(scene.box_half)),
            margins=np.array([wide, wide]),
            exact_hand=False,
            max_step_rad=c.max_step_rad,
            max_step_m=c.max_step_m,
        )

    def _near(self, q_hand: np.ndarray) -> CheckArrays:
        """The approach's arrays."""
        c = self.config
        arrays = self._arrays(q_hand)
        margins = arrays.margins.copy()
        margins[1] = [c.near_margin_m, c.near_target_margin_m, c.near_margin_m, c.near_margin_m]
        return arrays._replace(margins=margins, exact_hand=True, max_step_m=c.near_step_m)

    def _set_phase(self, phase: str, arrays: CheckArrays) -> None:
        self.phase, self.arrays = phase, arrays
        self.work: Work = make_work(arrays.robot)

    def _in_phase(self, phase: str, q_hand: np.ndarray, arrays: CheckArrays) -> CollisionChecker:
        other = object.__new__(CollisionChecker)
        other.manipulator, other.world, other.config = self.manipulator, self.world, self.config
        other.q_hand, other._scene = np.asarray(q_hand, float), self._scene
        other._set_phase(phase, arrays)
        return other


def _scene(world: PlanningWorld) -> _Scene:
    X, half = box_arrays(world.boxes)
    return _Scene(
        box_X=X,
        box_half=half,
        target=no_grids() if world.target is None else full_grid(world.target.obj, world.target.X_BO),
        others=thinned_grids([(p.obj, p.X_BO) for p in world.objects]),
        cloud=cloud_grids(world.cloud_B),
    )


def _nothing(boxes: int) -> CarriedArrays:
    return CarriedArrays(
        body=0, points=np.zeros((0, 3)), centre=np.zeros(3), radius=0.0, grid=no_grids(),
        meets_link=np.zeros(0, np.bool_), box_limit=np.zeros(boxes), other_limit=np.zeros(0), cloud_limit=np.zeros(0),
    )  # fmt: skip


def _carried(checker: CollisionChecker, arrays: CheckArrays, q_hand: np.ndarray, X_HO: np.ndarray) -> CarriedArrays:
    """The target held at X_HO, with the limits that its place in the world sets."""
    target, c = checker.world.target, checker.config
    assert target is not None
    body, X_KO = pose_in_hand(checker.manipulator, q_hand, X_HO)
    shape = object_shape(target.obj)
    X_BO = np.asarray(target.X_BO, float)
    points_B = shape.points_O @ X_BO[:3, :3].T + X_BO[:3, 3]
    grid = stack_grids([(shape.grid, shape.error_m, shape.low, shape.high, X_KO)])
    robot = arrays.robot
    box, other, cloud = (
        collision_report.start_limits(arrays, grids, points_B, margin=c.near_margin_m, sink=c.sink_m)
        for grids in (None, arrays.others, arrays.cloud)
    )
    return CarriedArrays(
        body=body,
        points=np.ascontiguousarray(shape.points_O @ X_KO[:3, :3].T + X_KO[:3, 3]),
        centre=grid.centre[0],
        radius=float(grid.radius[0]),
        grid=grid,
        meets_link=~robot.link_is_hand & (robot.link_body != body),
        box_limit=box,
        other_limit=other,
        cloud_limit=cloud,
    )
