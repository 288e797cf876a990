"""The tables of a run: constructed cases with known answers, and a small fitted field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.published import (
    HANDS,
    PUBLISHED_RETRIEVAL,
    PUBLISHED_TRAIN_CHAMFER,
    PUBLISHED_TRAIN_RETRIEVAL,
    published_chamfer_of,
    published_similarities,
)
from neuralgrasps.evaluate.reconstruction import ShapeScores
from neuralgrasps.evaluate.retrieval import score_codebook, score_retrieval
from neuralgrasps.evaluate.run_evaluate import evaluate_run
from neuralgrasps.evaluate.run_examples import retrieval_examples
from neuralgrasps.evaluate.run_pairs import MeasureConfig
from neuralgrasps.evaluate.run_scores import (
    ALL_OVER,
    INPUTS,
    KNOWN,
    ONE_VIEW,
    ObjectRow,
    RunScores,
    hand_row,
    similarity_row,
)
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.reconstruct import surface_errors
from neuralgrasps.model.train import TrainResult

QUICK = MeasureConfig(queries=4000, points=200, observed=False, per_pair=2, seed=1)
Grasps = Mapping[tuple[str, str], GraspSet]


@pytest.fixture(scope="module")
def grasps(small_dataset: GraspDataset) -> Grasps:
    return {pair: small_dataset.grasps(*pair) for pair in small_dataset.pairs}


@pytest.fixture(scope="module")
def scores(small_run: TrainResult, grasps: Grasps) -> RunScores:
    return evaluate_run(small_run.field, small_run.codebook, grasps, part="both", config=QUICK, workers=1)


def test_near_and_far_on_three_by_three() -> None:
    """Distances of maps, query by query: 0 1 4 / 1 0 3 / 4 3 0, over 4; codes have the first two columns swapped."""
    maps, codes = np.array([[0.0], [1.0], [4.0]]), np.array([[1.0], [0.0], [4.0]])
    found = score_retrieval(maps, codes, maps, maps, recall=(1, 2))
    # by code: 0 is at 1, 1 is at 0, 2 is at 4, so the nearest are 1, 0, 2 and the farthest 2, 2, 1
    assert found.near_z == pytest.approx(np.mean([0.75, 0.75, 1.0])) and found.near_gt == 1.0
    assert found.gap == pytest.approx(1 / 6)
    assert found.far_z == pytest.approx(np.mean([0.0, 0.25, 0.25]))  # 1 - 4/4, 1 - 3/4, 1 - 3/4
    assert found.far_gt == pytest.approx(np.mean([0.0, 0.25, 0.0]))
    assert found.recall_at == {1: pytest.approx(1 / 3), 2: 1.0}
    assert score_retrieval(maps, codes, maps, maps, rerank=2).gap == 0.0
    assert score_retrieval(maps, codes, maps, maps, rerank=1).gap == found.gap


def test_a_row_of_known_numbers() -> None:
    distances = np.array([[[0.0005, 0.0015], [0.0005, 0.0030]], [[0.0, 0.0], [0.0, 0.0]]])
    scores = ShapeScores(chamfer=np.array([0.003, 0.005]), oracle=np.array([0.002, 0.002]), distances_m=distances)
    row = hand_row(scores, np.array([0.0, 0.2]), part="test", given=KNOWN, object_name="003_cracker_box", hand="fetch")
    assert (row.chamfer_e3, row.oracle_e3, row.over_oracle) == (4.0, 2.0, pytest.approx(2.0))
    assert row.paper_e3 == 1.44 and row.perfect_meets_paper is False
    assert row.f_1mm == pytest.approx((0.5 + 1.0) / 2)
    assert row.f_2mm == pytest.approx((2 * 1.0 * 0.5 / 1.5 + 1.0) / 2)
    assert row.surface_mean_mm == pytest.approx(5.5 / 8) and row.contact_error_mean == pytest.approx(0.1)
    assert row.surface_median_mm == pytest.approx(0.25)


def test_tables_of_the_paper() -> None:
    assert set(PUBLISHED_TRAIN_RETRIEVAL) == set(PUBLISHED_TRAIN_CHAMFER) == set(PUBLISHED_RETRIEVAL)
    assert published_chamfer_of("021_bleach_cleanser", "panda") == 14.08
    assert published_chamfer_of("bleach_cleanser", "panda", part="train") == 8.85
    assert published_chamfer_of("tomato_soup_can", "object", part="train") == 1.29
    assert published_chamfer_of("teapot", "panda") is None and published_chamfer_of("cracker_box", "my_hand") is None
    assert published_similarities("008_pudding_box", part="train") == (0.83, 0.84, 0.24, 0.23)
    train = np.array(list(PUBLISHED_TRAIN_RETRIEVAL.values()))
    assert (train[:, 1] - train[:, 0] < 0.011).all()  # codes of training grasps lose .01 everywhere
    sums = [sum(row[h] for h in HANDS) for row in PUBLISHED_TRAIN_CHAMFER.values()]
    assert sum(sums) == pytest.approx(169.37, abs=0.005)  # a digit that slips changes it
    with pytest.raises(InputError, match="expected 'test' or 'train'"):
        published_similarities("cracker_box", part="all")


def three_columns(first: float) -> RunScores:
    """The cracker box: object 1.0, fetch `first`, barrett above the paper's 5.52; perfect: 0.5, 2.0 and 1.0."""

    def scored(chamfer: float, oracle: float) -> ShapeScores:
        return ShapeScores(chamfer=np.array([chamfer]), oracle=np.array([oracle]), distances_m=np.zeros((1, 2, 4)))

    name = "003_cracker_box"
    common = {"part": "test", "given": KNOWN, "object_name": name}
    retrieval = score_retrieval(np.eye(3), np.eye(3), np.eye(3), np.eye(3))
    return RunScores(
        field="KinematicField",
        hands=(
            hand_row(scored(first, 0.002), np.zeros(3), hand="fetch", **common),
            hand_row(scored(0.006, 0.001), np.zeros(3), hand="barrett", **common),
        ),
        objects=(
            ObjectRow(part="test", object=name, chamfer_e3=1.0, oracle_e3=0.5, paper_e3=1.33, surface_mean_mm=0.1,
                      surface_p95_mm=0.2),
        ),
        similarities=(similarity_row(retrieval, retrieval, **common),),
        pooled={("test", KNOWN): surface_errors(np.zeros(4))}, times_ms={}, errors_mm={}, conditions={},
    )  # fmt: skip


