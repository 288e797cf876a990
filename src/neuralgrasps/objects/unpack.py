"""Unpacking archives from the network without trusting them."""

from __future__ import annotations

import shutil
import tarfile
from pathlib import Path, PurePosixPath

from neuralgrasps.errors import DataFormatError

MAX_BYTES = 512 * 1024 * 1024
MAX_FILES = 1000


def unpack_tar(archive: Path, folder: Path, *, max_bytes: int = MAX_BYTES, max_files: int = MAX_FILES) -> list[Path]:
    """Unpack the regular files of a (compressed) tar archive below `folder`; owners, modes and times are dropped.

    Every entry's name, kind and size is checked before it is written.

    Returns:
        the files written, in archive order.
    Raises:
        DataFormatError: not a readable tar archive, or an entry is a link or device, has an absolute path or "..",
            or the limits on files or bytes are passed. Files of earlier entries may then lie in `folder`.
    """
    written: list[Path] = []
    left = max_bytes
    try:
        with tarfile.open(archive, mode="r:*") as tar:
            for entry in tar:
                target = _safe_target(archive, folder, entry)
                if entry.isdir():
                    continue
                left -= entry.size
                if left < 0 or len(written) >= max_files:
                    raise DataFormatError(
                        f"archive '{archive.name}' holds more than {max_bytes} bytes or {max_files} files; it was not "
                        "unpacked further."
                    )
                target.parent.mkdir(parents=True, exist_ok=True)
                content = tar.extractfile(entry)
                assert content is not None  # it is a regular file
                with content, open(target, "wb") as file:
                    shutil.copyfileobj(content, file)
                written.append(target)
    except (tarfile.TarError, EOFError, OSError) as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(
            f"archive '{archive.name}' cannot be unpacked: {error}. Delete it and try again."
        ) from error
    return written


def _safe_target(archive: Path, folder: Path, entry: tarfile.TarInfo) -> Path:
    """Where an entry goes; raises when it must not be unpacked."""
    name = PurePosixPath(entry.name)
    what = f"archive '{archive.name}' has the entry '{entry.name}'"
    if not (entry.isreg() or entry.isdir()):
        raise DataFormatError(f"{what}, a link or device; expected only files and folders. It was not unpacked.")
    if name.is_absolute() or ".." in name.parts or "\\" in entry.name or ":" in entry.name or "\0" in entry.name:
        raise DataFormatError(f"{what}, which leads out of its folder. It was not unpacked.")
    return folder.joinpath(*name.parts)
