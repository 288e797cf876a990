"""`bench joints`: which objects it takes, its options, and its JSON."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from neuralgrasps.evaluate import joint_bench
from neuralgrasps.evaluate.joint_figures import FIGURES
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.objects.store import ply_bytes
from tests.cli.conftest import Ended

Call = Callable[..., Ended]


@pytest.fixture(autouse=True)
def little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint_bench, "STAND_INS", {"gelatin_box": joint_bench.STAND_INS["gelatin_box"]})
    monkeypatch.setattr(joint_bench, "QUICK", replace(joint_bench.QUICK, solids=1, proposals=60))


def test_figures_and_tables_of_given_objects(ng: Call, tmp_path: Path) -> None:
    brick = tmp_path / "brick.ply"
    brick.write_bytes(ply_bytes(box_mesh([0.03, 0.05, 0.08])))
    ended = ng("bench", "joints", "--quick", "--objects", brick, "--count", 4, "--workers", 1, "--seed", 2)
    assert ended.code == 0, ended.err
    assert ended.result["name"] == "joints" and ended.result["machine"]["cores"] >= 1
    config, figures, absent = (ended.result[key] for key in ("config", "figures", "absent"))
    assert (config["scenes"], config["seed"], config["quick"], list(config["objects"])) == (4, 2, True, ["brick"])
    assert set(FIGURES) <= set(figures) | set(absent) and None not in figures.values()
    assert 0 < figures["scene_joints_objects_n"] <= 4 and figures["scene_joints_root_relative_mm"] < 60.0
    assert [row["set"] for row in ended.result["table"]["sets"]] == ["stand-ins", "objects", "solids"]
    assert "boxes" in ended.result["notes"] and "root_relative_mm" in ended.out


def test_without_objects_solids_are_measured(ng: Call) -> None:
    ended = ng("bench", "joints", "--quick", "--count", 2, "--workers", 1)
    assert ended.code == 0, ended.err
    assert [row["set"] for row in ended.result["table"]["sets"]] == ["stand-ins", "solids"]
    assert ended.result["config"]["objects"] == {}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--count", "0"), "--count is 0"),
        (("--hands", "fetch"), "--hands is not of 'bench joints'"),
        (("--run", "ycb7"), "--run and --grasps are of 'bench latent'"),
        (("--unseen-hand", "h.urdf"), "--unseen-hand is of 'bench synthesis'"),
        (("--objects", "none.ply"), "'none.ply' does not exist"),
    ],
)
def test_wrong_options_are_refused(ng: Call, options: tuple[str, ...], said: str) -> None:
    ended = ng("bench", "joints", *options)
    assert ended.code == 2 and said in ended.err and "Traceback" not in ended.err
