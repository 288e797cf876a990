"""From a recorded demonstration to ordered robot grasps, with the nets and grasps that come with the library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import (
    DemonstrateConfig,
    box_mask,
    demonstrate,
    demonstration_support,
    load_hand_eyes,
)
from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.human.joint_errors import root_relative_error
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.model.run_notes import run_folder
from neuralgrasps.objects.zoo import load_object

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
    support = demonstration_support(obj, found.table_O)
    assert support.allows(load_hand("fetch"), found.grasps.X_OH, found.grasps.q, found.grasps.q_pregrasp).all()


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


def test_no_frames_is_an_error(shown):
    obj, *_ = shown
    with pytest.raises(InputError, match="no frames"):
        demonstrate([], obj, load_hand("fetch"))


def test_boxes_are_hidden_with_some_room():
    box = HandBox(u_min=20.0, v_min=10.0, u_max=40.0, v_max=30.0, score=1.0, side="right", side_score=1.0)
    mask = box_mask([box], (60, 80))
    assert mask[5, 15] and mask[34, 44] and not mask[4, 15] and not mask[5, 14] and not mask[36, 30]
    assert not box_mask([], (60, 80)).any()
    far = HandBox(u_min=-90.0, v_min=-90.0, u_max=-60.0, v_max=-60.0, score=1.0, side="right", side_score=1.0)
    assert not box_mask([far], (60, 80)).any()


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
