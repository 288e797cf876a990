"""`neuralgrasps transfer`: what it prints, writes and refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import neuralgrasps
from neuralgrasps.apply.transfer import TransferResult, transfer
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]
OBJECT = ("--object", "gelatin_box")


def test_a_grasp_of_the_run_is_carried_over(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out, page = tmp_path / "new" / "grasps.safetensors", tmp_path / "page.html"
    asked = ("--query", "panda:1", "--hand", "fetch", "--count", 3, "--keep-free", "top:0.2", "--margin", 0.003)
    made = ng("transfer", pipeline.run, *OBJECT, *asked, "--out", out, "--report", page)
    assert made.code == 0, made.err
    rows, grasps = made.result["results"], neuralgrasps.load_grasps(out)
    assert len(grasps) == len(rows) >= 1 and grasps.validated.all() and grasps.hand == "fetch"
    similarity = [row["similarity"] for row in rows]
    assert max(similarity) <= 1 and all(row["clearance_mm"] >= 3 and row["held"] for row in rows)
    assert made.result["constraints"] == ["keep top:0.2 free by 3 mm"]
    assert grasps.config["transferred_from"] == "grasp 1 of the panda hand"
    assert "for grasp 1 of the panda hand" in made.out and "clear by" in made.out
    text = page.read_text()
    assert "Query and grasps" in text and "gelatin box, from panda to fetch".capitalize() in text
    assert "kept free: red" in text and "<b>1." not in text and text.count("contact map") > len(rows)
    assert ng("evaluate", out).result["grasps"] == len(grasps)


def test_the_same_seed_gives_the_same_grasps(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    asked = ("transfer", pipeline.run, *OBJECT, "--query", "panda", "--hand", "fetch", "--count", 2, "--seed", 4)
    first, again = (ng(*asked, "--out", tmp_path / "g.safetensors").result["results"] for _ in range(2))
    assert first == again and len(first) == 2


def test_what_slips_easily_is_marked_where_it_counts(
    ng: Call, pipeline: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ("transfer", pipeline.run, *OBJECT, "--query", "panda", "--hand", "fetch", "--count", 2)
    usual = ng(*asked, "--out", tmp_path / "g.safetensors")
    assert not any("weak" in row for row in usual.result["results"]) and "weak" not in usual.out

    def slippery(*args: Any, **kwargs: Any) -> TransferResult:
        return replace(transfer(*args, **kwargs), weak=np.array([0.0, 0.0375]))

    monkeypatch.setattr("neuralgrasps.apply.transfer.transfer", slippery)
    sturdy = ng(*asked, "--out", tmp_path / "g.safetensors")
    assert [row["weak"] for row in sturdy.result["results"]] == [0.0, 0.0375]
    assert "weak" in sturdy.out and "0.037" in sturdy.out


def test_files_of_grasps_and_points_are_queries_too(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "g.safetensors", "--count", 1, "--method", "retrieve")
    grasps = next(pipeline.grasps.rglob("panda.safetensors"))
    from_file = ng("transfer", pipeline.run, "--query", f"{grasps}:2", "--hand", "panda", *out)
    assert from_file.code == 0 and from_file.result["results"][0]["similarity"] == pytest.approx(1.0)
    touched = neuralgrasps.load_grasps(grasps)
    points = touched.contact_points_O[2][touched.contact_links[2] >= 0]
    np.save(tmp_path / "touched.npy", points)
    drawn = ng("transfer", pipeline.run, *OBJECT, "--contacts", tmp_path / "touched.npy", "--hand", "panda", *out)
    assert drawn.code == 0 and f"for {len(points)} contacts in 'touched.npy'" in drawn.out
    cloud = ng("transfer", pipeline.run, *OBJECT, "--query-cloud", tmp_path / "touched.npy", "--hand", "panda", *out)
    assert cloud.code == 0 and "points of a hand" in cloud.result["query"]


def test_contacts_off_the_surface_are_moved_onto_it_and_counted(
    ng: Call, pipeline: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    grasps = neuralgrasps.load_grasps(next(pipeline.grasps.rglob("panda.safetensors")))
    points = grasps.contact_points_O[2][grasps.contact_links[2] >= 0][:2].copy()
    points[0] += 0.02 * points[0] / np.linalg.norm(points[0])
    np.save(tmp_path / "drawn.npy", points)
    asked = ("transfer", pipeline.run, *OBJECT, "--contacts", tmp_path / "drawn.npy", "--hand", "panda", "--count", 1)
    made = ng(*asked, "--method", "retrieve", "--report", tmp_path / "page.html")
    assert made.code == 0, made.err
    assert "1 of 2 drawn points are more than 5 mm off" in made.err and "no. 1: " in made.err
    assert "no. 2: " not in made.err
    row = made.result["results"][0]
    assert row["touched"].endswith(" of 2") and 0 <= row["points_off_mm"] < 100
    assert "drawn points touched" in made.out and "drawn points touched" in (tmp_path / "page.html").read_text()
    assert (tmp_path / "transferred_panda_gelatin_box.safetensors").is_file()


def test_axes_may_stand_alone(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    """-z is an axis here, though it looks like an option."""
    asked = ("transfer", pipeline.run, *OBJECT, "--query", "panda", "--hand", "panda", "--count", 1)
    rules = (
        "--approach",
        "-z",
        "170deg",
        "--up",
        "+z",
        "--only-region",
        "-x:1",
        "--keep-free",
        "-z:0.01",
        "--margin",
        0,
    )
    made = ng(*asked, *rules, "--out", tmp_path / "g.safetensors")
    assert made.code in (0, 1), made.err
    assert made.result["constraints"] == [
        "approach along -z within 170°", "clear of the table, +z up", "keep -z:0.01 free by 0 mm", "touch only -x:1",
    ]  # fmt: skip


def test_it_says_which_constraint_left_nothing(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    out = tmp_path / "g.safetensors"
    asked = ("transfer", pipeline.run, *OBJECT, "--query", "panda", "--hand", "fetch", "--out", out)
    ended = ng(*asked, "--keep-free", "top:0.97", "--margin", 0.03, "--approach", "+x", "179deg")
    assert ended.code == 1 and not ended.result["results"] and not out.exists()
    assert "of 6 candidates, 'approach along +x within 179°' takes" in ended.out
    assert "'keep top:0.97 free by 30 mm' takes 6" in ended.out and "0 left" in ended.out
    assert "Without the constraints there is a grasp of similarity" in ended.out and "Nothing was written" in ended.out


def test_wrong_input_is_refused(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    run, query = pipeline.run, ("--query", "panda:0")
    np.savetxt(tmp_path / "far.txt", [[5.0, 5.0, 5.0]])
    base = (run, *OBJECT, *query, "--hand", "fetch")
    for args, message in (
        ((tmp_path, *OBJECT, *query, "--hand", "fetch"), "Train first"),
        ((run, *OBJECT, *query, "--hand", "fecth"), "Did you mean 'fetch'"),
        ((run, "--object", "gelatin_bx", *query, "--hand", "fetch"), "gelatin_bx"),
        ((run, *OBJECT, "--hand", "fetch"), "give one query"),
        ((run, *OBJECT, "--query", "panda:77", "--hand", "fetch"), "holds 6 grasps"),
        ((run, *OBJECT, "--query", "nowhere:1", "--hand", "fetch"), "neither a grasp file nor a hand"),
        ((run, "--contacts", tmp_path / "far.txt", "--hand", "fetch"), "--object"),
        ((run, *OBJECT, "--contacts", tmp_path / "far.txt", "--hand", "fetch"), "mm from 'gelatin_box'"),
        ((*base, "--count", 0), "count is 0"),
        ((*base, "--method", "retreive"), "--method"),
        ((*base, "--protocol", "shaken"), "protocol"),
        ((*base, "--seed", -1), "--seed is -1"),
        ((*base, "--keep-free", "topp"), "Did you mean 'top'"),
        ((*base, "--keep-free", "box:0,0,0,0,1,1"), "is empty"),
        ((*base, "--keep-free", "top:1"), "nothing is left to touch"),
        ((*base, "--only-region", "file:nowhere.ply"), "does not exist"),
        ((*base, "--approach", "down"), "it takes an axis and an angle"),
        ((*base, "--approach", "-z", "0deg"), "holds no direction"),
        ((*base, "--approach", "-z", "30"), "has no unit"),
        ((*base, "--approach", "z", "30deg"), "approach axis 'z' is not known"),
        ((*base, "--approach", "+z", "20deg", "--up", "+z"), "through the table"),
        ((*base, "--up", "w"), "side 'w' is not known"),
        ((*base, "--report", tmp_path), "is a folder"),
    ):  # fmt: skip
        ended = ng("transfer", *args, "--out", tmp_path / "g.safetensors")
        assert ended.code == 2, (args, ended.out, ended.err)
        assert message in ended.err and "Traceback" not in ended.err, (args, ended.err)
    assert not (tmp_path / "g.safetensors").exists()
