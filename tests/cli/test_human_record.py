"""`neuralgrasps human record`: what it writes, says and refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from neuralgrasps.cli.human_record import _missed
from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.human.synthetic.files import read_truth
from neuralgrasps.perception.frame_files import read_frames
from tests.cli.conftest import Ended

Call = Callable[..., Ended]


def test_recordings_are_videos_with_their_truth(ng: Call, tmp_path: Path) -> None:
    asked = ("human", "record", "--object", "gelatin_box", "--side", "right", "--scale", 0.78, "--seed", 2)
    made = ng(*asked, "--count", 2, "--no-noise", "--out", tmp_path / "videos")
    assert made.code == 0 and made.result["failures"] == [] and len(made.result["recordings"]) == 2
    for seed, (name, record) in enumerate(zip(("000", "001"), made.result["recordings"], strict=True), start=2):
        folder = tmp_path / "videos" / name
        assert (record["folder"], record["side"], record["scale"], record["seed"]) == (str(folder), "right", 0.78, seed)
        truth, frames = read_truth(folder), read_frames(folder)
        assert len(frames) == len(truth.q) == record["frames"] and truth.object == "gelatin_box"
        assert frames[0].colour is not None and frames[0].X_WC is not None
        assert truth.still[0] <= record["grasp_frame"] < truth.still[1]
        with Image.open(folder / "strip.png") as strip:
            assert strip.width > 5 * strip.height and np.ptp(np.asarray(strip)) > 100
    assert "78" in made.out and "right" in made.out


def test_an_object_that_no_hand_grasps_ends_with_code_1_and_the_reason(ng: Call, tmp_path: Path) -> None:
    block, path = box_mesh([0.15, 0.15, 0.15]), tmp_path / "block.off"
    rows = [*(" ".join(map(str, v)) for v in block.vertices), *(f"3 {a} {b} {c}" for a, b, c in block.faces)]
    path.write_text("\n".join(["OFF", "8 12 0", *rows]))
    asked = ("human", "record", "--object", path, "--unit", "m", "--side", "left", "--scale", 0.7)
    ended = ng(*asked, "--out", tmp_path / "videos")
    assert ended.code == 1 and "too wide" in ended.out and ended.result["recordings"] == []
    assert not (tmp_path / "videos").exists()


def test_a_badly_seen_hand_is_asked_for_by_its_share(ng: Call, tmp_path: Path) -> None:
    asked = ("human", "record", "--object", "gelatin_box", "--side", "right", "--scale", 0.78, "--seed", 2)
    made = ng(*asked, "--no-noise", "--share", 0.4, 0.6, "--out", tmp_path / "video")
    record = made.result["recordings"][0]
    truth = read_truth(tmp_path / "video")
    assert made.code == 0 and 0.4 <= record["visible_at_grasp"] <= 0.6
    assert record["visible_at_grasp"] == float(truth.visible[truth.grasp_frame])
    assert f"{100 * record['visible_at_grasp']:.0f} %" in made.out
    assert "40 to 60 %" in made.out and "warning" not in made.err


def test_a_share_that_was_not_reached_is_said() -> None:
    made = [{"seed": 4, "visible_at_grasp": 0.69}, {"seed": 5, "visible_at_grasp": 0.3}]
    said = _missed(made, (0.1, 0.3))
    assert said.startswith("warning: 1 of 2 recordings could not be made with 10 to 30 % of the hand visible")
    assert "69 % with seed 4." in said
    assert _missed(made, (0.3, 0.7)) == "" and _missed(made, None) == ""


def test_a_folder_that_holds_a_recording_is_refused_and_left_as_it_is(ng: Call, tmp_path: Path) -> None:
    asked = ("human", "record", "--object", "gelatin_box", "--seed", 2, "--out", tmp_path)
    (tmp_path / "001").mkdir()
    (tmp_path / "001" / "truth.json").write_text("{}")
    ended = ng(*asked, "--count", 2)
    assert ended.code == 2 and "'" + str(tmp_path / "001") + "' holds a recording already" in ended.err
    assert not (tmp_path / "000").exists() and (tmp_path / "001" / "truth.json").read_text() == "{}"


def test_what_cannot_be_is_refused(ng: Call, tmp_path: Path) -> None:
    asked = ("human", "record", "--object", "gelatin_box", "--out", tmp_path / "videos")
    assert "0.66 to 0.92" in ng(*asked, "--scale", 1.0).err
    assert "share is (0.8, 0.4)" in ng(*asked, "--share", 0.8, 0.4).err
    assert "--count is 0" in ng(*asked, "--count", 0).err
    assert ng("human", "record", "--object", "gelatin_bok", "--out", tmp_path / "videos").code == 2
