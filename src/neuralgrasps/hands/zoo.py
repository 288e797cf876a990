"""The hands that come with the library, and hands from any URDF or MJCF file."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np

from neuralgrasps.errors import RobotDescriptionError, unknown_name
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.loader import hand_from_description
from neuralgrasps.hands.notes import HandNotes, load_hand_notes
from neuralgrasps.hands.whole_robot import find_hand
from neuralgrasps.kinematics.description import RobotDescription
from neuralgrasps.kinematics.mjcf import load_mjcf
from neuralgrasps.kinematics.safe_xml import read_xml
from neuralgrasps.kinematics.subtree import RobotOutline
from neuralgrasps.kinematics.urdf import load_urdf, outline_urdf

MissingMeshes = Literal["error", "skip"]
ALL_HANDS = "all"
_HANDS = ("fetch", "panda", "barrett", "allegro", "human")


def hand_names() -> tuple[str, ...]:
    """Names of the hands that come with the library."""
    return _HANDS


def hand_sources(given: Sequence[str]) -> tuple[str, ...]:
    """Names or paths of hands to load; "all", or nothing, stands for those of `hand_names()`."""
    return tuple(name for text in given or (ALL_HANDS,) for name in (_HANDS if text == ALL_HANDS else (text,)))


def hand_folder(name: str) -> Path:
    """Folder of a built-in hand: hand.xml, hand.toml, LICENSE, README.md, preview.png.

    Raises:
        UnknownNameError: no hand of this name.
    """
    if name not in _HANDS:
        raise unknown_name("hand", name, _HANDS)
    return Path(str(resources.files("neuralgrasps"))) / "assets" / "hands" / name


def load_hand(name_or_path: str | Path, *, link: str | None = None, missing_meshes: MissingMeshes = "error") -> Hand:
    """A built-in hand by name, or any hand from a URDF or MJCF file.

    A file is annotated automatically (palm, fingers, closing directions, preshapes). A `hand.toml`, or `<file>.toml`,
    beside it overrides whatever it states. A folder stands for the hand.xml, or the only URDF or MJCF, in it.
    In the file of a whole robot the hand is found, and this is said; or its base is named by `link`.

    Args:
        name_or_path: a name of `hand_names()`, or a path to a .urdf or .xml file or a folder with one.
        link: the link to take as the hand's base, with everything that hangs on it.
        missing_meshes: "skip" leaves out link shapes of a URDF whose mesh files are missing or unreadable.
    Raises:
        UnknownNameError: neither a known name nor a file.
        RobotDescriptionError: the file cannot be used as a hand.
    """
    if isinstance(name_or_path, str) and name_or_path in _HANDS:
        return _load_file(hand_folder(name_or_path) / "hand.xml", link, missing_meshes)
    return _load_file(robot_file(name_or_path, kind="hand", built_in=_HANDS), link, missing_meshes)


def robot_file(name_or_path: str | Path, *, kind: str, built_in: Sequence[str]) -> Path:
    """The robot file that a path stands for; of a folder its `<kind>.xml`, or the only URDF or MJCF in it.

    Args:
        kind: what is wanted, "hand" or "arm"; `built_in`: names that need no file, for the message.
    Raises:
        UnknownNameError: looks like a name and is none.
        RobotDescriptionError: no such file, or a folder without one robot file.
    """
    path = Path(name_or_path)
    if path.is_dir():
        path = _only_robot_file(path, kind)
    if path.is_file():
        return path
    raise _not_found(str(name_or_path), kind, built_in)


def _not_found(name: str, kind: str, built_in: Sequence[str]) -> Exception:
    if name.endswith((".urdf", ".xml", ".mjcf")) or "/" in name or "\\" in name:
        folder = Path(name).parent
        near = difflib.get_close_matches(Path(name).name, [p.name for p in folder.glob("*")], n=1)
        hint = f" Did you mean '{folder / near[0]}'?" if near else ""
        return RobotDescriptionError(
            f"{kind} file '{name}' does not exist.{hint} Built-in {kind}s: {', '.join(built_in)}."
        )
    return unknown_name(kind, name, built_in)


def _only_robot_file(folder: Path, kind: str) -> Path:
    if (folder / f"{kind}.xml").is_file():
        return folder / f"{kind}.xml"
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".urdf", ".xml", ".mjcf"))
    if len(found) != 1:
        listed = f"{len(found)} robot files ({', '.join(p.name for p in found[:5])})" if found else "no robot file"
        raise RobotDescriptionError(f"folder '{folder}' holds {listed}; name one .urdf or .xml file.")
    return found[0]


def _load_file(path: Path, link: str | None, missing_meshes: MissingMeshes) -> Hand:
    if link is not None:
        description = load_robot(path, link=link, missing_meshes=missing_meshes)
    else:
        description = _hand_only(path, missing_meshes)
    return hand_from_description(description, _notes_beside(path))


def _hand_only(path: Path, missing_meshes: MissingMeshes) -> RobotDescription:
    """The file's hand: all of it, or of a whole robot the limb that is one."""
    link = find_hand(path.stem, outline_robot(path))
    if link is None:
        return load_robot(path, missing_meshes=missing_meshes)
    limb = load_robot(path, link=link, missing_meshes=missing_meshes)
    remark = f"the file holds a whole robot: link '{link}' and what hangs on it was taken for the hand."
    return replace(limb, name=f"{limb.name}_{link}", repairs=(remark, *limb.repairs))


def outline_robot(path: Path) -> RobotOutline:
    """The tree of a URDF or MJCF file and which links have shapes; no mesh of a URDF is read."""
    if read_xml(path, root_tag=None, kind="robot").tag == "robot":
        return outline_urdf(path)
    description = load_robot(path)
    has_shape = np.zeros(description.tree.num_links, bool)
    has_shape[[g.link for g in description.geometries]] = True
    return RobotOutline(tree=description.tree, has_shape=has_shape)


def _notes_beside(path: Path) -> HandNotes | None:
    for candidate in (path.with_suffix(".toml"), path.parent / "hand.toml"):
        if candidate.is_file():
            return load_hand_notes(candidate)
    return None


def load_robot(
    path: str | Path, *, link: str | None = None, missing_meshes: MissingMeshes = "error"
) -> RobotDescription:
    """Read a URDF or MJCF file, told apart by the root tag of its XML; `missing_meshes` as for `load_hand`.

    All of it, or what hangs on `link`. Visual shapes are read for links that have no collision shape.

    Raises:
        RobotDescriptionError: the file is neither, or cannot be used.
    """
    path = Path(path)
    root = read_xml(path, root_tag=None, kind="robot").tag
    if root == "robot":
        return load_urdf(path, link=link, with_visuals=False, missing_meshes=missing_meshes)
    if root == "mujoco":
        return load_mjcf(path, link=link)
    raise RobotDescriptionError(f"'{path.name}' has the root tag <{root}>; expected <robot> (URDF) or <mujoco> (MJCF).")
