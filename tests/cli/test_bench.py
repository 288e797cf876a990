"""Benchmarks: their options, their JSON, the machine. The demo that one of them runs is tested where the demo is."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from neuralgrasps.cli import bench_synthesis
from neuralgrasps.cli.bench import machine
from neuralgrasps.cli.bench_demo import import_seconds
from neuralgrasps.cli.bench_synthesis import QUICK_OBJECTS, bench_objects, make_with_unseen_hand
from neuralgrasps.cli.main import run
from neuralgrasps.hands.zoo import hand_folder
from neuralgrasps.objects.builtin import STAND_INS
from tests.cli.conftest import Ended

Call = Callable[..., Ended]
SMALL = ("bench", "synthesis", "--hands", "panda", "--objects", "gelatin_box", "--count", "2", "--workers", "1")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Any]:
    target = tmp_path_factory.mktemp("bench") / "result.json"
    assert run([*SMALL, "--json", str(target)]) == 0
    return json.loads(target.read_text(), parse_constant=lambda text: pytest.fail(f"{text} in JSON"))


def test_machine_and_import_time() -> None:
    found = machine()
    assert found["cores"] >= 1 and found["memory_gb"] > 0 and found["python"].count(".") == 2
    assert 0 < import_seconds() < 10


def test_synthesis_prints_one_object_with_figures_and_pairs(measured: Mapping[str, Any]) -> None:
    assert measured["name"] == "synthesis" and measured["machine"]["cores"] >= 1
    assert (measured["config"]["count"], measured["config"]["protocol"]) == (2, "dexgraspbench")
    assert (
        measured["config"]["hands"] == ["panda"] and "stand-in" in measured["config"]["object_sources"]["gelatin_box"]
    )
    assert (measured["physics"]["mass_kg"], measured["physics"]["torsional_friction_m"]) == (0.1, 0.02)
    figures = measured["figures"]
    assert {
        "validated_per_min_4c_jaws", "seconds_to_2_jaws", "success_jaws_boxes", "penetration_p95_mm",
        "penetration_max_mm", "epsilon_ms", "epsilon_sign_errors", "table_wall_s",
    } <= set(figures)  # fmt: skip
    assert not any(value is None for value in figures.values())
    assert "unseen_hand_wall_s" not in figures and "validated_per_min_4c_human" not in figures
    (pair,) = measured["pairs"]
    assert (pair["hand"], pair["object"], pair["validated"], pair["alone_same_grasps"]) == (
        "panda", "gelatin_box", 2, True,
    )  # fmt: skip
    assert figures["validated_per_min_4c_jaws"] == pytest.approx(240 * pair["validated_per_cpu_s"])
    assert figures["success_jaws_boxes"] == pair["success_before_filter"]
    assert measured["infeasible"] == []


def test_what_could_not_be_measured_is_null(ng: Call, tmp_path: Path) -> None:
    wall = tmp_path / "wall.obj"  # too wide for a jaw: 0.3 x 0.3 x 0.3 m
    corners = [(x, y, z) for x in (0, 0.3) for y in (0, 0.3) for z in (0, 0.3)]
    sides = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(map(str, side)) for side in sides]
    wall.write_text("\n".join(lines) + "\n")
    ended = ng("bench", "synthesis", "--hands", "panda", "--objects", wall, "--count", "2", "--workers", "1")
    assert ended.code == 0, ended.err
    (pair,) = ended.result["pairs"]
    assert pair["validated"] == 0 and pair["penetration_max_mm"] is None and pair["success_before_filter"] is None
    assert "alone_wall_s" not in pair and ended.result["epsilon"] is None
    assert [(p["hand"], p["object"]) for p in ended.result["infeasible"]] == [("panda", "wall")]
    assert ended.result["infeasible"][0]["reason"] in ended.out
    assert ended.result["figures"]["infeasible_pairs"] == 1.0
    assert ended.result["figures"]["validated_per_min_4c_jaws"] == 0.0


def test_quick_takes_three_objects(tmp_path: Path) -> None:
    assert bench_objects((), quick=False) == tuple(STAND_INS)
    assert bench_objects((), quick=True) == QUICK_OBJECTS
    files = ["003_cracker_box.ply", "004_sugar_box.ply", "005_tomato_soup_can.ply", "006_mustard_bottle.ply"]
    for name in files:
        (tmp_path / name).touch()
    assert len(bench_objects((str(tmp_path),), quick=False)) == 4
    assert [Path(p).name for p in bench_objects((str(tmp_path),), quick=True)] == [files[0], *files[2:]]
    assert bench_objects(("a", "b", "c", "d"), quick=True) == ("a", "b", "c")


def test_options_reach_the_benchmark(ng: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: dict[str, Any] = {}

    def take(_: object, **options: Any) -> dict[str, Any]:
        taken.update(options)
        return {"config": {}, "figures": {"x": 1.0}}

    monkeypatch.setattr(bench_synthesis, "bench_synthesis", take)
    assert ng("bench", "synthesis", "--quick").result["figures"] == {"x": 1.0}
    assert taken == {
        "objects": (), "hands": (), "count": None, "seed": 0, "workers": None, "quick": True, "unseen_hand": None,
    }  # fmt: skip
    ng("bench", "synthesis", "--hands", "fetch", "panda", "--seed", "3", "--workers", "2", "--unseen-hand", "x.urdf")
    assert (taken["hands"], taken["seed"], taken["workers"], taken["quick"]) == (("fetch", "panda"), 3, 2, False)
    assert taken["unseen_hand"] == Path("x.urdf")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("synthesis", "--count", "0"), "--count is 0"),
        (("synthesis", "--workers", "0"), "workers is 0"),
        (("synthesis", "--unseen-hand", "none.urdf"), "'none.urdf' does not exist"),
        (("demo", "--unseen-hand", "none.urdf"), "--unseen-hand is of 'bench synthesis'"),
        (("synthesis", "--objects", "none.ply"), "none.ply"),
        (("synthesis", "--hands", "alegro"), "Did you mean 'allegro'"),
    ],
)
def test_wrong_options_are_refused(ng: Call, options: tuple[str, ...], said: str) -> None:
    ended = ng("bench", *options)
    assert ended.code == 2 and said in ended.err and "Traceback" not in ended.err


def test_a_hand_file_is_tried_in_a_fresh_process(tmp_path: Path) -> None:
    made = make_with_unseen_hand(hand_folder("panda") / "hand.xml", "gelatin_box", seed=0, count=2)
    assert (made["file"], made["wanted"], made["validated"], made["reason"]) == ("hand.xml", 2, 2, "")
    assert made["wall_s_to_count"] == made["wall_s"] > 0
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot name=")
    failed = make_with_unseen_hand(broken, "gelatin_box", seed=0, count=2)
    assert failed["validated"] == 0 and failed["wall_s_to_count"] != failed["wall_s_to_count"]
    assert "broken.urdf" in failed["reason"]
