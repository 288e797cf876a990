"""Lifted joints: other pixels than the hand's say nothing of its depth, and a guessed posture bends the right way."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.geometry.camera import project
from neuralgrasps.human.video.joint_files import read_joints
from neuralgrasps.human.video.landmarker import landmark_joints
from neuralgrasps.human.video.lift import lift_joints
from tests.human.video.test_landmarker import _library
from tests.human.video.test_lift import LAST, _error, _picture

NUMBERS = range(14, 24, 2)


def test_what_is_nearer_beside_the_hand_does_not_count(grasp_video):
    frame, mask = grasp_video.frames[LAST], grasp_video.masks[LAST]
    picture = _picture(grasp_video)
    beside = replace(frame, depth=np.where(mask, frame.depth, np.maximum(frame.depth - 0.1, 0.1)))
    seen, expected = (lift_joints(picture, f, scale=0.8, mask=mask) for f in (beside, frame))
    np.testing.assert_allclose(seen.points_C, expected.points_C, atol=1e-9)
    assert _error(lift_joints(picture, beside, scale=0.8), grasp_video) > _error(seen, grasp_video) + 0.001


def test_a_guessed_posture_bends_the_right_way(grasp_video):
    """Relative depths taken from the posture that fits the picture have the sign of the true ones."""
    for n in NUMBERS:
        picture = _picture(grasp_video, n, relative=False)
        seen = lift_joints(picture, grasp_video.frames[n], scale=0.8, mask=grasp_video.masks[n])
        assert _error(seen, grasp_video, n) < 0.009


def test_a_file_that_does_not_say_the_side_gets_it_from_the_posture(grasp_video, tmp_path):
    mirrored = grasp_video.mirrored()
    frames = [mirrored.frames[n] for n in NUMBERS]
    pixels = [project(mirrored.joints_C[n], f.intrinsics).tolist() for n, f in zip(NUMBERS, frames, strict=True)]
    file = tmp_path / "joints.json"
    file.write_text(json.dumps(pixels))
    assert {s.side for s in read_joints(file, frames)} == {"left"}
    file.write_text(json.dumps([{"pixels": p, "side": "right"} for p in pixels]))
    assert {s.side for s in read_joints(file, frames)} == {"right"}  # what is said is believed


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_landmark_models_hand_has_the_side_that_is_asked_for(grasp_video, tmp_path, monkeypatch, side):
    frame = replace(grasp_video.frames[LAST], colour=np.zeros((240, 320, 3), np.uint8))
    task = tmp_path / "hand.task"
    task.write_bytes(b"model")
    points, k = grasp_video.joints_C[LAST], frame.intrinsics
    depth = (points[:, 2] / points[0, 2] - 1.0) * k.fx
    hand = np.column_stack([project(points, k), depth]) / [k.width, k.height, k.width]
    monkeypatch.setitem(sys.modules, "mediapipe", _library([hand]))
    assert landmark_joints([frame], task, side=side)[0].side == side
