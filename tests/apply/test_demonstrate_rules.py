"""Rules typed before a video is read mean what is up in the video."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.demonstrate import DemonstrateConfig, demonstrate, demonstration_support
from neuralgrasps.apply.demonstrate_rules import rules_from_text, transfer_under
from neuralgrasps.apply.regions import Side
from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.apply.transfer_search import SearchConfig
from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.geometry.plane import Plane, standing_on
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.seen import SeenJoints
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.model.run_notes import run_folder
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.synthesis.support import Support
from tests.apply.conftest import BoxWorld

FEW = DemonstrateConfig(transfer=TransferConfig(count=3, trials=9))
ON_X = Plane(np.array([1.0, 0.0, 0.0]), 0.04)  # the table under an object whose +x side is up


@pytest.fixture(scope="module")
def lying():
    """A gelatin box that stands on its +y side: frames, joints as another tool gives them, and known grasps."""
    obj = load_object("gelatin_box")
    recorded = record_demonstration(
        obj, seed=3, config=DemonstrationConfig(side="right", scale=0.82, lift=False, wall=False)
    )
    truth = recorded.truth
    assert (recorded.frames[0].X_WC @ truth.X_CO[0])[2, 1] < -0.99
    joints = [
        SeenJoints(points_C=points, weight=np.ones(21), mask=mask, side=truth.side, source="test")
        if seen > 0.4
        else None
        for points, mask, seen in zip(truth.joints_C, truth.hand_mask, truth.visible, strict=True)
    ]
    known = load_grasps(run_folder("standins7") / "grasps" / obj.name / "fetch.safetensors")
    return obj, [replace(frame, X_WC=None) for frame in recorded.frames], joints, known


def test_top_and_down_are_those_of_the_video(lying):
    obj, frames, joints, known = lying
    hand = load_hand("fetch")
    rules = rules_from_text(obj, only_region=["top:0.6"], approach=("down", "40deg"))
    found = demonstrate(frames, obj, hand, joints=joints, known=known, config=FEW, constraints=rules)
    assert (found.stage, found.reason) == ("", "")
    assert found.table_O.normal @ [0.0, -1.0, 0.0] > 0.99
    grasps = found.grasps
    palm = grasps.X_OH[:, :3, :3] @ hand.X_HP[:3, 2]
    assert (palm @ -found.table_O.normal >= np.cos(np.radians(40.0))).all()
    upper = GraspConstraints(obj=obj, only_region=(Side("-y", 0.6),))
    assert upper.allows(hand, grasps.X_OH, grasps.q).all()


def test_rules_that_this_pose_makes_impossible_fail_the_transfer(lying):
    obj, frames, joints, known = lying
    rules = rules_from_text(obj, only_region=["top:0.3"], keep_free=["-y:0.5"])  # fine, were another side up
    found = demonstrate(frames, obj, load_hand("fetch"), joints=joints, known=known, config=FEW, constraints=rules)
    assert found.stage == "transfer" and "lies in what is kept free" in found.reason
    assert found.query is not None and found.transfer is None


def test_what_up_means_comes_from_the_table(box_world: BoxWorld):
    obj = box_world.obj
    rules = rules_from_text(obj, keep_free=["top:0.25"], approach=("down", "30deg"))
    assert rules.names == ("approach along world:-z within 30°", "keep top:0.25 free by 5 mm")
    bound = rules(ON_X)
    assert bound.approach_O == pytest.approx([-1.0, 0.0, 0.0]) and bound.up_O == pytest.approx([1.0, 0.0, 0.0])
    free, _ = bound.marked(obj.points_O)
    assert free.any() and obj.points_O[free, 0].min() >= 0.02 - 0.25 * 0.04 - 1e-9
    with pytest.raises(InputError, match="no table was seen"):
        rules(None)
    assert rules_from_text(obj, keep_free=["+y:0.25"])(None).names == ("keep +y:0.25 free by 5 mm",)
    assert rules_from_text(obj) is None


def test_bad_texts_are_refused_before_anything_is_seen(box_world: BoxWorld):
    obj = box_world.obj
    with pytest.raises(UnknownNameError, match="lid"):
        rules_from_text(obj, keep_free=["lid"])
    with pytest.raises(InputError, match="covers all of the surface"):
        rules_from_text(obj, keep_free=["top:1"])
    with pytest.raises(InputError, match="is not vertical"):
        rules_from_text(obj, approach=("world:+x", "30deg"))
    with pytest.raises(InputError, match="none of the surface"):
        rules_from_text(obj, only_region=["sphere:1,1,1,0.01"])


def test_where_few_known_grasps_meet_the_rules_some_are_made(box_world: BoxWorld):
    hand, obj, known = box_world.hand, box_world.obj, box_world.grasps
    rules = rules_from_text(obj, only_region=["top:0.4"])(Plane(np.array([0.0, 0.0, 1.0]), 0.06))
    support = Support(plane=Plane(np.array([0.0, 0.0, 1.0]), 0.06))
    few = known[~rules.allows(hand, known.X_OH, known.q, known.q_pregrasp)]
    query = query_from_grasp(hand, obj, known.X_OH[0], known.q[0])
    config = TransferConfig(method="retrieve", count=3, search=SearchConfig(starts=3))
    found = transfer_under(
        query, hand, obj, known=few, config=config, support=support, constraints=rules, seed=0
    )  # fmt: skip
    assert len(found.grasps) == 3 and (found.source >= len(few)).all()
    assert rules.allows(hand, found.grasps.X_OH, found.grasps.q, found.grasps.q_pregrasp).all()
    assert support.allows(hand, found.grasps.X_OH, found.grasps.q, found.grasps.q_pregrasp).all()


def test_an_object_stands_on_the_plane_that_was_seen():
    normal = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])
    X_WO = standing_on(Plane(normal, 0.07))
    assert np.linalg.det(X_WO[:3, :3]) == pytest.approx(1.0)
    assert X_WO[:3, :3] @ normal == pytest.approx([0.0, 0.0, 1.0])
    assert (X_WO @ [*(-0.07 * normal), 1.0])[2] == pytest.approx(0.0, abs=1e-12)


def test_where_no_known_grasp_clears_the_table_new_ones_are_made_for_it():
    obj, hand = load_object("gelatin_box"), load_hand("fetch")
    known = load_grasps(run_folder("standins7") / "grasps" / obj.name / "fetch.safetensors")
    human = load_grasps(run_folder("standins7") / "grasps" / obj.name / "human.safetensors")
    support = demonstration_support(obj, Plane(np.array([0.0, 0.0, 1.0]), float(-obj.mesh.bounds[0, 2])))
    meets = ~support.allows(hand, known.X_OH, known.q, known.q_pregrasp)
    assert meets.sum() >= 5
    query = query_from_grasp(load_hand("human"), obj, human.X_OH[0], human.q[0])
    found = transfer_under(
        query, hand, obj, known=known[meets], config=TransferConfig(count=3, synthesise=12), support=support,
        constraints=None, seed=0,
    )  # fmt: skip
    assert len(found.grasps) == 3
    assert support.allows(hand, found.grasps.X_OH, found.grasps.q, found.grasps.q_pregrasp).all()
