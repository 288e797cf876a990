"""Boxes of hands over time."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics, project
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.human.video.sighting import distinct, joints_box, linked_paths, overlap, side_vote

CAMERA = Intrinsics(300.0, 300.0, 160.0, 120.0, 320, 240)


def _box(u: float, v: float, size: float = 60.0, score: float = 0.9, side: str = "right", sure: float = 0.9) -> HandBox:
    half = size / 2
    return HandBox(u_min=u - half, v_min=v - half, u_max=u + half, v_max=v + half, score=score, side=side,
                   side_score=sure)  # fmt: skip


def test_two_hands_are_two_paths():
    found = {n: [_box(60 + 4 * n, 60), _box(250 - 4 * n, 180, score=0.8)] for n in range(0, 20, 2)}
    found[8] = found[8][::-1]  # the order in a frame says nothing
    found[10] = found[10][:1]
    first, second = linked_paths(found, least_score=0.4)
    assert len(first.boxes) == 10 and len(second.boxes) == 9
    assert all(box.v_min == 30 for box in first.boxes.values())


def test_weak_boxes_and_doubles_are_left_out():
    found = {0: [_box(100, 100), _box(104, 102, score=0.7), _box(250, 50, score=0.2)]}
    assert len(linked_paths(found, least_score=0.4)) == 1
    assert distinct(found[0][:2]) == found[0][:1]


def test_overlap_is_of_the_smaller_box():
    assert overlap(_box(100, 100, 60), _box(100, 100, 30)) == pytest.approx(1.0)
    assert overlap(_box(100, 100, 60), _box(130, 100, 60)) == pytest.approx(0.5)
    assert overlap(_box(100, 100, 60), _box(200, 100, 60)) == 0.0


def test_a_box_holds_the_joints_and_some_room():
    points = np.random.default_rng(0).normal(size=(21, 3)) * 0.03 + [0.0, 0.0, 0.6]
    points[5] = np.nan
    seen = SeenJoints(points_C=points, weight=np.ones(21), mask=None, side="left", source="test")
    box = joints_box(seen, CAMERA)
    pixels = project(points[np.arange(21) != 5], CAMERA)
    assert box is not None and box.side == "left"
    assert (pixels.min(axis=0) > [box.u_min, box.v_min]).all() and (pixels.max(axis=0) < [box.u_max, box.v_max]).all()
    far = SeenJoints(
        points_C=points + np.array([3.0, 0.0, 0.0]), weight=np.ones(21), mask=None, side="left", source="test"
    )
    assert joints_box(far, CAMERA) is None


def test_sides_are_voted_by_how_sure_the_boxes_are():
    boxes = [_box(0, 0, sure=0.55), _box(0, 0, sure=0.55), _box(0, 0, side="left", sure=0.95)]
    assert side_vote(boxes) == pytest.approx((0.05 + 0.05 - 0.45) / 3)
    assert side_vote([_box(0, 0, score=0.0)]) == 0.0
