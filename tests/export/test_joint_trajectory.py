"""Motions as JointTrajectory messages, and back."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export.joint_trajectory import (
    KIND,
    joint_trajectory,
    load_trajectory,
    save_trajectory,
    trajectory_of,
)
from neuralgrasps.export.messages import Ros, check_message
from tests.export.conftest import smooth_motion

NAMES = ("shoulder", "elbow", "wrist")


@pytest.mark.parametrize("ros", (1, 2))
def test_a_motion_survives_a_file(tmp_path: Path, ros: Ros) -> None:
    motion = smooth_motion(NAMES)
    path = save_trajectory(tmp_path / "a.yaml", motion, frame_id="base", ros=ros)
    check_message(KIND, yaml.safe_load(path.read_text()), ros=ros)
    back = load_trajectory(path)
    assert back.joint_names == NAMES
    np.testing.assert_array_equal(back.q, motion.q)
    np.testing.assert_array_equal(back.qd, motion.qd)
    np.testing.assert_allclose(back.t, motion.t, rtol=0, atol=0.5e-9)
    at = np.linspace(-0.1, motion.duration_s + 0.1, 200)
    np.testing.assert_allclose(back.sample(at)[0], motion.sample(at)[0], atol=1e-6)
    again = save_trajectory(tmp_path / "b.yaml", smooth_motion(NAMES), frame_id="base", ros=ros)
    assert again.read_bytes() == path.read_bytes()


def test_points_say_what_the_motion_is() -> None:
    motion = Trajectory(
        joint_names=("a", "b"), t=np.array([0.0, 1.25]), q=np.array([[1.0, 2.0], [3.0, 4.0]]),
        qd=np.array([[0.0, 0.0], [5.0, 6.0]]),
    )  # fmt: skip
    message = joint_trajectory(motion, names={"a": "arm_a"})
    assert message == {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": ["arm_a", "b"],
        "points": [
            {
                "positions": positions, "velocities": velocities, "accelerations": [], "effort": [],
                "time_from_start": {"sec": sec, "nanosec": nanosec},
            }
            for positions, velocities, sec, nanosec in (
                ([1.0, 2.0], [0.0, 0.0], 0, 0), ([3.0, 4.0], [5.0, 6.0], 1, 250_000_000)
            )
        ],
    }  # fmt: skip
    ros1 = joint_trajectory(motion, ros=1)
    assert ros1["header"] == {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""}
    assert ros1["points"][1]["time_from_start"] == {"secs": 1, "nsecs": 250_000_000}


def test_joints_come_in_the_order_asked_for() -> None:
    motion = smooth_motion(NAMES)
    back = trajectory_of(joint_trajectory(motion), joint_names=("wrist", "shoulder", "elbow"))
    np.testing.assert_array_equal(back.q, motion.q[:, [2, 0, 1]])
    np.testing.assert_array_equal(back.qd, motion.qd[:, [2, 0, 1]])


def _late_start(message: dict[str, Any]) -> None:
    message["points"] = message["points"][1:]


def _same_time(message: dict[str, Any]) -> None:
    message["points"][3]["time_from_start"] = message["points"][2]["time_from_start"]


def _no_speeds(message: dict[str, Any]) -> None:
    message["points"][4]["velocities"] = []


def _short(message: dict[str, Any]) -> None:
    message["points"][5]["positions"].pop()


def _one_point(message: dict[str, Any]) -> None:
    message["points"] = message["points"][:1]


def _one_name_twice(message: dict[str, Any]) -> None:
    message["joint_names"][1] = "shoulder"


def _text(message: dict[str, Any]) -> None:
    message["points"][6]["positions"][0] = "1.0"


@pytest.mark.parametrize(
    ("damage", "said"),
    (
        (_late_start, "first at time 0"),
        (_same_time, "then rising"),
        (_no_speeds, r"points\[4\].velocities has 0 numbers for 3 joints"),
        (_short, r"points\[5\].positions has 2 numbers for 3 joints"),
        (_one_point, "1 points; expected two"),
        (_one_name_twice, "once each"),
        (_text, r"points\[6\].positions\[0\] is '1.0'"),
    ),
)
def test_messages_that_are_no_motion(damage: Callable[[dict[str, Any]], None], said: str) -> None:
    message = copy.deepcopy(joint_trajectory(smooth_motion(NAMES)))
    damage(message)
    with pytest.raises(DataFormatError, match=said):
        trajectory_of(message)


def test_other_joints_are_refused() -> None:
    message = joint_trajectory(smooth_motion(NAMES))
    with pytest.raises(DataFormatError, match="moves shoulder, elbow, wrist; expected shoulder, elbow"):
        trajectory_of(message, joint_names=("shoulder", "elbow"))


def test_motions_that_no_message_can_hold() -> None:
    names, q = ("a",), np.zeros((2, 1))
    with pytest.raises(InputError, match="nanosecond"):
        joint_trajectory(Trajectory(joint_names=names, t=np.array([0.0, 1e-10]), q=q, qd=q))
    with pytest.raises(InputError, match="finite"):
        joint_trajectory(Trajectory(joint_names=names, t=np.array([0.0, 1.0]), q=q * np.nan, qd=q))
    with pytest.raises(InputError, match="one name"):
        joint_trajectory(smooth_motion(("a", "b")), names={"a": "b"})
