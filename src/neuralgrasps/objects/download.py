"""Fetching one file over HTTP: resumable, with time limits, checked against a recorded checksum."""

from __future__ import annotations

import hashlib
import http.client
import json
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from neuralgrasps.errors import DownloadError, StorageError
from neuralgrasps.files import storage_reason, write_whole

Progress = Callable[[str, int, int | None], None]  # file name, bytes so far, bytes in all if known
MAX_BYTES = 512 * 1024 * 1024
_BLOCK = 1 << 18
_ATTEMPTS = 3
_HOME_HINT = "The home folder can be moved: set NEURALGRASPS_HOME."


def fetch_file(
    url: str, target: Path, *, timeout_s: float = 30.0, progress: Progress | None = None, max_bytes: int = MAX_BYTES
) -> None:
    """Download `url` into `target`; a partial file beside it (`.part`) is continued, also across runs.

    A connection that drops is taken up again where it stopped, three times. The server's entity tag guards against
    gluing two versions of a file together.

    Raises:
        DownloadError: no connection, an HTTP error, a file over `max_bytes`, or the disk is full or read-only.
    """
    if not url.startswith(("http://", "https://")):
        raise DownloadError(f"cannot download '{url}'; expected an address that starts with https:// or http://.")
    part = target.with_name(target.name + ".part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _disk_error(target, error) from error
    for attempt in range(1, _ATTEMPTS + 1):
        try:
            _fetch_rest(url, part, timeout_s, progress, max_bytes)
            break
        except urllib.error.HTTPError as error:
            raise DownloadError(f"cannot download {url}: the server answered {error.code} {error.reason}.") from error
        except DownloadError:
            raise
        except (OSError, http.client.HTTPException) as error:  # URLError, TLS, timeouts and dropped connections
            if attempt == _ATTEMPTS:
                reason = getattr(error, "reason", None) or error or type(error).__name__
                raise DownloadError(
                    f"cannot download {url}: {reason}. Check the network; what was received is kept, and the next try "
                    "goes on from there."
                ) from error
    try:
        part.replace(target)
        _tag_file(part).unlink(missing_ok=True)
    except OSError as error:
        raise _disk_error(target, error) from error


def _fetch_rest(url: str, part: Path, timeout_s: float, progress: Progress | None, max_bytes: int) -> None:
    have = part.stat().st_size if part.is_file() else 0
    tag = _read_tag(part, url)
    if have and tag is None:
        have = 0  # it cannot be known whether this is the start of the same file
    request = urllib.request.Request(url, headers={"User-Agent": "neuralgrasps", "Accept-Encoding": "identity"})
    if have:
        request.add_header("Range", f"bytes={have}-")
        request.add_header("If-Range", str(tag))
    try:
        response = urllib.request.urlopen(request, timeout=timeout_s)
    except urllib.error.HTTPError as error:
        if error.code != http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE or not have:
            raise
        part.unlink()  # complete or of another version: start over
        _fetch_rest(url, part, timeout_s, progress, max_bytes)
        return
    with response:
        if response.status != http.HTTPStatus.PARTIAL_CONTENT:
            have = 0
        length = response.headers.get("Content-Length")
        total = have + int(length) if length and length.isdigit() else None
        if total is not None and total > max_bytes:
            raise DownloadError(f"cannot download {url}: it holds {total} bytes; at most {max_bytes} are accepted.")
        _remember_tag(part, url, response.headers.get("ETag"))
        received = _append(response, part, have, url, progress, total, max_bytes)
    if total is not None and received < total:
        raise http.client.IncompleteRead(b"", total - received)


def _append(
    response: Any, part: Path, have: int, url: str, progress: Progress | None, total: int | None, max_bytes: int
) -> int:
    name = part.name.removesuffix(".part")
    try:
        file = open(part, "ab" if have else "wb")  # noqa: SIM115 - closed below; errors of opening are the disk's
    except OSError as error:
        raise _disk_error(part, error) from error
    with file:
        while block := response.read(_BLOCK):
            try:
                file.write(block)
                file.flush()
            except OSError as error:
                raise _disk_error(part, error, len(block)) from error
            have += len(block)
            if have > max_bytes:
                raise DownloadError(f"cannot download {url}: it holds over {max_bytes} bytes; that is not accepted.")
            if progress is not None:
                progress(name, have, total)
    return have


def _tag_file(part: Path) -> Path:
    return part.with_name(part.name + ".json")


def _read_tag(part: Path, url: str) -> str | None:
    try:
        record = json.loads(_tag_file(part).read_text(encoding="utf-8"))
        return str(record["etag"]) if record["url"] == url and record["etag"] else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _remember_tag(part: Path, url: str, etag: str | None) -> None:
    strong = etag if etag and not etag.startswith("W/") else None
    _write_note(_tag_file(part), {"url": url, "etag": strong})


def _write_note(path: Path, note: Mapping[str, str | None]) -> None:
    try:
        write_whole(path, json.dumps(note, indent=1, sort_keys=True))
    except StorageError as error:
        raise DownloadError(f"{error} {_HOME_HINT}") from error.__cause__


def _disk_error(path: Path, error: OSError, size: int = 0) -> DownloadError:
    return DownloadError(f"cannot write '{path}': {storage_reason(error, path, size)} {_HOME_HINT}")


def file_sha256(path: Path) -> str:
    """sha256 (hex) of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sha256(path: Path, manifest: Path, *, key: str) -> tuple[str, bool]:
    """The sha256 of a file, and whether one is recorded for `key` (it is then the same).

    Raises:
        DownloadError: another one is recorded (the file is deleted), or the manifest cannot be read.
    """
    digest = file_sha256(path)
    known = _read_manifest(manifest).get(key)
    if known not in (None, digest):
        path.unlink(missing_ok=True)
        raise DownloadError(
            f"'{key}' has sha256 {digest} but {known} was recorded in '{manifest}'; it was deleted. Try again; if the "
            "publisher changed the file, remove that entry."
        )
    return digest, known is not None


def record_sha256(digest: str, manifest: Path, *, key: str) -> None:
    """Remember the checksum of a file that proved good, so that later downloads are held to it."""
    _write_note(manifest, {**_read_manifest(manifest), key: digest})


def _read_manifest(manifest: Path) -> dict[str, str]:
    try:
        content = json.loads(manifest.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise DownloadError(
            f"'{manifest}' cannot be read ({error}); delete it to record the checksums again."
        ) from error
    if not isinstance(content, dict):
        raise DownloadError(f"'{manifest}' does not hold checksums; delete it to record them again.")
    return {str(k): str(v) for k, v in content.items()}
