"""Goals for controllers, and readings of sensors, without ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.export import ros_robot
from neuralgrasps.export.joint_trajectory import trajectory_of
from neuralgrasps.export.messages import check_message
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from tests.export.conftest import smooth_motion


def test_an_arm_goal_holds_the_motion() -> None:
    motion = smooth_motion(("a", "b"))
    goal = ros_robot.follow_goal(motion, tolerance=0.01, late_s=0.5)
    check_message(ros_robot.FOLLOW_KIND, goal)
    np.testing.assert_array_equal(trajectory_of(goal["trajectory"]).q, motion.q)
    ends = [(t["name"], t["position"]) for t in goal["goal_tolerance"]]
    assert ends == [("a", 0.01), ("b", 0.01)] and goal["goal_time_tolerance"] == {"sec": 0, "nanosec": 500_000_000}
    assert ros_robot.follow_goal(motion)["goal_tolerance"] == []
    with pytest.raises(InputError, match="tolerance is -1"):
        ros_robot.follow_goal(motion, tolerance=-1.0)


def test_a_gripper_goal() -> None:
    goal = ros_robot.gripper_goal(load_hand("fetch"), np.array([0.02]), force=0.5, scale=2.0)
    assert goal == {"command": {"position": 0.04, "max_effort": 30.0}}
    with pytest.raises(InputError, match="use hand_goal"):
        ros_robot.gripper_goal(load_hand("allegro"), np.zeros(16))
    with pytest.raises(InputError, match=r"force is 1\.5"):
        ros_robot.gripper_goal(load_hand("fetch"), np.array([0.02]), force=1.5)
    with pytest.raises(ShapeError):
        ros_robot.gripper_goal(load_hand("fetch"), np.zeros(2))


def test_a_hand_goal_moves_independent_joints_only() -> None:
    hand, q = load_hand("barrett"), np.arange(1.0, 8.0) / 10
    goal = ros_robot.hand_goal(hand, q, duration_s=1.5, force=0.5)
    check_message(ros_robot.FOLLOW_KIND, goal)
    assert goal["trajectory"]["joint_names"] == list(hand.tree.dof_names)
    (point,) = goal["trajectory"]["points"]
    assert point["positions"] == q.tolist() and point["effort"] == (0.5 * hand.tree.effort).tolist()
    assert point["time_from_start"] == {"sec": 1, "nanosec": 500_000_000}


def joint_state(fetch: Manipulator, q: np.ndarray) -> Any:
    """All joints of a Fetch in another order, with others between."""
    names = [*fetch.arm.tree.dof_names, "r_gripper_finger_joint", "l_gripper_finger_joint", "l_wheel_joint"]
    values = [*q, q[-1] + 0.002, 99.0]
    order = np.random.default_rng(0).permutation(len(names))
    return SimpleNamespace(name=[names[i] for i in order], position=[values[i] for i in order])


def test_joints_are_found_by_name_and_the_camera_follows_the_head(fetch: Manipulator) -> None:
    q = fetch.q_home.copy()
    q[fetch.tree.dof_names.index("head_tilt_joint")] += 0.3
    q[fetch.tree.dof_names.index("torso_lift_joint")] += 0.05
    q[-1] = 0.03
    np.testing.assert_array_equal(ros_robot.read_robot(fetch, joint_state(fetch, q)), q)
    camera = fetch.arm.camera
    assert camera is not None
    X_BC = ros_robot.camera_in_base(fetch, q)
    np.testing.assert_allclose(X_BC, forward_numpy(fetch.tree, q)[camera.link] @ camera.X_LC, atol=1e-9)
    at_home = fetch.camera_pose(fetch.q_home[fetch.arm_dofs])
    assert X_BC[2, 2] < at_home[2, 2] - 0.1  # it looks further down than at home
    np.testing.assert_allclose(X_BC[2, 3] - at_home[2, 3], 0.05, atol=0.06)


def test_joint_states_that_do_not_fit(fetch: Manipulator) -> None:
    state = joint_state(fetch, fetch.q_home)
    state.name[state.name.index("elbow_flex_joint")] = "elbow"
    with pytest.raises(InputError, match="lacks elbow_flex_joint; it has"):
        ros_robot.read_robot(fetch, state)
    state = joint_state(fetch, fetch.q_home)
    state.position[state.name.index("elbow_flex_joint")] = float("nan")
    with pytest.raises(InputError, match="not finite"):
        ros_robot.read_robot(fetch, state)


def image(values: np.ndarray, encoding: str, *, pad: int = 0, big: bool = False) -> Any:
    rows = values.astype(values.dtype.newbyteorder(">" if big else "<"))
    data = b"".join(row.tobytes() + b"\xee" * pad for row in rows)
    return SimpleNamespace(
        encoding=encoding, height=values.shape[0], width=values.shape[1], is_bigendian=int(big), data=data,
        step=values.shape[1] * values.itemsize + pad,
    )  # fmt: skip


@pytest.mark.parametrize(("pad", "big"), ((0, False), (6, False), (6, True)))
def test_depth_images_become_metres(pad: int, big: bool) -> None:
    millimetres = np.array([[0, 500, 65535], [1, 2, 3]], np.uint16)
    depth = ros_robot.read_depth(image(millimetres, "16UC1", pad=pad, big=big))
    np.testing.assert_allclose(depth, millimetres / 1000)
    metres = np.array([[np.nan, 0.5, np.inf], [1.0, 2.25, 3.0]], np.float32)
    depth = ros_robot.read_depth(image(metres, "32FC1", pad=pad, big=big))
    np.testing.assert_array_equal(depth, [[0.0, 0.5, 0.0], [1.0, 2.25, 3.0]])


def test_depth_images_that_cannot_be_read() -> None:
    with pytest.raises(InputError, match="encoded as 'rgb8'"):
        ros_robot.read_depth(image(np.zeros((2, 3), np.uint8), "rgb8"))
    short = image(np.zeros((2, 3), np.uint16), "16UC1")
    short.data = short.data[:-1]
    with pytest.raises(InputError, match="11 bytes in rows of 6"):
        ros_robot.read_depth(short)


def test_the_camera_is_that_of_the_rectified_image() -> None:
    k = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
    p = [490.0, 0.0, 321.0, 0.0, 0.0, 495.0, 241.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    info = SimpleNamespace(width=640, height=480, k=k, p=p)
    camera = ros_robot.read_intrinsics(info)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (490.0, 495.0, 321.0, 241.0)
    assert (camera.width, camera.height) == (640, 480)
    info.p = [0.0] * 12
    assert ros_robot.read_intrinsics(info).fx == 500.0
    info.k = [0.0] * 9
    with pytest.raises(InputError, match="no focal length"):
        ros_robot.read_intrinsics(info)


def test_targets_beyond_the_limits_are_sent_at_the_limits() -> None:
    panda, barrett = load_hand("panda"), load_hand("barrett")
    goal = ros_robot.gripper_goal(panda, np.array([-0.0146]), force=0.5, scale=2.0)["command"]
    assert goal == {"position": 0.0, "max_effort": 0.5 * panda.tree.effort[0]}
    assert ros_robot.gripper_goal(panda, np.array([0.07]))["command"]["position"] == panda.tree.upper[0]
    sent = ros_robot.hand_goal(barrett, barrett.tree.upper + 0.3, duration_s=1.0)["trajectory"]["points"][0]
    assert sent["positions"] == barrett.tree.upper.tolist() and sent["effort"] == barrett.tree.effort.tolist()
