"""`bench execute`: one scene of one object, its figures, and which options it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from neuralgrasps.cli.bench_library import paper_objects
from neuralgrasps.evaluate import execute_bench
from neuralgrasps.evaluate.execute_figures import FIGURES
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.objects.builtin import STAND_INS
from tests.cli.conftest import Ended

Call = Callable[..., Ended]


def test_one_scene_of_one_object(ng: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An object of no shipped run: its grasps are made, and the published estimates cannot be had."""
    mesh, brick = box_mesh([0.02, 0.03, 0.04]), tmp_path / "brick.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    brick.write_text("\n".join(lines) + "\n")
    quick = replace(execute_bench.QUICK, panda_scenes=0, clutter_scenes=0)
    monkeypatch.setattr(execute_bench, "QUICK", quick)
    ended = ng("bench", "execute", "--objects", brick, "--count", "1", "--workers", "1", "--quick")
    assert ended.code == 0, ended.err
    result, figures = ended.result, ended.result["figures"]
    assert result["name"] == "execute" and result["config"]["scenes"] == 1 and result["config"]["quick"]
    assert figures["success_true"] in (0.0, 1.0) and figures["success_ours"] in (0.0, 1.0)
    assert figures["collisions"] == 0.0 and figures["paths_checked"] >= 4.0 and figures["plan_found"] == 1.0
    assert 0.0 < figures["plan_median_ms"] == figures["plan_p95_ms"]
    assert set(FIGURES) <= {*figures, *result["absent"]}
    absent = {"success_baseline", "success_contact", "success_panda_allegro", "clutter_success"}
    assert absent <= set(result["absent"]) and not absent & set(figures)
    assert [row["object"] for row in result["table"]["success"] if row["method"] == "true"] == ["brick", "all"]
    assert len(result["failures"]) == 2 - figures["success_true"] - figures["success_ours"]


def test_wrong_options_are_refused(ng: Call) -> None:
    for options, said in ((("--hands", "panda"), "--hands is not of 'bench execute'"), (("--count", "0"), "0")):
        ended = ng("bench", "execute", *options)
        assert ended.code == 2 and said in ended.err and "Traceback" not in ended.err


def test_which_objects_are_picked() -> None:
    assert paper_objects(()) == tuple(STAND_INS)  # no scans were imported into the home of the tests
    assert paper_objects(("gelatin_box", "pudding_box")) == ("gelatin_box", "pudding_box")
