from dataclasses import asdict

import numpy as np
import pytest

from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.evaluate.inference_bench import measure_inference
from neuralgrasps.model.infer import InferConfig


@pytest.fixture(scope="module")
def asked(small_run, small_world):
    sets = {(g.hand, g.object): g for g in small_world.grasp_sets if g.hand == "fetch"}
    return small_run.field, small_run.codebook, sets


def test_clear_observations_are_inferred(asked) -> None:
    row = measure_inference(*asked, condition="F1")
    assert row.grasps == 4 and row.wrong_basins == 0.0 and np.isnan(row.flagged)
    assert 0.0 < row.surface_median_mm < row.surface_mean_mm < 0.5
    assert row.retrieval_gap == pytest.approx(0.0, abs=0.01) and row.contact_error < 0.01


def test_a_search_without_effort_is_seen_to_fail(asked) -> None:
    lazy = InferConfig(starts=1, finalists=1, rounds=1, coarse_iterations=1, middle_iterations=1, fine_iterations=1)
    row = measure_inference(*asked, condition="V3", config=lazy)
    assert row.wrong_basins > 0.0 and row.flagged == 1.0 and row.surface_p95_mm > 5.0


def test_workers_and_limits_do_not_change_the_grasps_measured(asked) -> None:
    one, two = (asdict(measure_inference(*asked, condition="F1", limit_per_pair=1, workers=n)) for n in (1, 2))
    assert one["grasps"] == 2
    assert {k: v for k, v in one.items() if "_ms_" not in k} == pytest.approx(
        {k: v for k, v in two.items() if "_ms_" not in k}, nan_ok=True
    )


def test_bad_requests_are_refused(asked) -> None:
    with pytest.raises(UnknownNameError, match="F1"):
        measure_inference(*asked, condition="F2")
    with pytest.raises(InputError, match="no test grasps"):
        measure_inference(asked[0], asked[1][~asked[1].is_test], asked[2])
