"""A Fetch over a small table, its open jaw around an upright box: a grasp that needs no planner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.tabletop import TableTop
from neuralgrasps.sim.tabletop_model import TableTopConfig

from .toy import HALF

# torso, shoulder pan and lift, upper-arm roll, elbow, forearm roll, wrist flex and roll: the jaw points straight down
ABOVE = np.array([0.1, 0.3, 0.2, 0.0, 0.7, 0.0, np.pi / 2 - 0.9, 0.0])


@dataclass(frozen=True)
class Slab:
    """A box of the world."""

    name: str
    X_BX: np.ndarray
    half: np.ndarray


@dataclass(frozen=True)
class Placed:
    """An object at a pose."""

    obj: ObjectModel
    X_BO: np.ndarray


@dataclass(frozen=True)
class World:
    """What `recheck_path` reads."""

    boxes: Sequence[Slab] = ()
    target: Placed | None = None
    objects: Sequence[Placed] = ()


def fetch_above() -> Manipulator:
    """The Fetch with its jaw open and pointing down."""
    robot = mount(load_arm("fetch"), load_hand("fetch"))
    return replace(robot, q_home=robot.full_q(ABOVE, robot.hand.q_open))


def translation(x: float, y: float, z: float) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = [x, y, z]
    return X


def box_in_jaw(robot: Manipulator) -> np.ndarray:
    """X_BO of an upright box whose middle is the jaw's, its 40 mm side between the pads."""
    X_BH = robot.hand_pose(ABOVE)
    pad = X_BH[:3, :3] @ robot.hand.jaw_pad_H + X_BH[:3, 3]
    across = X_BH[:3, :3] @ robot.hand.X_HP[:3, 0]
    X = translation(*(pad - [0.0, 0.0, 0.02]))
    X[:3, 0] = across / np.linalg.norm(across)
    X[:3, 1] = np.cross([0.0, 0.0, 1.0], X[:3, 0])
    return X


def table_under(X_BO: np.ndarray, *, gap_m: float = 0.0) -> Slab:
    """A table top under an upright box."""
    half = np.array([0.15, 0.15, 0.02])
    return Slab("table", translation(X_BO[0, 3], X_BO[1, 3], X_BO[2, 3] - HALF[2] - half[2] - gap_m), half)


def scene(robot: Manipulator, box: ObjectModel, *, config: TableTopConfig | None = None) -> TableTop:
    """The box on its table, the open jaw around it."""
    X_BO = box_in_jaw(robot)
    return TableTop(robot, [(box, X_BO)], table_under(X_BO), config=config)


def smooth(robot: Manipulator, q_from: np.ndarray, change: np.ndarray, duration_s: float) -> Trajectory:
    """From rest to rest along a straight line in joint space, minimum jerk."""
    t = np.linspace(0.0, duration_s, 101)
    s = t / duration_s
    way = 10 * s**3 - 15 * s**4 + 6 * s**5
    speed = (30 * s**2 - 60 * s**3 + 30 * s**4) / duration_s
    return Trajectory(joint_names=robot.arm_names, t=t, q=q_from + way[:, None] * change, qd=speed[:, None] * change)


def lift(robot: Manipulator, height_m: float = 0.2) -> Trajectory:
    """Straight up by the torso."""
    return smooth(robot, ABOVE, np.eye(len(ABOVE))[0] * height_m, 2.0)
