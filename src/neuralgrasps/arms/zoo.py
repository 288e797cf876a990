"""The arms that come with the library, and arms from any URDF or MJCF file."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources
from pathlib import Path

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.flange import find_flange, further_flange
from neuralgrasps.arms.loader import arm_from_description
from neuralgrasps.arms.notes import ArmNotes, load_arm_notes
from neuralgrasps.errors import unknown_name
from neuralgrasps.hands.zoo import MissingMeshes, load_robot, outline_robot, robot_file

_ARMS = ("fetch", "panda")


def arm_names() -> tuple[str, ...]:
    """Names of the arms that come with the library."""
    return _ARMS


def arm_folder(name: str) -> Path:
    """Folder of a built-in arm: arm.xml, arm.toml, LICENSE, README.md, preview.png.

    Raises:
        UnknownNameError: no arm of this name.
    """
    if name not in _ARMS:
        raise unknown_name("arm", name, _ARMS)
    return Path(str(resources.files("neuralgrasps"))) / "assets" / "arms" / name


def load_arm(
    name_or_path: str | Path,
    *,
    flange: str | None = None,
    base: str | None = None,
    missing_meshes: MissingMeshes = "error",
) -> Arm:
    """A built-in arm by name, or any arm from a URDF or MJCF file.

    In a file the flange is found: a link with a usual name ("tool0", "flange", "ee_link"), else what the hand of a
    whole robot hangs on, else the only tip. What hangs beyond it is cut off; joints that do not move it stay at rest.
    An `arm.toml`, or `<file>.toml`, beside the file overrides whatever it states. A folder stands for the arm.xml,
    or the only URDF or MJCF, in it.

    Args:
        name_or_path: a name of `arm_names()`, or a path to a .urdf or .xml file or a folder with one.
        flange: the link that hands are mounted on.
        base: the link to take for the base B, with what hangs on it; the whole robot when None.
        missing_meshes: "skip" leaves out link shapes of a URDF whose mesh files are missing or unreadable.
    Raises:
        UnknownNameError: neither a known name nor a file.
        RobotDescriptionError: the file cannot be used as an arm; the message lists what may be chosen.
    """
    if isinstance(name_or_path, str) and name_or_path in _ARMS:
        path = arm_folder(name_or_path) / "arm.xml"
    else:
        path = robot_file(name_or_path, kind="arm", built_in=_ARMS)
    notes = _notes_beside(path)
    description = load_robot(path, link=base or notes.base, missing_meshes=missing_meshes)
    outline = outline_robot(path)
    chosen = flange or notes.flange or find_flange(description.name, outline)
    arm = arm_from_description(description, notes, flange=chosen)
    further = further_flange(outline, chosen)
    said = [line for line in (further, arm.extra["assumed"]) if line]
    return replace(arm, extra={**arm.extra, "assumed": "\n".join(said)})


def _notes_beside(path: Path) -> ArmNotes:
    for candidate in (path.with_suffix(".toml"), path.parent / "arm.toml"):
        if candidate.is_file():
            return load_arm_notes(candidate)
    return ArmNotes()
