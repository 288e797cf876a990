"""The `demonstrate` verb: a made-up video to a robot hand's grasps, what it writes, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.cli.demonstrate import _reason_with
from neuralgrasps.cli.demonstrate_show import short_why
from neuralgrasps.export.pick_plan import load_pick_plan
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.objects.zoo import load_object
from tests.cli.conftest import Ended, Pipeline
from tests.hands.conftest import three_finger_urdf
from tests.human.shown import SCALE, shown_video, write_video

Call = Callable[..., Ended]
OBJECT = "tomato_soup_can"


@dataclass(frozen=True, slots=True, kw_only=True)
class Video:
    """A folder of frames, and the file of the joints in them."""

    folder: Path
    joints: Path

    @property
    def args(self) -> tuple[object, ...]:
        return ("demonstrate", "--rgbd", self.folder, "--object", OBJECT, "--joints", self.joints)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Video:
    folder = tmp_path_factory.mktemp("shown") / "video"
    shown = shown_video(load_object(OBJECT), (None, None, 0.06, 0.004, 0.004, 0.004, 0.004))
    return Video(folder=folder, joints=write_video(folder, shown))


@pytest.fixture
def no_depth_in_one(video: Video, tmp_path: Path) -> Path:
    folder = tmp_path / "video"
    shutil.copytree(video.folder, folder)
    Image.fromarray(np.zeros((240, 320), np.uint16)).save(folder / "depth" / "000001.png")
    return folder


def test_a_video_becomes_grasps_that_hold_and_a_lifted_object(ng: Call, video: Video, tmp_path: Path):
    out, page = tmp_path / "out", tmp_path / "page.html"
    ended = ng(*video.args, "--count", 2, "--execute", "--out", out, "--report", page)
    result = ended.result
    assert ended.code == 0, ended.err
    assert result["stage"] == ""
    assert [s["verdict"] for s in result["stages"]] == ["ok"] * 8
    person = result["person"]
    assert person["side"] == "right"
    assert person["moment"] in (3, 4, 5, 6)
    assert person["scale"] == pytest.approx(SCALE, abs=0.06)
    assert person["by_frame"][0]["box"] is None
    assert np.shape(person["by_frame"][3]["joints_C"]) == (21, 3)
    found = result["transfer"]["grasps"]
    assert 1 <= len(found) <= 2
    assert all(g["held"] for g in found)
    assert all(0.0 <= g["similarity"] <= 1.0 for g in found)
    assert "FAILED" not in ended.out
    assert result["execution"]["success_retry"]
    assert result["execution"]["place"] in (0, 1)
    assert load_pick_plan(out / "plan.yaml").hand == "fetch"
    grasps = load_grasps(out / "grasps.safetensors")
    assert (grasps.hand, grasps.object, len(grasps)) == ("fetch", OBJECT, len(found))
    np.testing.assert_allclose(grasps.X_OH, [g["X_OH"] for g in found])
    written = json.loads((out / "demonstration.json").read_text())
    assert written["transfer"] == result["transfer"]
    assert (out / "grasp_1.png").exists()
    html = page.read_text(encoding="utf-8")
    assert "Stage by stage" in html
    assert "Carried out, no. " in html


def test_the_stage_that_fails_is_named_with_its_reason(ng: Call, video: Video, tmp_path: Path):
    none = tmp_path / "none.json"
    none.write_text(json.dumps({"frames": [None] * 7}))
    ended = ng("demonstrate", "--rgbd", video.folder, "--object", OBJECT, "--joints", none, "--execute")
    assert ended.code == 1
    assert ended.result["stage"] == "detect"
    assert "no hand" in ended.result["reason"]
    verdicts = [s["verdict"] for s in ended.result["stages"]]
    assert verdicts == ["ok", "failed", *["not reached"] * 6]
    assert ended.result["transfer"] is None
    assert ended.result["execution"] is None
    assert f"Stopped at Hand: {ended.result['reason']}" in ended.out


def test_another_object_than_the_one_on_the_table_is_not_found(ng: Call, video: Video):
    ended = ng(*video.args[:3], "--object", "cracker_box", "--joints", video.joints)
    assert ended.code == 1
    assert ended.result["stage"] == "object"
    assert ended.result["person"] is None


def test_a_frame_without_depth_is_left_out_and_said(ng: Call, video: Video, no_depth_in_one: Path, tmp_path: Path):
    records = json.loads(video.joints.read_text())["frames"]
    joints = tmp_path / "by_name.json"
    joints.write_text(json.dumps({f"{k:06d}": r for k, r in enumerate(records) if k == 2}))
    ended = ng("demonstrate", "--rgbd", no_depth_in_one, "--object", OBJECT, "--joints", joints)
    assert "1 frame left out" in ended.err
    assert ended.result["frame_numbers"] == [0, 2, 3, 4, 5, 6]


def test_pictures_without_depth_are_said_and_frames_called_by_their_files(ng: Call, video: Video, tmp_path: Path):
    folder = tmp_path / "video"
    shutil.copytree(video.folder, folder)
    for k in range(7):
        Image.fromarray(np.zeros((240, 320, 3), np.uint8)).save(_made(folder / "rgb") / f"{k:06d}.png")
    for k in (0, 2):
        (folder / "depth" / f"{k:06d}.png").unlink()
    records = json.loads(video.joints.read_text())["frames"]
    joints = tmp_path / "by_name.json"
    joints.write_text(json.dumps({f"{k:06d}": r for k, r in enumerate(records)}))
    ended = ng("demonstrate", "--rgbd", folder, "--object", OBJECT, "--joints", joints, "--count", 1)
    assert "warning: 2 of 7 frames have no depth and are left out (000000, 000002)." in ended.err
    assert "sure, in frame 00000" in ended.result["stages"][0]["text"]
    moment = ended.result["frame_names"][ended.result["person"]["moment"]]
    assert f"in frame {moment}" in ended.result["stages"][4]["text"]


def _made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder


def test_every_takes_some_frames_and_their_joints(ng: Call, video: Video, tmp_path: Path):
    records = json.loads(video.joints.read_text())["frames"]
    joints = tmp_path / "few.json"
    joints.write_text(json.dumps({"frames": [r if k in (2,) else None for k, r in enumerate(records)]}))
    args = ("demonstrate", "--rgbd", video.folder, "--object", OBJECT, "--joints", joints)
    assert ng(*args, "--every", 3).result["frame_numbers"] == [0, 3, 6]
    assert ng(*args, "--every", 3).result["stage"] == "detect"  # frame 2 was not among them


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--rgbd", "nowhere"), "--rgbd is 'nowhere', which does not exist"),
        (("--object", "tomato_soup_cn"), "Did you mean 'tomato_soup_can'"),
        (("--hand", "fetsh"), "Did you mean 'fetch'"),
        (("--hand", "allegro", "--execute"), "--arm is missing: hand 'allegro' comes with none"),
        (("--approach", "down"), "--approach is 'down'; it takes an axis and an angle, such as: down 30deg"),
        (("--approach", "down", "30deg", "1"), "it takes an axis and an angle"),
        (("--arm", "panda"), "add --execute"),
        (("--video", "film.mp4"), "add --execute"),
        (("--execute", "--video", "film.avi"), "ending in .mp4"),
        (("--every", "0"), "--every is 0"),
        (("--count", "0"), "--count is 0"),
        (("--seed", "-1"), "--seed is -1"),
        (("--landmarker", "hand.task"), "give one of them"),
        (("--joints", "nowhere.json"), "--joints is 'nowhere.json', which does not exist"),
        (("--colour", "a.png"), "--colour goes with a single depth image"),
        (("--fx", "300", "--camera", "a.json"), "both give the camera"),
        (("--keep-free", "lid"), "lid"),
        (("--keep-free", "top:1"), "covers all of the surface"),
        (("--approach", "sideways", "30deg"), "approach axis 'sideways'"),
        (("--approach", "world:+x", "30deg"), "is not vertical"),
        (("--report", "."), "is a folder"),
    ],
)
def test_bad_input_is_refused_before_the_work(
    ng: Call, video: Video, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], message: str
):
    monkeypatch.chdir(tmp_path)
    given = dict(zip(video.args[1::2], video.args[2::2], strict=True))
    given |= {options[0]: options[1]} if options[0] in given else {}
    rest = options[2:] if options[0] in given and given[options[0]] == options[1] else options
    ended = ng("demonstrate", *(v for pair in given.items() for v in pair), *rest)
    assert ended.code == 2
    assert message in ended.err


def test_a_whole_robot_as_hand_is_offered_as_the_arm_too(ng: Call, video: Video, tmp_path: Path):
    file = tmp_path / "robot.urdf"
    file.write_text(three_finger_urdf())
    ended = ng(*video.args, "--hand", file, "--execute")
    assert ended.code == 2
    assert f"Is 'robot.urdf' the whole robot? Then it is the arm too: --arm {file}." in ended.err


def test_grasps_of_another_hand_are_refused(ng: Call, video: Video, pipeline: Pipeline):
    file = next(pipeline.grasps.rglob("*.safetensors"))
    ended = ng(*video.args, "--grasps", file)
    assert ended.code == 2
    assert f"expected some of 'fetch' on '{OBJECT}'" in ended.err


def test_constraints_that_leave_nothing_say_what_would_do_without_them(ng: Call, video: Video):
    ended = ng(*video.args, "--count", 1, "--approach", "-z", "2deg", "--keep-free", "top:0.45")
    assert ended.code == 1
    assert ended.result["stage"] == "transfer"
    said = re.match(
        r"no grasp of hand 'fetch' meets all conditions \((\d+) known, (\d+) made for this\): of (\d+) candidates, "
        r"'approach along -z within 2°' takes .*; 0 left; without the constraints one",
        ended.result["reason"],
    )
    assert said is not None, ended.result["reason"]
    assert int(said[1]) + int(said[2]) == int(said[3])
    assert "'clear of the table' takes" in said[0]
    assert "without the constraints one of similarity 0." in ended.result["reason"]
    assert ended.result["constraints"] == ["approach along -z within 2°", "keep top:0.45 free by 5 mm"]


def test_what_would_hold_without_constraints_is_the_most_alike(monkeypatch):
    """Not the one of which similarity is given up for a firmer hold."""

    def found(query, hand, obj, *, config, **_):
        alike = np.array([0.7, 0.9, 0.8]) if config.robust else np.array([0.9, 0.8, 0.7])
        return SimpleNamespace(grasps=range(config.count), similarity=alike[: config.count])

    monkeypatch.setattr("neuralgrasps.apply.transfer.transfer", found)
    task = SimpleNamespace(known=None, hand=None, obj=None, config=TransferConfig(count=3, robust=0.08))
    demo = Demonstration(object="box", hand="fetch", seed=0, stage="transfer", reason="none holds.", query="asked")
    quiet = SimpleNamespace(progress=lambda _: nullcontext())
    assert _reason_with(quiet, demo, task, None) == (
        "none holds; without the constraints one of similarity 0.90 holds."
    )


def test_the_reason_printed_repeats_no_other_column():
    reason = (
        "number 2 in likeness, generated from row 3 of the known grasps; similarity 0.90 against 0.80 of the best known"
    )
    assert short_why(f"{reason}; held in dexgraspbench") == "generated from row 3 of the known grasps"
    assert short_why("held in dexgraspbench") == "held in dexgraspbench"