def test_columns_are_sorted_by_how_they_stand_to_the_paper() -> None:
    sides = three_columns(0.0021).against_paper("test", KNOWN)
    assert sides == {
        "at_or_below": ("003_cracker_box: object",),
        "above": ("003_cracker_box: barrett",),
        "above_as_a_perfect_field": ("003_cracker_box: fetch",),
    }
    assert "003_cracker_box: fetch" in three_columns(0.001439).against_paper("test", KNOWN)["at_or_below"]
    summary = three_columns(0.002).summary("test", KNOWN)
    assert summary["chamfer_over_oracle"] == pytest.approx((1 + 6) / 2) and summary["chamfer_over_oracle_worst"] == 6
    record = three_columns(0.002).record()
    assert record["retrieval"][0]["paper_near_z"] == 0.81 and record["retrieval"][0]["gap"] == 0.0
    assert record["inputs"] == {KNOWN: INPUTS[KNOWN]}


def test_known_grasps_are_exact(scores: RunScores) -> None:
    assert {(r.part, r.input) for r in scores.hands} == {("test", KNOWN), ("train", KNOWN)}
    assert len(scores.hands) == 8 and all(r.grasps == 2 for r in scores.hands)
    for row in scores.hands:
        assert row.over_oracle == pytest.approx(1.0, abs=2e-3) and row.f_1mm == 1.0
        assert row.surface_p95_mm < 1e-3 and row.contact_error_p95 < 1e-4 and row.infer_ms is None
    by_part = {(r.part, r.object): (r.queries, r.gallery) for r in scores.similarities}
    assert by_part == {
        ("test", "ball"): (4, 20), ("test", "brick"): (4, 20),
        ("train", "ball"): (20, 20), ("train", "brick"): (20, 20),
    }  # fmt: skip
    assert all(abs(r.over_oracle - 1) < 0.05 for r in scores.objects)
    assert set(scores.errors_mm) == {("test", KNOWN), ("train", KNOWN)}
    assert scores.times_ms["encode"] > 0 and scores.times_ms["retrieve"] > 0


def test_codes_that_are_off_are_told_apart(small_run: TrainResult, grasps: Grasps) -> None:
    """The palm of every code moves by 1 cm: surfaces, contacts and Chamfer show it; retrieval reads no palm."""
    values = small_run.codebook.values.copy()
    values[:, 96] += 0.1
    moved = replace(small_run.codebook, values=values)
    found = evaluate_run(small_run.field, moved, grasps, config=QUICK, workers=1)
    summary = found.summary("test", KNOWN)
    assert 1.0 < summary["surface_mean_mm"] < 10.0 and summary["f_1mm"] < 0.9
    assert summary["contact_error_mean"] > 0.005
    assert max(r.over_oracle for r in found.hands) > 1.01
    assert (
        summary["gap"]
        == evaluate_run(small_run.field, small_run.codebook, grasps, config=QUICK, workers=1).summary("test", KNOWN)[
            "gap"
        ]
    )


