"""moveit_msgs/Grasp: frames by an independent computation, fields against the table, and the way back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.errors import DataFormatError, InputError, ShapeError
from neuralgrasps.export.frames import Wrist, hand_base, wrist_of
from neuralgrasps.export.messages import Ros, check_message
from neuralgrasps.export.moveit_grasp import (
    KIND,
    GraspMessageConfig,
    grasps_of,
    load_moveit_grasps,
    moveit_grasps,
    save_moveit_grasps,
)
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.urdf import load_urdf
from tests.export.conftest import poses

X_BO = poses(6, seed=5)[4]
MakeGrasps = Callable[..., GraspSet]


def turned(quaternion: Mapping[str, float], v: np.ndarray) -> np.ndarray:
    """v (3,) turned by a quaternion q, as q v q*; nothing of the library."""
    w, u = quaternion["w"], np.array([quaternion[k] for k in "xyz"])
    return v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))


def placed(pose: Mapping[str, Any], p: np.ndarray) -> np.ndarray:
    return turned(pose["orientation"], p) + [pose["position"][k] for k in "xyz"]


def test_the_pose_is_that_of_the_link_before_the_hand(fetch: Manipulator, grasps_by: MakeGrasps, assets: Path) -> None:
    """A point of the hand, taken through the vendor's fixed joint and the message, is where the grasp puts it."""
    grasps = grasps_by(fetch.hand, 8)
    wrist = wrist_of(fetch)
    messages = moveit_grasps(grasps, fetch.hand, frame_id="base_link", X_frame_O=X_BO, wrist=wrist)
    vendor = load_urdf(assets / "robots/fetch/fetch.urdf", with_visuals=False, missing_meshes="skip").tree
    X = forward_numpy(vendor, np.zeros(vendor.num_dofs))
    X_LH = np.linalg.inv(X[vendor.link_names.index(wrist.link)]) @ X[vendor.link_names.index("gripper_link")]
    assert np.abs(X_LH[:3, 3]).max() > 0.1  # else wrist and hand would not be told apart
    for point_H in np.random.default_rng(0).normal(size=(5, 3)):
        point_L = X_LH[:3, :3] @ point_H + X_LH[:3, 3]
        for message, X_OH in zip(messages, grasps.X_OH, strict=True):
            assert message["grasp_pose"]["header"]["frame_id"] == "base_link"
            expected = (X_BO @ X_OH @ [*point_H, 1.0])[:3]
            np.testing.assert_allclose(placed(message["grasp_pose"]["pose"], point_L), expected, atol=1e-6)


def test_an_allegro_on_a_panda_is_placed_by_its_flange(grasps_by: MakeGrasps) -> None:
    robot = mount(load_arm("panda"), load_hand("allegro"))
    grasps, q = grasps_by(robot.hand, 1), robot.arm.q_home
    X_BL = forward_numpy(robot.arm.tree, q)[robot.arm.flange]
    X_BH = robot.hand_pose(robot.q_home[robot.arm_dofs])
    X_frame_O = X_BH @ np.linalg.inv(grasps.X_OH[0])  # the hand is at the grasp when the arm is at home
    (message,) = moveit_grasps(grasps, robot.hand, frame_id="b", X_frame_O=X_frame_O, wrist=wrist_of(robot))
    for p in np.eye(3):
        expected = X_BL[:3, :3] @ p + X_BL[:3, 3]
        np.testing.assert_allclose(placed(message["grasp_pose"]["pose"], p), expected, atol=1e-9)
    assert (
        message["pre_grasp_approach"]["direction"]["header"]["frame_id"] == robot.arm.tree.link_names[robot.arm.flange]
    )


@pytest.mark.parametrize("name", hand_names())
def test_the_hand_comes_in_along_its_palm_axis_and_goes_back_the_same_way(name: str, grasps_by: MakeGrasps) -> None:
    hand = load_hand(name)
    grasps = grasps_by(hand, 1)
    wrist = Wrist(link="wrist", X_LH=poses(3, seed=9)[2])
    (message,) = moveit_grasps(grasps, hand, frame_id="base", X_frame_O=X_BO, wrist=wrist)
    palm = (X_BO @ grasps.X_OH[0])[:3, :3] @ hand.X_HP[:3, 2]
    for field, sign in (("pre_grasp_approach", 1), ("post_place_retreat", -1)):
        direction = message[field]["direction"]
        assert direction["header"]["frame_id"] == "wrist"
        along = turned(message["grasp_pose"]["pose"]["orientation"], np.array([direction["vector"][k] for k in "xyz"]))
        np.testing.assert_allclose(along, sign * palm, atol=1e-6)
    up = message["post_grasp_retreat"]["direction"]
    assert up["header"]["frame_id"] == "base" and up["vector"] == {"x": 0.0, "y": 0.0, "z": 1.0}


