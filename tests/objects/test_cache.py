from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.objects import cache
from neuralgrasps.objects.cache import cache_key, home_folder, read_cache, write_cache


def test_home_folder_is_the_variable_or_the_platforms(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path))
    assert home_folder() == tmp_path
    monkeypatch.setenv("NEURALGRASPS_HOME", "  ")
    assert home_folder().name == "neuralgrasps"


def test_round_trip(fresh_home: Path):
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.array([1, 2], dtype=np.int64)}
    assert write_cache("k", arrays, {"note": "x"}) is None
    stored = read_cache("k")
    assert stored is not None
    assert stored[1] == {"note": "x"}
    for name, value in arrays.items():
        np.testing.assert_array_equal(stored[0][name], value)
        assert stored[0][name].dtype == value.dtype
    assert [f.suffix for f in (fresh_home / "cache" / "objects").iterdir()] == [".safetensors"]


def test_missing_and_damaged_files_are_no_answer(fresh_home: Path):
    assert read_cache("k") is None
    write_cache("k", {"a": np.zeros(1000)}, {})
    file = fresh_home / "cache" / "objects" / "k.safetensors"
    file.write_bytes(file.read_bytes()[:100])
    assert read_cache("k") is None
    file.write_bytes(b"")
    assert read_cache("k") is None


def test_key_depends_on_content_options_and_version(monkeypatch: pytest.MonkeyPatch):
    key = cache_key("abc", {"x": 1, "y": 2.0})
    assert key == cache_key("abc", {"y": 2.0, "x": 1})
    assert len({key, cache_key("abd", {"x": 1, "y": 2.0}), cache_key("abc", {"x": 2, "y": 2.0})}) == 3
    monkeypatch.setattr(cache, "CACHE_VERSION", "other")
    assert cache_key("abc", {"x": 1, "y": 2.0}) != key


def test_a_folder_that_cannot_be_made_is_a_note(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("NEURALGRASPS_HOME", str(blocked))
    note = write_cache("k", {"a": np.zeros(2)}, {})
    assert note is not None and note.startswith("not cached")
    assert read_cache("k") is None


def test_a_full_disk_is_a_note_and_keeps_the_old_entry(monkeypatch: pytest.MonkeyPatch, fresh_home: Path):
    write_cache("k", {"a": np.ones(2)}, {})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    note = write_cache("k", {"a": np.zeros(2)}, {})
    assert note is not None and "disk is full" in note
    stored = read_cache("k")
    assert stored is not None and (stored[0]["a"] == 1).all()
    assert len(list((fresh_home / "cache" / "objects").iterdir())) == 1
