"""Joints by a landmark model that the user gives. Its library is not needed here: a stand-in answers for it."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import project
from neuralgrasps.human.video.landmarker import LandmarkerMissingError, landmark_joints

LAST = 23


class _Landmarker:
    """Answers with hands (21, 3) in shares of the image, the surest last."""

    def __init__(self, hands):
        self.hands = hands

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def detect(self, image):
        assert image["data"].dtype == np.uint8
        marks = [[SimpleNamespace(x=x, y=y, z=z) for x, y, z in hand] for hand in self.hands]
        sure = [[SimpleNamespace(score=0.5 + 0.4 * k, category_name="Left")] for k in range(len(marks))]
        return SimpleNamespace(hand_landmarks=marks, handedness=sure)


def _library(hands, refuse=False):
    def create(options):
        if refuse:
            raise RuntimeError("not a zip archive")
        assert options["num_hands"] == 2 and options["base_options"]["model_asset_path"].endswith("hand.task")
        return _Landmarker(hands)

    vision = SimpleNamespace(
        HandLandmarkerOptions=dict, RunningMode=SimpleNamespace(IMAGE=1),
        HandLandmarker=SimpleNamespace(create_from_options=create),
    )  # fmt: skip
    return SimpleNamespace(
        tasks=SimpleNamespace(vision=vision, BaseOptions=dict), Image=dict, ImageFormat=SimpleNamespace(SRGB=0)
    )


@pytest.fixture
def task(tmp_path):
    path = tmp_path / "hand.task"
    path.write_bytes(b"model")
    return path


@pytest.fixture
def frame(grasp_video):
    return replace(grasp_video.frames[LAST], colour=np.zeros((240, 320, 3), np.uint8))


def test_landmarks_are_lifted(grasp_video, frame, task, monkeypatch):
    points, k = grasp_video.joints_C[LAST], frame.intrinsics
    depth = (points[:, 2] / points[0, 2] - 1.0) * k.fx
    hand = np.column_stack([project(points, k), depth]) / [k.width, k.height, k.width]
    monkeypatch.setitem(sys.modules, "mediapipe", _library([hand * 0.5, hand]))
    seen = landmark_joints([frame], task)[0]
    assert np.linalg.norm(seen.points_C - points, axis=1).mean() < 0.015
    assert seen.weight.max() <= 0.9
    monkeypatch.setitem(sys.modules, "mediapipe", _library([]))
    assert landmark_joints([frame], task) == [None]


def test_a_missing_library_is_explained(frame, task, monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(LandmarkerMissingError, match="pip install mediapipe"):
        landmark_joints([frame], task)


def test_wrong_models_and_frames_are_explained(grasp_video, frame, task, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"none\.task' does not exist"):
        landmark_joints([frame], tmp_path / "none.task")
    with pytest.raises(InputError, match="has no colour image"):
        landmark_joints([grasp_video.frames[LAST]], task)
    monkeypatch.setitem(sys.modules, "mediapipe", _library([], refuse=True))
    with pytest.raises(InputError, match="cannot be used as a hand landmarker: not a zip archive"):
        landmark_joints([frame], task)
    monkeypatch.setitem(sys.modules, "mediapipe", _library([np.zeros((33, 3))]))
    with pytest.raises(InputError, match="33 landmarks per hand; expected 21"):
        landmark_joints([frame], task)
