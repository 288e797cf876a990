"""What a robot must offer so that it can pick things up: the simulator offers it, and so would a real one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError
from neuralgrasps.perception.frame import Frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotState:
    """Where a robot is.

    Attributes:
        q_arm: (D,) planned joints, in the order of `Manipulator.arm_dofs`, rad or metres.
        q_hand: (J,) joints of the hand.
        time_s: the robot's clock.
    """

    q_arm: np.ndarray
    q_hand: np.ndarray
    time_s: float


def check_start(manipulator: Manipulator, trajectory: Trajectory, q_arm: np.ndarray, *, slack: float = 0.05) -> None:
    """Refuse a motion that does not begin where the arm is: it would jump there.

    Args:
        q_arm: (D,) measured joints. slack: rad or metres that each may be off.
    Raises:
        InputError: other joints, or another start.
    """
    names = manipulator.arm_names
    if sorted(trajectory.joint_names) != sorted(names):
        raise InputError(f"the trajectory moves joints {trajectory.joint_names}; expected {names}.")
    start = trajectory.q[0, [trajectory.joint_names.index(n) for n in names]]
    off = np.abs(start - q_arm)
    if not (off <= slack).all():
        j = int(np.argmax(off))
        raise InputError(
            f"the trajectory begins at {names[j]} = {start[j]:.3f}, but the arm is at {q_arm[j]:.3f}; plan anew from "
            "where the robot is."
        )


class Robot(Protocol):
    """A manipulator with a depth camera.

    Every call returns when the motion has ended. A robot that cannot do what it is asked raises; it never moves
    otherwise than asked. All poses are in the robot base frame B, z up.
    """

    @property
    def manipulator(self) -> Manipulator:
        """Its model: planning is done on this."""
        ...

    def state(self) -> RobotState:
        """Measured joints."""
        ...

    def look(self) -> Frame:
        """A depth frame; `X_WC` is the camera in B at that moment, from the measured joints and the calibration."""
        ...

    def execute(self, trajectory: Trajectory) -> None:
        """Follow a trajectory that starts where the arm is (`check_start`); the hand holds its posture and force."""
        ...

    def move_hand(self, q_hand: np.ndarray, *, duration_s: float, force: float = 1.0) -> None:
        """Move the hand to a posture (J,) in about `duration_s`.

        Args:
            force: share of the joints' effort limits that may be used; fingers that meet something stop there and
                press.
        """
        ...

    def wait(self, duration_s: float) -> None:
        """Stand still."""
        ...
