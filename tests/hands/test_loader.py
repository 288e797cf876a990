"""Robot files and notes to hands: what is read, and what wrong input says."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError, RobotDescriptionError, ShapeError
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.loader import MAX_HULL_VERTICES
from neuralgrasps.hands.notes import load_hand_notes
from neuralgrasps.hands.zoo import load_hand

from .conftest import SLIDE_JAW, three_finger_urdf


def test_notes_beside_a_file_override_the_guesses(write_robot):
    path = write_robot(three_finger_urdf())
    path.with_suffix(".toml").write_text(
        'name = "mine"\nlicence = "CC0"\n[palm]\nposition = [0, 0, -0.02]\nx_axis = [0, 2, 0]\nz_axis = [0, 0, -3]\n'
        "[joints]\na0_joint = { close = 0.5, effort = 9.0, preshape = [0.2, 0.3] }\n"
    )
    hand = load_hand(path)
    assert (hand.name, hand.licence) == ("mine", "CC0")
    assert np.allclose(hand.X_HP, [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, -0.02], [0, 0, 0, 1]])
    j = hand.tree.dof_names.index("a0_joint")
    assert (hand.closing_rate[j], hand.tree.effort[j], hand.preshape_lower[j]) == (0.5, 9.0, 0.2)
    assert hand.q_open[j] == pytest.approx(0.2)  # the guess (0) moved into the stated range
    assert hand.closing_rate[j + 1] == 1.0  # unstated: still guessed


def test_a_folder_stands_for_the_file_in_it(write_robot):
    path = write_robot(three_finger_urdf())
    assert load_hand(path.parent).name == "claw"
    write_robot(three_finger_urdf(), "second.urdf")
    with pytest.raises(RobotDescriptionError, match=r"holds 2 robot files \(robot.urdf, second.urdf\)"):
        load_hand(path.parent)


def test_meshes_become_small_hulls_that_keep_their_size(assets):
    hand = load_hand(assets / "hands/allegro_hand/allegro_hand_right.urdf")
    tip = next(p for p in hand.parts if p.kind == PartKind.HULL)
    assert len(tip.vertices) <= MAX_HULL_VERTICES
    assert np.ptp(tip.vertices, axis=0) == pytest.approx([0.024, 0.024, 0.023], abs=1e-3)
    a, b, c = tip.vertices[tip.faces].transpose(1, 0, 2)
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3 - tip.vertices.mean(axis=0))
    assert np.all(outward > 0)


BROKEN_NOTES = {
    'nmae = "x"': r"key 'nmae' is not known. Did you mean 'name'\?",
    "is_jaw = 1": r"is_jaw is 1; expected true or false",
    "name = 3": r"name is 3; expected text",
    "name = ": r"not valid TOML",
    "[palm]\nposition = [0, 0, 0]": r"key 'x_axis' is missing",
    "[palm]\nposition = [0, 0, 0]\nx_axis = [1, 0, 0]\nz_axis = [1, 0, 0]": r"non-zero and perpendicular",
    "[palm]\nposition = [0, 0]\nx_axis = [1, 0, 0]\nz_axis = [1, 0, 0]": r"position is \[0, 0\]; expected 3 numbers",
    "jaw_pad = [0, 0, nan]": r"finite",
    "[joints.a0_joint]\nclsoe = 1.0": r"Did you mean 'close'\?",
    "[joints.a0_joint]\npreshape = [2, 1]": r"preshape is \[2, 1\]; expected \[lowest, highest\]",
    "[joints.a0_joint]\neffort = -1": r"effort is -1; expected a positive number",
    "[joints]\na0_joint = 3": r"a0_joint is 3; expected a table",
    "[[fingers]]\nname = 'a'": r"expected a name and a list of link names",
    "fingers = []": r"expected one or more",
}


@pytest.mark.parametrize("text", BROKEN_NOTES)
def test_broken_notes_say_what_and_how(tmp_path, text):
    path = tmp_path / "hand.toml"
    path.write_text(text)
    with pytest.raises(RobotDescriptionError, match=BROKEN_NOTES[text]) as error:
        load_hand_notes(path)
    assert "hand.toml" in str(error.value)


@pytest.mark.parametrize(
    ("notes", "message"),
    [
        ("[joints.a0_jiont]\nclose = 1.0", r"joint 'a0_jiont' is not known. Did you mean 'a0_joint'\?"),
        ("[[fingers]]\nname = 'x'\nlinks = ['a9']", r"link 'a9' is not known"),
        ("[joints.a0_joint]\nopen = 5.0", r"open value 5 of joint 'a0_joint' is outside its limits -0.1..1.6"),
    ],
)
def test_notes_that_do_not_fit_the_robot(write_robot, notes, message):
    path = write_robot(three_finger_urdf())
    path.with_suffix(".toml").write_text(notes)
    with pytest.raises(RobotDescriptionError, match=message):
        load_hand(path)


def test_files_that_are_no_hands(write_robot, tmp_path):
    with pytest.raises(RobotDescriptionError, match=r"does not exist.*Built-in hands: fetch"):
        load_hand(tmp_path / "nothing.urdf")
    write_robot(SLIDE_JAW, "gripper.urdf")
    with pytest.raises(RobotDescriptionError, match=r"Did you mean '.*gripper.urdf'\?"):
        load_hand(tmp_path / "griper.urdf")
    with pytest.raises(RobotDescriptionError, match="root tag <sdf>"):
        load_hand(write_robot("<sdf/>", "x.xml"))
    with pytest.raises(RobotDescriptionError, match="no geometry"):
        load_hand(write_robot("<robot name='r'><link name='a'/></robot>", "bare.urdf"))
    solid = "<collision><geometry><sphere radius='0.1'/></geometry></collision>"
    with pytest.raises(RobotDescriptionError, match="no movable joints"):
        load_hand(write_robot(f"<robot name='r'><link name='a'>{solid}</link></robot>", "stiff.urdf"))


def test_wrong_number_of_joint_values(hand):
    with pytest.raises(ShapeError, match=rf"q has {hand.num_dofs + 1} columns but hand '{hand.name}' has"):
        hand.check_q(np.zeros(hand.num_dofs + 1))
    with pytest.raises(InputError):
        hand.check_q(np.array(0.0))
