"""A known object over a video."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import look_at
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.perception import object_video
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.object_sighting import sight, without
from neuralgrasps.perception.object_video import follow_object

FRAMES = 16


@pytest.fixture
def film(things, look, standing):
    """Frames of a wedge that stands, is lifted from frame 10 on, and a ball that comes near from frame 4 on."""
    obj = things["wedge"]
    X_WO = standing(obj, yaw_rad=1.0)

    def make(*, lifted=True, ball=True, known_camera=False):
        frames, poses = [], []
        for k in range(FRAMES):
            X = X_WO.copy()
            X[2, 3] += 0.008 * max(0, k - 9) if lifted else 0.0
            others = []
            if ball and k >= 4:
                others = [(sphere_mesh(0.02, segments=24), _at(X[:3, 3] + [0.06, 0.05, 0.03]))]
            seen = look(obj.mesh, X, others=others)
            frames.append(Frame(seen.depth, seen.intrinsics, X_WC=seen.X_WC if known_camera else None, name=f"{k}"))
            poses.append(seen.X_CO)
        return obj, frames, np.stack(poses)

    return make


def _at(place):
    X = np.eye(4)
    X[:3, 3] = place
    return X


def _errors(obj, found, truth):
    return [pose_errors(obj, a, b).mssd_m for a, b in zip(found, truth, strict=True)]


def test_what_stands_still_keeps_one_pose(film):
    obj, frames, truth = film(lifted=False)
    found = follow_object(frames, obj)
    assert found.reason == "" and found.moves_from is None and found.lost_from is None
    assert max(_errors(obj, found.X_CO, truth)) < 2e-3
    assert np.abs(found.X_CO - found.X_CO[0]).max() == 0.0
    assert (found.seen > 0.5).all()


def test_what_is_lifted_is_followed_from_then_on(film):
    obj, frames, truth = film()
    found = follow_object(frames, obj)
    assert found.moves_from is not None and 10 <= found.moves_from <= 13
    assert found.lost_from is None
    assert max(_errors(obj, found.X_CO, truth)) < 0.02  # a pose is kept until enough pixels speak against it
    assert _errors(obj, found.X_CO, truth)[-1] < 4e-3


def test_a_person_in_the_first_frames_is_looked_past(film):
    obj, frames, truth = film(lifted=False, ball=False)
    lump = np.zeros(frames[0].depth.shape, bool)
    lump[60:130, 90:150] = True
    broken = [Frame(np.where(lump, 0.3, f.depth), f.intrinsics, name=f.name) for f in frames]
    assert follow_object(broken, obj, hidden=lambda k: lump).reason != ""  # nothing is left of it
    mixed = [*frames[:2], *broken[2:]]
    found = follow_object(mixed, obj, hidden=lambda k: lump if k >= 2 else None)
    assert found.found_in < 2 and max(_errors(obj, found.X_CO, truth)) < 2e-3
    assert (found.seen[2:] < 0.6 * found.seen[0]).all()


def test_an_object_taken_away_is_lost_not_invented(film):
    obj, frames, _ = film(lifted=False, ball=False)
    empty = Frame(_empty_table(frames[0]), frames[0].intrinsics)
    found = follow_object([*frames[:5], empty, empty], obj)
    assert found.lost_from == 5
    assert np.isfinite(found.X_CO[:5]).all() and np.isnan(found.X_CO[5:]).all()


def test_what_is_found_late_is_followed_back(film):
    obj, frames, truth = film(ball=False)
    lump = np.zeros(frames[0].depth.shape, bool)
    lump[60:130, 90:150] = True
    late = [*(Frame(np.where(lump, 0.3, f.depth), f.intrinsics) for f in frames[:1]), *frames[11:]]
    found = follow_object(late, obj, hidden=lambda k: lump if k == 0 else np.zeros_like(lump))
    assert found.found_in >= 1 and found.reason == ""
    assert max(_errors(obj, found.X_CO[1:], truth[11:])) < 0.02
    backwards = follow_object(frames[::-1], obj)  # lifted at first, and put down
    assert backwards.lost_from is None
    assert max(_errors(obj, backwards.X_CO, truth[::-1])) < 0.02


def test_what_is_not_there_before_the_person_comes_is_not_the_object(film):
    obj, frames, _ = film(lifted=False, ball=False)
    empty = Frame(_empty_table(frames[0]), frames[0].intrinsics)
    nobody = np.zeros(frames[0].depth.shape, bool)
    found = follow_object([empty, empty, *frames[:3]], obj, hidden=lambda k: nobody if k >= 2 else None)
    assert found.found_in == -1 and "is not there in frame 0, before the person comes" in found.reason
    assert np.isnan(found.X_CO).all()


def test_a_camera_that_moves_and_knows_it_changes_nothing(film, things, look, standing):
    obj, _, _ = film()
    X_WO = standing(obj, yaw_rad=1.0)
    frames, truth = [], []
    for k in range(6):
        seen = look(obj.mesh, X_WO, X_WC=look_at(np.array([0.50, 0.18 - 0.02 * k, 0.42]), np.array([0.0, 0.0, 0.04])))
        frames.append(Frame(seen.depth, seen.intrinsics, X_WC=seen.X_WC))
        truth.append(seen.X_CO)
    found = follow_object(frames, obj)
    assert found.moves_from is None
    assert max(_errors(obj, found.X_CO, truth)) < 2e-3
    frames[2] = Frame(frames[2].depth, frames[2].intrinsics, name="third")
    with pytest.raises(InputError, match=r"1 of 6 frames have no camera pose X_WC: 2 \('third'\)"):
        follow_object(frames, obj)


def test_another_thing_is_not_taken_for_it(things, look, standing):
    seen = look(things["ball"].mesh, standing(things["ball"]))
    found = follow_object([Frame(seen.depth, seen.intrinsics)], things["corner"])
    assert "does not look like 'corner'" in found.reason
    assert np.isnan(found.X_CO).all() and found.table_O is None


def test_the_table_is_given_in_the_object_frame(film):
    obj, frames, truth = film(lifted=False)
    plane = follow_object(frames, obj).table_O
    up_O = truth[0][:3, :3].T @ np.linalg.inv(look_at(np.array([0.50, 0.18, 0.42]), np.array([0.0, 0.0, 0.04])))[:3, 2]
    assert plane.normal @ up_O > 0.999
    assert np.abs(plane.height(obj.mesh.vertices).min()) < 2e-3


def test_what_is_only_seen_in_the_air_has_no_table(film):
    obj, frames, _ = film(ball=False)
    found = follow_object(frames[14:], obj)  # lifted by 4 cm and more
    assert found.reason == "" and found.table_O is None
    assert re.search(r"is in no frame seen standing on the table, but at least (39|4\d) mm above it", found.note)


def test_the_table_is_the_one_it_stood_on_though_it_was_found_in_the_air(film):
    obj, frames, _ = film(ball=False)
    found = follow_object(frames[::-1], obj)  # lifted at first, and put down
    assert found.stands_in is not None and found.stands_in >= 5 and found.note == ""
    plane = found.table_O
    assert np.abs(plane.height(obj.mesh.vertices).min()) < 3e-3


def test_a_pose_that_half_a_view_suggests_is_refuted_by_the_other_frames(film, monkeypatch):
    obj, frames, truth = film(lifted=False, ball=False)
    wrong = _at([0.0, 0.03, 0.0]) @ truth[0]

    def seen(frame, number, obj, *, hidden=None, seed=0):
        found = sight(frame, number, obj, hidden=hidden, seed=seed)
        pose = replace(found.pose, confidence=0.8) if number == 0 else replace(found.pose, X_CO=wrong, confidence=0.98)
        return replace(found, pose=pose)

    monkeypatch.setattr(object_video, "sight", seen)
    found = follow_object(frames, obj)
    assert found.found_in == 0 and max(_errors(obj, found.X_CO, truth)) < 2e-3


def test_under_a_hand_the_search_goes_on_until_a_pose_is_accepted(film, monkeypatch):
    obj, frames, truth = film(lifted=False, ball=False)
    nobody = np.zeros(frames[0].depth.shape, bool)

    def seen(frame, number, obj, *, hidden=None, seed=0):
        found = sight(frame, number, obj, hidden=hidden, seed=seed)
        confidence, score = (0.995, 0.85) if number == 0 else (0.97, 0.97)
        return replace(found, pose=replace(found.pose, confidence=confidence, score=score))

    monkeypatch.setattr(object_video, "sight", seen)
    found = follow_object(frames, obj, hidden=lambda k: nobody)
    assert found.reason == "" and found.found_in > 0 and max(_errors(obj, found.X_CO, truth)) < 2e-3


def test_what_is_found_after_it_was_moved_moves_from_the_first_frame_in_which_it_did(film, monkeypatch):
    obj, frames, truth = film(ball=False)  # lifted from frame 10 on
    monkeypatch.setattr(object_video, "_order", lambda count, hidden: [len(frames) - 1])
    found = follow_object(frames, obj)
    assert found.found_in == len(frames) - 1 and max(_errors(obj, found.X_CO, truth)) < 0.02
    assert 8 <= found.moves_from <= 11


def test_no_frames_and_masks_of_everything(film):
    obj, frames, _ = film(lifted=False)
    with pytest.raises(InputError, match="no frames"):
        follow_object([], obj)
    assert without(frames[0], np.ones(frames[0].depth.shape, bool)) is frames[0]


def _empty_table(frame):
    """The depth of the bare table of a frame."""
    X_WC = look_at(np.array([0.50, 0.18, 0.42]), np.array([0.0, 0.0, 0.04]))
    k = frame.intrinsics
    u, v = np.meshgrid((np.arange(k.width) - k.cx) / k.fx, (np.arange(k.height) - k.cy) / k.fy)
    down = X_WC[2, 0] * u + X_WC[2, 1] * v + X_WC[2, 2]
    return np.where(down < -0.05, -X_WC[2, 3] / np.minimum(down, -0.05), 0.0)
