"""`neuralgrasps novel`: what it prints, writes and refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import neuralgrasps
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]
PAIR = ("--hand", "panda", "--object", "gelatin_box")


def test_novel_writes_grasps_and_a_page(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out, page = tmp_path / "new" / "grasps.safetensors", tmp_path / "page.html"
    made = ng("novel", pipeline.run, *PAIR, "--count", 4, "--search", 8, "--out", out, "--report", page)
    assert made.code == 0 and made.result["codes"] == 4 == sum(made.result["outcomes"].values())
    grasps = neuralgrasps.load_grasps(out)
    assert len(grasps) == made.result["held"] >= 2 and grasps.validated.all()
    assert made.result["novelty_median_mm"] > 1 and len(made.result["codes_by_outcome"]) == 4
    assert "of 4 codes became grasps that hold" in made.out and "best of up to 9 closings" in made.out
    text = page.read_text()
    assert "What became of the codes" in text and "from a known grasp" in text
    assert ng("evaluate", out).result["grasps"] == len(grasps)
    found = ng("retrieve", pipeline.run, "--query", out, "--query-index", 0)
    assert found.code == 0 and found.result["query_hand"] == "panda"


def test_novel_repeats_itself(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    asked = ("novel", pipeline.run, *PAIR, "--from", "midpoint", "--count", 3, "--out", tmp_path / "g.safetensors")
    runs = [ng(*asked, "--seed", 5, "--workers", workers).result for workers in (1, 2)]
    same = ("outcomes", "codes_by_outcome", "novelty_median_mm", "held_share")
    assert all(runs[0][name] == runs[1][name] for name in same)
    assert all(row["neighbour"] >= 0 for row in runs[0]["codes_by_outcome"])


def test_nothing_is_written_when_none_holds(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out = tmp_path / "g.safetensors"
    ended = ng("novel", pipeline.run, *PAIR, "--count", 2, "--spread", 30, "--search", 0, "--out", out)
    assert ended.code == 1 and ended.result["held"] == 0 and "Nothing was written" in ended.out
    assert not out.exists()


def test_wrong_input_is_refused(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "g.safetensors")
    for args, message in (
        (("novel", tmp_path, *PAIR), "Train first"),
        (("novel", pipeline.run, "--hand", "pand", "--object", "gelatin_box"), "Did you mean 'panda'"),
        (("novel", pipeline.run, "--hand", "panda", "--object", "cup"), "Known objects: gelatin_box"),
        (("novel", pipeline.run, "--hand", "panda"), "--object"),
        (("novel", pipeline.run, *PAIR, "--count", 0), "count is 0"),
        (("novel", pipeline.run, *PAIR, "--spread", -1), "spread is -1"),
        (("novel", pipeline.run, *PAIR, "--from", "nois"), "--from"),
        (("novel", pipeline.run, *PAIR, "--search", -2), "search is -2"),
        (("novel", pipeline.run, *PAIR, "--seed", -2), "--seed is -2"),
        (("novel", pipeline.run, *PAIR, "--workers", 0), "--workers is 0"),
        (("novel", pipeline.run, *PAIR, "--protocol", "shaken"), "protocol"),
        (("novel", pipeline.run, *PAIR, "--from", "midpoint", "--count", 500), "pairs"),
        (("novel", pipeline.run, *PAIR, "--report", tmp_path), "is a folder"),
    ):  # fmt: skip
        ended = ng(*args, *out)
        assert ended.code == 2, args
        assert message in ended.err and "Traceback" not in ended.err, (args, ended.err)
    assert not (tmp_path / "g.safetensors").exists()
