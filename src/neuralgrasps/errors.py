"""Errors the library raises on purpose, and checks on user input.

Every message says what is wrong, what was given, what was expected and how to fix it.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class NeuralGraspsError(Exception):
    """Base of every error raised on purpose by this library."""


class InputError(NeuralGraspsError, ValueError):
    """A value, file or option given by the user cannot be used."""


class ShapeError(InputError):
    """An array does not have the shape the function documents."""


class MeshError(InputError):
    """A mesh file cannot be read or does not describe a solid."""


class RobotDescriptionError(InputError):
    """A URDF, MJCF or hand.toml file cannot be used as a hand or an arm."""


class UnknownNameError(NeuralGraspsError, KeyError):
    """A hand, object or preset of this name does not exist."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class DataFormatError(InputError):
    """A data file is corrupt, of another version, or not what its manifest says."""


class DeviceError(InputError):
    """A device that was asked for, a GPU for example, is not there or cannot be used."""


class StorageError(NeuralGraspsError, OSError):
    """A file cannot be written: full disk, read-only folder, no permission."""


class DownloadError(NeuralGraspsError, OSError):
    """A download could not be started, finished or verified."""


class DivergedError(NeuralGraspsError, ArithmeticError):
    """The loss of a training is not a number any more."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UnknownNameError:
    """An error for a name that is not in `known`, with the nearest known name as a hint."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean '{near[0]}'?" if near else ""
    return UnknownNameError(f"{kind} '{name}' is not known.{hint} Known {kind}s: {', '.join(names)}.")


def check_shape(name: str, shape: tuple[int, ...], expected: tuple[int | None, ...]) -> None:
    """Raise `ShapeError` unless the trailing axes of `shape` are `expected` (None matches any size)."""
    tail = shape[len(shape) - len(expected) :] if len(shape) >= len(expected) else None
    if tail is None or any(e is not None and e != s for s, e in zip(tail, expected, strict=True)):
        want = ", ".join("*" if e is None else str(e) for e in expected)
        raise ShapeError(f"{name} has shape {tuple(shape)}; expected (..., {want}).")
