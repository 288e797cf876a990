"""The ROS 2 example without ROS: what it reads, what it sends, and what it says."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from neuralgrasps.apply.robot import Robot
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.export import ros_robot
from tests.export.conftest import smooth_motion
from tests.export.test_ros_robot import image, joint_state

FILE = Path(__file__).parents[2] / "examples" / "06_ros2_pick.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ros2_pick", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_without_ros_it_says_what_is_missing(
    example: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert example.main(["mustard_bottle"]) == 2
    assert "needs ROS 2" in capsys.readouterr().err


def test_it_offers_all_that_a_robot_must(example: ModuleType) -> None:
    for name, wanted in vars(Robot).items():
        if not name.startswith("_") and inspect.isfunction(wanted):
            ours = inspect.signature(getattr(example.RosRobot, name))
            assert ours.parameters == inspect.signature(wanted).parameters, name


def _sensors(fetch: Manipulator) -> tuple[Any, Any, Any]:
    state = joint_state(fetch, fetch.q_home)
    state.header = SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=500_000_000))
    depth = image(np.full((48, 64), 900, np.uint16), "16UC1")
    info = SimpleNamespace(width=64, height=48, k=[60.0, 0, 32, 0, 60, 24, 0, 0, 1], p=[0.0] * 12)
    return state, depth, info


def test_a_look_knows_where_the_camera_was(example: ModuleType, fetch: Manipulator) -> None:
    state, depth, info = _sensors(fetch)
    frame = example.frame_from(fetch, state, depth, info)
    np.testing.assert_allclose(frame.depth, 0.9)
    np.testing.assert_allclose(frame.X_WC, fetch.camera_pose(fetch.q_home[fetch.arm_dofs]), atol=1e-9)
    now = example.state_from(fetch, state)
    np.testing.assert_array_equal(now.q_arm, fetch.q_home[fetch.arm_dofs])
    np.testing.assert_array_equal(now.q_hand, fetch.q_home[fetch.hand_dofs])
    assert now.time_s == 12.5


class Ros:
    """The little of ROS 2 that the example calls: topics that speak when spun, controllers that answer."""

    def __init__(self, speaks: dict[str, list[Any]], status: int = 4) -> None:
        self.speaks, self.status, self.accepts, self.sent = speaks, status, True, []
        self.heard: dict[str, Any] = {}

    def create_subscription(self, kind: Any, topic: str, call: Any, quality: Any) -> None:
        self.heard[topic] = call

    def spin_once(self, node: Any, timeout_sec: float) -> None:
        for topic, messages in self.speaks.items():
            for message in messages:
                self.heard[topic](message)

    def spin_until_future_complete(self, node: Any, future: Any, timeout_sec: float) -> None: ...

    def client(self, node: Any, action: Any, name: str) -> Any:
        def answer(goal: Any) -> Any:
            self.sent.append((name, goal.fields))
            ended = _done(SimpleNamespace(status=self.status, result=SimpleNamespace(error_string="path tolerance")))
            return _done(SimpleNamespace(accepted=self.accepts, get_result_async=lambda: ended))

        return SimpleNamespace(wait_for_server=lambda timeout_sec: True, send_goal_async=answer)


def _done(value: Any) -> Any:
    return SimpleNamespace(done=lambda: True, result=lambda: value)


@pytest.fixture
def ros(fetch: Manipulator, example: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros]:
    state, depth, info = _sensors(fetch)
    halves = [
        SimpleNamespace(header=state.header, name=state.name[a:b], position=state.position[a:b])
        for a, b in ((0, 5), (5, None))  # two drivers, each with some of the joints
    ]
    ros = Ros({example.JOINTS: halves, example.DEPTH: [depth], example.CAMERA: [info]})
    action = SimpleNamespace(Goal=SimpleNamespace)
    modules = {
        "rclpy": {"spin_once": ros.spin_once, "spin_until_future_complete": ros.spin_until_future_complete},
        "rclpy.action": {"ActionClient": ros.client},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "control_msgs": {},
        "control_msgs.action": {"FollowJointTrajectory": action, "GripperCommand": action},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"CameraInfo": None, "Image": None, "JointState": None},
        "action_msgs": {},
        "action_msgs.msg": {"GoalStatus": SimpleNamespace(STATUS_SUCCEEDED=4, STATUS_ABORTED=6)},
        "rosidl_runtime_py": {},
        "rosidl_runtime_py.set_message": {"set_message_fields": lambda goal, fields: setattr(goal, "fields", fields)},
    }
    for name, parts in modules.items():
        module = ModuleType(name)
        vars(module).update(parts)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(example, "WAIT_S", 0.05)
    yield ros


def test_goals_go_to_the_controllers_and_looks_come_from_the_topics(
    example: ModuleType, fetch: Manipulator, ros: Ros
) -> None:
    robot = example.RosRobot(ros, fetch)
    motion = smooth_motion(fetch.arm_names)
    robot.execute(motion)
    robot.move_hand(np.array([0.02]), duration_s=0.1, force=0.5)
    robot.move_hand(np.array([-0.0146]), duration_s=0.1)  # a jaw that presses is sent beyond its limits
    assert ros.sent == [
        (example.ARM_ACTION, ros_robot.follow_goal(motion)),
        (example.GRIPPER_ACTION, {"command": {"position": 0.04, "max_effort": 30.0}}),
        (example.GRIPPER_ACTION, {"command": {"position": 0.0, "max_effort": 60.0}}),
    ]
    np.testing.assert_array_equal(robot.state().q_arm, fetch.q_home[fetch.arm_dofs])
    np.testing.assert_allclose(robot.look().depth, 0.9)


def test_what_goes_wrong_on_the_robot_is_said(example: ModuleType, fetch: Manipulator, ros: Ros) -> None:
    robot, motion = example.RosRobot(ros, fetch), smooth_motion(fetch.arm_names)
    ros.status = 6
    robot.move_hand(np.array([0.0]), duration_s=0.1)  # it stalled: there is something between the fingers
    with pytest.raises(example.RobotError, match=r"arm_with_torso.*status 6: path tolerance"):
        robot.execute(motion)
    ros.status = 5  # cancelled
    with pytest.raises(example.RobotError, match=r"gripper_controller.*status 5"):
        robot.move_hand(np.array([0.0]), duration_s=0.1)
    ros.accepts = False
    with pytest.raises(example.RobotError, match="refused"):
        robot.execute(motion)
    ros.speaks[example.JOINTS].pop()
    with pytest.raises(example.RobotError, match="nothing, or not all joints, came on /joint_states"):
        robot.state()
