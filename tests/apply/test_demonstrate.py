"""From a recorded demonstration to ordered robot grasps, with the nets and grasps that come with the library."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import (
    DemonstrateConfig,
    _hidden,
    box_mask,
    demonstrate,
    demonstration_support,
    load_hand_eyes,
    person_mask,
)
from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.nets.joint_errors import root_relative_error
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.human.skeleton import joint_points
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.model.run_notes import run_folder
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.object_video import follow_object

FEW = DemonstrateConfig(transfer=TransferConfig(count=4, trials=12))


@pytest.fixture(scope="module")
def shown():
    """A right hand takes a gelatin box; frames without the camera's pose, and what is true."""
    obj = load_object("gelatin_box")
    recorded = record_demonstration(
        obj, seed=2, config=DemonstrationConfig(side="right", scale=0.82, lift=False, wall=False)
    )
    frames = [replace(frame, X_WC=None) for frame in recorded.frames]
    known = load_grasps(run_folder("standins7") / "grasps" / obj.name / "fetch.safetensors")
    return obj, frames, recorded.truth, known


@pytest.fixture(scope="module")
def eyes():
    return load_hand_eyes()


def true_joints(truth, *, noise=0.003):
    """Joints as another tool might give them."""
    rng = np.random.default_rng(0)
    return [
        SeenJoints(
            points_C=truth.joints_C[n] + rng.normal(0.0, noise, (21, 3)), weight=np.ones(21),
            mask=truth.hand_mask[n], side=truth.side, source="test",
        ) if truth.visible[n] > 0.4 else None
        for n in range(len(truth.q))
    ]  # fmt: skip


def test_a_video_becomes_grasps_that_touch_alike(shown, eyes):
    obj, frames, truth, known = shown
    found = demonstrate(frames, obj, load_hand("fetch"), detector=eyes[0], reader=eyes[1], known=known, config=FEW)
    assert (found.stage, found.reason) == ("", "")
    track = found.track
    assert track.side == "right" and track.scale == pytest.approx(truth.scale, abs=0.03)
    assert truth.still[0] - 2 <= track.moment < truth.still[1] + 1
    assert root_relative_error(track.grasp.joints_C, truth.joints_C[track.moment]) < 0.010
    assert len(found.grasps) == 4 and found.grasps.validated.all()
    assert (np.diff(found.transfer.similarity) <= 1e-9).all()
    assert set(found.seconds) == {"object", "hand", "transfer"}
    alike = found.transfer.similarity[0]
    assert repr(found) == (
        f"Demonstration(right hand x{track.scale:.2f} on gelatin_box: 4 grasps by fetch, similarity {alike:.2f})"
    )
    assert re.fullmatch(
        rf"HandTrack\(right hand x{track.scale:.2f}: grasp in frame {track.moment} of {len(frames)}, \d+ % sure\)",
        repr(track),
    )
    support = demonstration_support(obj, found.table_O)
    assert support.allows(load_hand("fetch"), found.grasps.X_OH, found.grasps.q, found.grasps.q_pregrasp).all()


def test_a_left_hand_is_read_too(shown, eyes):
    """The video in a mirror; the box is nearly its own image."""
    obj, frames, truth, known = shown
    mirrored = [
        replace(
            frame, depth=frame.depth[:, ::-1].copy(), colour=None,
            intrinsics=replace(frame.intrinsics, cx=frame.intrinsics.width - 1 - frame.intrinsics.cx),
        )
        for frame in frames[::2]
    ]  # fmt: skip
    found = demonstrate(mirrored, obj, load_hand("fetch"), detector=eyes[0], reader=eyes[1], known=known, config=FEW)
    assert (found.stage, found.reason) == ("", "")
    track = found.track
    assert track.side == track.grasp.side == "left" and "left" in found.human.name
    assert track.scale == pytest.approx(truth.scale, abs=0.03)
    assert root_relative_error(track.grasp.joints_C, truth.joints_C[2 * track.moment] * [-1.0, 1.0, 1.0]) < 0.012
    X_CH = found.followed.X_CO[track.moment] @ found.X_OH
    np.testing.assert_allclose(X_CH, track.grasp.X_CH, atol=1e-9)
    joints_O = joint_points(found.human, found.X_OH, found.q)
    seen_O = transform_points_np(inverse_np(found.followed.X_CO[track.moment]), track.grasp.joints_C)
    np.testing.assert_allclose(joints_O, seen_O, atol=1e-6)
    assert (found.query.contact_map > 0.5).any() and found.grasps.validated.all()


