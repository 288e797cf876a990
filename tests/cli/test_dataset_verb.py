"""`dataset build` from hands and objects, its options, and what the other two verbs say of them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import neuralgrasps
from neuralgrasps.hands.zoo import hand_names, hand_sources
from neuralgrasps.objects.zoo import object_sources
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]
YCB7 = (
    "003_cracker_box", "005_tomato_soup_can", "006_mustard_bottle", "008_pudding_box", "009_gelatin_box",
    "010_potted_meat_can", "021_bleach_cleanser",
)  # fmt: skip


def test_group_names_stand_for_their_members() -> None:
    assert hand_sources(["all"]) == hand_sources([]) == hand_names()
    assert hand_sources(["my.xml", "panda"]) == ("my.xml", "panda")
    assert object_sources(["ycb7"]) == YCB7
    assert object_sources(["mug", "ycb7"]) == ("mug", *YCB7)


def test_one_command_makes_grasps_and_builds(ng: Call, tmp_path: Path) -> None:
    out = tmp_path / "d"
    command = ("dataset", "build", "--hands", "panda", "fetch", "--objects", "009_gelatin_box", "--count", 2)
    options = ("--out", out, "--workers", 1, "--clouds", "exact", "--cloud-points", 64)
    made = ng(*command, *options, "--hold-out", "fetch")
    assert made.code == 0, made.err
    assert (made.result["pairs"], made.result["grasps"], made.result["held_out"]) == (2, 4, ["fetch"])
    assert made.err.count("no scan is here") == 1 and "009_gelatin_box" in made.err
    info = ng("dataset", "info", out).result
    assert (info["clouds"], info["cloud_points"], info["held_out_hands"]) == ("exact", 64, ["fetch"])
    assert [(p["hand"], p["train"], p["test"]) for p in info["pairs"]] == [("fetch", 0, 2), ("panda", 1, 1)]
    assert neuralgrasps.read_dataset(out).clouds("panda", "gelatin_box").hand_points_O.shape == (2, 64, 3)
    assert ng("dataset", "verify", out).result["files"] == 7
    grasps = {p: p.stat().st_mtime_ns for p in (out / "synthesised").rglob("*.safetensors")}
    assert len(grasps) == 2
    again = ng(*command, *options, "--hold-out", "009_gelatin_box", "panda")
    assert again.code != 0 and "leaves no pair" in again.err  # the object alone is all there is
    again = ng(*command, *options)
    assert (again.result["built"], again.result["kept"], again.result["held_out"]) == (0, 2, [])
    assert {p: p.stat().st_mtime_ns for p in (out / "synthesised").rglob("*.safetensors")} == grasps


def test_grasp_files_are_still_taken(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out = tmp_path / "d"
    made = ng("dataset", "build", pipeline.grasps, "--out", out, "--workers", 1, "--hold-out", "panda")
    assert made.code == 0 and made.result["grasps"] == 12 and not (out / "synthesised").exists()
    assert np.array_equal(neuralgrasps.read_dataset(out).split("panda", "gelatin_box").test, np.arange(6))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "nothing to build from"),
        (("--hands", "panda"), "nothing to build from"),
        (
            ("--hands", "panda", "--objects", "gelatin_box", "--hold-out", "pandda"),
            "--hold-out: name 'pandda' is not known. Did you mean 'panda'?",
        ),
        (("--hands", "panda", "--objects", "gelatin_box", "--hold-out", "panda"), "leaves no pair"),
        (("--hands", "panda", "--objects", "gelatin_box", "--cloud-points", 0), "cloud_points is 0"),
        (("--hands", "panda", "--objects", "gelatin_box", "--count", 0), "count is 0"),
        (("grasps", "--count", 3), "--count"),
    ],
)
def test_what_cannot_be_built_is_said_before_any_work(ng: Call, tmp_path: Path, options, said: str) -> None:
    ended = ng("dataset", "build", *options, "--out", tmp_path / "d")
    assert ended.code != 0 and said in ended.err and not (tmp_path / "d" / "synthesised").exists()


def test_an_unknown_name_to_hold_out_of_grasp_files_is_named(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    ended = ng("dataset", "build", pipeline.grasps, "--out", tmp_path / "d", "--hold-out", "allegro")
    assert ended.code == 2 and "--hold-out: name 'allegro' is not known. Known names: fetch, gelatin_box" in ended.err


def test_info_notices_files_that_are_short_or_gone(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    copy = tmp_path / "d"
    shutil.copytree(pipeline.dataset, copy)
    sound = ng("dataset", "info", copy)
    assert sound.result["damaged"] == [] and "DAMAGED" not in sound.out and "spare: beyond 50 and 5" in sound.out
    manifest = neuralgrasps.read_dataset(copy).manifest
    short, gone = copy / manifest.shards[0].samples_file, copy / manifest.shards[1].grasps_file
    short.write_bytes(short.read_bytes()[:-100])
    gone.unlink()
    told = ng("dataset", "info", copy)
    assert told.code == 0 and "DAMAGED" in told.out and len(told.result["damaged"]) == 2
    assert any(manifest.shards[0].samples_file in line and "cut short" in line for line in told.result["damaged"])
    assert f"{manifest.shards[1].grasps_file}: missing" in told.result["damaged"]
