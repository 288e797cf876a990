"""Motions of an arm as `trajectory_msgs/JointTrajectory`, and back.

Points carry positions and velocities and no accelerations: controllers then follow the cubic through both, which is
what a `Trajectory` is. Times are rounded to the nanosecond, numbers are written in full.

Source: https://docs.ros.org/en/jazzy/p/trajectory_msgs/ (message definitions).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import DataFormatError, InputError, check_shape
from neuralgrasps.export.messages import Message, Ros, check_message, clock, header, seconds_of
from neuralgrasps.export.yaml_files import read_yaml, write_yaml

KIND = "trajectory_msgs/JointTrajectory"


def trajectory_point(
    positions: np.ndarray,
    time_s: float,
    *,
    velocities: np.ndarray | None = None,
    effort: np.ndarray | None = None,
    ros: Ros = 2,
) -> Message:
    """One `JointTrajectoryPoint`: positions (D,), and velocities and effort (D,) where they are known."""
    count = (len(positions),)
    lists = {"positions": positions, "velocities": velocities, "accelerations": None, "effort": effort}
    point: Message = {}
    for name, values in lists.items():
        if values is not None:
            check_shape(name, np.shape(values), count)
        point[name] = [] if values is None else np.asarray(values, np.float64).tolist()
    return {**point, "time_from_start": clock(time_s, ros=ros)}


def joint_trajectory(
    trajectory: Trajectory, *, frame_id: str = "", names: Mapping[str, str] | None = None, ros: Ros = 2
) -> Message:
    """A motion as `trajectory_msgs/JointTrajectory`.

    Args:
        frame_id: of the header; joint motions need none.
        names: the robot's names of joints by ours, where they differ.
        ros: 2, or 1 for its names of times (secs, nsecs) and its header (seq).
    Raises:
        InputError: positions or speeds that are not finite, samples less than a nanosecond apart, or two joints of one
            name.
    """
    joints = [(names or {}).get(n, n) for n in trajectory.joint_names]
    if len(set(joints)) < len(joints):
        raise InputError(f"two joints of the trajectory would have one name: {', '.join(joints)}.")
    points = [
        trajectory_point(q, float(t), velocities=qd, ros=ros)
        for t, q, qd in zip(trajectory.t, trajectory.q, trajectory.qd, strict=True)
    ]
    times = np.array([seconds_of(p["time_from_start"]) for p in points])
    if not (np.diff(times) > 0).all():
        raise InputError("samples of the trajectory are less than a nanosecond apart; sample it more coarsely.")
    message = {"header": header(frame_id, ros=ros), "joint_names": joints, "points": points}
    check_message(KIND, message, ros=ros)
    return message


def posture_trajectory(
    joint_names: Sequence[str],
    points: Sequence[Message],
    *,
    frame_id: str = "",
    ros: Ros = 2,
) -> Message:
    """A `JointTrajectory` of points made with `trajectory_point`: where a hand should be, and when."""
    message = {"header": header(frame_id, ros=ros), "joint_names": list(joint_names), "points": list(points)}
    check_message(KIND, message, ros=ros)
    return message


def trajectory_of(
    message: Mapping[str, Any], *, joint_names: Sequence[str] | None = None, where: str = KIND
) -> Trajectory:
    """The motion that a `JointTrajectory` of either ROS describes.

    Args:
        joint_names: D names in the order wanted; default the message's own.
        where: what the message is called in messages.
    Raises:
        DataFormatError: not such a message; other joints than `joint_names`; points without velocities, with another
            number of joints, not from time 0, or whose times do not rise.
    """
    check_message(KIND, message, ros=ros_of(message), name=where)
    own: list[str] = message["joint_names"]
    wanted = own if joint_names is None else list(joint_names)
    if len(set(own)) < len(own) or sorted(own) != sorted(wanted):
        raise DataFormatError(
            f"{where} moves {', '.join(own) or 'no joints'}; expected {', '.join(wanted)}, once each."
        )
    points = message["points"]
    for i, point in enumerate(points):
        for field in ("positions", "velocities"):
            if len(point[field]) != len(own):
                raise DataFormatError(
                    f"{where}.points[{i}].{field} has {len(point[field])} numbers for {len(own)} joints; expected one "
                    "each."
                )
    t = np.array([seconds_of(p["time_from_start"]) for p in points])
    if len(t) < 2 or t[0] != 0.0 or not (np.diff(t) > 0).all():
        raise DataFormatError(f"{where} has {len(t)} points; expected two or more, the first at time 0, then rising.")
    order = [own.index(n) for n in wanted]
    return Trajectory(
        joint_names=tuple(wanted),
        t=t,
        q=np.array([p["positions"] for p in points], np.float64)[:, order],
        qd=np.array([p["velocities"] for p in points], np.float64)[:, order],
    )


def ros_of(message: Any) -> Ros:
    """The version of ROS whose header a message has; 2 where it has none."""
    head = message.get("header") if isinstance(message, Mapping) else None
    return 1 if isinstance(head, Mapping) and "seq" in head else 2


def save_trajectory(
    path: str | os.PathLike[str],
    trajectory: Trajectory,
    *,
    frame_id: str = "",
    names: Mapping[str, str] | None = None,
    ros: Ros = 2,
) -> Path:
    """Write `joint_trajectory(...)` as YAML; equal motions, equal bytes. Returns the path.

    Raises:
        StorageError: it cannot be written. InputError: as `joint_trajectory`.
    """
    message = joint_trajectory(trajectory, frame_id=frame_id, names=names, ros=ros)
    return write_yaml(path, message, comment=f"{KIND} (ROS {ros}), {trajectory.duration_s:.3f} s")


def load_trajectory(path: str | os.PathLike[str], *, joint_names: Sequence[str] | None = None) -> Trajectory:
    """Read a motion that `save_trajectory`, or another program, wrote.

    Raises:
        InputError: the file cannot be read. DataFormatError: as `trajectory_of`.
    """
    return trajectory_of(read_yaml(path), joint_names=joint_names, where=f"'{path}'")
