"""Joints of hands by the names of their robots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import DataFormatError, InputError, ShapeError
from neuralgrasps.export.joints import hand_joints
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.kinematics.urdf import load_urdf


def test_following_joints_are_listed_with_their_values() -> None:
    fetch = hand_joints(load_hand("fetch"))
    assert fetch.names == ("r_gripper_finger_joint", "l_gripper_finger_joint")
    np.testing.assert_array_equal(fetch.positions(np.array([[0.02], [0.03]])), [[0.02, 0.02], [0.03, 0.03]])
    assert fetch.own.tolist() == [True, False] and fetch.effort.tolist() == [60.0, 60.0]
    barrett = hand_joints(load_hand("barrett"))
    values = dict(zip(barrett.names, barrett.positions(np.arange(1.0, 8.0)), strict=True))
    assert values["spread"] == 1.0 and values["f2_spread"] == 1.0 and values["f3_dist"] == 7.0
    assert [n for n, own in zip(barrett.names, barrett.own, strict=True) if not own] == ["f2_spread"]


MIMIC = """<robot name="mimic">
<link name="base"><collision><geometry><box size=".1 .1 .02"/></geometry></collision></link>
<link name="a"><collision><origin xyz="0 0 .05"/><geometry><box size=".02 .02 .1"/></geometry></collision></link>
<link name="b"><collision><origin xyz="0 0 .05"/><geometry><box size=".02 .02 .1"/></geometry></collision></link>
<joint name="ja" type="revolute"><parent link="base"/><child link="a"/><origin xyz=".05 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="2" velocity="1"/></joint>
<joint name="jb" type="revolute"><parent link="base"/><child link="b"/><origin xyz="-.05 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="2" velocity="1"/><mimic joint="ja" multiplier="-2" offset="0.25"/></joint>
</robot>"""


def test_multiplier_and_offset_of_a_follower(tmp_path: Path) -> None:
    (tmp_path / "mimic.urdf").write_text(MIMIC)
    joints = hand_joints(load_hand(str(tmp_path / "mimic.urdf")), names={"jb": "robot_jb"})
    assert joints.names == ("ja", "robot_jb")
    np.testing.assert_allclose(joints.positions(np.array([0.3])), [0.3, -0.35])
    np.testing.assert_allclose(joints.q({"ja": 0.3}, where="x"), [0.3])
    with pytest.raises(DataFormatError, match=r"robot_jb is at 0.35, but follows the others to -0.35"):
        joints.q({"ja": 0.3, "robot_jb": 0.35}, where="x")


@pytest.mark.parametrize("name", hand_names())
def test_every_hand_reads_back_what_it_wrote(name: str) -> None:
    hand = load_hand(name)
    joints = hand_joints(hand)
    assert len(set(joints.names)) == len(joints.names) >= hand.num_dofs == joints.own.sum()
    rng = np.random.default_rng(0)
    for q in rng.uniform(hand.tree.lower, hand.tree.upper, (5, hand.num_dofs)):
        values = dict(zip(joints.names, joints.positions(q), strict=True))
        np.testing.assert_allclose(joints.q(values, where="x"), q, atol=1e-12)
        own = {joints.names[k]: values[joints.names[k]] for k in joints.dofs}
        np.testing.assert_allclose(joints.q(own, where="x"), q, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "file"),
    (
        ("fetch", "robots/fetch/fetch.urdf"),
        ("panda", "hands/panda_gripper/panda_gripper_glb.urdf"),
        ("allegro", "hands/allegro_hand/allegro_hand_right.urdf"),
    ),
)
def test_names_are_those_of_the_robots_own_description(assets: Path, name: str, file: str) -> None:
    real = load_urdf(assets / file, with_visuals=False, missing_meshes="skip").tree
    assert set(hand_joints(load_hand(name)).names) <= set(real.joint_names)


def test_bad_names_and_values() -> None:
    hand = load_hand("barrett")
    joints = hand_joints(hand)
    with pytest.raises(ShapeError, match="q has shape"):
        joints.positions(np.zeros(6))
    with pytest.raises(DataFormatError, match="lacks joints f1_dist"):
        joints.q({n: 0.0 for n in joints.names if n != "f1_dist"}, where="x")
    with pytest.raises(DataFormatError, match="f9 are unknown"):
        joints.q({**dict.fromkeys(joints.names, 0.0), "f9": 0.0}, where="x")
    with pytest.raises(InputError, match="has no joints thumb"):
        hand_joints(hand, names={"thumb": "t"})
    with pytest.raises(InputError, match="one name"):
        hand_joints(hand, names={"f1_prox": "f1_dist"})
