from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import DownloadError, InputError, MeshError, StorageError, UnknownNameError
from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.objects.download import fetch_file
from neuralgrasps.objects.store import ply_bytes, stored_mesh_file
from neuralgrasps.objects.ycb import download_ycb, import_object
from neuralgrasps.objects.zoo import load_object, object_names

MakeTar = Callable[..., Path]
BOX = box_mesh((0.014, 0.043, 0.037))


class Server(ThreadingHTTPServer):
    """Serves `files`; notes each request's Range header; breaks off after `cut` bytes while `cuts` lasts."""

    files: dict[str, bytes]
    ranges: list[str | None]
    cut: int
    cuts: int
    etag: str

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        wanted = self.headers.get("Range")
        self.server.ranges.append(wanted)
        data = self.server.files.get(self.path)
        if data is None:
            self.send_error(404)
            return
        start = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted else 0
        fresh = wanted is None or self.headers.get("If-Range") != self.server.etag
        start = 0 if fresh else start
        if start >= len(data):
            self.send_error(416)
            return
        self.send_response(200 if fresh else 206)
        self.send_header("Content-Length", str(len(data) - start))
        self.send_header("ETag", self.server.etag)
        self.send_header("Connection", "close")
        self.end_headers()
        body = data[start:]
        if self.server.cuts > 0:
            self.server.cuts -= 1
            body = body[: self.server.cut]
        self.wfile.write(body)
        self.close_connection = True

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server(("127.0.0.1", 0), Handler)
    server.files, server.ranges, server.cut, server.cuts, server.etag = {}, [], 0, 0, '"v1"'
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def serve_box(make_tar: MakeTar, server: Server, tmp_path: Path, ycb_id: str = "009_gelatin_box") -> bytes:
    archive = make_tar(tmp_path / "box.tgz", (f"{ycb_id}/google_16k/nontextured.ply", ply_bytes(BOX)), ("x", b"y"))
    data = archive.read_bytes()
    server.files[f"/google/{ycb_id}_google_16k.tgz"] = data
    return data


def test_downloaded_objects_are_found_by_name(make_tar: MakeTar, server: Server, tmp_path: Path, fresh_home: Path):
    serve_box(make_tar, server, tmp_path)
    assert download_ycb(["gelatin_box"], url=server.url) == ("009_gelatin_box",)
    obj = load_object("009_gelatin_box")
    assert obj.content_hash == BOX.content_hash()
    assert obj.mass_kg == 0.097
    assert "first use" in obj.provenance["source"] and obj.provenance["licence"].startswith("CC BY 4.0")
    assert "009_gelatin_box" in object_names()
    np.testing.assert_allclose(load_object("gelatin_box").mesh.extents, (0.028, 0.085, 0.073), atol=1e-6)
    assert load_object("gelatin_box").content_hash != obj.content_hash  # still the stand-in
    assert download_ycb(["gelatin_box"], url=server.url) == ("009_gelatin_box",)
    assert len(server.ranges) == 1  # nothing to fetch the second time
    assert sorted(p.name for p in (fresh_home / "downloads").iterdir()) == ["checksums.json"]


def test_a_dropped_connection_is_taken_up_where_it_stopped(server: Server, tmp_path: Path):
    data = bytes(range(256)) * 2000
    server.files["/f"] = data
    server.cut, server.cuts = 100_000, 2
    seen: list[int] = []
    fetch_file(f"{server.url}/f", tmp_path / "f", progress=lambda name, done, total: seen.append(done))
    assert (tmp_path / "f").read_bytes() == data
    assert server.ranges == [None, "bytes=100000-", "bytes=200000-"]
    assert seen == sorted(seen) and seen[-1] == len(data)
    assert [p.name for p in tmp_path.iterdir()] == ["f"]


def test_an_interrupted_run_is_continued_by_the_next(server: Server, tmp_path: Path):
    data = bytes(range(256)) * 2000
    server.files["/f"] = data
    server.cut, server.cuts = 50_000, 3
    with pytest.raises(DownloadError, match="goes on from there"):
        fetch_file(f"{server.url}/f", tmp_path / "f")
    assert not (tmp_path / "f").exists()
    fetch_file(f"{server.url}/f", tmp_path / "f")
    assert server.ranges[-1] == "bytes=150000-"
    assert (tmp_path / "f").read_bytes() == data