def test_figures_do_not_depend_on_workers_or_other_pairs(
    small_run: TrainResult, grasps: Grasps, scores: RunScores
) -> None:
    both = evaluate_run(small_run.field, small_run.codebook, grasps, config=QUICK, workers=2)
    assert both.hands == tuple(r for r in scores.hands if r.part == "test")
    book = small_run.codebook
    one = book[book.where(hand="fetch", object_name="ball")]
    alone = evaluate_run(small_run.field, one, grasps, config=QUICK, workers=1)
    assert alone.hands == tuple(r for r in both.hands if (r.hand, r.object) == ("fetch", "ball"))


def test_observed_grasps_are_their_own_rows(small_run: TrainResult, grasps: Grasps) -> None:
    book = small_run.codebook
    one = book[book.where(hand="fetch", object_name="brick")]
    config = replace(QUICK, observed=True)
    found = evaluate_run(small_run.field, one, grasps, config=config, workers=1)
    assert [r.input for r in found.hands] == [KNOWN, ALL_OVER, ONE_VIEW]
    known, whole, view = found.hands
    assert known.surface_mean_mm < 1e-3
    assert whole.surface_mean_mm > 0.05  # 3 mm noise cannot give rounding errors
    assert whole.infer_ms is not None and view.infer_ms is not None and view.oracle_e3 == known.oracle_e3
    assert whole.surface_median_mm < 2.0 and 0 <= view.wrong <= view.grasps
    assert "3 mm noise" in found.conditions[ONE_VIEW] and f"infer, {ONE_VIEW}" in found.times_ms
    assert found.summary("test", ALL_OVER)["wrong_basins"] == whole.wrong / whole.grasps


def test_examples_show_unseen_queries_and_the_best_of_each_hand(small_run: TrainResult) -> None:
    book = small_run.codebook
    examples = retrieval_examples(book, prefer="fetch")
    assert [e.object for e in examples] == ["ball", "brick"]
    for e in examples:
        assert book.is_test[e.query] and not any(book.is_test[i] for i in (*e.nearest, e.farthest))
        assert [book.hands[book.hand_index[i]] for i in e.nearest] == ["allegro", "fetch"]
        assert book.hands[book.hand_index[e.query]] == "fetch" and e.similarity[e.query] == 1.0
        assert e.similarity[e.farthest] <= min(e.similarity[i] for i in e.nearest)
    # Normalised as the table is: the mean similarity of the nearest grasps of all unseen ones is its "Near Z".
    for name in book.objects:
        shown = []
        asked = np.flatnonzero(book.where(object_name=name, is_test=True))
        for query in asked:  # the first of each order is the example
            order = np.array([query, *asked[asked != query], *np.flatnonzero(~book.is_test)])
            (one,) = (e for e in retrieval_examples(book[order], prefer="none") if e.object == name)
            shown.append(one.similarity[one.farthest])
        assert np.mean(shown) == pytest.approx(score_codebook(book, object_name=name).far_z, abs=1e-6)


def test_wrong_questions(small_run: TrainResult, grasps: Grasps) -> None:
    book = small_run.codebook
    with pytest.raises(InputError, match="'test', 'train' or 'both'"):
        evaluate_run(small_run.field, book, grasps, part="all", config=QUICK)
    with pytest.raises(InputError, match="holds no test grasps"):
        evaluate_run(small_run.field, book[~book.is_test], grasps, config=QUICK)
    with pytest.raises(InputError, match="expected 0 or more metres"):
        MeasureConfig(noise_m=-0.001)
    with pytest.raises(InputError, match="expected at least 1 each"):
        MeasureConfig(queries=0)


def test_a_held_out_hand_is_measured_and_named(small_run: TrainResult, grasps: Grasps) -> None:
    """All grasps of one hand are test grasps: nothing to start inference from, but known codes are still scored."""
    book = small_run.codebook
    held = replace(book, is_test=book.is_test | book.where(hand="fetch"))
    config = MeasureConfig(queries=2000, points=100, per_pair=2, seed=1)
    found = evaluate_run(small_run.field, held, grasps, config=config, workers=1)
    assert {(r.hand, r.input) for r in found.hands if r.object == "brick"} == {
        ("allegro", KNOWN), ("allegro", ALL_OVER), ("allegro", ONE_VIEW), ("fetch", KNOWN),
    }  # fmt: skip
    assert "fetch on brick" in found.conditions["not inferred"]
    by_input = {r.input: r.queries for r in found.similarities if r.object == "brick"}
    assert by_input[KNOWN] == 2 + 12 and by_input[ONE_VIEW] == 2


def test_a_held_out_object_has_no_retrieval(small_run: TrainResult, grasps: Grasps) -> None:
    book = small_run.codebook
    held = replace(book, is_test=book.is_test | book.where(object_name="brick"))
    config = MeasureConfig(queries=2000, points=100, observed=False, seed=1)
    found = evaluate_run(small_run.field, held, grasps, config=config, workers=1)
    assert {r.object for r in found.similarities} == {"ball"}
    assert {r.object for r in found.hands} == {"ball", "brick"} and "brick" in found.conditions["no retrieval"]
