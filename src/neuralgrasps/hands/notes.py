"""What a `hand.toml` says about a hand: palm, fingers and how each joint is used for grasping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.notes_table import FRAME_KEYS, NotesTable

_TOP_KEYS = ("name", "licence", "provenance", "is_jaw", "jaw_pad", "palm", "joints", "fingers")
_JOINT_KEYS = ("close", "open", "preshape", "group", "effort")
_FINGER_KEYS = ("name", "links", "thumb")


@dataclass(frozen=True, slots=True, kw_only=True)
class JointNotes:
    """Use of one independent joint; None where nothing is said.

    Attributes:
        close: closing rate, rad/s or m/s at unit closing speed, signed; 0 = not used to close.
        open: value in the open posture; preshape: (lowest, highest) start value for closing. Radians or metres.
        group: joints of equal group share one random number when a preshape is drawn.
        effort: largest torque (N m) or force (N), in place of the robot file's.
    """

    close: float | None = None
    open: float | None = None
    preshape: tuple[float, float] | None = None
    group: str | None = None
    effort: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FingerNotes:
    """One finger: its links by name, proximal first."""

    name: str
    links: tuple[str, ...]
    thumb: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HandNotes:
    """Annotation of a hand; None or empty where nothing is said (see `annotate` for what fills the gaps).

    Attributes:
        X_HP: (4, 4) palm frame in the hand base.
        jaw_pad_H: (3,) middle between the pads in the hand base, metres.
    """

    name: str | None = None
    licence: str | None = None
    provenance: str | None = None
    is_jaw: bool | None = None
    jaw_pad_H: np.ndarray | None = None
    X_HP: np.ndarray | None = None
    fingers: tuple[FingerNotes, ...] | None = None
    joints: Mapping[str, JointNotes] = field(default_factory=dict)


def load_hand_notes(path: str | Path) -> HandNotes:
    """Read a `hand.toml`.

    Raises:
        RobotDescriptionError: not a file, not TOML, an unknown key, or a value of the wrong type; the message
            names the file, the key and what was expected.
    """
    return _Table.read(path).hand_notes()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table(NotesTable):
    def hand_notes(self) -> HandNotes:
        self.check_keys(_TOP_KEYS)
        palm, joints = self.table("palm"), self.table("joints")
        return HandNotes(
            name=self.text("name"),
            licence=self.text("licence"),
            provenance=self.text("provenance"),
            is_jaw=self.flag("is_jaw"),
            jaw_pad_H=self.vector("jaw_pad", 3),
            X_HP=None if palm is None else palm.palm_frame(),
            fingers=self.finger_list() if "fingers" in self.values else None,
            joints={} if joints is None else {name: joints.joint(name) for name in joints.values},
        )

    def palm_frame(self) -> np.ndarray:
        self.check_keys(FRAME_KEYS)
        return self.frame()

    def joint(self, name: str) -> JointNotes:
        table = self.table(name)
        assert table is not None
        table.check_keys(_JOINT_KEYS)
        preshape, effort = table.vector("preshape", 2), table.number("effort")
        if preshape is not None and preshape[0] > preshape[1]:
            raise table.fail("preshape", "[lowest, highest]")
        if effort is not None and effort <= 0:
            raise table.fail("effort", "a positive number")
        return JointNotes(
            close=table.number("close"),
            open=table.number("open"),
            preshape=None if preshape is None else (float(preshape[0]), float(preshape[1])),
            group=table.text("group"),
            effort=effort,
        )

    def finger_list(self) -> tuple[FingerNotes, ...]:
        value = self.values["fingers"]
        if not isinstance(value, list) or not value or not all(isinstance(v, dict) for v in value):
            raise self.fail("fingers", "one or more [[fingers]] tables")
        return tuple(_Table(where=f"{self.where} fingers[{i}]", values=v).finger() for i, v in enumerate(value))

    def finger(self) -> FingerNotes:
        self.check_keys(_FINGER_KEYS)
        links, name = self.values.get("links"), self.text("name")
        if name is None or not isinstance(links, list) or not links or not all(isinstance(v, str) for v in links):
            raise RobotDescriptionError(
                f"{self.where}: expected a name and a list of link names, e.g. links = ['tip']."
            )
        return FingerNotes(name=name, links=tuple(links), thumb=bool(self.flag("thumb")))
