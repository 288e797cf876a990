"""Every way a command can fail, as one message and an exit code.

0 done, 1 ran and failed, 2 the input cannot be used, 130 stopped with Ctrl-C.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass

from neuralgrasps.errors import DownloadError, NeuralGraspsError

DONE, FAILED, BAD_INPUT, INTERRUPTED, TERMINATED, BROKEN_PIPE = 0, 1, 2, 130, 143, 141
_USERS_FAULT = (
    errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENAMETOOLONG,
)  # fmt: skip


class Terminated(KeyboardInterrupt):
    """The process was asked to end (SIGTERM); work stops as for Ctrl-C."""


@dataclass(frozen=True, slots=True)
class Failure:
    """What to tell the user, and the exit code."""

    message: str
    exit_code: int


def describe(error: BaseException) -> Failure:
    """The failure behind an exception, in plain words."""
    from neuralgrasps.parallel import WorkerDiedError

    if isinstance(error, WorkerDiedError | DownloadError):
        return Failure(str(error), FAILED)
    if isinstance(error, NeuralGraspsError):
        cause = error.__cause__
        full = isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)
        return Failure(str(error), FAILED if full else BAD_INPUT)
    if isinstance(error, OSError):
        return _os_failure(error)
    if isinstance(error, MemoryError):
        return Failure(
            "out of memory. Use fewer workers (--workers 1) or smaller input, or close other programs.", FAILED
        )
    text = str(error).strip().splitlines()
    what = f"{type(error).__name__}: {text[0]}" if text else type(error).__name__
    return Failure(
        f"unexpected failure ({what}). This is a fault of the program, not of your input; run again with --debug for "
        "details to report.",
        FAILED,
    )


def _os_failure(error: OSError) -> Failure:
    where = f"'{error.filename}'" if error.filename else "a file"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return Failure(f"cannot write {where}: the disk is full. Free some space or choose another folder.", FAILED)
    if error.errno == errno.ENOENT:
        return Failure(f"{where} does not exist; check the path.", BAD_INPUT)
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return Failure(f"no permission for {where}; check its permissions or choose another folder.", BAD_INPUT)
    reason = error.strerror or str(error) or type(error).__name__
    return Failure(f"{where}: {reason}.", BAD_INPUT if error.errno in _USERS_FAULT else FAILED)
