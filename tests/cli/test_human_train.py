"""`neuralgrasps human train`: what it writes and refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from neuralgrasps.human.nets.detect import HandDetector
from neuralgrasps.human.nets.joint_reader import WEIGHTS, JointReader
from neuralgrasps.human.nets.joint_train import test_crops as crops_to_test
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


def test_joints_are_trained_on_from_weights(ng: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neuralgrasps.human.nets.joint_train.test_crops", lambda kit, count: crops_to_test(kit, 24))
    bank, out = tmp_path / "hands.bank", tmp_path / "new" / "joints.safetensors"
    save_bank(small_bank(), bank)
    asked = ("human", "train", "joints", "--out", out, "--bank", bank, "--images", 96, "--threads", 1)
    trained, fresh = ng(*asked, "--start", WEIGHTS), ng(*asked)
    assert trained.code == 0 and trained.result["images"] == 96, trained.err
    assert trained.result["root_relative_mm"] < 30.0 < fresh.result["root_relative_mm"]
    JointReader.load(out)
    assert [path.name for path in out.parent.iterdir()] == [out.name]  # the checkpoint is gone
    (tmp_path / "bad").write_bytes(b"nothing")
    assert "is damaged" in ng(*asked, "--start", tmp_path / "bad").err
    assert "do not exist" in ng(*asked, "--start", tmp_path / "none").err


def test_what_cannot_be_is_refused(ng: Call, tmp_path: Path) -> None:
    asked = ("human", "train", "detector", "--out", tmp_path / "d.safetensors")
    assert "--images is 0" in ng(*asked, "--images", 0).err
    assert "--threads is 0" in ng(*asked, "--threads", 0).err
    assert "a folder" in ng("human", "train", "detector", "--out", tmp_path).err
    (tmp_path / "hands.bank").write_bytes(b"nothing")
    assert "cannot be read" in ng(*asked).err