def test_joints_of_another_tool_will_do(shown):
    obj, frames, truth, known = shown
    found = demonstrate(frames, obj, load_hand("fetch"), joints=true_joints(truth), known=known, config=FEW)
    assert found.stage == ""
    assert root_relative_error(found.track.grasp.joints_C, truth.joints_C[found.track.moment]) < 0.006
    again = demonstrate(frames, obj, load_hand("fetch"), joints=true_joints(truth), known=known, config=FEW)
    np.testing.assert_array_equal(again.grasps.X_OH, found.grasps.X_OH)


def test_each_stage_says_why_it_failed(shown, eyes):
    obj, frames, truth, known = shown
    see = {"detector": eyes[0], "reader": eyes[1], "known": known, "config": FEW}
    empty = demonstrate(frames[:2], obj, load_hand("fetch"), **see)
    assert repr(empty) == f"Demonstration(failed at detect: {empty.reason})"
    assert repr(empty.track) == f"HandTrack(failed at detect: {empty.reason})"
    assert truth.visible[:2].max() < 0.4 and empty.stage == "detect" and "no hand was found in 2 frames" in empty.reason
    other = demonstrate(frames[:2], load_object("bleach_cleanser"), load_hand("fetch"), **see)
    assert other.stage == "object" and "bleach_cleanser" in other.reason
    assert other.track is None and other.grasps is None

    class Nothing:
        def allows(self, hand, X_OH, q, q_pregrasp=None):
            return np.zeros(len(X_OH), bool)

    none = demonstrate(
        frames, obj, load_hand("fetch"), joints=true_joints(truth), known=known, config=FEW, constraints=Nothing()
    )
    assert none.stage == "transfer" and none.reason != "" and none.query is not None


def test_an_object_that_is_lost_before_the_grasp_is_no_error(shown, monkeypatch):
    obj, frames, truth, known = shown
    lost_from = truth.still[0] - 3

    def lost(*args, **options):
        found = follow_object(*args, **options)
        X_CO = found.X_CO.copy()
        X_CO[lost_from:] = np.nan
        return replace(found, X_CO=X_CO, lost_from=lost_from)

    monkeypatch.setattr("neuralgrasps.apply.demonstrate.follow_object", lost)
    found = demonstrate(frames, obj, load_hand("fetch"), joints=true_joints(truth), known=known, config=FEW)
    assert found.stage == "grasp" and f"the object was lost from frame {lost_from}, before" in found.reason
    assert found.track is not None and found.query is None


def test_what_is_wrong_with_the_depth_is_said_when_the_object_is_not_found(shown):
    obj, frames, truth, _ = shown
    far = [replace(frame, depth=5.0 * frame.depth) for frame in frames[:2]]
    found = demonstrate(far, obj, load_hand("fetch"), joints=true_joints(truth)[:2], config=FEW)
    assert found.stage == "object" and "check the depth scale" in found.reason
    assert found.reason.startswith(found.followed.reason)


def test_a_camera_that_moves_without_saying_where_is_refused(shown):
    obj, frames, *_ = shown
    moved = np.eye(4)
    moved[0, 3] = 0.05
    said = [replace(frames[0], X_WC=np.eye(4)), frames[1], replace(frames[2], X_WC=moved)]
    with pytest.raises(InputError, match="1 of 3 frames have no camera pose"):
        demonstrate(said, obj, load_hand("fetch"), joints=[None] * 3)


def test_joints_that_lie_apart_from_the_depth_are_not_believed(shown):
    obj, frames, truth, known = shown
    off = [
        None if j is None else replace(j, points_C=j.points_C + np.array([0.0, 0.0, -0.07])) for j in true_joints(truth)
    ]
    found = demonstrate(frames, obj, load_hand("fetch"), joints=off, known=known, config=FEW)
    assert found.stage == "grasp" and found.grasps is None