@pytest.mark.parametrize("ros", (1, 2))
@pytest.mark.parametrize("name", hand_names())
def test_grasps_survive_a_file(name: str, ros: Ros, grasps_by: MakeGrasps, tmp_path: Path) -> None:
    hand = load_hand(name)
    grasps, wrist = grasps_by(hand, 4), Wrist(link="wrist", X_LH=poses(2, seed=3)[0])
    given = {"frame_id": "base", "X_frame_O": X_BO, "wrist": wrist, "config": GraspMessageConfig(ros=ros)}
    path = save_moveit_grasps(tmp_path / "g.yaml", grasps, hand, **given)
    for message in yaml.safe_load(path.read_text())["grasps"]:
        check_message(KIND, message, ros=ros)
    read = load_moveit_grasps(path)
    assert (read.hand, read.object, read.frame_id, read.wrist_link, read.ros) == (name, "box", "base", "wrist", ros)
    assert [m["id"] for m in read.messages] == ["grasp_0", "grasp_1", "grasp_2", "grasp_3"]
    back = grasps_of(read.messages, hand, object_name=read.object, X_frame_O=X_BO, wrist=wrist)
    np.testing.assert_array_equal(back.epsilon, grasps.epsilon)
    for field in ("X_OH", "q", "q_pregrasp", "q_squeeze"):
        np.testing.assert_allclose(getattr(back, field), getattr(grasps, field), atol=1e-12)
    assert save_moveit_grasps(tmp_path / "h.yaml", grasps_by(hand, 4), hand, **given).read_bytes() == path.read_bytes()
    assert "pose of link 'wrist' in frame 'base'" in path.read_text().splitlines()[0]


def test_postures_and_the_rest_of_the_message(grasps_by: MakeGrasps) -> None:
    hand = load_hand("panda")
    grasps = grasps_by(hand, 2)
    config = GraspMessageConfig(
        approach_m=0.12, approach_min_m=0.03, lift_m=0.25, up=(0.0, 0.0, 2.0), up_frame="world", close_s=0.5,
        squeeze_s=0.25, max_contact_force=15.0, allowed_touch_objects=("shelf",),
        joint_names={"gripper": "left", "panda_finger_joint2": "right"},
    )  # fmt: skip
    first, second = moveit_grasps(
        grasps, hand, frame_id="base", X_frame_O=X_BO, wrist=hand_base(hand), names=("a", "b"), config=config
    )
    assert (first["id"], second["id"]) == ("a", "b")
    assert second["grasp_quality"] == grasps.epsilon[1]
    (before,) = second["pre_grasp_posture"]["points"]
    touch, press = second["grasp_posture"]["points"]
    assert second["pre_grasp_posture"]["joint_names"] == second["grasp_posture"]["joint_names"] == ["left", "right"]
    assert before["positions"] == [grasps.q_pregrasp[1, 0]] * 2 and before["effort"] == []
    assert touch["positions"] == [grasps.q[1, 0]] * 2 and press["positions"] == [grasps.q_squeeze[1, 0]] * 2
    assert touch["effort"] == press["effort"] == [70.0, 70.0]
    assert press["time_from_start"] == {"sec": 0, "nanosec": 750_000_000}
    approach, lift = second["pre_grasp_approach"], second["post_grasp_retreat"]
    assert approach["direction"]["header"]["frame_id"] == "panda_hand"
    assert (approach["desired_distance"], approach["min_distance"]) == (0.12, 0.03)
    assert lift["direction"]["header"]["frame_id"] == "world" and lift["direction"]["vector"]["z"] == 1.0
    assert (second["max_contact_force"], second["allowed_touch_objects"]) == (15.0, ["shelf"])


def test_a_grasp_posture_of_one_point_is_read(grasps_by: MakeGrasps) -> None:
    hand = load_hand("fetch")
    messages = moveit_grasps(grasps_by(hand, 1), hand, frame_id="base", X_frame_O=np.eye(4))
    messages[0]["grasp_posture"]["points"].pop()
    back = grasps_of(messages, hand, object_name="box", X_frame_O=np.eye(4))
    np.testing.assert_array_equal(back.q_squeeze, back.q)
    messages[0]["grasp_posture"]["points"].clear()
    with pytest.raises(DataFormatError, match="grasp_posture has no points"):
        grasps_of(messages, hand, object_name="box", X_frame_O=np.eye(4))


def test_no_messages_are_no_grasps() -> None:
    assert len(grasps_of([], load_hand("allegro"), object_name="box", X_frame_O=np.eye(4))) == 0


