"""Arms from any file: what is found, what is assumed, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.arms.home import SelfClearance
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.notes import load_arm_notes
from neuralgrasps.arms.zoo import arm_folder, load_arm
from neuralgrasps.errors import RobotDescriptionError, UnknownNameError
from neuralgrasps.hands.zoo import load_hand

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")


def _link(name: str, shape: str = "") -> str:
    inside = f'<collision><origin xyz="0.08 0 0"/><geometry>{shape}</geometry></collision>' if shape else ""
    return f'<link name="{name}">{inside}</link>'


def _joint(name: str, parent: str, child: str, axis: str = "", limit: str = "", kind: str = "revolute") -> str:
    axis_text = f'<axis xyz="{axis}"/>' if axis else ""
    limit_text = limit and f"<limit {limit}/>"
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{0.05 if kind == "fixed" else 0.2} 0 0"/>{axis_text}{limit_text}</joint>'
    )


def arm_urdf(
    prefix: str = "",
    *,
    tip: str = "tool0",
    limit: str = 'lower="-2" upper="2" effort="50" velocity="1.5"',
    joints: int = 6,
) -> str:
    """Links and joints of an arm from the link "base" on; its flange `tip` is a fixed frame."""
    text, parent = "", "base"
    for k in range(joints):
        child = f"{prefix}link{k}"
        text += _link(child, '<box size="0.12 0.04 0.04"/>')
        text += _joint(f"{prefix}joint{k}", parent, child, AXES[k], limit)
        parent = child
    return text + _link(prefix + tip) + _joint(f"{prefix}{tip}_fixed", parent, prefix + tip, kind="fixed")


BASE = _link("base", '<box size="0.1 0.1 0.1"/>')


def robot(*pieces: str) -> str:
    return f'<robot name="r">{BASE}{"".join(pieces)}</robot>'


@pytest.fixture
def write(tmp_path):
    def put(text: str, name: str = "r.urdf"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return put


def test_an_arm_with_tool0(write):
    arm = load_arm(write(robot(arm_urdf())))
    assert arm.tree.link_names[arm.flange] == "tool0" and arm.joints.tolist() == list(range(6))
    assert arm.velocity.tolist() == [1.5] * 6 and arm.acceleration.tolist() == [3.0] * 6
    assert "reached in 0.5 s" in arm.extra["assumed"] and "speed limit" not in arm.extra["assumed"]
    assert arm.camera is None and arm.table_height_m == 0.0
    assert SelfClearance(arm.tree, arm.parts, arm.q_home)(arm.q_home) > 0.0
    # the last joint turns about x: that is the way out of the face
    assert arm.X_FM[:3, 2] == pytest.approx([1, 0, 0]) and arm.X_FM[:3, 3] == pytest.approx([0, 0, 0])
    hand = mount(arm, load_hand("panda")).hand_pose(np.zeros(6))
    assert hand[:3, 2] == pytest.approx([1, 0, 0]) and hand[0, 3] > 1.24  # six times 0.2, and 0.05 to tool0


def test_the_face_looks_away_from_the_arm_whatever_the_axis(write):
    last = _joint("joint5", "link4", "link5", AXES[5])[:-8]
    text = robot(arm_urdf())
    assert last in text
    arm = load_arm(write(text.replace(last, last.replace("1 0 0", "-1 0 0"))))
    assert arm.X_FM[:3, 2] == pytest.approx([1, 0, 0])


def test_home_is_free_where_the_middle_of_the_ranges_is_not(write):
    text = robot(arm_urdf())
    for k in (1, 2, 4):  # the middle of these ranges folds the arm into itself
        start = text.index(f'<joint name="joint{k}"')
        text = text[:start] + text[start:].replace('lower="-2" upper="2"', 'lower="0.1" upper="5.1"', 1)
    arm = load_arm(write(text))
    middle = 0.5 * (arm.tree.lower + arm.tree.upper)
    clearance = SelfClearance(arm.tree, arm.parts, arm.q_home)
    assert clearance(middle) < 0.0 < clearance(arm.q_home)


def test_speeds_that_are_missing_or_zero_are_assumed_and_said(write):
    arm = load_arm(write(robot(arm_urdf(limit='lower="-2" upper="2" effort="50" velocity="0"'))))
    assert arm.velocity.tolist() == [1.0] * 6
    assert "no usable speed limit for joint0 (found 0), joint1 (found 0)" in arm.extra["assumed"]
    arm = load_arm(
        write(
            robot(arm_urdf(limit='lower="-2" upper="2" effort="50"')).replace(
                'effort="50"', 'effort="50" velocity="-3"', 1
            )
        )
    )
    assert "joint0 (found -3), joint1 (none)" in arm.extra["assumed"]


def test_a_joint_without_limits_turns_on_and_on(write):
    text = robot(arm_urdf()).replace('<joint name="joint5" type="revolute">', '<joint name="joint5" type="continuous">')
    arm = load_arm(write(text))
    assert arm.continuous.tolist() == [False] * 5 + [True]
    assert (arm.tree.lower[5], arm.tree.upper[5]) == pytest.approx((-2 * np.pi, 2 * np.pi))
    assert "-2 pi..2 pi: joint5." in arm.extra["repairs"]


def test_what_hangs_on_the_flange_is_cut_off_and_other_limbs_rest(write):
    tool = _link("drill", '<box size="0.3 0.3 0.3"/>') + _joint("drill_fixed", "tool0", "drill", kind="fixed")
    leg = _link("leg", '<box size="0.1 0.1 0.1"/>') + _joint("hip", "base", "leg", "0 1 0", 'lower="0.5" upper="1"')
    arm = load_arm(write(robot(arm_urdf(), tool, leg)))
    assert "drill" not in arm.tree.link_names and "leg" in arm.tree.link_names
    hip = arm.tree.dof_names.index("hip")
    assert hip not in arm.joints and arm.q_home[hip] == 0.5  # the value next to 0
    bare = load_arm(write(robot(arm_urdf(), tool, leg)), base="link0")
    assert "leg" not in bare.tree.link_names and len(bare.joints) == 5


def test_the_hand_of_a_whole_robot_tells_the_flange(write):
    palm = _link("palm", '<box size="0.05 0.08 0.05"/>') + _joint("palm_fixed", "wrist", "palm", kind="fixed")
    for side in ("left", "right"):
        palm += _link(side, '<box size="0.04 0.01 0.02"/>')
        slide = _joint(f"{side}_slide", "palm", side, "0 1 0", 'lower="0" upper="0.04" effort="20"', "prismatic")
        palm += slide.replace("0.2 0 0", "0.05 0 0")
    arm = load_arm(write(robot(arm_urdf(tip="wrist"), palm)))
    assert arm.tree.link_names[arm.flange] == "wrist" and "left_slide" not in arm.tree.dof_names


REFUSED = {
    "reversed limits": (
        robot(arm_urdf()).replace('lower="-2" upper="2"', 'lower="2" upper="-2"', 1),
        {},
        "joint 'joint0' has the lower limit 2 above the upper one -2",
    ),
    "two arms": (robot(arm_urdf("left_"), arm_urdf("right_")), {}, "2 links.*'left_tool0', 'right_tool0'.*--flange"),
    "two tips": (robot(arm_urdf("a_", tip="x"), arm_urdf("b_", tip="y")), {}, "'a_x', 'b_y'"),
    "no arm": (robot(arm_urdf(joints=2)), {}, "no arm.*4 joints or more.*2"),
    "flange of another name": (
        robot(arm_urdf()),
        {"flange": "tool1"},
        "link 'tool1' is not known.*Did you mean 'tool0'",
    ),
    "flange too near": (robot(arm_urdf()), {"flange": "link1"}, "with 2 joints; expected at least 4"),
    "base of another name": (robot(arm_urdf()), {"base": "bse"}, "link 'bse' is not known"),
    "no shapes": (
        '<robot name="r">' + _link("base") + arm_urdf().replace("box", "bx") + "</robot>",
        {},
        "expected box",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_files_that_are_no_arm_are_refused_with_the_choices(write, case):
    text, options, message = REFUSED[case]
    with pytest.raises(RobotDescriptionError, match=f"(?s){message}"):
        load_arm(write(text), **options)


def test_names_that_are_no_arm(tmp_path):
    with pytest.raises(UnknownNameError, match=r"arm 'pnada' is not known\. Did you mean 'panda'"):
        load_arm("pnada")
    with pytest.raises(
        RobotDescriptionError, match=r"arm file 'lost.urdf' does not exist.*Built-in arms: fetch, panda"
    ):
        load_arm("lost.urdf")
    with pytest.raises(RobotDescriptionError, match="no robot file"):
        load_arm(tmp_path)


NOTES = """
name = "mine"
table_height = 0.4
[face]
position = [0.0, 0.0, 0.03]
x_axis = [1.0, 0.0, 0.0]
z_axis = [0.0, 0.0, 2.0]
[camera]
link = "base"
position = [0.0, 0.5, 0.5]
x_axis = [1.0, 0.0, 0.0]
z_axis = [0.0, 0.0, -1.0]
fov_y = 60.0
width = 320
height = 240
[joints]
joint0 = { home = 0.3, velocity = 0.7, acceleration = 9.0 }
joint1 = { planned = false, home = -0.5 }
"""


def test_notes_beside_the_file_win(write):
    path = write(robot(arm_urdf()))
    write(NOTES, "arm.toml")
    arm = load_arm(path)
    assert (arm.name, arm.table_height_m) == ("mine", 0.4) and arm.X_FM[:3, 3] == pytest.approx([0, 0, 0.03])
    assert arm.joints.tolist() == [0, 2, 3, 4, 5]
    assert (arm.velocity[0], arm.acceleration[0], arm.q_home[0], arm.q_home[1]) == (0.7, 9.0, 0.3, -0.5)
    assert arm.camera.link == 0 and arm.camera.intrinsics.width == 320
    write(NOTES.replace('link = "base"', 'link = "bas"'), "arm.toml")
    with pytest.raises(RobotDescriptionError, match="camera: link 'bas' is not known"):
        load_arm(path)


BAD_NOTES = {
    "unknown key": (NOTES.replace("fov_y", "fov"), "camera: key 'fov' is not known. Did you mean 'fov_y'"),
    "missing key": (NOTES.replace("width = 320\n", ""), "key 'width' is missing"),
    "no speed": (NOTES.replace("velocity = 0.7", "velocity = 0"), "velocity is 0; expected a positive number"),
    "no square axes": (NOTES.replace("z_axis = [0.0, 0.0, 2.0]", "z_axis = [1.0, 0.0, 2.0]"), "perpendicular"),
    "half a pixel": (NOTES.replace("320", "320.5"), "width is 320.5; expected a whole number"),
    "half-plane view": (NOTES.replace("60.0", "180.0"), "fov_y is 180.0; expected degrees"),
    "not TOML": ("name =", "not valid TOML"),
}


@pytest.mark.parametrize("case", BAD_NOTES)
def test_bad_notes_name_the_key(tmp_path, case):
    text, message = BAD_NOTES[case]
    path = tmp_path / "arm.toml"
    path.write_text(text)
    with pytest.raises(RobotDescriptionError, match=message):
        load_arm_notes(path)


def test_notes_on_joints_that_do_not_exist(write):
    path = write(robot(arm_urdf()))
    write(NOTES.replace("joint1 =", "joint9 ="), "arm.toml")
    with pytest.raises(RobotDescriptionError, match="joint 'joint9' is not known"):
        load_arm(path)


@pytest.mark.parametrize("name", ["fetch", "panda"])
def test_built_in_folders_are_complete(name):
    files = {p.name for p in arm_folder(name).iterdir()}
    assert {"arm.xml", "arm.toml", "LICENSE", "README.md", "preview.png"} <= files
    text = (arm_folder(name) / "arm.xml").read_text()
    assert "<mesh" not in text  # primitives only
    assert load_arm(arm_folder(name)).name == name
