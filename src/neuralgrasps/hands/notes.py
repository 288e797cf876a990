"""What a `hand.toml` says about a hand: palm, fingers and how each joint is used for grasping."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.errors import RobotDescriptionError

_TOP_KEYS = ("name", "licence", "provenance", "is_jaw", "jaw_pad", "palm", "joints", "fingers")
_PALM_KEYS = ("position", "x_axis", "z_axis")
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
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RobotDescriptionError(f"'{path}' cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RobotDescriptionError(f"'{path.name}' is not valid TOML: {error}.") from None
    return _Table(where=f"'{path.name}'", values=table).hand_notes()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    """A TOML table whose values are read with checks; `where` names it in messages."""

    where: str
    values: Mapping[str, Any]

    def fail(self, key: str, expected: str) -> RobotDescriptionError:
        return RobotDescriptionError(f"{self.where}: {key} is {self.values[key]!r}; expected {expected}.")

    def check_keys(self, known: Iterable[str]) -> None:
        known = tuple(known)
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                hint = f" Did you mean '{near[0]}'?" if near else ""
                raise RobotDescriptionError(
                    f"{self.where}: key '{key}' is not known.{hint} Known keys: {', '.join(known)}."
                )

    def text(self, key: str) -> str | None:
        value = self.values.get(key)
        if value is not None and not (isinstance(value, str) and value):
            raise self.fail(key, "text in quotes")
        return value

    def flag(self, key: str) -> bool | None:
        value = self.values.get(key)
        if value is not None and not isinstance(value, bool):
            raise self.fail(key, "true or false")
        return value

    def number(self, key: str) -> float | None:
        value = self.values.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise self.fail(key, "a finite number")
        return float(value)

    def vector(self, key: str, size: int) -> np.ndarray | None:
        value = self.values.get(key)
        if value is None:
            return None
        good = isinstance(value, list) and len(value) == size
        if not good or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
            raise self.fail(key, f"{size} numbers in brackets")
        if not np.all(np.isfinite(value)):
            raise self.fail(key, "finite numbers")
        return np.array(value, float)

    def table(self, key: str) -> _Table | None:
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.fail(key, "a table")
        return _Table(where=f"{self.where} {key}", values=value)

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
        self.check_keys(_PALM_KEYS)
        missing = [k for k in _PALM_KEYS if k not in self.values]
        if missing:
            raise RobotDescriptionError(
                f"{self.where}: key '{missing[0]}' is missing; expected {', '.join(_PALM_KEYS)}."
            )
        position, x, z = (self.vector(k, 3) for k in _PALM_KEYS)
        assert position is not None and x is not None and z is not None
        if min(np.linalg.norm(x), np.linalg.norm(z)) < 1e-9 or abs(x @ z) > 1e-3 * np.linalg.norm(x) * np.linalg.norm(
            z
        ):
            raise RobotDescriptionError(f"{self.where}: x_axis and z_axis must be non-zero and perpendicular.")
        return palm_frame(position, x, z)

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


def palm_frame(position_H: np.ndarray, x_axis_H: np.ndarray, z_axis_H: np.ndarray) -> np.ndarray:
    """X_HP (4, 4) from the palm's origin (metres), closing direction and outward normal (any length), all in H."""
    z = z_axis_H / np.linalg.norm(z_axis_H)
    x = x_axis_H - (x_axis_H @ z) * z
    x = x / np.linalg.norm(x)
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3] = x, np.cross(z, x), z, position_H
    return X
