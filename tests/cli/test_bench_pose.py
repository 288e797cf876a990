"""`neuralgrasps bench pose`: which objects and run it takes, its options, and its JSON."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neuralgrasps.cli import bench_pose
from neuralgrasps.cli.bench_library import library_of
from neuralgrasps.cli.bench_pose import OTHER_SCANS, pose_objects
from neuralgrasps.evaluate.pose_bench_figures import expected_figures
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.objects.builtin import STAND_INS
from neuralgrasps.objects.store import ply_bytes, store_mesh
from neuralgrasps.objects.zoo import OBJECT_GROUPS
from tests.cli.conftest import Ended

Call = Callable[..., Ended]


@pytest.fixture
def brick(tmp_path: Path) -> Path:
    path = tmp_path / "brick.ply"
    path.write_bytes(ply_bytes(box_mesh([0.03, 0.05, 0.08])))
    return path


def test_objects_are_the_scans_when_the_seven_are_here(
    tmp_path: Path, brick: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path / "home"))
    assert pose_objects(()) == tuple(STAND_INS)
    for name in (*OBJECT_GROUPS["ycb7"][1:], OTHER_SCANS[1], "a_thing_of_mine"):
        store_mesh(name, box_mesh([0.03, 0.03, 0.03]), {})
    assert pose_objects(()) == tuple(STAND_INS)
    store_mesh(OBJECT_GROUPS["ycb7"][0], box_mesh([0.03, 0.03, 0.03]), {})
    assert pose_objects(()) == tuple(sorted({*OBJECT_GROUPS["ycb7"], OTHER_SCANS[1]}))
    assert pose_objects((str(brick.parent),)) == (str(brick.resolve()),)
    assert pose_objects(("gelatin_box",)) == ("gelatin_box",)


def test_the_run_is_the_one_that_knows_the_objects() -> None:
    def of(**sources: str) -> tuple[str | None, tuple[str, ...]]:
        library = library_of(tuple(sources.values()), dict.fromkeys(sources))  # type: ignore[arg-type]
        assert library.sources == tuple(sources.values())
        return library.run, library.run_sources

    run, sources = of(brick="/m/brick.ply", **{"003_cracker_box": "/m/003_cracker_box.ply"})
    assert run == "ycb7" and "/m/003_cracker_box.ply" in sources and "005_tomato_soup_can" in sources
    assert of(gelatin_box="gelatin_box") == ("standins7", of(cracker_box="cracker_box")[1])
    assert of(brick="/m/brick.ply") == (None, ())


def test_one_object_is_measured_and_the_rest_is_absent(ng: Call, brick: Path) -> None:
    ended = ng("bench", "pose", "--quick", "--objects", brick, "--count", "1", "--workers", "1", "--seed", "2")
    assert ended.code == 0, ended.err
    assert ended.result["name"] == "pose" and ended.result["machine"]["cores"] >= 1
    config, figures, absent = (ended.result[key] for key in ("config", "figures", "absent"))
    assert (config["scenes"], config["seed"], config["quick"], config["run"]) == (1, 2, True, None)
    assert list(config["objects"]) == ["brick"] and set(config["packages"]) >= {"open3d", "small_gicp"}
    assert config["counts"]["ours, hard"] == 1 and config["counts"]["baseline, easy"] == 1
    assert set(expected_figures()) <= set(figures) | set(absent)
    assert not set(figures) & set(absent) and None not in figures.values()
    assert figures["easy_mssd_01d"] == 1.0 and figures["pose_ms"] > 0 and figures["track_ms"] > 0
    assert "one object" in absent["identity_hard"] and "no shipped run" in absent["pose_ms_contact"]
    assert {row["method"] for row in ended.result["table"]["methods"]} >= {"ours", "baseline"}
    assert "absent: " in ended.out and "identity_hard" in ended.out and "MSSD < 0.1 d" in ended.out
    assert "pose_ms" in ended.result["notes"]


def test_options_reach_the_benchmark(ng: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: dict[str, Any] = {}

    def take(_: object, **options: Any) -> dict[str, Any]:
        taken.update(options)
        return {"config": {}, "figures": {"x": 1.0}}

    monkeypatch.setattr(bench_pose, "bench_pose", take)
    assert ng("bench", "pose", "--quick", "--workers", "3", "--count", "5", "--objects", "a", "b").code == 0
    assert taken == {"objects": ("a", "b"), "count": 5, "seed": 0, "workers": 3, "quick": True}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--count", "0"), "--count is 0"),
        (("--hands", "fetch"), "--hands is not of 'bench pose'"),
        (("--run", "ycb7"), "--run and --grasps are of 'bench latent'"),
        (("--objects", "none.ply"), "'none.ply' does not exist"),
        (("--objects", "gelatine_box"), "Did you mean 'gelatin_box'"),
    ],
)
def test_wrong_options_are_refused(ng: Call, options: tuple[str, ...], said: str) -> None:
    ended = ng("bench", "pose", *options)
    assert ended.code == 2 and said in ended.err and "Traceback" not in ended.err
