"""A known object in one frame, with a person in it or without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception import object_sighting
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.object_sighting import sight


@pytest.fixture
def behind(things, look, standing):
    """A frame of a thing that stands behind a bar, as behind a finger, and the bar's pixels."""

    def make(name, *, bar, at, yaw_rad=1.0, noise=None):
        obj = things[name]
        X = np.eye(4)
        X[:3, 3] = at
        seen = look(obj.mesh, standing(obj, yaw_rad=yaw_rad), others=[(box_mesh(bar), X)], noise=noise)
        return obj, Frame(seen.depth, seen.intrinsics), seen.masks[0], seen.X_CO

    return make


def test_what_a_hand_hides_speaks_for_nothing(behind):
    obj, frame, hand, truth = behind("wedge", bar=[0.02, 0.05, 0.2], at=[0.1, 0.07, 0.1])
    found = sight(frame, 0, obj, hidden=hand)
    assert found.found and found.pose.confidence > 0.95
    assert pose_errors(obj, found.pose.X_CO, truth).mssd_m < 3e-3


def test_the_pieces_that_a_finger_leaves_of_a_thing_are_one_thing(behind):
    obj, frame, hand, truth = behind("box", bar=[0.02, 0.015, 0.2], at=[0.1, 0.045, 0.1])
    found = sight(frame, 0, obj, hidden=hand)
    assert found.found and found.pose.confidence > 0.95
    assert pose_errors(obj, found.pose.X_CO, truth).mssd_m < 3e-3


def test_a_part_that_another_pose_explains_in_part_is_not_enough_under_a_hand(behind):
    obj, frame, hand, _ = behind("wedge", bar=[0.02, 0.05, 0.2], at=[0.1, 0.07, 0.1])
    found = sight(frame, 0, obj, hidden=hand)
    doubtful = replace(found.pose, confidence=0.95, score=0.89)
    assert not replace(found, pose=doubtful).found
    assert replace(found, pose=doubtful, hidden=False).found


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        ([(0.85, 0.70), (0.82, 0.97), (0.10, 0.50)], (0.82, 0.97)),  # the pieces together are not accepted
        ([(0.10, 0.50), (0.95, 0.70), (0.94, 0.97)], (0.94, 0.97)),  # surer, but half of the view is not explained
        ([(0.85, 0.95)], (0.85, 0.95)),  # pieces that are accepted end the search
        ([(0.10, 0.95), (0.60, 0.95), (0.30, 0.99)], (0.60, 0.95)),  # none is: the surest
    ],
)
def test_under_a_hand_a_pose_that_counts_as_found_goes_before_a_surer_one(behind, monkeypatch, given, taken):
    obj, frame, hand, _ = behind("box", bar=[0.02, 0.015, 0.2], at=[0.1, 0.045, 0.1])
    pose, left = sight(frame, 0, obj, hidden=hand).pose, iter(given)

    def seen(*_, **__):
        confidence, score = next(left)
        return replace(pose, confidence=confidence, score=score)

    monkeypatch.setattr(object_sighting, "_pose", seen)
    found = sight(frame, 0, obj, hidden=hand)
    assert (found.pose.confidence, found.pose.score) == taken and next(left, None) is None