def test_messages_whose_joints_or_quaternions_do_not_fit(grasps_by: MakeGrasps) -> None:
    hand = load_hand("fetch")

    def message() -> dict[str, Any]:
        return moveit_grasps(grasps_by(hand, 1), hand, frame_id="base", X_frame_O=np.eye(4))[0]

    short, apart, zero = message(), message(), message()
    short["grasp_posture"]["points"][0]["positions"].pop()
    apart["pre_grasp_posture"]["points"][0]["positions"][1] += 0.01
    zero["grasp_pose"]["pose"]["orientation"] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    for wrong, said in (
        (short, "1 positions for 2 joints"),
        (apart, "follows the others"),
        (zero, "quaternion is zero"),
    ):
        with pytest.raises(DataFormatError, match=f"grasp_0.*{said}"):
            grasps_of([wrong], hand, object_name="box", X_frame_O=np.eye(4))


def test_bad_input_is_refused_in_words(grasps_by: MakeGrasps) -> None:
    hand, other = load_hand("fetch"), load_hand("allegro")
    grasps = grasps_by(hand, 2)
    good: dict[str, Any] = {"frame_id": "base", "X_frame_O": np.eye(4)}
    scaled = np.diag([2.0, 2.0, 2.0, 1.0])
    cases: list[tuple[GraspSet, Any, dict[str, Any], str]] = [
        (empty_grasps("fetch", "box", num_joints=1), hand, good, "no grasps of 'box' by 'fetch'"),
        (grasps, other, good, "hand 'allegro' was given"),
        (grasps, hand, good | {"frame_id": ""}, "frame_id is empty"),
        (grasps, hand, good | {"X_frame_O": scaled}, "X_frame_O is not a rigid transform"),
        (grasps, hand, good | {"X_frame_O": np.eye(3)}, "X_frame_O has shape"),
        (grasps, hand, good | {"X_frame_O": np.eye(4) * np.nan}, "X_frame_O is not a rigid transform"),
        (grasps, hand, good | {"wrist": Wrist(link="w", X_LH=scaled)}, "X_LH is not a rigid"),
        (grasps, hand, good | {"names": ["a", "a"]}, "2 names, 1 of them different"),
        (grasps, hand, good | {"names": ["a"]}, "1 names"),
    ]
    for given, by, options, said in cases:
        with pytest.raises(InputError, match=said):
            moveit_grasps(given, by, **options)
    with pytest.raises(ShapeError, match="q has 16 columns but hand 'fetch' has 1 joints"):
        moveit_grasps(replace(grasps_by(other, 2), hand="fetch"), hand, **good)


@pytest.mark.parametrize(
    ("wrong", "said"),
    (
        ({"approach_min_m": 0.2}, "approach_min_m, approach_m are 0.2, 0.1"),
        ({"lift_m": np.nan}, "lift_m"),
        ({"close_s": 0.0}, "positive seconds"),
        ({"up": (0.0, 0.0, 0.0)}, "expected a direction"),
    ),
)
def test_contradictory_settings(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        GraspMessageConfig(**wrong)


@pytest.mark.parametrize(
    ("damage", "said"),
    (
        (lambda d: d.update(format="moveit"), "holds 'moveit'"),
        (lambda d: d.pop("wrist_link"), "lacks wrist_link"),
        (lambda d: d.update(ros=3), "ros is 3"),
        (lambda d: d.update(ros=1), "lacks seq|lacks secs"),
        (lambda d: d.update(hand=7), "hand should be text"),
        (lambda d: d["grasps"][1].pop("grasp_pose"), r"grasps\[1\] lacks grasp_pose"),
        (lambda d: d["grasps"][0]["grasp_pose"]["pose"]["position"].update(x="1"), r"grasps\[0\].*position.x is '1'"),
    ),
)
def test_damaged_files(
    damage: Callable[[dict[str, Any]], Any], said: str, grasps_by: MakeGrasps, tmp_path: Path
) -> None:
    hand = load_hand("panda")
    path = save_moveit_grasps(tmp_path / "g.yaml", grasps_by(hand, 2), hand, frame_id="b", X_frame_O=np.eye(4))
    data = yaml.safe_load(path.read_text())
    damage(data)
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(DataFormatError, match=said):
        load_moveit_grasps(path)


def test_postures_stay_within_the_joint_limits_and_say_the_force_apart(grasps_by: Callable[..., GraspSet]) -> None:
    hand = load_hand("panda")
    grasps = grasps_by(hand, 2)
    beyond = replace(grasps, q_squeeze=np.full((2, 1), -0.0146), q_pregrasp=np.full((2, 1), 0.05))
    config = GraspMessageConfig(force=0.25)
    message = moveit_grasps(beyond, hand, frame_id="box", X_frame_O=np.eye(4), config=config)[0]
    (before,) = message["pre_grasp_posture"]["points"]
    press = message["grasp_posture"]["points"][1]
    assert before["positions"] == [hand.tree.upper[0]] * 2
    assert press["positions"] == [0.0, 0.0] and press["effort"] == [0.25 * hand.tree.effort[0]] * 2
    with pytest.raises(InputError, match="force is 2"):
        GraspMessageConfig(force=2.0)
