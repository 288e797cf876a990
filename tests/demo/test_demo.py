"""The main job on a small scale: two hands, one object."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.dataset.read import read_dataset
from neuralgrasps.dataset.verify import verify_dataset
from neuralgrasps.demo.data import DemoConfig, DemoResult
from neuralgrasps.demo.run import run_demo
from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_io import load_grasps

HANDS = ("fetch", "barrett")
COUNT = 8


def small(out: Path, **changes: object) -> DemoConfig:
    settings = dict(objects=("gelatin_box",), hands=HANDS, count=COUNT, workers=1, out=out, pose_views=2)
    return DemoConfig(**{**settings, **changes})


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DemoResult]:
    out = tmp_path_factory.mktemp("demo")
    return out, run_demo(small(out))


def test_page_holds_every_section_and_loads_nothing(finished):
    _, result = finished
    page = result.report_path.read_text()
    assert "From pose to lifted object" in page and "data:image/webp" in page
    for word in ("Grasps", "Contact maps", "Retrieval", "Latent space", "Object pose", "Measured quality", "Times"):
        assert word in page
    assert '<section id="part-1"><h2>Shown by a hand</h2>' in page
    for word in ("Stage by stage", "What was shown", "The grasp", "Grasps of the robot"):
        assert f"<h3>{word}</h3>" in page
    assert "torsional friction 0.02 m" in page and "stand-ins of published size" in page
    assert page.count("<img") >= len(HANDS) * 3
    assert 'src="http' not in page and 'href="http' not in page


def test_figures_are_measured(finished):
    _, result = finished
    figures = result.figures
    assert figures["grasps_min_per_pair"] >= COUNT
    assert figures["grasps_total"] == COUNT * len(HANDS)
    assert 0.0 <= figures["penetration_p95_mm"] <= 1.1
    assert figures["penetration_2mm_p95_mm"] <= figures["penetration_2mm_max_mm"] < 2.5
    assert 0.0 <= figures["retrieval_gap_encoded"] <= 0.2
    assert figures["hand_surface_mean_mm"] < 0.01  # encoded grasps decode exactly
    assert 0.0 < figures["hand_surface_complete_mean_mm"] < 5.0
    assert figures["pose_add_s_median_mm"] < 3.0
    assert figures["lift_trials"] == 1.0 and figures["lifted"] in (0.0, 1.0)
    assert 0.0 < figures["demonstration_similarity"] <= 1.0 and figures["demonstration_lifted"] in (0.0, 1.0)
    assert figures["demo_wall_s"] > 0.0 and figures["peak_rss_gb"] > 0.05


def test_every_grasp_on_disk_was_held(finished):
    out, _ = finished
    for hand in HANDS:
        grasps = load_grasps(out / "grasps" / "gelatin_box" / f"{hand}.safetensors")
        assert len(grasps) == COUNT
        assert grasps.validated.all()
        assert (grasps.epsilon > 0).all()
        assert (grasps.verdicts["dexgraspbench"].displacement_m < 0.05).all()
        assert grasps.verdicts["dexgraspbench"].parameters["friction"] == pytest.approx(0.6)


def test_dataset_is_whole(finished):
    out, _ = finished
    dataset = read_dataset(out / "dataset")
    assert {hand for hand, _ in dataset.pairs} == set(HANDS)
    assert not verify_dataset(dataset).problems


def test_second_run_keeps_the_grasps_and_two_workers_change_nothing(finished, tmp_path):
    out, first = finished
    stamps = {p: p.stat().st_mtime_ns for p in (out / "grasps").rglob("*.safetensors")}
    again = run_demo(small(out, demonstration=False))
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps
    fresh = run_demo(small(tmp_path, workers=2))
    for hand in HANDS:
        name = Path("grasps") / "gelatin_box" / f"{hand}.safetensors"
        one, two = load_grasps(out / name), load_grasps(tmp_path / name)
        for field in ("X_OH", "q", "q_squeeze", "epsilon", "contact_links"):
            np.testing.assert_array_equal(getattr(one, field), getattr(two, field))
    for result in (again, fresh):
        for key in ("penetration_p95_mm", "retrieval_gap", "hand_surface_one_view_mean_mm", "pose_add_s_median_mm"):
            assert result.figures[key] == first.figures[key]
    for key in ("demonstration_similarity", "demonstration_lifted"):
        assert fresh.figures[key] == first.figures[key] and key not in again.figures
    assert "Shown by a hand" in fresh.report_path.read_text() and "Shown by a hand" not in again.report_path.read_text()


def test_records_are_json_with_reasons(finished):
    out, _ = finished
    record = json.loads((out / "grasps" / "gelatin_box" / "fetch.json").read_text())
    assert record["validated"] == COUNT and record["reason"] == ""


def test_bad_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match="at least 6"):
        DemoConfig(count=2)
    with pytest.raises(InputError, match="holds no mesh"):
        run_demo(DemoConfig(objects=(str(tmp_path),), out=tmp_path / "out"))
    with pytest.raises(InputError, match="no object"):
        run_demo(DemoConfig(objects=(), out=tmp_path / "out"))
