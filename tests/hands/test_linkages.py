"""Struts of linkages, and branches that follow one joint: what is a finger, and what is said when it is not clear."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.zoo import load_hand

from .wild_urdf import Robot, new_robot

MOTOR = "left_knuckle_joint"


def linkage_gripper(folder: Path, *, strut_limit: float = 0.88, strut_ratio: float = 1.0) -> Robot:
    """Two four-bar linkages on one motor; the shapes of the struts end 23 mm before their hinges in the pads."""
    robot = new_robot(folder, "linkage_gripper")
    robot.link("body", robot.box((0.075, 0.05, 0.09), (0, 0, 0.045)))
    for name, side in (("left", 1.0), ("right", -1.0)):
        yaw = (0.0, 0.0, 0.0 if side > 0 else 3.14159265)
        follow = None if side > 0 else (MOTOR, 1.0, 0.0)
        robot.link(f"{name}_knuckle", robot.box((0.03, 0.02, 0.01), (0.015, 0, 0)))
        robot.joint(
            f"{name}_knuckle_joint", "body", f"{name}_knuckle", (0.0306 * side, 0, 0.0549), yaw, axis=(0, -1, 0),
            limits=(0, 0.8), effort=5, mimic=follow,
        )  # fmt: skip
        robot.link(f"{name}_outer", robot.box((0.012, 0.02, 0.045), (0.005, 0, 0.022)))
        robot.joint(f"{name}_outer_joint", f"{name}_knuckle", f"{name}_outer", (0.0315, 0, -0.0041), kind="fixed")
        robot.link(f"{name}_strut", robot.box((0.01, 0.02, 0.05), (0.01, 0, 0.02)))
        robot.joint(
            f"{name}_strut_joint", "body", f"{name}_strut", (0.0127 * side, 0, 0.0614), yaw, axis=(0, -1, 0),
            limits=(0, strut_limit), effort=5, mimic=(MOTOR, strut_ratio, 0.0),
        )  # fmt: skip
        robot.link(f"{name}_pad", robot.box((0.01, 0.022, 0.038), (-0.012, 0, 0.03)))
        robot.joint(
            f"{name}_pad_joint", f"{name}_outer", f"{name}_pad", (0.0061, 0, 0.0471), axis=(0, -1, 0),
            limits=(-0.88, 0), effort=5, mimic=(MOTOR, -1.0, 0.0),
        )  # fmt: skip
    return robot


def test_a_strut_that_ends_before_its_hinge_is_no_finger(tmp_path):
    hand = load_hand(linkage_gripper(tmp_path).write())
    assert hand.is_jaw and len(hand.fingers) == 2 and not any(f.is_thumb for f in hand.fingers)
    assert "taken for struts of a linkage, no fingers: left_strut, right_strut." in hand.extra["annotated"]
    assert "state 'fingers'" not in hand.extra["annotated"]


def test_branches_that_turn_at_their_own_rate_are_fingers_and_said_to_be_in_doubt(tmp_path):
    hand = load_hand(linkage_gripper(tmp_path, strut_ratio=1.5, strut_limit=1.3).write())
    assert len(hand.fingers) == 4 and not hand.is_jaw
    assert (
        f"4 branches follow joint {MOTOR} and have none of their own: if some are struts of a linkage, state 'fingers' "
        "in hand.toml." in hand.extra["annotated"]
    )


@pytest.mark.parametrize("beside", [0.017, 0.02, -0.017, -0.02])
def test_short_fingers_beside_long_ones_on_the_same_motor_are_no_struts(tmp_path, beside):
    """They share the pivot's line and turn by another angle than the long one's end, but in another plane."""
    robot = new_robot(tmp_path, "four_on_one")
    robot.link("palm", robot.box((0.05, 0.1, 0.03), (0, 0, -0.015)))
    for x, axis, side in ((0.025, (0, -1, 0), "front"), (-0.025, (0, 1, 0), "back")):
        lead = "front_long_joint_0"
        for length, name, y in (((0.04, 0.04), "long", 0.0), ((0.04,), "short", beside)):
            robot.chain("palm", f"{side}_{name}", (x, y, 0), (0, 0, 0), length, axis=axis, limits=(0, 1.2),
                        follow={1: (0, 1.0)} if name == "long" else None)  # fmt: skip
            if (side, name) != ("front", "long"):
                own = f'<joint name="{side}_{name}_joint_0"'
                k = next(i for i, part in enumerate(robot.parts) if part.startswith(own))
                robot.parts[k] = robot.parts[k].replace("</joint>", f'<mimic joint="{lead}"/></joint>')
    hand = load_hand(robot.write())
    assert len(hand.fingers) == 4 and hand.num_dofs == 1


def test_two_jaws_on_one_pivot_are_two_fingers(tmp_path):
    robot = new_robot(tmp_path, "pliers")
    robot.link("grip", robot.box((0.03, 0.03, 0.08), (0, 0, -0.04)))
    for name, sign, length in (("a", 1.0, 0.08), ("b", -1.0, 0.05)):
        robot.link(name, robot.box((0.01, 0.02, length), (0.006 * sign, 0, length / 2)))
        mimic = None if name == "a" else ("a_joint", -1.0, 0.0)
        robot.joint(f"{name}_joint", "grip", name, axis=(0, 1, 0), limits=(0, 0.6) if name == "a" else (-0.6, 0),
                    mimic=mimic)  # fmt: skip
    assert len(load_hand(robot.write()).fingers) == 2


def test_a_jaw_of_four_fingers_is_refused(tmp_path):
    path = linkage_gripper(tmp_path, strut_ratio=1.5, strut_limit=1.3).write()
    notes = tmp_path / "hand.toml"
    notes.write_text("is_jaw = true\n")
    with pytest.raises(
        RobotDescriptionError, match=r"is_jaw = true, but 4 fingers begin at left_knuckle, .*has 2. Name these two in"
    ):
        load_hand(path)
    fingers = "".join(
        f'[[fingers]]\nname = "{n}"\nlinks = ["{n}_knuckle", "{n}_outer", "{n}_pad"]\n' for n in ("left", "right")
    )
    notes.write_text(f"is_jaw = true\n{fingers}")
    assert load_hand(path).is_jaw
    notes.write_text(f'is_jaw = true\n{fingers}[[fingers]]\nname = "extra"\nlinks = ["left_strut"]\n')
    with pytest.raises(RobotDescriptionError, match="3 fingers begin at left, right, extra"):
        load_hand(path)


def test_a_hand_without_movable_joints_names_those_of_equal_limits(tmp_path):
    robot = new_robot(tmp_path, "stiff")
    robot.link("palm", robot.box((0.05, 0.1, 0.03)))
    robot.chain("palm", "a", (0, 0, 0), (0, 0, 0), (0.04,), limits=(0.3, 0.3))
    with pytest.raises(RobotDescriptionError, match=r"no movable joints.*a_joint_0.*limit are both 0.3"):
        load_hand(robot.write())


@pytest.mark.parametrize(("effort", "word"), [(-2, "negative"), (0, "missing, 0 or not finite")])
def test_a_useless_effort_is_called_what_it_is(tmp_path, effort, word):
    robot = new_robot(tmp_path, "claw")
    robot.link("palm", robot.box((0.05, 0.1, 0.03)))
    for x, axis in ((0.02, (0, -1, 0)), (-0.02, (0, 1, 0))):
        robot.chain("palm", f"f{x}", (x, 0, 0.02), (0, 0, 0), (0.05,), axis=axis, effort=effort)
    assert f"effort is {word} for f0.02_joint_0, f-0.02_joint_0: 1 N m" in load_hand(robot.write()).extra["repairs"]


def test_one_finger_is_counted_in_the_singular(tmp_path):
    robot = new_robot(tmp_path, "hook")
    robot.link("palm", robot.box((0.05, 0.05, 0.02)))
    robot.chain("palm", "f", (0.02, 0, 0.02), (0, 0, 0), (0.05,))
    assert "1 finger," in repr(load_hand(robot.write()))