def test_no_frames_or_joints_of_others_are_an_error(shown):
    obj, frames, truth, _ = shown
    with pytest.raises(InputError, match="joints are given for"):
        demonstrate(frames, obj, load_hand("fetch"), joints=true_joints(truth)[:-1])
    with pytest.raises(InputError, match="no frames"):
        demonstrate([], obj, load_hand("fetch"))


@pytest.mark.parametrize(("count", "looks"), [(1, 1), (20, 20), (60, 24), (300, 61), (600, 121)])
def test_a_person_is_looked_for_in_frames_that_are_near_to_each_other(shown, count, looks):
    """In a long video, too: a hand moves by its own width in few frames."""
    looked: list[int] = []

    class Finder:
        def find(self, frame):
            looked.append(int(frame.name))
            return []

    frames = [replace(shown[1][0], name=str(k)) for k in range(count)]
    assert _hidden(frames, Finder(), None, None)(count - 1) is None
    assert len(looked) == looks and (looked[0], looked[-1]) == (0, count - 1)
    assert max(np.diff(looked), default=0) <= 5


def test_boxes_are_hidden_with_some_room():
    box = HandBox(u_min=20.0, v_min=10.0, u_max=40.0, v_max=30.0, score=1.0, side="right", side_score=1.0)
    mask = box_mask([box], (60, 80))
    assert mask[5, 15] and mask[34, 44] and not mask[4, 15] and not mask[5, 14] and not mask[36, 30]
    assert not box_mask([], (60, 80)).any()
    far = HandBox(u_min=-90.0, v_min=-90.0, u_max=-60.0, v_max=-60.0, score=1.0, side="right", side_score=1.0)
    assert not box_mask([far], (60, 80)).any()


def test_hand_and_forearm_are_hidden_and_the_object_is_not(shown):
    obj, frames, truth, _ = shown
    n = truth.grasp_frame
    seen = true_joints(truth, noise=0.0)[n]
    rows, columns = np.nonzero(truth.hand_mask[n])
    box = HandBox(
        u_min=columns.min(), v_min=rows.min(), u_max=columns.max(), v_max=rows.max(), score=1.0, side="right",
        side_score=1.0,
    )  # fmt: skip
    mask = person_mask(frames[n], box, seen)
    assert mask[truth.hand_mask[n]].all()
    points_O = (frames[n].points - truth.X_CO[n, :3, 3]) @ truth.X_CO[n, :3, :3]
    own = (frames[n].depth > 0) & ~truth.hand_mask[n]
    own[own] = np.abs(query_grid_numpy(obj.sdf, points_O[own])) < 0.004
    assert mask[own].mean() < 0.35  # but for a rim beside the fingers
    arm = seen.points_C[0] + 0.15 * (seen.points_C[0] - seen.points_C[9]) / np.linalg.norm(
        seen.points_C[0] - seen.points_C[9]
    )
    k = frames[n].intrinsics
    u, v = round(k.fx * arm[0] / arm[2] + k.cx), round(k.fy * arm[1] / arm[2] + k.cy)
    if 0 <= u < k.width and 0 <= v < k.height:
        assert mask[v, u]
    assert (person_mask(frames[n], box, replace(seen, mask=None)) == box_mask([box], mask.shape)).all()


def test_the_table_of_a_resting_pose_stands_for_what_was_seen():
    obj = load_object("cracker_box")
    assert demonstration_support(obj, None) is None
    low = obj.mesh.bounds[0, 2]
    tilted = np.array([0.02, 0.0, 1.0]) / np.linalg.norm([0.02, 0.0, 1.0])
    support = demonstration_support(obj, Plane(tilted, -low + 0.001))
    assert support.plane.normal == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    leaning = np.array([0.5, 0.0, 0.866])
    leaning /= np.linalg.norm(leaning)
    assert demonstration_support(obj, Plane(leaning, 0.1)).plane.normal == pytest.approx(leaning)
