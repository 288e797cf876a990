"""Pick an object up with a real robot over ROS 2: python examples/06_ros2_pick.py mustard_bottle [--grasps FILE].

`RosRobot` is the library's `Robot` protocol on ROS 2: it reads joint states, a depth image and its camera info, and
sends goals to the controllers of arm and gripper. With it, `propose_pick` looks and plans, and `carry_out` moves. The
names below are those of a Fetch; for another robot change them, and the arm and hand. Before anything moves the plan is
written to plan.yaml and has to be confirmed.

Needs ROS 2 with Python (rclpy, control_msgs, sensor_msgs, rosidl_runtime_py) to run; nothing else here does.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

import neuralgrasps as ng
from neuralgrasps.apply.robot import RobotState
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.export import ros_robot
from neuralgrasps.export.joints import hand_joints
from neuralgrasps.perception.frame import Frame

ARM, HAND = "fetch", "fetch"
JOINTS = "/joint_states"
DEPTH = "/head_camera/depth_registered/image_raw"
CAMERA = "/head_camera/depth_registered/camera_info"
ARM_ACTION = "/arm_with_torso_controller/follow_joint_trajectory"
GRIPPER_ACTION = "/gripper_controller/gripper_action"
OPENING_PER_TRAVEL = 2.0  # the Fetch's gripper takes the opening, our joint is the travel of one finger
HAND_ACTION = "/hand_controller/follow_joint_trajectory"  # of hands with more joints than one
WAIT_S = 5.0
NO_ROS = (
    "This example needs ROS 2 with its Python packages (rclpy is missing). Source the setup file of a ROS 2 "
    "installation, such as /opt/ros/jazzy/setup.bash, in this shell and run it again."
)


class RobotError(RuntimeError):
    """The robot did not do what it was asked."""


def frame_from(manipulator: Manipulator, joint_state: Any, depth: Any, info: Any) -> Frame:
    """One look: depth image, camera, and where the camera was in the robot base, from the joints measured with it."""
    q = ros_robot.read_robot(manipulator, joint_state)
    return Frame(
        depth=ros_robot.read_depth(depth),
        intrinsics=ros_robot.read_intrinsics(info),
        X_WC=ros_robot.camera_in_base(manipulator, q),
        name=DEPTH,
    )


def state_from(manipulator: Manipulator, joint_state: Any) -> RobotState:
    """Joints of arm and hand, and when they were measured."""
    q = ros_robot.read_robot(manipulator, joint_state)
    stamp = joint_state.header.stamp
    return RobotState(
        q_arm=q[manipulator.arm_dofs], q_hand=q[manipulator.hand_dofs], time_s=stamp.sec + 1e-9 * stamp.nanosec
    )


def merged(before: Any | None, message: Any) -> Any:
    """A joint state with the joints of two: several drivers may publish their own on one topic."""
    joints = dict(zip(before.name, before.position, strict=True)) if before is not None else {}
    joints.update(zip(message.name, message.position, strict=True))
    return SimpleNamespace(header=message.header, name=list(joints), position=list(joints.values()))


class RosRobot:
    """A `Robot` behind ROS 2 topics and actions."""

    def __init__(self, node: Any, manipulator: Manipulator) -> None:
        import rclpy  # noqa: PLC0415 - ROS is needed to run only
        from control_msgs.action import FollowJointTrajectory, GripperCommand  # noqa: PLC0415
        from rclpy.action import ActionClient  # noqa: PLC0415
        from rclpy.qos import qos_profile_sensor_data  # noqa: PLC0415
        from sensor_msgs.msg import CameraInfo, Image, JointState  # noqa: PLC0415

        self.manipulator, self._node, self._rclpy = manipulator, node, rclpy
        self._latest: dict[str, Any] = {}
        hand = hand_joints(manipulator.hand)
        self._joints = {*manipulator.arm.tree.dof_names, *(hand.names[k] for k in hand.dofs)}
        for topic, kind in ((JOINTS, JointState), (DEPTH, Image), (CAMERA, CameraInfo)):
            node.create_subscription(kind, topic, partial(self._keep, topic), qos_profile_sensor_data)
        jaw = manipulator.hand.num_dofs == 1
        self._actions = {
            ARM_ACTION: FollowJointTrajectory,
            **({GRIPPER_ACTION: GripperCommand} if jaw else {HAND_ACTION: FollowJointTrajectory}),
        }
        self._clients = {name: ActionClient(node, action, name) for name, action in self._actions.items()}

    def _keep(self, topic: str, message: Any) -> None:
        self._latest[topic] = merged(self._latest.get(topic), message) if topic == JOINTS else message

    def _has(self, topic: str) -> bool:
        return topic in self._latest and (topic != JOINTS or self._joints <= set(self._latest[topic].name))

    def _fresh(self, *topics: str) -> list[Any]:
        """New messages of all topics."""
        for topic in topics:
            self._latest.pop(topic, None)
        end = time.monotonic() + WAIT_S
        while not all(map(self._has, topics)):
            if time.monotonic() > end:
                missing = ", ".join(t for t in topics if not self._has(t))
                raise RobotError(f"nothing, or not all joints, came on {missing} for {WAIT_S:g} s; is the driver on?")
            self._rclpy.spin_once(self._node, timeout_sec=0.1)
        return [self._latest[topic] for topic in topics]

    def state(self) -> RobotState:
        return state_from(self.manipulator, *self._fresh(JOINTS))

    def look(self) -> Frame:
        return frame_from(self.manipulator, *self._fresh(JOINTS, DEPTH, CAMERA))

    def execute(self, trajectory: Trajectory) -> None:
        self._send(ARM_ACTION, ros_robot.follow_goal(trajectory), trajectory.duration_s)

    def move_hand(self, q_hand: np.ndarray, *, duration_s: float, force: float = 1.0) -> None:
        """Targets may lie beyond the joint limits; the goals clamp them and say the force as an effort."""
        hand = self.manipulator.hand
        if hand.num_dofs == 1:
            goal = ros_robot.gripper_goal(hand, q_hand, force=force, scale=OPENING_PER_TRAVEL)
            self._send(GRIPPER_ACTION, goal, duration_s, may_stall=True)
        else:
            goal = ros_robot.hand_goal(hand, q_hand, duration_s=duration_s, force=force)
            self._send(HAND_ACTION, goal, duration_s, may_stall=True)

    def wait(self, duration_s: float) -> None:
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            self._rclpy.spin_once(self._node, timeout_sec=0.05)

    def _send(self, name: str, fields: dict[str, Any], duration_s: float, *, may_stall: bool = False) -> None:
        """Send a goal and wait until it has ended; a hand that stalls on an object has done what it should."""
        from action_msgs.msg import GoalStatus  # noqa: PLC0415
        from rosidl_runtime_py.set_message import set_message_fields  # noqa: PLC0415

        client = self._clients[name]
        if not client.wait_for_server(timeout_sec=WAIT_S):
            raise RobotError(f"no controller answers at {name}; is it started?")
        goal = self._actions[name].Goal()
        set_message_fields(goal, fields)
        handle = self._result(client.send_goal_async(goal), name, WAIT_S)
        if not handle.accepted:
            raise RobotError(f"{name} refused the goal.")
        outcome = self._result(handle.get_result_async(), name, duration_s + WAIT_S, cancel=handle)
        fine = {GoalStatus.STATUS_SUCCEEDED, *([GoalStatus.STATUS_ABORTED] if may_stall else [])}
        if outcome.status not in fine:
            why = getattr(outcome.result, "error_string", "") or "no reason given"
            raise RobotError(f"{name} ended with status {outcome.status}: {why}.")

    def _result(self, future: Any, name: str, timeout_s: float, cancel: Any = None) -> Any:
        self._rclpy.spin_until_future_complete(self._node, future, timeout_sec=timeout_s)
        if not future.done():
            if cancel is not None:
                self._rclpy.spin_until_future_complete(self._node, cancel.cancel_goal_async(), timeout_sec=WAIT_S)
            raise RobotError(f"{name} did not end within {timeout_s:.1f} s; the goal was given up.")
        return future.result()


def main(argv: list[str]) -> int:
    """Look, plan, ask, pick up."""
    parser = argparse.ArgumentParser(description="Pick an object up over ROS 2.")
    parser.add_argument("object", help="name of an object, or its mesh file")
    parser.add_argument("--grasps", help="grasp file of the object by the robot's hand; without it grasps are made")
    parser.add_argument("--plan", default="plan.yaml", help="file for the plan (default: plan.yaml)")
    options = parser.parse_args(argv)
    try:
        import rclpy  # noqa: PLC0415
    except ImportError:
        print(NO_ROS, file=sys.stderr)
        return 2
    from neuralgrasps.apply.pick_up import carry_out, propose_pick  # noqa: PLC0415
    from neuralgrasps.export.pick_plan import save_pick_plan  # noqa: PLC0415
    from neuralgrasps.export.plan_origin import PlanOrigin  # noqa: PLC0415

    obj = ng.load_object(options.object)
    grasps = ng.load_grasps(options.grasps) if options.grasps else None
    rclpy.init()
    try:
        robot = RosRobot(rclpy.create_node("neuralgrasps_pick"), mount(load_arm(ARM), ng.load_hand(HAND)))
        proposal = propose_pick(robot, obj, grasps=grasps)
        if proposal.plan is None:
            print(f"no plan: {proposal.reason}", file=sys.stderr)
            return 1
        view, sighting, result = proposal.view, proposal.sighting, proposal.result
        origin = PlanOrigin(
            X_BO=proposal.X_BO,
            confidence=sighting.pose.confidence if sighting and sighting.pose else None,
            table_B=view.plane_B if view else None,
            seed=result.seed if result else None,
        )
        print(f"The plan is in {save_pick_plan(options.plan, proposal.plan, robot.manipulator, origin=origin)}.")
        if input("Is the robot's way free, and may it move? [y/N] ").strip().lower() != "y":
            return 1
        carry_out(robot, proposal.plan)
    except (RobotError, ng.NeuralGraspsError) as error:
        print(f"stopped: {error}", file=sys.stderr)
        return 1
    finally:
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
