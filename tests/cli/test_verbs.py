"""Every verb once, on small settings: what it prints, writes and returns."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import neuralgrasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]


def test_hands_show_and_check(ng: Call, tmp_path: Path) -> None:
    shown = ng("hands", "show", "allegro")
    assert shown.code == 0 and len(shown.result["joints"]) == 16
    assert {"lower_rad", "upper_rad"} <= set(shown.result["joints"][0])
    assert "lower_m" in ng("hands", "show", "panda").result["joints"][0]
    picture = tmp_path / "new" / "hand.png"
    hand = Path(neuralgrasps.__file__).parent / "assets" / "hands" / "barrett" / "hand.xml"
    shutil.copy(hand, tmp_path / "mine.xml")  # without its notes: everything is derived
    checked = ng("hands", "check", tmp_path / "mine.xml", "--picture", picture)
    assert checked.code == 0 and checked.result["derived"]
    assert "can be used" in checked.out
    assert checked.result["following_joints"] == ["f2_spread = spread"] and "f2_spread = spread" in checked.out
    with Image.open(picture) as image:
        assert image.width > 4 * image.height and np.ptp(np.asarray(image)) > 100


def test_objects_show_import_list(ng: Call, tmp_path: Path) -> None:
    shown = ng("objects", "show", "gelatin_box", "--picture", tmp_path / "box.png")
    assert shown.code == 0 and (tmp_path / "box.png").stat().st_size > 1000
    np.testing.assert_allclose(sorted(shown.result["size_mm"]), [28, 73, 85], atol=0.1)
    mesh = tmp_path / "thing.obj"
    box = neuralgrasps.load_object("gelatin_box").mesh
    lines = [f"v {x * 1e3} {y * 1e3} {z * 1e3}" for x, y, z in box.vertices]
    mesh.write_text("\n".join(lines + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.faces]))
    imported = ng("objects", "import", mesh, "--unit", "mm")
    assert imported.code == 0 and imported.result["name"] == "thing"
    np.testing.assert_allclose(imported.result["size_mm"], shown.result["size_mm"], rtol=1e-6)
    assert "thing" in [o["name"] for o in ng("objects", "list").result["objects"]]
    again = ng("objects", "import", mesh)
    assert again.code == 2 and "imported before" in again.err
    assert ng("objects", "import", mesh, "--replace").code == 0


def _write_off(path: Path, corners: list[list[float]], faces: list[list[int]]) -> Path:
    lines = ["OFF", f"{len(corners)} {len(faces)} 0", *(" ".join(map(str, c)) for c in corners)]
    path.write_text("\n".join([*lines, *(f"{len(f)} {' '.join(map(str, f))}" for f in faces)]))
    return path


@pytest.fixture
def wall(tmp_path: Path) -> Path:
    """A mesh file of a cube of 60 cm: no jaw opens that far."""
    corners = [[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.3, 0.3)]
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return _write_off(tmp_path / "wall.off", corners, quads)


def test_synthesise_pairs(pipeline: Pipeline) -> None:
    record = pipeline.record
    assert record["grasps"] == 12 and [p["hand"] for p in record["pairs"]] == ["panda", "fetch"]
    assert all(p["penetration_p95_mm"] < 1.0 and 0 < p["physics_success_share"] <= 1 for p in record["pairs"])
    file = pipeline.grasps / "gelatin_box" / "panda.safetensors"
    assert len(neuralgrasps.load_grasps(file)) == 6
    described, hand = _description(file), neuralgrasps.load_hand("panda")
    assert described["joints"] == list(hand.tree.dof_names) and described["links"] == list(hand.tree.link_names)


def _description(file: str | Path) -> dict[str, Any]:
    data = Path(file).read_bytes()
    return json.loads(json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]["description"])


def test_the_mass_given_for_many_pairs_is_that_of_every_object(
    ng: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    masses: list[float] = []

    def collect(folder: Path, hands: list[Hand], objects: list[ObjectModel], **_: object) -> tuple[list, list]:
        masses.extend(obj.mass_kg for obj in objects)
        return [], []

    monkeypatch.setattr("neuralgrasps.dataset.collect.collect_grasps", collect)
    pairs = ("--hands", "panda", "--objects", "gelatin_box", "pudding_box")
    ng("synthesise", *pairs, "--mass-kg", 0.25, "--out-dir", tmp_path / "g")
    assert masses == [0.25, 0.25]


def test_synthesise_own_files_with_a_page(ng: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(Path(neuralgrasps.__file__).parent / "assets" / "hands" / "panda" / "hand.xml", "my.xml")
    box = neuralgrasps.load_object("gelatin_box").mesh
    _write_off(Path("my.off"), box.vertices.tolist(), box.faces.tolist())
    made = ng(
        "synthesise",
        "--hand",
        "my.xml",
        "--object",
        "my.off",
        "--count",
        2,
        "--report",
        "page/p.html",
        "--out",
        "g/a.safetensors",
    )
    assert made.code == 0, made.err
    assert made.result["validated"] == 2 and made.result["wall_s"] > made.result["compile_s"] >= 0
    running_s = made.result["wall_s"] - made.result["compile_s"]
    assert made.result["grasps_per_minute"] == pytest.approx(120 / running_s)
    page = Path("page/p.html").read_text()
    assert "my.off" in page and page.count("data:image/") == 5  # two grasps, their contact maps, the hand
    grasps = neuralgrasps.load_grasps("g/a.safetensors")
    described = _description("g/a.safetensors")
    assert len(described["joints"]) == 1 and len(described["links"]) > 2
    assert described["hand_fingerprint"] and described["object_fingerprint"]
    assert (grasps.config["also"], grasps.config["power_share"]) == ("dexgraspbench-hard, shake", "")
    assert grasps.validated.all() and grasps.config["hand_source"] == str(tmp_path / "my.xml")
    measured = ng("evaluate", "g/a.safetensors")  # finds the files again
    assert measured.code == 0 and measured.result["pairs"][0]["held_share"] == 1
    assert measured.result["pairs"][0]["penetration_p95_mm"] == pytest.approx(made.result["penetration_p95_mm"])


def test_no_grasp_is_a_failure_with_a_reason(ng: Call, wall: Path, tmp_path: Path) -> None:
    out = tmp_path / "g.safetensors"
    made = ng(
        "synthesise", "--hand", "panda", "--object", wall, "--count", 2, "--max-rounds", 1, "--out", out,
        "--report", tmp_path / "p.html",
    )  # fmt: skip
    assert made.code == 1 and made.result["validated"] == 0 and made.result["shortfall"] == "too wide"
    reason = "too wide: narrowest graspable width 600 mm, aperture 80 mm"
    assert made.result["reason"] == reason and reason in made.out
    assert not out.exists() and not (tmp_path / "p.html").exists()


def test_the_feasibility_table(ng: Call, pipeline: Pipeline, wall: Path, tmp_path: Path) -> None:
    folder = tmp_path / "grasps"
    shutil.copytree(pipeline.grasps, folder)  # the pairs with the box are done
    parts = tmp_path / "parts"
    parts.mkdir()
    shutil.move(wall, parts / "wall.off")
    made = ng(
        "synthesise", "--all", "--hands", "panda", "fetch", "--objects", "gelatin_box", parts, "--count", 6,
        "--out-dir", folder, "--workers", 1, "--report", tmp_path / "page" / "p.html",
    )  # fmt: skip
    assert made.code == 0, made.err
    assert [(p["hand"], p["object"], p["validated"], p["shortfall"]) for p in made.result["pairs"]] == [
        ("panda", "gelatin_box", 6, ""),
        ("fetch", "gelatin_box", 6, ""),
        ("panda", "wall", 0, "too wide"),
        ("fetch", "wall", 0, "too wide"),
    ]
    assert "6/6" in made.out and "aperture 100 mm" in made.out
    table = json.loads((folder / "feasibility.json").read_text())
    assert table["pairs"] == made.result["pairs"] and table["protocol"] == "dexgraspbench" and table["grasps"] == 12
    assert (folder / "feasibility.csv").read_text().count("\n") == 5
    page = (tmp_path / "page" / "p.html").read_text()
    assert page.count("<figure>") - page.count('class="plot"') == 12  # two sheets of six
    assert "too wide" in page and 'href="#sheet-1"' in page


def test_a_bad_file_in_a_folder_is_skipped_and_said(ng: Call, wall: Path, tmp_path: Path) -> None:
    parts, folder = tmp_path / "parts", tmp_path / "g"
    parts.mkdir()
    shutil.move(wall, parts / "wall.off")
    (parts / "empty.stl").touch()
    made = ng("synthesise", "--hands", "panda", "--objects", parts, "--count", 1, "--out-dir", folder, "--workers", 1)
    assert made.code == 1 and [p["object"] for p in made.result["pairs"]] == ["wall"]  # too wide for any grasp
    (skipped,) = made.result["skipped"]
    assert skipped["object"] == str(parts / "empty.stl") and "empty (0 bytes)" in skipped["reason"]
    assert json.loads((folder / "feasibility.json").read_text())["skipped"] == [skipped]
    assert "Skipped:" in made.out and skipped["reason"] in made.out


def test_jaws_say_that_they_ignore_the_power_share(ng: Call, wall: Path, tmp_path: Path) -> None:
    quick = ("--object", wall, "--count", 1, "--max-rounds", 1, "--out", tmp_path / "g.safetensors")
    ignored = "--power-share is ignored: 'panda' is a parallel jaw"
    assert ignored in ng("synthesise", "--hand", "panda", *quick, "--power-share", 0.5).err
    assert ignored not in ng("synthesise", "--hand", "panda", *quick).err


def test_only_infeasible_pairs_is_a_failure_with_a_table(ng: Call, wall: Path, tmp_path: Path) -> None:
    made = ng(
        "synthesise", "--hands", "panda", "--objects", wall, "--count", 1, "--out-dir", tmp_path / "g", "--workers", 1,
        "--report", tmp_path / "p.html",
    )  # fmt: skip
    assert made.code == 1 and made.result["pairs"][0]["shortfall"] == "too wide"
    assert "too wide" in (tmp_path / "p.html").read_text() and (tmp_path / "g" / "feasibility.csv").is_file()


def test_a_mesh_inside_out_is_turned_and_said(ng: Call, tmp_path: Path) -> None:
    box = neuralgrasps.load_object("gelatin_box").mesh
    file = _write_off(tmp_path / "inside_out.off", box.vertices.tolist(), box.faces[:, ::-1].tolist())
    made = ng("synthesise", "--hand", "fetch", "--object", file, "--count", 1, "--out", tmp_path / "g.safetensors")
    assert made.code == 0 and made.result["validated"] == 1
    assert "inside-out" in made.out


def test_dataset_info_and_verify(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    info = ng("dataset", "info", pipeline.dataset)
    assert (
        info.result["grasps"] == 12 and info.result["hands"] == ["fetch", "panda"] and info.result["size_bytes"] > 1e4
    )
    sound = ng("dataset", "verify", pipeline.dataset)
    assert sound.code == 0 and sound.result["ok"] and sound.result["max_error_mm"] < 2e-3
    copy = tmp_path / "copy"
    shutil.copytree(pipeline.dataset, copy)
    shard = max(copy.rglob("*.safetensors"), key=lambda p: p.stat().st_size)
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 0xFF
    shard.write_bytes(bytes(data))
    damaged = ng("dataset", "verify", copy)
    assert damaged.code == 1 and not damaged.result["ok"] and shard.name in damaged.out


def test_dataset_build_resumes(ng: Call, pipeline: Pipeline) -> None:
    again = ng(
        "dataset",
        "build",
        pipeline.grasps,
        "--out",
        pipeline.dataset,
        "--store-samples",
        "--queries",
        200,
        "--workers",
        1,
    )
    assert again.code == 0 and (again.result["built"], again.result["kept"]) == (0, 2)


def test_evaluate_run_and_dataset(ng: Call, pipeline: Pipeline) -> None:
    quick = ("--queries", 2000, "--workers", 1)
    run = ng("evaluate", pipeline.run, *quick)
    assert run.code == 0 and run.result["field"] == "KinematicField"
    summary = {row["input"]: row for row in run.result["summary"]}
    assert set(summary) == {"known", "observed all over", "observed in one view"}
    assert all(-1e-9 <= row["gap"] < 0.3 for row in summary.values()) and summary["known"]["f_1mm"] == 1.0
    assert "nothing is inferred" in run.out and "protocol, not of data" in run.result["comparison"]
    both = ng("evaluate", pipeline.run, *quick, "--part", "both", "--no-observed")
    assert [(row["part"], row["input"]) for row in both.result["summary"]] == [("test", "known"), ("train", "known")]
    few = ng("evaluate", pipeline.run, "--queries", 10)
    assert few.code == 2 and "expected at least 1000" in few.err
    refused = ng("evaluate", pipeline.dataset, "--report", "page.html")
    assert refused.code == 2 and "--report is of runs" in refused.err
    dataset = ng("evaluate", pipeline.dataset)
    assert dataset.code == 0 and dataset.result["grasps"] == 12
    assert all(p["held_share"] == 1 for p in dataset.result["pairs"])


def test_retrieve(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    picture = tmp_path / "r.png"
    query = ("--query-hand", "panda", "--query-index", 0)
    found = ng("retrieve", pipeline.run, *query, "--hand", "fetch", "--count", 2, "--picture", picture)
    assert found.code == 0 and [r["hand"] for r in found.result["results"]] == ["fetch", "fetch"]
    with Image.open(picture) as image:
        assert image.width == 3 * image.height
    file = pipeline.grasps / "gelatin_box" / "panda.safetensors"
    same = ng("retrieve", pipeline.run, "--query", file, "--query-index", 0, "--count", 1)
    assert same.result["results"][0]["grasp_index"] == 0  # the grasp itself is in the run
    assert same.result["results"][0]["contact_distance"] == pytest.approx(0, abs=1e-5)
    far = ng("retrieve", pipeline.run, *query, "--farthest", "--count", 1)
    assert far.result["results"][0]["code_distance"] >= max(r["code_distance"] for r in found.result["results"])
