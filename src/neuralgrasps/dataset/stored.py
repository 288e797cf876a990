"""Reading a dataset's files: nothing is believed that is not what the manifest or its own notes say. Torch-free."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load

from neuralgrasps.dataset.schema import sha256_of_file
from neuralgrasps.errors import DataFormatError

_FIX = "Run the build again: it replaces damaged files and keeps the others."


def content_hash(arrays: Mapping[str, np.ndarray]) -> str:
    """sha256 (hex) over names, types, shapes and values."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def is_whole(path: Path, key: str) -> bool:
    """Whether a shard file is there, was computed from the inputs of this key, and has not changed since."""
    metadata = metadata_on_disk(path)
    if metadata.get("key") != key:
        return False
    try:
        return content_hash(load(path.read_bytes())) == metadata.get("content")
    except (SafetensorError, OSError):
        return False


def metadata_on_disk(path: Path) -> Mapping[str, str]:
    """The header notes of a shard file; empty when there is none or it cannot be read."""
    if not path.is_file():
        return {}
    try:
        with safe_open(path, framework="numpy") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError):
        return {}


def header_fits(path: Path) -> bool:
    """Whether a shard file has a header, and is as long as that says; its arrays are not read."""
    try:
        with safe_open(path, framework="numpy"):
            return True
    except (SafetensorError, OSError):
        return False


class CheckedFiles:
    """Files whose sha256 is compared with the manifest's before anything is read from them.

    Once a file, as long as its size and time of change stay the same: reading a few rows of a large file again and
    again costs no hashing.
    """

    def __init__(self) -> None:
        self._sound: dict[tuple[Path, str], tuple[int, int]] = {}

    def path(self, path: Path, sha256: str) -> Path:
        """`path`, if the file is the one that the manifest names.

        Raises:
            DataFormatError: it is missing, damaged, or another file.
        """
        if not path.is_file():
            raise DataFormatError(f"dataset file '{path}' is missing. {_FIX}")
        state = path.stat()
        stamp = (state.st_size, state.st_mtime_ns)
        if self._sound.get((path, sha256)) != stamp:
            if sha256_of_file(path) != sha256:
                raise DataFormatError(
                    f"dataset file '{path}' is not the one its manifest names: it was damaged or replaced (sha256 "
                    f"differs). {_FIX}"
                )
            self._sound[path, sha256] = stamp
        return path

    def arrays(self, path: Path, sha256: str) -> Mapping[str, np.ndarray]:
        """All arrays of a safetensors file."""
        with _opened(self.path(path, sha256)) as file:
            return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping

    def rows(
        self, path: Path, sha256: str, names: Sequence[str], rows: Sequence[int] | np.ndarray | None
    ) -> dict[str, np.ndarray]:
        """Rows of some arrays, all when `rows` is None; only these are read from disk.

        Raises:
            DataFormatError: the file is not the manifest's, or an array is not in it.
            IndexError: a row that the arrays do not have.
        """
        with _opened(self.path(path, sha256)) as file:
            missing = set(names) - set(file.keys())
            if missing:
                raise DataFormatError(f"dataset file '{path}' holds no {', '.join(sorted(missing))}. {_FIX}")
            if rows is None:
                return {name: file.get_tensor(name) for name in names}
            return {name: _rows(file.get_slice(name), np.asarray(rows, np.int64)) for name in names}


def _opened(path: Path):  # type: ignore[no-untyped-def]
    try:
        return safe_open(path, framework="numpy")
    except SafetensorError as error:
        raise DataFormatError(f"dataset file '{path}' is corrupt: {error}. {_FIX}") from error


def _rows(stored, rows: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The named rows of an array on disk, negative ones counted from its end."""
    total = stored.get_shape()[0]
    if len(rows) and not (-total <= rows.min() and rows.max() < total):
        raise IndexError(f"grasps {rows.min()} to {rows.max()} were asked for; the pair has {total}.")
    if not len(rows):
        return stored[0:0]
    return np.concatenate([stored[i : i + 1] for i in (int(r) % total for r in rows)])
