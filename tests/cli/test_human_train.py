"""`neuralgrasps human train`: what it writes and refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from neuralgrasps.human.nets.detect import HandDetector
from neuralgrasps.human.scenes.grasp_bank import save_bank
from tests.cli.conftest import Ended
from tests.human.human_scenes import small_bank

Call = Callable[..., Ended]


def test_a_detector_is_trained_and_measured(ng: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neuralgrasps.cli.human_train._TEST_IMAGES", 8)
    bank, out = tmp_path / "hands.bank", tmp_path / "new" / "detector.safetensors"
    save_bank(small_bank(), bank)
    ended = ng("human", "train", "detector", "--out", out, "--bank", bank, "--images", 4)
    assert ended.code == 0 and ended.result["file"] == str(out) and ended.result["images"] == 8
    assert 0.0 <= ended.result["ap50"] <= 1.0
    HandDetector.load(out)
    assert sorted(path.name for path in out.parent.iterdir()) == [out.name]  # the checkpoint is gone


def test_what_cannot_be_is_refused(ng: Call, tmp_path: Path) -> None:
    asked = ("human", "train", "detector", "--out", tmp_path / "d.safetensors")
    assert "--images is 0" in ng(*asked, "--images", 0).err
    assert "--threads is 0" in ng(*asked, "--threads", 0).err
    assert "a folder" in ng("human", "train", "detector", "--out", tmp_path).err
    start = tmp_path / "none.safetensors"
    joints = ("human", "train", "joints", "--out", tmp_path / "j.safetensors")
    assert "--start belongs to" in ng(*joints, "--start", start).err
    (tmp_path / "hands.bank").write_bytes(b"nothing")
    assert "cannot be read" in ng(*asked).err
