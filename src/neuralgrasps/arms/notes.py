"""What an `arm.toml` says about an arm: flange, mounting face, camera, and the use and limits of each joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.kinematics.notes_table import FRAME_KEYS, NotesTable

_TOP_KEYS = ("name", "licence", "provenance", "base", "flange", "table_height", "face", "camera", "joints")
_CAMERA_KEYS = ("link", *FRAME_KEYS, "fov_y", "width", "height")
_JOINT_KEYS = ("planned", "home", "velocity", "acceleration")


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmJointNotes:
    """One joint; None where nothing is said.

    Attributes:
        planned: the planner may move it.
        home: value in the posture to start from, rad or metres.
        velocity, acceleration: limits, rad/s or m/s and per second.
    """

    planned: bool | None = None
    home: float | None = None
    velocity: float | None = None
    acceleration: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraNotes:
    """A camera: the link it is fixed to by name, X_LC (4, 4) in it (OpenCV axes), and its image."""

    link: str
    X_LC: np.ndarray
    intrinsics: Intrinsics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmNotes:
    """Annotation of an arm; None or empty where nothing is said.

    Attributes:
        base: link that stands for B; flange: link that carries hands. By name.
        X_FM: (4, 4) mounting face in the flange link.
        table_height_m: of a table that suits the arm, above B.
    """

    name: str | None = None
    licence: str | None = None
    provenance: str | None = None
    base: str | None = None
    flange: str | None = None
    X_FM: np.ndarray | None = None
    camera: CameraNotes | None = None
    table_height_m: float | None = None
    joints: Mapping[str, ArmJointNotes] = field(default_factory=dict)


def load_arm_notes(path: str | Path) -> ArmNotes:
    """Read an `arm.toml`.

    Raises:
        RobotDescriptionError: not a file, not TOML, an unknown key, or a value of the wrong type; the message
            names the file, the key and what was expected.
    """
    table = NotesTable.read(path)
    table.check_keys(_TOP_KEYS)
    face, camera, joints = table.table("face"), table.table("camera"), table.table("joints")
    if face is not None:
        face.check_keys(FRAME_KEYS)
    return ArmNotes(
        name=table.text("name"),
        licence=table.text("licence"),
        provenance=table.text("provenance"),
        base=table.text("base"),
        flange=table.text("flange"),
        X_FM=None if face is None else face.frame(),
        camera=None if camera is None else _camera(camera),
        table_height_m=table.number("table_height"),
        joints={} if joints is None else {name: _joint(joints, name) for name in joints.values},
    )


def _camera(table: NotesTable) -> CameraNotes:
    table.check_keys(_CAMERA_KEYS)
    table.need(_CAMERA_KEYS)
    link, fov_y = table.text("link"), table.number("fov_y")
    width, height = (table.number(key) for key in ("width", "height"))
    assert link is not None and fov_y is not None and width is not None and height is not None
    if not 1 <= fov_y <= 179:
        raise table.fail("fov_y", "degrees between 1 and 179")
    for key, value in (("width", width), ("height", height)):
        if value < 1 or value != int(value):
            raise table.fail(key, "a whole number of pixels")
    intrinsics = Intrinsics.from_fov(np.deg2rad(fov_y), int(width), int(height))
    return CameraNotes(link=link, X_LC=table.frame(), intrinsics=intrinsics)


def _joint(joints: NotesTable, name: str) -> ArmJointNotes:
    table = joints.table(name)
    assert table is not None
    table.check_keys(_JOINT_KEYS)
    velocity, acceleration = table.number("velocity"), table.number("acceleration")
    for key, value in (("velocity", velocity), ("acceleration", acceleration)):
        if value is not None and value <= 0:
            raise table.fail(key, "a positive number")
    return ArmJointNotes(
        planned=table.flag("planned"), home=table.number("home"), velocity=velocity, acceleration=acceleration
    )
