"""Files are written whole or not at all."""

from __future__ import annotations

import errno
import os
import resource
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from neuralgrasps.errors import StorageError
from neuralgrasps.files import storage_reason, write_whole


@pytest.fixture
def no_room() -> Iterator[None]:
    """Files of this process cannot grow past 1 kB."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_bytes_and_text_are_written_as_they_are(tmp_path):
    assert write_whole(tmp_path / "a" / "b" / "c.bin", b"\x00\xff") == tmp_path / "a" / "b" / "c.bin"
    assert (tmp_path / "a" / "b" / "c.bin").read_bytes() == b"\x00\xff"
    write_whole(str(tmp_path / "t.txt"), "pâle\n")
    assert (tmp_path / "t.txt").read_bytes() == "pâle\n".encode()


def test_an_old_file_is_replaced_and_nothing_else_is_left(tmp_path):
    write_whole(tmp_path / "x", b"old")
    write_whole(tmp_path / "x", b"new")
    assert (tmp_path / "x").read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_a_file_gets_the_rights_that_the_user_gives_new_files(tmp_path):
    before = os.umask(0o027)
    try:
        path = write_whole(tmp_path / "x", b"")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_failed_write_keeps_the_old_file_and_leaves_no_trace(tmp_path, no_room):
    write_whole(tmp_path / "x", b"old")
    with pytest.raises(StorageError, match="cannot write"):
        write_whole(tmp_path / "x", b"n" * 5000)
    assert (tmp_path / "x").read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_an_interrupted_write_leaves_no_trace(tmp_path, monkeypatch):
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "x", b"data")
    assert list(tmp_path.iterdir()) == []


def test_a_path_through_a_file_says_so(tmp_path):
    (tmp_path / "f").write_text("")
    with pytest.raises(StorageError, match="runs through a file"):
        write_whole(tmp_path / "f" / "x", b"")
    with pytest.raises(StorageError, match="runs through a file"):
        write_whole(tmp_path / "f" / "y" / "x", b"")


def test_a_path_that_is_a_folder_says_so(tmp_path):
    (tmp_path / "d").mkdir()
    with pytest.raises(StorageError, match="names a folder"):
        write_whole(tmp_path / "d", b"")
    assert [p.name for p in tmp_path.iterdir()] == ["d"]


def test_a_missing_folder_is_made_only_on_request(tmp_path):
    with pytest.raises(StorageError, match="does not exist"):
        write_whole(tmp_path / "d" / "x", b"", make_folder=False)
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    ("code", "says"),
    [
        (errno.ENOSPC, "free at least 3.0 MB"),
        (errno.EDQUOT, "disk is full"),
        (errno.EROFS, "no permission"),
        (errno.EACCES, "no permission"),
        (errno.EIO, "Input/output error"),
    ],
)
def test_reasons_name_the_remedy(code, says):
    assert says in storage_reason(OSError(code, os.strerror(code)), Path("/a/b"), 3_000_000)


def test_an_existing_folder_is_not_said_to_be_missing(tmp_path):
    missing = OSError(errno.ENOENT, os.strerror(errno.ENOENT))
    assert "takes no new files" in storage_reason(missing, tmp_path / "x", 0)
    assert "does not exist" in storage_reason(missing, tmp_path / "none" / "x", 0)
