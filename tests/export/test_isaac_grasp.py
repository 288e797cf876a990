"""isaac_grasp files: frames and quaternion order by an independent computation, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export.isaac_grasp import isaac_grasps, load_isaac_grasps, save_isaac_grasps
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.hands.zoo import hand_names, load_hand
from tests.export.test_moveit_grasp import turned

MakeGrasps = Callable[..., GraspSet]


def test_a_file_has_the_published_layout(grasps_by: MakeGrasps, tmp_path: Path) -> None:
    hand = load_hand("panda")
    grasps = grasps_by(hand, 2)
    data = yaml.safe_load(save_isaac_grasps(tmp_path / "g.yaml", grasps, hand).read_text())
    assert list(data) == ["format", "format_version", "object_frame", "gripper_frame", "grasps"]
    assert (data["format"], data["object_frame"], data["gripper_frame"]) == ("isaac_grasp", "box", "panda_hand")
    assert isinstance(data["format_version"], float) and data["format_version"] == 1.0
    assert list(data["grasps"]) == ["grasp_0", "grasp_1"]
    one = data["grasps"]["grasp_1"]
    assert list(one) == ["confidence", "position", "orientation", "cspace_position", "pregrasp_cspace_position"]
    assert one["cspace_position"] == {"panda_finger_joint1": grasps.q[1, 0]}  # the second finger follows
    assert one["pregrasp_cspace_position"] == {"panda_finger_joint1": grasps.q_pregrasp[1, 0]}
    assert one["confidence"] == grasps.epsilon[1]


def test_the_pose_is_the_hand_base_in_the_object(grasps_by: MakeGrasps) -> None:
    hand = load_hand("allegro")
    grasps = grasps_by(hand, 8)
    entries = isaac_grasps(grasps, hand)["grasps"].values()
    for entry, X_OH in zip(entries, grasps.X_OH, strict=True):
        quaternion = dict(zip("xyz", entry["orientation"]["xyz"], strict=True)) | {"w": entry["orientation"]["w"]}
        for p in np.eye(3):
            moved = turned(quaternion, p) + entry["position"]
            np.testing.assert_allclose(moved, (X_OH @ [*p, 1.0])[:3], atol=1e-9)


@pytest.mark.parametrize("name", hand_names())
def test_grasps_survive_a_file(name: str, grasps_by: MakeGrasps, tmp_path: Path) -> None:
    hand = load_hand(name)
    grasps = grasps_by(hand, 4)
    path = save_isaac_grasps(tmp_path / "g.yaml", grasps, hand, names=("d", "c", "b", "a"), gripper_frame="/World/hand")
    read = load_isaac_grasps(path, hand, object_name="box")
    assert read.names == ("d", "c", "b", "a")
    assert (read.object_frame, read.gripper_frame) == ("box", "/World/hand")
    for field in ("X_OH", "q", "q_pregrasp", "epsilon"):
        np.testing.assert_allclose(getattr(read.grasps, field), getattr(grasps, field), atol=1e-12)
    np.testing.assert_array_equal(read.grasps.q_squeeze, read.grasps.q)
    again = save_isaac_grasps(
        tmp_path / "h.yaml", grasps_by(hand, 4), hand, names=("d", "c", "b", "a"), gripper_frame="/World/hand"
    )
    assert again.read_bytes() == path.read_bytes()


def test_closed_joints_may_be_those_that_press(grasps_by: MakeGrasps) -> None:
    hand = load_hand("fetch")
    grasps = grasps_by(hand, 1)
    entry = isaac_grasps(grasps, hand, squeezed=True, joint_names={"gripper": "jaw"})["grasps"]["grasp_0"]
    assert entry["cspace_position"] == {"jaw": grasps.q_squeeze[0, 0]}


OTHERS = """format: isaac_grasp
format_version: 1.0
object_frame_link: /World/cup
gripper_frame_link: /World/hand
grasps:
  "top":
    confidence: 1
    position: [0.1, 0, -0.25]
    orientation: {w: 0.70711, xyz: [0, 0, 0.70711]}
    cspace_position:
      panda_finger_joint1: 0.01
      panda_finger_joint2: 0.01
    pregrasp_cspace_position: {panda_finger_joint1: 0.04}
"""


def test_files_of_other_writers_are_read(tmp_path: Path) -> None:
    """Older names of frames, whole numbers, five decimals, followers listed or not."""
    path = tmp_path / "others.yaml"
    path.write_text(OTHERS)
    read = load_isaac_grasps(path, load_hand("panda"), object_name="cup")
    assert (read.object_frame, read.gripper_frame, read.names) == ("/World/cup", "/World/hand", ("top",))
    expected = [[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.25], [0.0, 0.0, 0.0, 1.0]]
    np.testing.assert_allclose(read.grasps.X_OH[0], expected, atol=1e-12)
    assert (read.grasps.q[0, 0], read.grasps.q_pregrasp[0, 0]) == (0.01, 0.04)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    (
        ("isaac_grasp", "graspit", "holds 'graspit'"),
        ("1.0\n", "2.0\n", "format_version 2.0"),
        ("grasps:", "other:", "lacks 'grasps'"),
        ("confidence: 1\n", "confidence: 1.5\n", "confidence is 1.5"),
        ("    confidence: 1\n", "", "top lacks confidence"),
        ("[0.1, 0, -0.25]", "[0.1, 0]", "expected three numbers"),
        ("[0.1, 0, -0.25]", "[0.1, x, 0]", "position is 'x'"),
        ("{w: 0.70711, xyz: [0, 0, 0.70711]}", "[1, 0, 0, 0]", "expected w and xyz"),
        ("w: 0.70711", "w: 0", "has not length 1"),
        ("w: 0.70711", "w: .nan", "orientation.w is nan"),
        ("panda_finger_joint2: 0.01", "panda_finger_joint2: 0.02", "follows the others to 0.01"),
        ("panda_finger_joint2: 0.01", "thumb: 0.01", "thumb are unknown"),
        ("{panda_finger_joint1: 0.04}", "{}", "lacks joints panda_finger_joint1"),
        ("{panda_finger_joint1: 0.04}", "0.04", "expected positions by the names"),
    ),
)
def test_files_that_do_not_fit(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in OTHERS
    path = tmp_path / "bad.yaml"
    path.write_text(OTHERS.replace(old, new, 1))
    with pytest.raises(DataFormatError, match=said):
        load_isaac_grasps(path, load_hand("panda"), object_name="cup")


def test_bad_input(grasps_by: MakeGrasps) -> None:
    hand = load_hand("fetch")
    with pytest.raises(InputError, match="no grasps of 'box'"):
        isaac_grasps(empty_grasps("fetch", "box", num_joints=1), hand)
    with pytest.raises(InputError, match="hand 'panda' was given"):
        isaac_grasps(grasps_by(hand), load_hand("panda"))


def test_a_file_without_grasps_is_an_empty_set(tmp_path: Path) -> None:
    path: Any = tmp_path / "empty.yaml"
    path.write_text("format: isaac_grasp\nformat_version: 1.0\ngrasps: {}\n")
    assert len(load_isaac_grasps(path, load_hand("barrett"), object_name="cup").grasps) == 0


def test_squeezed_joints_stay_within_their_limits(grasps_by: Callable[..., GraspSet]) -> None:
    hand = load_hand("panda")
    grasps = replace(grasps_by(hand, 1), q_squeeze=np.array([[-0.0146]]))
    entry = isaac_grasps(grasps, hand, squeezed=True)["grasps"]["grasp_0"]
    assert entry["cspace_position"] == {"panda_finger_joint1": 0.0}
