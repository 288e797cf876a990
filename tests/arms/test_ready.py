"""An arm file with nothing beside it: a posture to start from above the table, efforts, and what is said of both."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.arms.home import SelfClearance
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.cli.main import run
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

# name of the joint, its child, origin and turn of the joint, its axis, and the child's cylinder: radius, length, middle
CHAIN = (
    ("pan", "shoulder", "0 0 0.09", "0 0 0", "0 0 1", 0.06, 0.14, "0 0 0"),
    ("lift", "upper_arm", "0 0.135 0", "0 1.5708 0", "0 1 0", 0.05, 0.42, "0 0 0.21"),
    ("elbow", "forearm", "0 -0.12 0.425", "0 0 0", "0 1 0", 0.04, 0.38, "0 0 0.2"),
    ("wrist_1", "wrist_1_link", "0 0 0.39", "0 1.5708 0", "0 1 0", 0.04, 0.08, "0 0 0"),
    ("wrist_2", "wrist_2_link", "0 0.093 0", "0 0 0", "0 0 1", 0.04, 0.1, "0 0 0"),
    ("wrist_3", "wrist_3_link", "0 0 0.095", "0 0 0", "0 1 0", 0.03, 0.03, "0 0.06 0"),
)


def six_joints(*, tool: bool = True, limit: str = 'effort="0" velocity="3.1"', base_z: float = 0.0) -> str:
    """A URDF of primitives with the shape of a common six-joint arm; joints turn two turns, links meet at the wrist."""
    text = (
        '<link name="base"><collision><geometry><cylinder radius="0.07" length="0.04"/></geometry></collision></link>'
    )
    parent = "base"
    for k, (name, child, xyz, rpy, axis, radius, length, middle) in enumerate(CHAIN):
        place = xyz if k else f"0 0 {0.09 + base_z}"
        shape = f'<geometry><cylinder radius="{radius}" length="{length}"/></geometry>'
        turn = ' rpy="1.5708 0 0"' if k == 5 else ""
        text += f'<link name="{child}"><collision><origin xyz="{middle}"{turn}/>{shape}</collision></link>'
        text += f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        text += f'<origin xyz="{place}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        text += f'<limit lower="-6.28" upper="6.28" {limit}/></joint>'
        parent = child
    if tool:
        text += '<link name="tool0"/><joint name="tool" type="fixed"><parent link="wrist_3_link"/><child link="tool0"/>'
        text += '<origin xyz="0 0.082 0" rpy="-1.5708 0 0"/></joint>'
    return f'<robot name="six">{text}</robot>'


@pytest.fixture
def write(tmp_path):
    def put(text: str):
        path = tmp_path / "six.urdf"
        path.write_text(text)
        return path

    return put


@pytest.mark.parametrize("base_z", [0.0, 0.7])
def test_home_is_above_the_table_and_ready(write, base_z):
    arm = load_arm(write(six_joints(base_z=base_z)))
    height = max(0.0, 0.09 + base_z - 0.35)
    assert arm.table_height_m == pytest.approx(height)
    X_BM = forward_numpy(arm.tree, arm.q_home)[arm.flange] @ arm.X_FM
    assert 0.3 < X_BM[2, 3] - height < 0.6 and X_BM[0, 3] > 0.3 and abs(X_BM[1, 3]) < 0.15
    assert X_BM[2, 2] < -0.7 and X_BM[0, 2] > -0.1  # down, or forward and down
    assert np.abs(arm.q_home).max() < 3.1
    assert SelfClearance(arm.tree, arm.parts, arm.q_home)(arm.q_home) > 0.01
    robot = mount(arm, load_hand("panda"))
    X_BL, moving = forward_numpy(robot.tree, robot.q_home), robot.tree.link_names.index("upper_arm")
    points = np.concatenate([part_mesh(p).transformed(X_BL[p.link]).vertices for p in robot.parts if p.link >= moving])
    assert points[points[:, 0] > 0.25, 2].min() > height + 0.08
    elbow = forward_numpy(arm.tree, arm.q_home)[arm.tree.link_names.index("forearm"), 2, 3]
    assert elbow > 0.09 + base_z + 0.1  # up


def test_home_is_the_same_each_time(write):
    path = write(six_joints())
    np.testing.assert_array_equal(load_arm(path).q_home, load_arm(path).q_home)


def test_efforts_of_zero_become_ones_that_carry_the_arm(write):
    arm = load_arm(write(six_joints()))
    assert arm.tree.effort.tolist() == [150.0] * 3 + [30.0] * 3
    assert "pan (found 0): 150 N m" in arm.extra["assumed"] and "wrist_3 (found 0): 30 N m" in arm.extra["assumed"]
    assert "effort" not in arm.extra["repairs"]
    stated = load_arm(write(six_joints(limit='effort="77" velocity="3.1"')))
    assert stated.tree.effort.tolist() == [77.0] * 6 and "effort" not in stated.extra["assumed"]


def test_a_guessed_face_and_a_short_flange_are_said(write):
    assert "[face]" not in load_arm(write(six_joints())).extra["assumed"]
    bare = load_arm(write(six_joints(tool=False)))
    assert "'wrist_3_link' is no tool0 or flange frame" in bare.extra["assumed"]
    short = load_arm(write(six_joints()), flange="wrist_2_link")
    assert "'wrist_2_link' is moved by 5 joints; the arm goes on to 'tool0' with 6" in short.extra["assumed"]
    assert "goes on" not in load_arm(write(six_joints()), flange="wrist_3_link").extra["assumed"]


def test_show_tells_home_table_and_face(write, capsys):
    assert run(["arms", "show", str(write(six_joints(tool=False)))]) == 0
    out = " ".join(capsys.readouterr().out.split())
    for words in ("mounting face", "mounting face at (", "table 0.00 m above the base", "home is not stated for pan"):
        assert words in out
