"""The fields of the ROS messages that we write and read, and a check of data against them.

A message is a plain dict of its fields, nested as the .msg files nest: what YAML holds, what ROS 2 sets on a message
with `rosidl_runtime_py.set_message_fields`.

Source: the public definitions of std_msgs, geometry_msgs, trajectory_msgs, control_msgs and moveit_msgs,
https://docs.ros.org/en/jazzy/ (names and types only, written down as a table); ROS 1: as of Noetic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from neuralgrasps.errors import DataFormatError, InputError, unknown_name

Ros = Literal[1, 2]
Message = dict[str, Any]

NANO = 1_000_000_000
_STAMPED = {"header": "std_msgs/Header"}
_XYZ = {"x": "float64", "y": "float64", "z": "float64"}
_CLOCK = {"sec": "int32", "nanosec": "uint32"}
_TOLERANCE = {"position": "float64", "velocity": "float64", "acceleration": "float64"}

MESSAGES: Mapping[str, Mapping[str, str]] = {
    "builtin_interfaces/Time": _CLOCK,
    "builtin_interfaces/Duration": _CLOCK,
    "std_msgs/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Vector3": _XYZ,
    "geometry_msgs/Quaternion": {**_XYZ, "w": "float64"},
    "geometry_msgs/Pose": {"position": "geometry_msgs/Point", "orientation": "geometry_msgs/Quaternion"},
    "geometry_msgs/PoseStamped": {**_STAMPED, "pose": "geometry_msgs/Pose"},
    "geometry_msgs/Vector3Stamped": {**_STAMPED, "vector": "geometry_msgs/Vector3"},
    "geometry_msgs/Transform": {"translation": "geometry_msgs/Vector3", "rotation": "geometry_msgs/Quaternion"},
    "geometry_msgs/Twist": {"linear": "geometry_msgs/Vector3", "angular": "geometry_msgs/Vector3"},
    "trajectory_msgs/JointTrajectoryPoint": {
        "positions": "float64[]",
        "velocities": "float64[]",
        "accelerations": "float64[]",
        "effort": "float64[]",
        "time_from_start": "builtin_interfaces/Duration",
    },
    "trajectory_msgs/JointTrajectory": {
        **_STAMPED,
        "joint_names": "string[]",
        "points": "trajectory_msgs/JointTrajectoryPoint[]",
    },
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": {
        "transforms": "geometry_msgs/Transform[]",
        "velocities": "geometry_msgs/Twist[]",
        "accelerations": "geometry_msgs/Twist[]",
        "time_from_start": "builtin_interfaces/Duration",
    },
    "trajectory_msgs/MultiDOFJointTrajectory": {
        **_STAMPED,
        "joint_names": "string[]",
        "points": "trajectory_msgs/MultiDOFJointTrajectoryPoint[]",
    },
    "control_msgs/JointTolerance": {"name": "string", **_TOLERANCE},
    "control_msgs/JointComponentTolerance": {"joint_name": "string", "component": "uint16", **_TOLERANCE},
    "control_msgs/FollowJointTrajectory_Goal": {
        "trajectory": "trajectory_msgs/JointTrajectory",
        "multi_dof_trajectory": "trajectory_msgs/MultiDOFJointTrajectory",
        "path_tolerance": "control_msgs/JointTolerance[]",
        "component_path_tolerance": "control_msgs/JointComponentTolerance[]",
        "goal_tolerance": "control_msgs/JointTolerance[]",
        "component_goal_tolerance": "control_msgs/JointComponentTolerance[]",
        "goal_time_tolerance": "builtin_interfaces/Duration",
    },
    "control_msgs/GripperCommand": {"position": "float64", "max_effort": "float64"},
    "control_msgs/GripperCommand_Goal": {"command": "control_msgs/GripperCommand"},
    "moveit_msgs/GripperTranslation": {
        "direction": "geometry_msgs/Vector3Stamped",
        "desired_distance": "float32",
        "min_distance": "float32",
    },
    "moveit_msgs/Grasp": {
        "id": "string",
        "pre_grasp_posture": "trajectory_msgs/JointTrajectory",
        "grasp_posture": "trajectory_msgs/JointTrajectory",
        "grasp_pose": "geometry_msgs/PoseStamped",
        "grasp_quality": "float64",
        "pre_grasp_approach": "moveit_msgs/GripperTranslation",
        "post_grasp_retreat": "moveit_msgs/GripperTranslation",
        "post_place_retreat": "moveit_msgs/GripperTranslation",
        "max_contact_force": "float32",
        "allowed_touch_objects": "string[]",
    },
}

# What differs in ROS 1.
MESSAGES_ROS1: Mapping[str, Mapping[str, str]] = {
    **MESSAGES,
    "builtin_interfaces/Time": {"secs": "uint32", "nsecs": "uint32"},
    "builtin_interfaces/Duration": {"secs": "int32", "nsecs": "int32"},
    "std_msgs/Header": {"seq": "uint32", "stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "control_msgs/FollowJointTrajectory_Goal": {
        "trajectory": "trajectory_msgs/JointTrajectory",
        "path_tolerance": "control_msgs/JointTolerance[]",
        "goal_tolerance": "control_msgs/JointTolerance[]",
        "goal_time_tolerance": "builtin_interfaces/Duration",
    },
}

_INTEGERS = {"int32": (-(2**31), 2**31 - 1), "uint16": (0, 2**16 - 1), "uint32": (0, 2**32 - 1)}
_FLOATS = {"float32": float(np.finfo(np.float32).max), "float64": math.inf}


def message_table(ros: Ros = 2) -> Mapping[str, Mapping[str, str]]:
    """Fields and their types of every message we know, by "package/Name", for a version of ROS.

    Raises:
        InputError: neither 1 nor 2.
    """
    if ros not in (1, 2):
        raise InputError(f"ros is {ros!r}; expected 1 or 2.")
    return MESSAGES if ros == 2 else MESSAGES_ROS1


def check_message(kind: str, data: Any, *, ros: Ros = 2, name: str = "") -> None:
    """Say which field of a message is missing, unknown or of a wrong type; say nothing when all is right.

    Every field must be there: a message that ROS reads back has them all. Numbers must be finite.

    Args:
        kind: "package/Name", such as "moveit_msgs/Grasp"; with "[]" a list of them.
        data: the message as a dict. name: what it is called in messages; default its kind.
    Raises:
        DataFormatError: the first field that does not fit, by its path. UnknownNameError: no such kind.
    """
    table = message_table(ros)
    if kind.removesuffix("[]") not in table:
        raise unknown_name("message", kind, table)
    _check(table, kind, data, name or kind)


def _check(table: Mapping[str, Mapping[str, str]], kind: str, data: Any, where: str) -> None:
    if kind.endswith("[]"):
        if not isinstance(data, list | tuple):
            raise DataFormatError(f"{where} is {_word(data)}; expected a list: {kind}.")
        for i, value in enumerate(data):
            _check(table, kind[:-2], value, f"{where}[{i}]")
    elif kind in table:
        _check_fields(table, kind, data, where)
    elif kind == "string":
        if not isinstance(data, str):
            raise DataFormatError(f"{where} is {_word(data)}; expected text.")
    else:
        _check_number(kind, data, where)


def _check_fields(table: Mapping[str, Mapping[str, str]], kind: str, data: Any, where: str) -> None:
    fields = table[kind]
    if not isinstance(data, Mapping):
        raise DataFormatError(f"{where} is {_word(data)}; expected the fields of {kind}: {', '.join(fields)}.")
    if missing := [f for f in fields if f not in data]:
        raise DataFormatError(f"{where} lacks {', '.join(missing)}; {kind} has {', '.join(fields)}.")
    if extra := [str(f) for f in data if f not in fields]:
        raise DataFormatError(f"{where} has {', '.join(extra)}, which {kind} has not; it has {', '.join(fields)}.")
    for field, inner in fields.items():
        _check(table, inner, data[field], f"{where}.{field}")


def _check_number(kind: str, data: Any, where: str) -> None:
    if kind in _INTEGERS:
        low, high = _INTEGERS[kind]
        if isinstance(data, bool) or not isinstance(data, int) or not low <= data <= high:
            raise DataFormatError(f"{where} is {_word(data)}; expected a whole number {low}..{high} ({kind}).")
        return
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise DataFormatError(f"{where} is {_word(data)}; expected a number ({kind}).")
    if not math.isfinite(data) or abs(data) > _FLOATS[kind]:
        raise DataFormatError(f"{where} is {data}; expected a finite number ({kind}).")


def _word(data: Any) -> str:
    """What a wrong value is, short enough for a message."""
    if data is None:
        return "empty"
    if isinstance(data, Mapping):
        return "a set of fields"
    if isinstance(data, list | tuple):
        return f"a list of {len(data)}"
    text = repr(data)
    return text if len(text) <= 40 else f"{text[:37]}..."


def clock(seconds: float, *, ros: Ros = 2) -> Message:
    """A time or duration to the nanosecond.

    Raises:
        InputError: negative, not finite, or beyond 68 years.
    """
    message_table(ros)
    if not (math.isfinite(seconds) and 0 <= seconds < 2**31 - 1):
        raise InputError(f"a time of {seconds} s cannot be written; expected 0 to 2^31 s.")
    whole, rest = divmod(round(seconds * NANO), NANO)
    return {"sec": whole, "nanosec": rest} if ros == 2 else {"secs": whole, "nsecs": rest}


def seconds_of(data: Mapping[str, int]) -> float:
    """Seconds of a time or duration of either version of ROS."""
    if "sec" in data:
        return float(data["sec"] + data["nanosec"] / NANO)
    return float(data["secs"] + data["nsecs"] / NANO)


def header(frame_id: str = "", *, ros: Ros = 2) -> Message:
    """A header without a time: what it stamps may be used at any time."""
    first: Message = {} if ros == 2 else {"seq": 0}
    return {**first, "stamp": clock(0.0, ros=ros), "frame_id": frame_id}
