"""What a driver of a real robot exchanges with ROS: goals for its controllers, and readings of its sensors.

Nothing here needs ROS: goals are plain dicts, readings take any object with the fields of the message.

Source: https://docs.ros.org/en/jazzy/p/control_msgs/, https://docs.ros.org/en/jazzy/p/sensor_msgs/ (definitions).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError
from neuralgrasps.export.joint_trajectory import joint_trajectory, posture_trajectory, trajectory_point
from neuralgrasps.export.joints import hand_joints
from neuralgrasps.export.messages import Message, check_message, clock, header
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast

FOLLOW_KIND = "control_msgs/FollowJointTrajectory_Goal"
GRIPPER_KIND = "control_msgs/GripperCommand_Goal"
_DEPTHS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}  # numbers, metres per unit


def follow_goal(
    trajectory: Trajectory,
    *,
    tolerance: float | None = None,
    late_s: float = 1.0,
    names: Mapping[str, str] | None = None,
) -> Message:
    """A goal of the action `control_msgs/FollowJointTrajectory` (ROS 2) that moves the arm.

    Args:
        tolerance: largest distance of each joint from the end, rad or metres; None: the controller's own.
        late_s: how much later than planned the end may be reached.
        names: the robot's names of joints by ours, where they differ.
    Raises:
        InputError: as `joint_trajectory`; a tolerance that is not positive.
    """
    return _goal(joint_trajectory(trajectory, names=names), tolerance, late_s)


def hand_goal(
    hand: Hand, q: np.ndarray, *, duration_s: float, force: float = 1.0, names: Mapping[str, str] | None = None
) -> Message:
    """A goal of `control_msgs/FollowJointTrajectory` that moves the joints of a hand of many fingers.

    Only independent joints are listed: those that follow have no controller.

    Args:
        q: (J,) where to; clamped to the joint limits. duration_s: when.
        force: share of the effort limits, in the point's `effort`, for controllers that heed it.
        names: the robot's names of the hand's joints by ours.
    Raises:
        ShapeError: another number of joints. InputError: a share outside 0..1, or as `hand_joints`.
    """
    joints = hand_joints(hand, names=names)
    own = joints.dofs
    point = trajectory_point(joints.targets(q)[own], duration_s, effort=_share(force) * joints.effort[own])
    return _goal(posture_trajectory([joints.names[k] for k in own], [point]), None, duration_s)


def gripper_goal(hand: Hand, q: np.ndarray, *, force: float = 1.0, scale: float = 1.0) -> Message:
    """A goal of the action `control_msgs/GripperCommand` for a hand of one joint.

    Args:
        q: (1,) travel of a finger, metres; clamped to its limits, as a target that presses lies beyond them.
        force: share of the effort limit; `max_effort` is so much of it.
        scale: position per travel: 1 for controllers that take a finger's travel, 2 for those that take the opening.
    Raises:
        InputError: a hand of more joints, a share outside 0..1. ShapeError: another number of joints in `q`.
    """
    hand.check_q(np.asarray(q))
    if hand.num_dofs != 1:
        raise InputError(f"hand '{hand.name}' has {hand.num_dofs} joints; a gripper command moves one: use hand_goal.")
    position = float(np.clip(q, hand.tree.lower, hand.tree.upper)[0])
    command = {"position": position * scale, "max_effort": _share(force) * float(hand.tree.effort[0])}
    goal = {"command": command}
    check_message(GRIPPER_KIND, goal)
    return goal


def _goal(trajectory: Message, tolerance: float | None, late_s: float) -> Message:
    if tolerance is not None and not 0 < tolerance < np.inf:
        raise InputError(f"tolerance is {tolerance}; expected a positive number.")
    ends = [] if tolerance is None else trajectory["joint_names"]
    goal = {
        "trajectory": trajectory,
        "multi_dof_trajectory": {"header": header(), "joint_names": [], "points": []},
        "path_tolerance": [],
        "component_path_tolerance": [],
        "goal_tolerance": [
            {"name": n, "position": float(tolerance or 0.0), "velocity": 0.0, "acceleration": 0.0} for n in ends
        ],
        "component_goal_tolerance": [],
        "goal_time_tolerance": clock(late_s),
    }
    check_message(FOLLOW_KIND, goal)
    return goal


def _share(force: float) -> float:
    if not 0 <= force <= 1:
        raise InputError(f"force is {force}; expected a share of the effort limit, 0 to 1.")
    return float(force)


def read_positions(joint_state: Any, names: Sequence[str]) -> np.ndarray:
    """Positions (K,) of the named joints from a `sensor_msgs/JointState`, rad or metres.

    Raises:
        InputError: a joint is not in it, or is not measured as a finite number.
    """
    found = dict(zip(joint_state.name, joint_state.position, strict=False))
    if missing := [n for n in names if n not in found]:
        raise InputError(f"the joint state lacks {', '.join(missing)}; it has {', '.join(found)}.")
    positions = np.array([found[n] for n in names], np.float64)
    if not np.isfinite(positions).all():
        raise InputError(f"the joint state has positions that are not finite: {positions.tolist()}.")
    return positions


def read_hand(hand: Hand, joint_state: Any, *, names: Mapping[str, str] | None = None) -> np.ndarray:
    """Independent joints (J,) of a hand from a `sensor_msgs/JointState`; joints that follow are not looked at.

    Raises:
        InputError: as `read_positions` and `hand_joints`.
    """
    joints = hand_joints(hand, names=names)
    own = [joints.names[k] for k in joints.dofs]
    return joints.q(dict(zip(own, read_positions(joint_state, own), strict=True)), where="the joint state")


def read_robot(
    manipulator: Manipulator, joint_state: Any, *, hand_names: Mapping[str, str] | None = None
) -> np.ndarray:
    """All joints (Q,) of a manipulator, also those of its head, from a `sensor_msgs/JointState`.

    Raises:
        InputError: as `read_positions` and `hand_joints`.
    """
    arm = read_positions(joint_state, manipulator.arm.tree.dof_names)
    return np.concatenate([arm, read_hand(manipulator.hand, joint_state, names=hand_names)])


def camera_in_base(manipulator: Manipulator, q: np.ndarray) -> np.ndarray:
    """X_BC (4, 4) of the arm's camera for all measured joints `q` (Q,), where its head looks elsewhere than at home.

    Raises:
        InputError: the arm has no camera.
    """
    camera = manipulator.arm.camera
    if camera is None:
        raise InputError(f"arm '{manipulator.arm.name}' has no camera; state one in its arm.toml.")
    return np.asarray(forward_fast(manipulator.tree, q)[camera.link] @ camera.X_LC)


def read_depth(image: Any) -> np.ndarray:
    """(h, w) z-depth in metres, 0 where nothing was measured, from a `sensor_msgs/Image`: 16UC1 (mm) or 32FC1 (m).

    Raises:
        InputError: another encoding, or fewer bytes than rows of `step` bytes need.
    """
    if image.encoding not in _DEPTHS:
        raise InputError(f"the depth image is encoded as '{image.encoding}'; expected {', '.join(_DEPTHS)}.")
    kind, metres = _DEPTHS[image.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if image.is_bigendian else "<")
    data = np.frombuffer(bytes(image.data), np.uint8)
    width = image.width * dtype.itemsize
    if image.step < width or len(data) < image.height * image.step:
        raise InputError(
            f"the depth image has {len(data)} bytes in rows of {image.step}; expected {image.height} rows of at least "
            f"{width}."
        )
    rows = np.ascontiguousarray(data[: image.height * image.step].reshape(image.height, image.step)[:, :width])
    depth = rows.view(dtype).astype(np.float64) * metres
    depth[~np.isfinite(depth)] = 0.0
    return depth


def read_intrinsics(info: Any) -> Intrinsics:
    """The camera of a rectified image from its `sensor_msgs/CameraInfo` (ROS 2 field names).

    Its projection matrix `p` is that of the rectified image; where it is zero, `k` is taken.

    Raises:
        InputError: neither holds a focal length.
    """
    p, k = np.reshape(info.p, (3, 4)), np.reshape(info.k, (3, 3))
    matrix = p if p[0, 0] > 0 else k
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise InputError("the camera info has no focal length in p or k; calibrate the camera.")
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    return Intrinsics(fx, fy, cx, cy, int(info.width), int(info.height))
