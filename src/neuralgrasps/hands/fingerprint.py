"""Content fingerprints: a hash over every field of a hand, or of any data made of dataclasses and arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum

import numpy as np

from neuralgrasps.hands.hand import Hand

PROSE = ("licence", "provenance", "extra")  # fields of `Hand` that nothing is computed from


def hand_fingerprint(hand: Hand) -> str:
    """sha256 (hex) over every field of a hand but the texts about its origin (`PROSE`).

    Two hands of equal fingerprint give the same grasps. A new field of `Hand` is part of it without a change here.
    """
    return fingerprint(hand, leave_out=PROSE)


def fingerprint(value: object, *, leave_out: Iterable[str] = ()) -> str:
    """sha256 (hex) of the content of `value`: equal content, equal hash, in every process.

    Args:
        value: None, numbers, text, enums, arrays, and tuples, lists, mappings and dataclasses of them.
        leave_out: fields of `value` itself (not of what is in it) that do not count.
    Raises:
        TypeError: something in it is of another kind, which could not be told apart from a changed one.
    """
    return _digest(value, frozenset(leave_out)).hex()


def _digest(value: object, leave_out: frozenset[str] = frozenset()) -> bytes:
    """sha256 of the kind of value, then of its content: nested parts by their own digests, so none can run together."""
    content = hashlib.sha256()
    match value:
        case np.ndarray() | np.generic():
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise TypeError("an array of Python objects has no content to hash; expected numbers or text.")
            content.update(f"array {array.dtype.str} {array.shape} ".encode())
            content.update(np.ascontiguousarray(array).tobytes())
        case None | bool() | int() | float() | str() | Enum():
            content.update(f"{type(value).__name__} {value!r}".encode())
        case tuple() | list():
            content.update(b"sequence ")
            for item in value:
                content.update(_digest(item))
        case Mapping():
            content.update(b"mapping ")
            for pair in sorted(_digest(key) + _digest(item) for key, item in value.items()):
                content.update(pair)
        case _ if is_dataclass(value) and not isinstance(value, type):
            content.update(f"{type(value).__name__} ".encode())
            for field in fields(value):
                if field.name not in leave_out:
                    content.update(_digest(field.name) + _digest(getattr(value, field.name)))
        case _:
            raise TypeError(f"cannot hash the content of a {type(value).__name__}; expected numbers, text or arrays.")
    return content.digest()