def test_two_versions_are_never_glued_together(server: Server, tmp_path: Path):
    server.files["/f"] = b"a" * 1000
    server.cut, server.cuts = 100, 3
    with pytest.raises(DownloadError):
        fetch_file(f"{server.url}/f", tmp_path / "f")
    server.files["/f"], server.etag = b"b" * 1000, '"v2"'
    fetch_file(f"{server.url}/f", tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == b"b" * 1000


def test_a_wrong_checksum_is_refused(make_tar: MakeTar, server: Server, tmp_path: Path, fresh_home: Path):
    serve_box(make_tar, server, tmp_path)
    manifest = fresh_home / "downloads" / "checksums.json"
    manifest.parent.mkdir(parents=True)
    manifest.write_text(json.dumps({"009_gelatin_box_google_16k.tgz": "0" * 64}))
    with pytest.raises(DownloadError, match="was recorded"):
        download_ycb(["009_gelatin_box"], url=server.url)
    assert stored_mesh_file("009_gelatin_box") is None
    assert [p.name for p in manifest.parent.iterdir()] == ["checksums.json"]


@pytest.mark.parametrize("entry", ["../../../evil", "/tmp/evil"])
def test_a_malicious_archive_changes_nothing(
    make_tar: MakeTar, server: Server, tmp_path: Path, fresh_home: Path, entry: str
):
    data = make_tar(tmp_path / "evil.tgz", (entry, b"evil")).read_bytes()
    server.files["/google/009_gelatin_box_google_16k.tgz"] = data
    with pytest.raises(DownloadError, match="leads out"):
        download_ycb(["009_gelatin_box"], url=server.url)
    assert not any(p.is_file() for p in fresh_home.rglob("*"))  # not even a checksum of it


def test_an_archive_without_a_mesh_is_refused(make_tar: MakeTar, server: Server, tmp_path: Path, fresh_home: Path):
    server.files["/google/009_gelatin_box_google_16k.tgz"] = make_tar(tmp_path / "a", ("x", b"")).read_bytes()
    with pytest.raises(DownloadError, match="holds no mesh"):
        download_ycb(["009_gelatin_box"], url=server.url)


def test_being_offline_or_a_missing_file_is_a_plain_error(server: Server, fresh_home: Path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(DownloadError, match="Check the network"):
        download_ycb(["009_gelatin_box"], url=f"http://127.0.0.1:{port}", timeout_s=2.0)
    with pytest.raises(DownloadError, match="404"):
        download_ycb(["009_gelatin_box"], url=server.url)
    with pytest.raises(DownloadError, match="https://"):
        download_ycb(["009_gelatin_box"], url="file:///etc")


def test_a_silent_server_times_out(fresh_home: Path):
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        with pytest.raises(DownloadError, match="timed out"):
            download_ycb(["009_gelatin_box"], url=f"http://127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.1)


def test_a_file_over_the_limit_is_refused(server: Server, tmp_path: Path):
    server.files["/f"] = bytes(2000)
    with pytest.raises(DownloadError, match="at most 1000"):
        fetch_file(f"{server.url}/f", tmp_path / "f", max_bytes=1000)


def test_a_full_disk_is_a_plain_error(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    server.files["/f"] = bytes(2000)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DownloadError, match=r"disk is full.*NEURALGRASPS_HOME"):
        fetch_file(f"{server.url}/f", tmp_path / "f")


def test_only_ycb_names_are_asked_for(fresh_home: Path):
    with pytest.raises(UnknownNameError, match="005_tomato_soup_can"):
        download_ycb(["tomato"])
    with pytest.raises(InputError):
        download_ycb(["003_../../x"])


def test_import_keeps_the_mesh_exactly(tmp_path: Path, fresh_home: Path):
    path = tmp_path / "my box.ply"
    path.write_bytes(ply_bytes(BOX))
    with pytest.raises(InputError, match="cannot be used"):
        import_object(path)
    assert import_object(path, "my_box") == "my_box"
    obj = load_object("my_box")
    assert obj.content_hash == BOX.content_hash()
    assert "my box.ply" in obj.provenance["source"]
    with pytest.raises(InputError, match="imported before"):
        import_object(path, "my_box")
    import_object(path, "my_box", replace=True)
    with pytest.raises(InputError, match="built-in"):
        import_object(path, "cracker_box")
    with pytest.raises(UnknownNameError, match="Did you mean 'my_box'"):
        load_object("my_bo")


def test_import_of_bad_files_and_folders_is_a_plain_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "bad.ply").write_text("nonsense")
    with pytest.raises(MeshError):
        import_object(tmp_path / "bad.ply")
    path = tmp_path / "box.ply"
    path.write_bytes(ply_bytes(BOX))
    monkeypatch.setenv("NEURALGRASPS_HOME", str(path))  # a file, not a folder
    with pytest.raises(StorageError, match="NEURALGRASPS_HOME"):
        import_object(path)
