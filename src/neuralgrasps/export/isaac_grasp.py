"""Grasp files of Isaac ("isaac_grasp", version 1.0): written, and read back.

A grasp is the pose of the gripper frame in the object frame, metres and a quaternion (w, then xyz), and the gripper's
moved joints closed and before closing. The gripper frame is our hand base H, the object frame that of the mesh, O.
Joints that follow others are not listed.

Source: https://nvidia-isaac-ros.github.io/concepts/manipulation/isaac_grasp.html (the published format). Older files
say `object_frame_link` and `gripper_frame_link`
(https://docs.isaacsim.omniverse.nvidia.com/latest/robot_simulation/grasp_editor.html); both are read.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.errors import DataFormatError
from neuralgrasps.export.bare_grasps import bare_grasps, check_exportable
from neuralgrasps.export.frames import quaternion_xyzw
from neuralgrasps.export.joints import HandJoints, hand_joints
from neuralgrasps.export.yaml_files import read_yaml, write_yaml
from neuralgrasps.geometry.se3_numpy import make_transform_np, quaternion_matrix
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand

FORMAT = "isaac_grasp"
VERSION = 1.0
_FIELDS = ("confidence", "position", "orientation", "cspace_position", "pregrasp_cspace_position")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IsaacGrasps:
    """What an isaac_grasp file holds.

    Attributes:
        grasps: N grasps; `epsilon` is the file's confidence, `q_squeeze` is `q`.
        names: N names. object_frame, gripper_frame: what the writer called them; not to be relied on.
    """

    grasps: GraspSet
    names: tuple[str, ...]
    object_frame: str
    gripper_frame: str


def isaac_grasps(
    grasps: GraspSet,
    hand: Hand,
    *,
    object_frame: str | None = None,
    gripper_frame: str | None = None,
    names: Sequence[str] | None = None,
    squeezed: bool = False,
    joint_names: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Grasps as the contents of an isaac_grasp file.

    Args:
        object_frame: what the file calls the object's frame; default its name. gripper_frame: that of the hand base;
            default the hand's base link.
        names: N names; default grasp_0, grasp_1, ...
        squeezed: closed joints are `q_squeeze`, the targets that press, not `q`, where the fingers touch. Both are
            clamped to the joint limits.
        joint_names: the robot's names of the hand's joints by ours; None: `joints.ROBOT_NAMES`.
    Returns:
        the dict that YAML holds. Confidence is `epsilon`, at most 1.
    Raises:
        InputError: no grasps, a hand of another name, names that are not unique.
        ShapeError: another number of joints than the hand has.
    """
    ids = check_exportable(grasps, hand, names)
    joints = hand_joints(hand, names=joint_names)
    closed = grasps.q_squeeze if squeezed else grasps.q
    entries: dict[str, Any] = {}
    for i, name in enumerate(ids):
        x, y, z, w = quaternion_xyzw(grasps.X_OH[i])
        entries[name] = {
            "confidence": float(np.clip(grasps.epsilon[i], 0.0, 1.0)),
            "position": grasps.X_OH[i, :3, 3].tolist(),
            "orientation": {"w": w, "xyz": [x, y, z]},
            "cspace_position": _moved(joints, closed[i]),
            "pregrasp_cspace_position": _moved(joints, grasps.q_pregrasp[i]),
        }
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "object_frame": object_frame or grasps.object,
        "gripper_frame": gripper_frame or hand.tree.link_names[0],
        "grasps": entries,
    }


def _moved(joints: HandJoints, q: np.ndarray) -> dict[str, float]:
    positions = joints.targets(q)
    return {joints.names[k]: float(positions[k]) for k in joints.dofs}


def save_isaac_grasps(
    path: str | os.PathLike[str],
    grasps: GraspSet,
    hand: Hand,
    *,
    object_frame: str | None = None,
    gripper_frame: str | None = None,
    names: Sequence[str] | None = None,
    squeezed: bool = False,
    joint_names: Mapping[str, str] | None = None,
) -> Path:
    """Write `isaac_grasps(...)` as YAML; equal grasps, equal bytes. Returns the path.

    Raises:
        StorageError: it cannot be written. InputError, ShapeError: as `isaac_grasps`.
    """
    data = isaac_grasps(
        grasps,
        hand,
        object_frame=object_frame,
        gripper_frame=gripper_frame,
        names=names,
        squeezed=squeezed,
        joint_names=joint_names,
    )
    comment = (
        f"{len(grasps)} grasps of '{grasps.object}' by '{grasps.hand}'; metres, radians; the gripper in the object"
    )
    return write_yaml(path, data, comment=comment)


