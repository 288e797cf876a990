"""Write files whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from neuralgrasps.errors import StorageError


def write_whole(path: str | os.PathLike[str], data: bytes | str, *, make_folder: bool = True) -> Path:
    """Write `data` to a temporary neighbour, flush it to disk, then rename it to `path`.

    A reader sees the old file or the new one, never a part; a failed or interrupted write leaves no trace.

    Args:
        path: where to; data: bytes, or text that is written as UTF-8.
        make_folder: create missing parent folders.
    Returns:
        the path written.
    Raises:
        StorageError: no permission, read-only, full disk, or a parent that is a file.
    """
    path = Path(path)
    content = data.encode() if isinstance(data, str) else data
    temporary: Path | None = None
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files that only their owner can read
        temporary.replace(path)
    except OSError as error:
        _remove(temporary)
        raise StorageError(f"cannot write '{path}': {storage_reason(error, path, len(content))}") from error
    except BaseException:
        _remove(temporary)
        raise
    return path


def _remove(path: Path | None) -> None:
    if path is not None:
        path.unlink(missing_ok=True)


def storage_reason(error: OSError, path: Path, size: int) -> str:
    """Why a write of `size` bytes to `path` failed, and what helps."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"the disk is full; free at least {size / 1e6:.1f} MB or choose another folder."
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return f"no permission to write in '{path.parent}'; choose a folder you may write to."
    if error.errno in (errno.ENOTDIR, errno.EEXIST, errno.EISDIR):
        return "the path runs through a file or names a folder; choose another path."
    if error.errno == errno.ENOENT and path.parent.is_dir():
        return f"'{path.parent}' takes no new files (a system folder?); choose another folder."
    if error.errno == errno.ENOENT:
        return f"the folder '{path.parent}' does not exist and cannot be made; choose another folder."
    return f"{error.strerror or error}."
