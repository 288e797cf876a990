"""Places to write to: checked before the work, made just before writing."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from neuralgrasps.errors import InputError, StorageError
from neuralgrasps.files import storage_reason


def check_writable(path: Path, *, folder: bool = False) -> None:
    """Refuse a file (or folder) that cannot be written, before anything long is computed.

    Raises:
        InputError: it is a folder where a file is expected, or the other way round, or runs through a file.
        StorageError: no permission.
    """
    if not folder and path.is_dir():
        raise InputError(f"'{path}' is a folder; expected a file to write, such as '{path / 'out'}'.")
    if folder and path.exists() and not path.is_dir():
        raise InputError(f"'{path}' is a file; expected a folder to write into.")
    if not folder and path.exists() and not path.is_file():
        raise InputError(f"'{path}' is a device; expected the name of a file.")
    place = path if folder else path.parent
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(f"'{path}' cannot be written: '{place}' is a file, not a folder; choose another path.")
    try:
        with tempfile.TemporaryFile(dir=place):  # permission bits alone say nothing about read-only disks
            pass
    except OSError as error:
        raise StorageError(f"cannot write '{path}': {storage_reason(error, place / path.name, 0)}") from error
    if path.is_file() and not os.access(path, os.W_OK):
        raise StorageError(f"cannot write '{path}': the file is read-only; choose another name.")


def make_parent(path: Path) -> None:
    """Make the folder of a file to be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
