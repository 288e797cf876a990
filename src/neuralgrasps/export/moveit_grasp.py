"""Grasps as `moveit_msgs/Grasp`, and back.

`grasp_pose` is the pose of the link before the hand (the "parent link" of the end effector), not of the hand, its
fingers or a tool point. The message has no field for that link's name: `pre_grasp_approach.direction`, a direction of
that link, carries it as its frame, and the files say it once more.

Source: https://docs.ros.org/en/jazzy/p/moveit_msgs/msg/Grasp.html (message definition).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export.bare_grasps import bare_grasps, check_exportable
from neuralgrasps.export.frames import Wrist, check_pose, hand_base, pose_fields, pose_of, xyz
from neuralgrasps.export.joint_trajectory import posture_trajectory, trajectory_point
from neuralgrasps.export.joints import HandJoints, hand_joints
from neuralgrasps.export.messages import Message, Ros, check_message, header
from neuralgrasps.export.yaml_files import read_yaml, write_yaml
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand

KIND = "moveit_msgs/Grasp"
FORMAT = "moveit_msgs/Grasp[]"
_KEYS = ("format", "ros", "hand", "object", "frame_id", "wrist_link", "grasps")


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspMessageConfig:
    """What goes into a `moveit_msgs/Grasp` beside the grasp itself.

    Attributes:
        approach_m: straight way to the grasp, along the hand's palm axis, metres; approach_min_m: the least of it.
        lift_m: straight way up after closing; lift_min_m: the least of it.
        retreat_m: straight way back after letting go; retreat_min_m: the least of it.
        up: upward direction in `up_frame`; up_frame: "" = the frame of the grasp poses.
        close_s, squeeze_s: time to close, and to press after that, seconds.
        force: share of the hand's effort limits, in [0, 1], that closing uses: `effort` of the grasp posture.
        max_contact_force: newtons; 0 = no limit.
        allowed_touch_objects: names of other objects that may be touched.
        joint_names: the robot's names of the hand's joints by ours; None: `joints.ROBOT_NAMES`.
        ros: 1 or 2.
    """

    approach_m: float = 0.10
    approach_min_m: float = 0.05
    lift_m: float = 0.20
    lift_min_m: float = 0.10
    retreat_m: float = 0.10
    retreat_min_m: float = 0.05
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    up_frame: str = ""
    close_s: float = 1.2
    squeeze_s: float = 0.3
    force: float = 1.0
    max_contact_force: float = 0.0
    allowed_touch_objects: tuple[str, ...] = ()
    joint_names: Mapping[str, str] | None = None
    ros: Ros = 2

    def __post_init__(self) -> None:
        for way in ("approach", "lift", "retreat"):
            least, most = getattr(self, f"{way}_min_m"), getattr(self, f"{way}_m")
            if not 0 <= least <= most < np.inf:
                raise InputError(f"{way}_min_m, {way}_m are {least}, {most}; expected 0 <= {way}_min_m <= {way}_m.")
        if not (0 < self.close_s < np.inf and 0 < self.squeeze_s < np.inf):
            raise InputError(f"close_s, squeeze_s are {self.close_s}, {self.squeeze_s}; expected positive seconds.")
        if not 0 <= self.force <= 1:
            raise InputError(f"force is {self.force}; expected a share of the effort limits, 0 to 1.")
        if not (np.isfinite(self.up).all() and np.linalg.norm(self.up) > 1e-9):
            raise InputError(f"up is {self.up}; expected a direction.")


def moveit_grasps(
    grasps: GraspSet,
    hand: Hand,
    *,
    frame_id: str,
    X_frame_O: np.ndarray,
    wrist: Wrist | None = None,
    names: Sequence[str] | None = None,
    config: GraspMessageConfig | None = None,
) -> list[Message]:
    """Grasps as `moveit_msgs/Grasp`, in the order given.

    The pre-grasp posture is `q_pregrasp`; the grasp posture has two points: `q`, where the fingers touch, then
    `q_squeeze`, where they press. All are clamped to the joint limits, beyond which a target that presses may lie; how
    hard it presses is said by `effort`, the share `config.force` of the effort limits. Joints that follow others are
    listed too. Quality is `epsilon`. Quaternions are x y z w.

    Args:
        frame_id: the frame of the poses; X_frame_O: (4, 4) the object in it, metres.
        wrist: the link that the poses are of, `wrist_of(manipulator)`; default the hand's own base link.
        names: N ids; default grasp_0, grasp_1, ...
    Raises:
        InputError: no grasps, a hand of another name, an empty frame, not a rigid pose, ids that are not unique.
        ShapeError: another number of joints than the hand has.
    """
    config, wrist = config or GraspMessageConfig(), wrist or hand_base(hand)
    ids = check_exportable(grasps, hand, names)
    if not frame_id:
        raise InputError("frame_id is empty; expected the name of the frame that X_frame_O places the object in.")
    X_frame_L = check_pose(X_frame_O, "X_frame_O") @ grasps.X_OH @ inverse_np(check_pose(wrist.X_LH, "X_LH"))
    joints = hand_joints(hand, names=config.joint_names)
    ways = _ways(hand, wrist, frame_id, config)
    messages = []
    for i, name in enumerate(ids):
        pose = {"header": header(frame_id, ros=config.ros), "pose": pose_fields(X_frame_L[i])}
        message = {
            "id": name,
            **_postures(grasps, i, joints, config),
            "grasp_pose": pose,
            "grasp_quality": float(grasps.epsilon[i]),
            **ways,
            "max_contact_force": float(config.max_contact_force),
            "allowed_touch_objects": list(config.allowed_touch_objects),
        }
        check_message(KIND, message, ros=config.ros, name=name)
        messages.append(message)
    return messages


def _postures(grasps: GraspSet, i: int, joints: HandJoints, config: GraspMessageConfig) -> Message:
    before = trajectory_point(joints.targets(grasps.q_pregrasp[i]), config.close_s, ros=config.ros)
    closed = [
        trajectory_point(joints.targets(q), t, effort=config.force * joints.effort, ros=config.ros)
        for q, t in ((grasps.q[i], config.close_s), (grasps.q_squeeze[i], config.close_s + config.squeeze_s))
    ]
    return {
        "pre_grasp_posture": posture_trajectory(joints.names, [before], ros=config.ros),
        "grasp_posture": posture_trajectory(joints.names, closed, ros=config.ros),
    }


def _ways(hand: Hand, wrist: Wrist, frame_id: str, config: GraspMessageConfig) -> Message:
    """Approach and retreat along the palm axis in the wrist link, and up in the world."""
    inward = wrist.X_LH[:3, :3] @ hand.X_HP[:3, 2]
    up = np.asarray(config.up, np.float64) / np.linalg.norm(config.up)
    ways = {
        "pre_grasp_approach": (wrist.link, inward, config.approach_m, config.approach_min_m),
        "post_grasp_retreat": (config.up_frame or frame_id, up, config.lift_m, config.lift_min_m),
        "post_place_retreat": (wrist.link, -inward, config.retreat_m, config.retreat_min_m),
    }
    return {
        name: {
            "direction": {"header": header(frame, ros=config.ros), "vector": xyz(direction)},
            "desired_distance": float(far),
            "min_distance": float(near),
        }
        for name, (frame, direction, far, near) in ways.items()
    }


def grasps_of(
    messages: Sequence[Mapping[str, Any]],
    hand: Hand,
    *,
    object_name: str,
    X_frame_O: np.ndarray,
    wrist: Wrist | None = None,
    joint_names: Mapping[str, str] | None = None,
) -> GraspSet:
    """The grasps of checked messages: poses, postures and qualities; contacts and verdicts are not in a message.

    `epsilon` is the messages' quality. A grasp posture of one point gives `q` and `q_squeeze` alike.

    Args:
        X_frame_O, wrist: as for `moveit_grasps`. joint_names: the robot's names of the hand's joints by ours.
    Raises:
        DataFormatError: other joints than the hand has, a posture without points, a quaternion of zero length.
    """
    wrist = wrist or hand_base(hand)
    X_OF = inverse_np(check_pose(X_frame_O, "X_frame_O"))
    joints = hand_joints(hand, names=joint_names)
    X_OH, q = [], []
    for message in messages:
        try:
            X_OH.append(X_OF @ pose_of(message["grasp_pose"]["pose"]) @ wrist.X_LH)
        except InputError as error:
            raise DataFormatError(f"grasp {message['id']}: {error}") from error
        before = _joints_at(message, "pre_grasp_posture", -1, joints)
        q.append(
            (before, _joints_at(message, "grasp_posture", 0, joints), _joints_at(message, "grasp_posture", -1, joints))
        )
    postures = np.array(q, np.float64).reshape(len(q), 3, hand.num_dofs)
    return bare_grasps(
        hand,
        object_name,
        X_OH=np.array(X_OH, np.float64).reshape(-1, 4, 4),
        q_pregrasp=postures[:, 0],
        q=postures[:, 1],
        q_squeeze=postures[:, 2],
        quality=np.array([m["grasp_quality"] for m in messages], np.float64),
        source=KIND,
    )


def _joints_at(message: Mapping[str, Any], field: str, point: int, joints: HandJoints) -> np.ndarray:
    """(J,) independent joints at one point of a posture."""
    posture, where = message[field], f"grasp {message['id']}: {field}"
    if not posture["points"]:
        raise DataFormatError(f"{where} has no points; expected the posture of the hand.")
    positions = posture["points"][point]["positions"]
    if len(positions) != len(posture["joint_names"]):
        raise DataFormatError(f"{where} has {len(positions)} positions for {len(posture['joint_names'])} joints.")
    return joints.q(dict(zip(posture["joint_names"], positions, strict=True)), where=where)


def save_moveit_grasps(
    path: str | os.PathLike[str],
    grasps: GraspSet,
    hand: Hand,
    *,
    frame_id: str,
    X_frame_O: np.ndarray,
    wrist: Wrist | None = None,
    names: Sequence[str] | None = None,
    config: GraspMessageConfig | None = None,
) -> Path:
    """Write `moveit_grasps(...)` as YAML, with the names of hand, object and wrist link; equal grasps, equal bytes.

    Raises:
        StorageError: it cannot be written. InputError, ShapeError: as `moveit_grasps`.
    """
    config, wrist = config or GraspMessageConfig(), wrist or hand_base(hand)
    messages = moveit_grasps(
        grasps, hand, frame_id=frame_id, X_frame_O=X_frame_O, wrist=wrist, names=names, config=config
    )
    data = {
        "format": FORMAT,
        "ros": config.ros,
        "hand": hand.name,
        "object": grasps.object,
        "frame_id": frame_id,
        "wrist_link": wrist.link,
        "grasps": messages,
    }
    comment = f"{len(messages)} x {KIND}: grasp_pose is the pose of link '{wrist.link}' in frame '{frame_id}'"
    return write_yaml(path, data, comment=comment)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspMessages:
    """A file of `moveit_msgs/Grasp`.

    Attributes:
        hand, object: names. frame_id: of the poses. wrist_link: the link that they are of.
        messages: the messages, every field checked. ros: 1 or 2.
    """

    hand: str
    object: str
    frame_id: str
    wrist_link: str
    messages: tuple[Message, ...]
    ros: Ros


def load_moveit_grasps(path: str | os.PathLike[str]) -> GraspMessages:
    """Read a file of `save_moveit_grasps`; `grasps_of(messages, ...)` makes grasps of it.

    Raises:
        InputError: the file cannot be read. DataFormatError: it is no such file, or a field of a message does not fit.
    """
    data = read_yaml(path)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        got = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise DataFormatError(f"'{path}' holds {got!r}; expected format {FORMAT!r}.")
    if missing := [k for k in _KEYS if k not in data]:
        raise DataFormatError(f"'{path}' lacks {', '.join(missing)}; expected {', '.join(_KEYS)}.")
    ros = data["ros"]
    if ros not in (1, 2):
        raise DataFormatError(f"'{path}': ros is {ros!r}; expected 1 or 2.")
    check_message(FORMAT, data["grasps"], ros=ros, name=f"'{path}': grasps")
    text = {k: data[k] for k in ("hand", "object", "frame_id", "wrist_link")}
    if wrong := [k for k, v in text.items() if not isinstance(v, str)]:
        raise DataFormatError(f"'{path}': {', '.join(wrong)} should be text.")
    return GraspMessages(**text, messages=tuple(data["grasps"]), ros=ros)
