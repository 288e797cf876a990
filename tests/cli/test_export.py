"""`neuralgrasps export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuralgrasps.export.bare_grasps import bare_grasps
from neuralgrasps.export.isaac_grasp import load_isaac_grasps
from neuralgrasps.export.moveit_grasp import grasps_of, load_moveit_grasps
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import Verdict
from neuralgrasps.hands.zoo import load_hand
from tests.cli.conftest import Ended

Call = Callable[..., Ended]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Five grasps by the Fetch, of which the third dropped the object."""
    hand = load_hand("fetch")
    X_OH = np.tile(np.eye(4), (5, 1, 1))
    X_OH[:, 0, 3] = np.arange(5) / 10
    q = np.linspace(0.0, 0.04, 5)[:, None]
    grasps = bare_grasps(
        hand, "gelatin_box", X_OH=X_OH, q_pregrasp=q + 0.01, q=q, q_squeeze=q / 2,
        quality=np.array([0.1, 0.4, 0.5, 0.2, 0.3]), source="tests",
    )  # fmt: skip
    held = Verdict(success=np.arange(5) != 2, displacement_m=np.zeros(5), rotation_rad=np.zeros(5))
    return save_grasps(tmp_path / "grasps.safetensors", grasps.with_verdict("dexgraspbench", held), hand=hand)


def test_moveit_messages_of_the_grasps_that_held(ng: Call, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "moveit.yaml"
    ended = ng("export", file, "--format", "moveit", "--out", out)
    assert ended.code == 0 and ended.result["index"] == [0, 1, 3, 4] and "4 grasps of 5" in ended.out
    read = load_moveit_grasps(out)
    assert (read.frame_id, read.wrist_link, read.object) == ("gelatin_box", "gripper_link", "gelatin_box")
    assert [m["id"] for m in read.messages] == ["grasp_0", "grasp_1", "grasp_3", "grasp_4"]
    assert read.messages[0]["post_grasp_retreat"]["direction"]["header"]["frame_id"] == "world"
    back = grasps_of(read.messages, load_hand("fetch"), object_name=read.object, X_frame_O=np.eye(4))
    np.testing.assert_allclose(back.X_OH, load_grasps(file).X_OH[[0, 1, 3, 4]], atol=1e-12)


def test_poses_of_the_wrist_in_the_robots_frame(ng: Call, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "moveit.yaml"
    where = ("--frame", "base_link", "--pose", 0.6, 0, 0.8, 0, 0, 1, 0)  # half a turn about z
    ended = ng("export", file, "--format", "moveit", "--out", out, "--arm", "fetch", *where, "--count", 2, "--ros", 1)
    assert ended.code == 0 and ended.result["index"] == [1, 4] and ended.result["link"] == "wrist_roll_link"
    read = load_moveit_grasps(out)
    assert read.ros == 1 and read.wrist_link == "wrist_roll_link"
    pose = read.messages[0]["grasp_pose"]["pose"]
    # grasp 1 is 0.1 m along x of the object, which points backwards; the wrist is 0.16645 m behind the hand
    np.testing.assert_allclose([pose["position"][k] for k in "xyz"], [0.6 - 0.1 + 0.16645, 0.0, 0.8], atol=1e-9)
    np.testing.assert_allclose([pose["orientation"][k] for k in "xyzw"], [0, 0, 1, 0], atol=1e-9)
    assert read.messages[0]["post_grasp_retreat"]["direction"]["header"]["frame_id"] == "base_link"


def test_isaac_file_with_grasps_that_failed(ng: Call, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "isaac.yaml"
    assert ng("export", file, "--format", "isaac", "--out", out, "--failed", "--hand", "fetch").code == 0
    read = load_isaac_grasps(out, load_hand("fetch"), object_name="gelatin_box")
    assert read.names == tuple(f"grasp_{i}" for i in range(5)) and read.gripper_frame == "gripper_link"
    np.testing.assert_allclose(read.grasps.q, load_grasps(file).q, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "said"),
    (
        (
            ("--format", "isaac", "--arm", "fetch"),
            "--arm is an option of --format moveit; an isaac_grasp file has no place for it",
        ),
        (
            ("--format", "isaac", "--arm", "fetch", "--frame", "b"),
            "--arm, --frame are options of --format moveit; an isaac_grasp file has no place for them",
        ),
        (("--format", "moveit", "--pose", 0, 0, 0, 0, 0, 0, 1), "name that frame with --frame"),
        (("--format", "moveit", "--frame", "b", "--pose", 0, 0, 0, 1, 1, 1, 1), "quaternion of length 2"),
        (("--format", "moveit", "--count", 0), "--count is 0"),
        (("--format", "moveit", "--hand", "panda"), "hand 'panda' was given"),
        (("--format", "moveit", "--hand", "pandda"), "Did you mean 'panda'"),
        (("--format", "moveit", "--arm", "fech"), "fetch"),
        (("--format", "graspit"), "graspit"),
    ),
)
def test_bad_options(ng: Call, file: Path, tmp_path: Path, options: tuple[Any, ...], said: str) -> None:
    out = tmp_path / "out.yaml"
    ended = ng("export", file, "--out", out, *options)
    assert ended.code == 2 and said in ended.err and not out.exists()


def test_files_that_hold_nothing_to_export(ng: Call, file: Path, tmp_path: Path) -> None:
    grasps = load_grasps(file)
    dropped = save_grasps(tmp_path / "dropped.safetensors", grasps[[2]])
    ended = ng("export", dropped, "--format", "isaac", "--out", tmp_path / "o.yaml")
    assert ended.code == 2 and "None held its trial; --failed" in ended.err
    empty = save_grasps(tmp_path / "empty.safetensors", grasps[[]])
    assert "none to export" in ng("export", empty, "--format", "isaac", "--out", tmp_path / "o.yaml").err
    missing = ng("export", tmp_path / "no.safetensors", "--format", "isaac", "--out", tmp_path / "o.yaml")
    assert missing.code == 2 and "no.safetensors" in missing.err
    folder = ng("export", file, "--format", "isaac", "--out", tmp_path)
    assert folder.code == 2 and "is a folder" in folder.err


@pytest.mark.parametrize(
    ("first", "said"),
    (
        ("# pick 'box' with 'fetch+fetch', step by step\nformat: neuralgrasps.pick_plan\n", "is the plan of one pick"),
        ("format: moveit_msgs/Grasp[]\n", "already holds exported grasps (moveit_msgs/Grasp[])"),
        ("# 2 grasps\nformat: isaac_grasp\n", "already holds exported grasps (isaac_grasp)"),
    ),
)
def test_files_that_were_exported_are_no_grasp_files(ng: Call, tmp_path: Path, first: str, said: str) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(first + "version: 1\n")
    ended = ng("export", path, "--format", "moveit", "--out", tmp_path / "o.yaml")
    assert ended.code == 2 and said in ended.err.replace("\n", " ") and "damaged" not in ended.err
