"""Trying grasps on an object that lies on a table: close, lift, hold. No arm: a carriage moves the hand straight up.

The trial of `validate_grasps` closes on an object that floats free and can turn into the fingers. On a table it cannot,
and a grasp near the limit of friction lets it go then.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.manipulator import Manipulator, mount_at
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane, standing_on
from neuralgrasps.geometry.se3_numpy import make_transform_np
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.grip import grip_target
from neuralgrasps.sim.tabletop import TableTop
from neuralgrasps.sim.tabletop_model import TableTopConfig
from neuralgrasps.sim.validate import check_pair, verdict_parameters

_TABLE_HALF_M = (1.0, 1.0, 0.02)
_LOST_M = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class LiftConfig:
    """How grasps are tried on the table.

    Attributes:
        friction_scale: of the object's friction; below 1 it leaves a margin for what is not known.
        grip: share of the hand's effort limits. close_s: time of each half of closing.
        lift_m, lift_s: height and time of the lift; hold_s: how long it is held then.
        table: the rest of the physics.
    """

    friction_scale: float = 0.75
    grip: float = 1.0
    close_s: float = 0.4
    lift_m: float = 0.1
    lift_s: float = 0.8
    hold_s: float = 0.5
    table: TableTopConfig = field(default_factory=TableTopConfig)

    def __post_init__(self) -> None:
        for name in ("friction_scale", "grip", "close_s", "lift_m", "lift_s"):
            if not getattr(self, name) > 0:
                raise InputError(f"table lift: {name} is {getattr(self, name)}; expected a positive number.")


def try_lifts(
    hand: Hand, obj: ObjectModel, grasps: GraspSet, table_O: Plane, *, config: LiftConfig | None = None
) -> Verdict:
    """Try each grasp on the object as it lies on its table; about 0.1 CPU-seconds a grasp.

    Args:
        hand, obj, grasps: as for `validate_grasps`.
        table_O: the table's top in the object's frame, normal up.
    Returns:
        The verdict, one row a grasp: success when the object came along and stayed within 3 cm of where it was in the
        hand; `displacement_m`, `rotation_rad`: how far it slipped there, from before closing to the end.
    Raises:
        InputError, ShapeError: grasps of another hand or object.
    """
    config = config or LiftConfig()
    check_pair(hand, obj, grasps)
    protocol = replace(config.table.grasp, friction_scale=config.friction_scale * config.table.grasp.friction_scale)
    physics = replace(config.table, grasp=protocol)
    X_WO = standing_on(table_O)
    slips = [_try(hand, obj, grasps[i], X_WO, config, physics) for i in range(len(grasps))]
    displacement = np.array([s[0] for s in slips], np.float64)
    return Verdict(
        success=displacement <= _LOST_M,  # nan, of a simulation that broke down, is none
        displacement_m=displacement,
        rotation_rad=np.array([s[1] for s in slips], np.float64),
        parameters=verdict_parameters(hand, obj, protocol)
        | {"grip": config.grip, "lift_m": config.lift_m, "lift_s": config.lift_s, "lift_hold_s": config.hold_s},
    )


def _try(
    hand: Hand, obj: ObjectModel, grasp: GraspSet, X_WO: np.ndarray, config: LiftConfig, physics: TableTopConfig
) -> tuple[float, float]:
    """How far the object slipped in the hand, metres and rad."""
    robot = _carried_hand(hand, X_WO @ grasp.X_OH[0], grasp.q_pregrasp[0])
    top = TableTop(robot, [(obj, X_WO)], _Table(), config=physics)
    top.settle(0.3)
    before = _in_hand(top)
    top.move_hand(grasp.q[0], config.close_s)
    top.move_hand(
        grip_target(hand, grasp.q[0], grasp.q_squeeze[0], grip=config.grip), config.close_s, force=config.grip
    )
    t = np.linspace(0.0, config.lift_s, 41)
    s = t / config.lift_s
    way, speed = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / config.lift_s  # minimum jerk
    up = Trajectory(joint_names=robot.arm_names, t=t, q=config.lift_m * way[:, None], qd=config.lift_m * speed[:, None])
    top.run(up, settle_s=config.hold_s)
    after = _in_hand(top)
    com = np.append(np.asarray(obj.com_O), 1.0)
    turn = before[:3, :3].T @ after[:3, :3]
    angle = float(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    return float(np.linalg.norm(((after - before) @ com)[:3])), angle


def _in_hand(top: TableTop) -> np.ndarray:
    """The object's pose (4, 4) with the carriage's way taken off."""
    X = top.object_pose(0)
    X[2, 3] -= top.q_arm[0]
    return X


@dataclass(frozen=True)
class _Table:
    """A table top at z = 0."""

    name: str = "table"
    X_BX: np.ndarray = field(default_factory=lambda: make_transform_np(translation=[0.0, 0.0, -_TABLE_HALF_M[2]]))
    half: np.ndarray = field(default_factory=lambda: np.array(_TABLE_HALF_M))


def _carried_hand(hand: Hand, X_WH: np.ndarray, q_hand: np.ndarray) -> Manipulator:
    """The hand at `X_WH` on a carriage without shape that slides along z."""
    tree = KinematicTree(
        link_names=("base", "carriage"),
        parents=np.array([-1, 0], np.int32),
        joint_names=("", "lift"),
        joint_types=np.array([FIXED, PRISMATIC], np.int8),
        X_parent_joint=np.tile(np.eye(4), (2, 1, 1)),
        axes=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        coupling=np.array([[0.0], [1.0]]),
        offset=np.zeros(2),
        dof_names=("lift",),
        lower=np.array([-0.5]),
        upper=np.array([1.0]),
        effort=np.array([2000.0]),
    )
    carriage = Arm(
        name="carriage", tree=tree, parts=(), flange=1, X_FM=np.eye(4), joints=np.array([0]),
        continuous=np.array([False]), q_home=np.zeros(1), velocity=np.ones(1), acceleration=np.ones(1), camera=None,
        table_height_m=0.0, licence="", provenance="",
    )  # fmt: skip
    robot = mount_at(carriage, hand, X_WH)
    return replace(robot, q_home=np.concatenate([[0.0], q_hand]))
