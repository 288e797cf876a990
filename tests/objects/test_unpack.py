from __future__ import annotations

import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import DataFormatError
from neuralgrasps.objects.unpack import unpack_tar

MakeTar = Callable[..., Path]


def special(kind: bytes, name: str = "x", target: str = "/etc/passwd") -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info


def test_files_are_unpacked_in_order(make_tar: MakeTar, tmp_path: Path):
    archive = make_tar(tmp_path / "a.tgz", special(tarfile.DIRTYPE, "d"), ("d/one", b"1"), ("d/e/two", b"22"))
    files = unpack_tar(archive, tmp_path / "out")
    assert [f.relative_to(tmp_path / "out").as_posix() for f in files] == ["d/one", "d/e/two"]
    assert [f.read_bytes() for f in files] == [b"1", b"22"]


@pytest.mark.parametrize("name", ["/abs", "../up", "a/../../up", "a\\..\\up", "C:evil"])
def test_names_that_lead_out_are_refused(make_tar: MakeTar, tmp_path: Path, name: str):
    archive = make_tar(tmp_path / "a.tgz", (name, b"evil"))
    with pytest.raises(DataFormatError, match="leads out"):
        unpack_tar(archive, tmp_path / "deep" / "out")
    assert sorted(p.name for p in tmp_path.rglob("*")) in (["a.tgz"], ["a.tgz", "deep", "out"])


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_are_refused(make_tar: MakeTar, tmp_path: Path, kind: bytes):
    archive = make_tar(tmp_path / "a.tgz", special(kind))
    with pytest.raises(DataFormatError, match="link or device"):
        unpack_tar(archive, tmp_path / "out")


def test_a_link_cannot_redirect_a_later_file(make_tar: MakeTar, tmp_path: Path):
    archive = make_tar(tmp_path / "a.tgz", special(tarfile.SYMTYPE, "d", str(tmp_path)), ("d/evil", b"evil"))
    with pytest.raises(DataFormatError):
        unpack_tar(archive, tmp_path / "out")
    assert not (tmp_path / "evil").exists()


def test_limits_on_bytes_and_files(make_tar: MakeTar, tmp_path: Path):
    archive = make_tar(tmp_path / "a.tgz", ("a", bytes(1000)), ("b", bytes(1000)))
    assert len(unpack_tar(archive, tmp_path / "fine", max_bytes=2000, max_files=2)) == 2
    with pytest.raises(DataFormatError, match="more than"):
        unpack_tar(archive, tmp_path / "bytes", max_bytes=1999)
    with pytest.raises(DataFormatError, match="more than"):
        unpack_tar(archive, tmp_path / "files", max_files=1)


@pytest.mark.parametrize("keep", [0, 10, 3000])
def test_damaged_archives_are_plain_errors(make_tar: MakeTar, tmp_path: Path, keep: int):
    archive = make_tar(tmp_path / "a.tgz", ("a", np.random.default_rng(0).bytes(6000)))
    archive.write_bytes(archive.read_bytes()[:keep])
    with pytest.raises(DataFormatError, match="cannot be unpacked"):
        unpack_tar(archive, tmp_path / "out")
