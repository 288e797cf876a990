"""Tables of notes beside a robot file (`hand.toml`, `arm.toml`), read with checks that name file, key and fix."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from neuralgrasps.errors import RobotDescriptionError

FRAME_KEYS = ("position", "x_axis", "z_axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class NotesTable:
    """A TOML table; `where` names it in messages. Readers return None for a key that is absent."""

    where: str
    values: Mapping[str, Any]

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The top table of a file.

        Raises:
            RobotDescriptionError: not a file, or not TOML.
        """
        path = Path(path)
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise RobotDescriptionError(f"'{path}' cannot be read: {error.strerror}.") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise RobotDescriptionError(f"'{path.name}' is not valid TOML: {error}.") from None
        return cls(where=f"'{path.name}'", values=table)

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

    def need(self, keys: Iterable[str]) -> None:
        keys = tuple(keys)
        missing = [k for k in keys if k not in self.values]
        if missing:
            raise RobotDescriptionError(f"{self.where}: key '{missing[0]}' is missing; expected {', '.join(keys)}.")

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

    def table(self, key: str) -> Self | None:
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.fail(key, "a table")
        return type(self)(where=f"{self.where} {key}", values=value)

    def frame(self) -> np.ndarray:
        """X (4, 4) from position, x_axis and z_axis; the axes of any length, perpendicular."""
        self.need(FRAME_KEYS)
        position, x, z = (self.vector(k, 3) for k in FRAME_KEYS)
        assert position is not None and x is not None and z is not None
        lengths = float(np.linalg.norm(x)), float(np.linalg.norm(z))
        if min(lengths) < 1e-9 or abs(x @ z) > 1e-3 * lengths[0] * lengths[1]:
            raise RobotDescriptionError(f"{self.where}: x_axis and z_axis must be non-zero and perpendicular.")
        return frame_from_axes(position, x, z)


def frame_from_axes(position: np.ndarray, x_axis: np.ndarray, z_axis: np.ndarray) -> np.ndarray:
    """X (4, 4) from origin, z axis and a direction to its side that is made square to it; (3,) each, any length."""
    z = z_axis / np.linalg.norm(z_axis)
    x = x_axis - (x_axis @ z) * z
    x = x / np.linalg.norm(x)
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3] = x, np.cross(z, x), z, position
    return X