def load_isaac_grasps(
    path: str | os.PathLike[str], hand: Hand, *, object_name: str, joint_names: Mapping[str, str] | None = None
) -> IsaacGrasps:
    """Read an isaac_grasp file whose gripper frame is the base of `hand` and whose object frame is the mesh's.

    The file does not say whether they are: that is for the caller to know.

    Raises:
        InputError: the file cannot be read.
        DataFormatError: not an isaac_grasp file of version 1.0, a field is missing or wrong, other joints than the
            hand's.
    """
    data = read_yaml(path)
    _check_file(data, path)
    joints = hand_joints(hand, names=joint_names)
    names = tuple(data["grasps"])
    entries = [_Entry.read(data["grasps"][n], f"'{path}': grasps.{n}", joints) for n in names]
    q = np.array([e.q for e in entries]).reshape(-1, hand.num_dofs)
    grasps = bare_grasps(
        hand,
        object_name,
        X_OH=np.array([e.X_OH for e in entries]).reshape(-1, 4, 4),
        q_pregrasp=np.array([e.q_pregrasp for e in entries]).reshape(-1, hand.num_dofs),
        q=q,
        q_squeeze=q,
        quality=np.array([e.confidence for e in entries]),
        source=FORMAT,
    )
    frames = {k: data.get(k, data.get(f"{k}_link", "")) for k in ("object_frame", "gripper_frame")}
    return IsaacGrasps(grasps=grasps, names=tuple(map(str, names)), **{k: str(v) for k, v in frames.items()})


def _check_file(data: Any, path: str | os.PathLike[str]) -> None:
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        got = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise DataFormatError(f"'{path}' holds {got!r}; expected format {FORMAT!r}.")
    if str(data.get("format_version")) != str(VERSION):
        raise DataFormatError(f"'{path}' has format_version {data.get('format_version')!r}; expected {VERSION}.")
    if not isinstance(data.get("grasps"), dict):
        raise DataFormatError(f"'{path}' lacks 'grasps'; expected grasps by their names.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Entry:
    """One grasp of a file: hand base in the object frame, joints closed and before closing (J,)."""

    confidence: float
    X_OH: np.ndarray
    q: np.ndarray
    q_pregrasp: np.ndarray

    @classmethod
    def read(cls, entry: Any, where: str, joints: HandJoints) -> _Entry:
        if not isinstance(entry, dict):
            raise DataFormatError(f"{where} is {entry!r:.40}; expected {', '.join(_FIELDS)}.")
        if missing := [f for f in _FIELDS if f not in entry]:
            raise DataFormatError(f"{where} lacks {', '.join(missing)}; expected {', '.join(_FIELDS)}.")
        turn = entry["orientation"]
        if not isinstance(turn, dict) or not {"w", "xyz"} <= set(turn):
            raise DataFormatError(f"{where}.orientation is {turn!r:.60}; expected w and xyz.")
        quaternion = [_number(turn["w"], f"{where}.orientation.w"), *_three(turn["xyz"], f"{where}.orientation.xyz")]
        if not math.isclose(float(np.linalg.norm(quaternion)), 1.0, abs_tol=0.01):
            raise DataFormatError(f"{where}.orientation {quaternion} has not length 1; expected w, then x y z.")
        confidence = _number(entry["confidence"], f"{where}.confidence")
        if not 0.0 <= confidence <= 1.0:
            raise DataFormatError(f"{where}.confidence is {confidence}; expected 0 to 1.")
        return cls(
            confidence=confidence,
            X_OH=make_transform_np(quaternion_matrix(quaternion), _three(entry["position"], f"{where}.position")),
            q=_posture(entry["cspace_position"], f"{where}.cspace_position", joints),
            q_pregrasp=_posture(entry["pregrasp_cspace_position"], f"{where}.pregrasp_cspace_position", joints),
        )


def _posture(values: Any, where: str, joints: HandJoints) -> np.ndarray:
    if not isinstance(values, dict):
        raise DataFormatError(f"{where} is {values!r:.40}; expected positions by the names of joints.")
    return joints.q({str(k): _number(v, f"{where}.{k}") for k, v in values.items()}, where=where)


def _three(values: Any, where: str) -> list[float]:
    if not isinstance(values, list) or len(values) != 3:
        raise DataFormatError(f"{where} is {values!r:.60}; expected three numbers.")
    return [_number(v, where) for v in values]


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise DataFormatError(f"{where} is {value!r:.40}; expected a finite number.")
    return float(value)
