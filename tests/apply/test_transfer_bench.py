from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.apply.transfer_search import SearchConfig
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.transfer_bench import (
    TransferBenchConfig,
    TransferTrial,
    bench_transfer,
    exact_oracle,
    published_scale,
    split_grasps,
)
from neuralgrasps.evaluate.transfer_figures import FIGURES, transfer_figures, transfer_tables
from neuralgrasps.model.checkpoint import Run
from neuralgrasps.sim.validate import validate_grasps
from tests.apply.conftest import BoxWorld


@pytest.fixture(scope="module")
def run(box_world: BoxWorld) -> Run:
    """A run of one pair: grasp 5 is a test grasp, grasp 6 in no part, six are fitted."""
    place = np.arange(8, dtype=np.int32)
    book = replace(box_world.book, grasp_index=place, is_test=place == 5)[place != 6]
    grasps = box_world.grasps
    for name in ("dexgraspbench-hard", "shake"):
        verdict = validate_grasps(box_world.hand, box_world.obj, grasps, name)
        grasps = grasps.with_verdict(name, verdict, decides=False)
    return Run(
        field=box_world.field, codebook=book, losses=np.zeros(1), config={}, grasps={("panda", "brick"): grasps}
    )  # fmt: skip


def config(**changes) -> TransferBenchConfig:
    short = TransferConfig(count=1, search=SearchConfig(starts=3, generations=1, children=4))
    return TransferBenchConfig(queries=2, hands=("panda",), transfer=short, **changes)


def test_unseen_grasps_are_asked_and_never_searched(run: Run) -> None:
    known, unseen = split_grasps(run)
    grasps = run.grasps["panda", "brick"]
    assert unseen["panda", "brick"].tolist() == [5, 6]
    assert len(known["panda", "brick"]) == 6
    assert not any(np.array_equal(X, grasps.X_OH[i]) for X in known["panda", "brick"].X_OH for i in (5, 6))


def test_the_benchmark_measures_what_it_says(run: Run) -> None:
    done = []
    bench = bench_transfer(run, config=config(), workers=1, progress=lambda *at: done.append(at))
    assert done == [(1, 1)] and [t.query for t in bench.trials] == [5, 6]
    known, _ = split_grasps(run)
    for trial in bench.trials:
        assert trial.held and trial.generated <= trial.tried <= 24 and trial.source == trial.target == "panda"
        assert trial.similarity >= max(trial.retrieved, trial.generated_alone) - 1e-9
        assert trial.oracle == pytest.approx(trial.oracle_plain)  # the brick of this test has no symmetry
        assert trial.retrieved <= trial.oracle + 1e-6
        assert trial.cpu_s > 0
    figures = transfer_figures(bench)
    assert set(figures) <= set(FIGURES) and figures["transfer_success"] == 1.0
    assert "transfer_other_hand_similarity_minus_oracle" not in figures  # there is no other hand
    mean = np.mean([t.similarity - t.oracle for t in bench.trials])
    assert figures["transfer_similarity_minus_oracle"] == pytest.approx(mean)
    held = known["panda", "brick"].succeeded("shake").mean()
    assert figures["known_success_shake"] == pytest.approx(held)
    tables = transfer_tables(bench)
    assert [(r["source"], r["target"], r["count"], r["success"]) for r in tables["pairs"]] == [
        ("panda", "panda", 2, 1.0)
    ]
    assert tables["targets"][0]["target"] == "panda (same hand)" and tables["objects"][0]["object"] == "brick"


def test_the_oracle_is_the_nearest_known_grasp(run: Run, box_world: BoxWorld) -> None:
    known, _ = split_grasps(run)
    searched, grasps = known["panda", "brick"], run.grasps["panda", "brick"]
    query = query_from_grasp(box_world.hand, box_world.obj, grasps.X_OH[5], grasps.q[5])
    maps = [
        query_from_grasp(box_world.hand, box_world.obj, X, q).contact_map
        for X, q in zip(searched.X_OH, searched.q, strict=True)
    ]
    nearest = min(float(np.abs(m - query.contact_map).mean()) for m in maps)
    best, plain = exact_oracle(query, box_world.hand, box_world.obj, searched, TransferConfig())
    assert best == plain == pytest.approx(nearest, abs=1e-6)
    scale = published_scale(query.contact_map[None], np.stack(maps))
    assert scale == pytest.approx(max(float(np.abs(m - query.contact_map).mean()) for m in maps))


def test_figures_leave_out_what_was_not_found(run: Run) -> None:
    bench = bench_transfer(run, config=config(parts=False), workers=1)
    lost = TransferTrial(
        object="brick", source="fetch", target="panda", query=0, held=False, similarity=float("nan"), generated=False,
        tried=9, oracle=0.5, oracle_plain=0.4, cpu_s=0.1, wall_s=0.1,
        others={"dexgraspbench-hard": False, "shake": False},
    )  # fmt: skip
    figures = transfer_figures(replace(bench, trials=(*bench.trials, lost)))
    assert figures["transfer_success"] == pytest.approx(2 / 3)
    assert figures["transfer_similarity"] == pytest.approx(np.mean([t.similarity for t in bench.trials]))
    over = [t.similarity - t.oracle for t in bench.trials]
    assert figures["transfer_without_result"] == 1.0 and transfer_figures(bench)["transfer_without_result"] == 0.0
    assert figures["transfer_similarity_minus_oracle"] == pytest.approx(np.mean(over))
    assert figures["transfer_similarity_missing_as_zero_minus_oracle"] == pytest.approx(np.mean([*over, 0.0 - 0.5]))
    assert "retrieve_alone_similarity" not in figures


def test_a_run_without_unseen_grasps_is_refused(run: Run) -> None:
    with pytest.raises(InputError, match="nothing to carry over"):
        bench_transfer(run, config=config(), objects=["can"], workers=1)
