"""Grasps that were made once and serve again: in memory, and in the home folder for the next process."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version

from neuralgrasps.errors import DataFormatError, InputError, StorageError
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.fingerprint import fingerprint, hand_fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.cache import home_folder
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.prepared import Memory

_VERSION = 5  # raise it when what is made changes
_ENGINES = ("mujoco", "numba", "numpy")  # another version of these may make other grasps
_KEPT = Memory[GraspSet](most=256)


def pair_fingerprint(hand: Hand, obj: ObjectModel) -> str:
    """sha256 (hex) of what grasps of a hand on an object depend on, the object's signed distances by their mesh."""
    sdf = obj.sdf
    shape = (obj.content_hash, sdf.values.shape, sdf.origin, sdf.spacing, len(obj.points_O), obj.convex_parts)
    return fingerprint((hand_fingerprint(hand), obj.name, shape, obj.mass_kg, obj.com_O, obj.friction))


@lru_cache(maxsize=1)
def engine_versions() -> tuple[str, ...]:
    """Versions of the libraries that decide what is made."""
    return tuple(version(name) for name in _ENGINES)


def remembered(content: object, make: Callable[[], GraspSet]) -> GraspSet:
    """The grasps kept for `content` (see `fingerprint`), else what `make` returns, which is then kept.

    `make` must depend on `content` only. A folder that cannot be read or written costs time only.
    """
    key = fingerprint((_VERSION, engine_versions(), content))

    def read_or_make() -> GraspSet:
        path = home_folder() / "cache" / "table_grasps" / f"{key}.safetensors"
        with suppress(InputError, DataFormatError):
            return load_grasps(path)
        made = make()
        with suppress(StorageError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            save_grasps(path, made)
        return made

    return _KEPT.get(key, read_or_make)


def forget() -> None:
    """Drop what is kept in memory; files stay."""
    _KEPT.clear()
