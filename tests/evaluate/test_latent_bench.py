"""The measurements behind `bench latent`, on small material. No time is checked, only that the work is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.dataset.read import read_dataset
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate import latent_bench
from neuralgrasps.evaluate.latent_bench import figures_of_scores, measure_scenes, measure_search, some_objects
from neuralgrasps.evaluate.run_scores import KNOWN, RunScores
from neuralgrasps.model.train import TrainResult
from tests.conftest import SmallWorld


def test_scenes_are_built_whole(small_world: SmallWorld, tmp_path: Path) -> None:
    sets = [g for g in small_world.grasp_sets if (g.hand, g.object) == ("fetch", "ball")]
    cost = measure_scenes(tmp_path, sets, hands=small_world.hands, objects=small_world.objects, per_pair=2)
    assert cost.scenes == 2 and 0 < cost.samples_cpu_s < cost.clouds_cpu_s
    data = read_dataset(tmp_path / "rendered")
    assert data.manifest.config.store_samples and data.manifest.config.clouds == "rendered"
    assert data.samples("fetch", "ball").points_O.shape == (2, 40_000, 3)
    with pytest.raises(InputError, match="no grasps"):
        measure_scenes(tmp_path, [], hands={}, objects={})


def test_search_is_exact_and_says_so(small_run: TrainResult, monkeypatch: pytest.MonkeyPatch) -> None:
    cost = measure_search(small_run.codebook, rows=3000, count=5)
    assert (cost.rows, cost.queries, cost.exact) == (3000, 8, 1.0) and cost.least_ms <= cost.median_ms

    class Wrong(latent_bench.CodeIndex):
        def search(self, *arguments, **options):  # type: ignore[no-untyped-def]
            index, distance = super().search(*arguments, **options)
            return np.where(index == index[:, :1], (index + 1) % len(self), index), distance

    monkeypatch.setattr(latent_bench, "CodeIndex", Wrong)
    assert measure_search(small_run.codebook, rows=3000, count=5).exact < 1.0
    with pytest.raises(InputError, match="some of both"):
        measure_search(small_run.codebook[~small_run.codebook.is_test])


def test_some_objects_falls_back_to_those_there_are(small_world: SmallWorld) -> None:
    sets = small_world.grasp_sets
    assert {g.object for g in some_objects(sets, ("ball", "teapot"))} == {"ball"}
    assert {g.object for g in some_objects(sets, ("teapot",))} == {sets[0].object}


def test_only_measured_figures_have_names(small_run: TrainResult, tmp_path: Path) -> None:
    row = {"gap": 0.01, "gap_reranked": 0.0, "surface_mean_mm": 0.1, "surface_p95_mm": 0.3}
    row |= {"chamfer_over_oracle": 1.01, "chamfer_over_oracle_worst": 1.2}

    class Known(RunScores):
        __slots__ = ()

        def summary(self, part: str, given: str) -> dict[str, float]:
            assert (part, given) == ("test", KNOWN)
            return row

    scores = Known(field="KinematicField", hands=(), objects=(), similarities=(), pooled={}, times_ms={"encode": 2.0},
                   errors_mm={}, conditions={})  # fmt: skip
    figures = figures_of_scores(scores)
    assert figures["retrieval_gap"] == 0.01 and figures["hand_surface_p95_mm"] == 0.3 and figures["encode_ms"] == 2.0
    assert not any("observed" in name or name == "infer_ms" for name in figures)
    assert replace(scores) == scores
