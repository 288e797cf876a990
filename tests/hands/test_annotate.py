"""Automatic annotation against the notes written by hand, and on files nobody annotated."""

from __future__ import annotations

import re

import numpy as np
import pytest

from neuralgrasps.hands.loader import hand_from_description
from neuralgrasps.hands.zoo import hand_folder, load_hand, load_robot
from neuralgrasps.kinematics.forward_kernels import forward_numpy

from .conftest import SLIDE_JAW, three_finger_urdf


def test_guesses_agree_with_the_notes_by_hand(hand):
    guessed = hand_from_description(load_robot(hand_folder(hand.name) / "hand.xml"))
    assert np.array_equal(np.sign(guessed.closing_rate), np.sign(hand.closing_rate))
    assert guessed.is_jaw == hand.is_jaw
    angle = np.degrees(np.arccos(np.clip(hand.X_HP[:3, 2] @ guessed.X_HP[:3, 2], -1, 1)))
    assert angle < 5
    assert abs(hand.X_HP[:3, 0] @ guessed.X_HP[:3, 0]) > 0.9  # closing direction; a jaw's may point either way
    assert np.linalg.norm(hand.X_HP[:3, 3] - guessed.X_HP[:3, 3]) < 0.04
    assert [set(f.links) for f in guessed.fingers] == [set(f.links) for f in hand.fingers]
    if not hand.is_jaw:
        assert [f.is_thumb for f in guessed.fingers] == [f.is_thumb for f in hand.fingers]
    assert np.linalg.norm(guessed.jaw_pad_H - hand.jaw_pad_H) < (0.02 if hand.is_jaw else 0.04)
    assert "closing rates" in guessed.extra["annotated"]


@pytest.mark.parametrize(
    "path",
    ["allegro_hand/allegro_hand_right.urdf", "barrett_hand/bhand_model.urdf", "panda_gripper/panda_gripper_glb.urdf"],
)
def test_vendors_files_work_without_notes(assets, path):
    hand = load_hand(assets / "hands" / path)
    ours = load_hand({"a": "allegro", "b": "barrett", "p": "panda"}[path[0]])
    assert hand.X_HP[:3, 2] == pytest.approx(ours.X_HP[:3, 2], abs=1e-6)
    assert hand.is_jaw == ours.is_jaw and len(hand.fingers) == len(ours.fingers)
    assert np.count_nonzero(hand.closing_rate) == np.count_nonzero(ours.closing_rate)
    if path.startswith("barrett"):  # flexion counts negative there, and distal turns about a third of medial
        assert np.all(hand.closing_rate <= 0)
        assert hand.closing_rate.min() == -1 and sorted(hand.closing_rate)[3] == pytest.approx(-0.32, abs=0.03)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_claw_closes_whichever_way_its_joints_count(write_robot, sign):
    hand = load_hand(write_robot(three_finger_urdf(curl_sign=sign)))
    assert hand.X_HP[:3, 2] == pytest.approx([0, 0, -1], abs=1e-9)
    assert abs(hand.X_HP[0, 0]) == pytest.approx(1, abs=0.01)
    assert np.all(np.sign(hand.closing_rate) == sign)
    assert [f.is_thumb for f in hand.fingers] == [False, False, True]
    assert hand.X_HP[2, 3] == pytest.approx(-0.015, abs=1e-3)  # on the palm's lower face
    assert sorted(map(len, hand.preshape_groups)) == [2, 4]  # the opposing finger curls by itself


def test_two_independent_slides_become_one_jaw(write_robot):
    hand = load_hand(write_robot(SLIDE_JAW))
    assert hand.is_jaw and hand.num_dofs == 1 and "were coupled" in hand.extra["annotated"]
    assert (hand.tree.lower[0], hand.tree.upper[0]) == pytest.approx((0, 0.04))  # the shorter travel
    assert hand.closing_rate[0] == -1 and hand.q_open[0] == pytest.approx(0.04)
    for q in (0.0, 0.03):
        left, right = forward_numpy(hand.tree, np.array([q]))[1:, 1, 3]
        assert (left, right) == pytest.approx((0.005 + q, -0.005 - q))
    assert hand.jaw_pad_H == pytest.approx([0.12, 0, 0], abs=0.003)
    assert hand.X_HP[:3, 2] == pytest.approx([1, 0, 0], abs=1e-9)


def test_a_wrist_stays_still(write_robot):
    text = three_finger_urdf().replace(
        '<robot name="claw">',
        '<robot name="claw"><link name="arm"><collision><geometry><box size="0.05 0.05 0.1"/></geometry></collision>'
        "</link>"
        '<joint name="wrist" type="revolute"><parent link="arm"/><child link="palm"/><origin xyz="0 0 -0.1"/>'
        '<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="5" velocity="1"/></joint>',
    )
    hand = load_hand(write_robot(text))
    j = hand.tree.dof_names.index("wrist")
    assert hand.closing_rate[j] == 0 and hand.preshape_lower[j] == hand.preshape_upper[j] == 0
    assert hand.X_HP[:3, 2] == pytest.approx([0, 0, -1], abs=1e-9)
    assert len(hand.fingers) == 3


@pytest.mark.parametrize(
    ("pattern", "instead"),
    [
        (r'(<link name="palm">)<collision>.*?</collision>', r"\1"),  # a palm without shape
        (r'(<link name="[abc]0">)<collision>.*?</collision>', r"\1"),  # shape on the tips alone
        (r"<limit[^>]*/>", ""),  # neither limits nor efforts
    ],
)
def test_gaps_in_the_file_do_not_change_what_is_found(write_robot, pattern, instead):
    hand = load_hand(write_robot(re.sub(pattern, instead, three_finger_urdf())))
    assert np.all(hand.closing_rate > 0) and len(hand.fingers) == 3 and np.all(hand.tree.effort > 0)
    assert hand.X_HP[:3, 2] == pytest.approx([0, 0, -1], abs=1e-9)
