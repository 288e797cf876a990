"""Records and figures of the synthesis benchmark, from one small real run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.grasps import measured_penetration
from neuralgrasps.evaluate.synthesis_bench import BenchConfig, BenchResult, bench_synthesis
from neuralgrasps.evaluate.synthesis_figures import infeasible_pairs, synthesis_figures
from neuralgrasps.evaluate.synthesis_pairs import PairMeasures, PairRun, measure_pair, pair_record
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.grasps.grasp_set import empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.synthesise import SynthesisConfig

COUNT = 4


@pytest.fixture(scope="module")
def world(make_object: Callable[..., ObjectModel]) -> tuple[Hand, ObjectModel]:
    return load_hand("panda"), make_object("brick", box_mesh([0.02, 0.03, 0.05]))


@pytest.fixture(scope="module")
def ran(world: tuple[Hand, ObjectModel]) -> BenchResult:
    config = BenchConfig(synthesis=SynthesisConfig(count=COUNT, batch=512), workers=1)
    return bench_synthesis([world[0]], [world[1]], config=config)


@pytest.fixture(scope="module")
def pair(ran: BenchResult) -> PairMeasures:
    return ran.pairs[0]


def changed(pair: PairMeasures, *, cpu_s: float = 2.0, tried: int = 5, held: int = 4, **fields) -> PairMeasures:
    """The pair with other counts and costs."""
    run = PairRun(result=replace(pair.run.result, tried=tried, validated=held), wall_s=3.0, cpu_s=cpu_s)
    return replace(pair, run=run, **fields)


def without_grasps(pair: PairMeasures, **fields) -> PairMeasures:
    result = replace(
        pair.run.result, grasps=empty_grasps(pair.hand, pair.object, num_joints=2), converged=False, tried=0,
        validated=0, reason="too wide",
    )  # fmt: skip
    run = PairRun(result=result, wall_s=1.0, cpu_s=1.0)
    return replace(pair, run=run, depth_m=np.zeros(0), diversity=None, alone=None, **fields)


def test_a_run_measures_its_pairs(ran: BenchResult, pair: PairMeasures, world: tuple[Hand, ObjectModel]) -> None:
    assert (pair.hand, pair.object, pair.hand_kind, pair.shape) == ("panda", "brick", "jaws", "boxes")
    assert pair.is_feasible and len(pair.grasps) == COUNT
    np.testing.assert_array_equal(pair.depth_m, measured_penetration(*world, pair.grasps, spacing=0.002))
    assert pair.diversity is not None and 0.0 < pair.diversity.approach_coverage < 1.0
    assert ran.epsilon is not None and ran.epsilon.count == 4 * COUNT
    record = pair_record(pair)
    assert record["alone_same_grasps"] is True
    assert 0 < record["valid_candidates"] <= record["candidates"]
    assert sum(record["outcomes"].values()) == record["candidates"]  # every start pose that was closed, no other
    assert sum(record["stage_cpu_s"].values()) == pytest.approx(record["cpu_s"])
    assert record["stage_cpu_s"]["other"] >= -0.02
    assert 0.0 <= record["penetration_p50_mm"] <= record["penetration_p95_mm"] <= record["penetration_max_mm"]
    assert (record["mass_kg"], record["friction"], record["torsional_friction_m"]) == (0.1, 0.6, 0.02)
    assert record["epsilon_median"] == np.median(pair.grasps.epsilon) >= record["epsilon_p5"] > 0.0
    assert ran.figures["table_wall_s"] >= pair.run.wall_s


def test_overlap_is_looked_for_every_2_mm(pair: PairMeasures, make_object: Callable[..., ObjectModel]) -> None:
    hand, ball = load_hand("panda"), make_object("ball", sphere_mesh(0.03))
    found = measure_pair(hand, ball, pair.run, COUNT, "dexgraspbench").depth_m  # pads 4 cm apart, a ball of 6 cm
    assert found.max() > 5e-3
    np.testing.assert_array_equal(found, measured_penetration(hand, ball, pair.grasps, spacing=0.002))


def test_rates_of_a_record_are_counts_by_cpu_time(pair: PairMeasures) -> None:
    result = replace(
        pair.run.result, tried=5, validated=4, proposals=600, outcomes={**pair.run.result.outcomes, "valid": 150},
        cpu_s={"propose": 0.5, "close": 1.0, "refine": 9.0},
    )  # fmt: skip
    record = pair_record(replace(pair, run=PairRun(result=result, wall_s=3.0, cpu_s=12.0)))
    assert record["candidates_per_cpu_s"] == pytest.approx(400.0)
    assert record["valid_per_cpu_s"] == pytest.approx(100.0)
    assert record["validated_per_cpu_s"] == pytest.approx(4 / 12)
    assert record["validated_per_wall_min"] == pytest.approx(80.0)
    assert record["validated_per_min_4c"] == pytest.approx(80.0)
    assert record["success_before_filter"] == pytest.approx(0.8)
    assert record["stage_cpu_s"]["other"] == pytest.approx(1.5)
    empty = pair_record(without_grasps(pair))
    assert np.isnan(empty["success_before_filter"]) and np.isnan(empty["penetration_max_mm"])
    assert empty["validated_per_min_4c"] == 0.0 and not empty["feasible"] and empty["reason"] == "too wide"


def test_figures_pool_their_pairs_and_hide_no_infeasible_one(pair: PairMeasures) -> None:
    def alone(seconds: float) -> PairRun:
        return replace(pair.run, wall_s=seconds)

    millimetres = 1e-3 * np.array([0.1, 0.2, 0.3, 1.4])
    pairs = [
        changed(pair, cpu_s=2.0, tried=5, held=4, shape="boxes", alone=alone(1.0), depth_m=millimetres),
        changed(pair, cpu_s=3.0, tried=10, held=4, shape="round", alone=alone(2.0), depth_m=0 * millimetres),
        changed(pair, cpu_s=4.0, tried=4, held=4, shape="round", alone=alone(9.0), depth_m=0 * millimetres),
        without_grasps(pair, shape="boxes"),  # 1 s of CPU time
        changed(pair, cpu_s=8.0, tried=8, held=4, hand="allegro", hand_kind="dexterous", alone=None),
    ]
    figures = synthesis_figures(pairs, table_wall_s=11.0)
    assert figures["validated_per_min_4c_jaws"] == pytest.approx(240 * 12 / 10)
    assert figures["validated_per_min_4c_allegro"] == pytest.approx(240 * 4 / 8)
    assert "validated_per_min_4c_human" not in figures and "seconds_to_4_dexterous" not in figures
    assert (figures["seconds_to_4_jaws"], figures["seconds_to_4_jaws_max"]) == (2.0, 9.0)
    assert figures["success_jaws_boxes"] == pytest.approx(4 / 5)
    assert figures["success_jaws_round"] == pytest.approx(8 / 14)
    assert figures["success_dexterous_boxes"] == pytest.approx(0.5)
    assert figures["penetration_max_mm"] == pytest.approx(1.4)
    assert figures["table_wall_s"] == 11.0
    assert (figures["pairs"], figures["infeasible_pairs"]) == (5, 1)
    assert not any(np.isnan(list(figures.values())))
    missing = {"hand": "panda", "object": "brick", "wanted": COUNT, "validated": 0, "reason": "too wide"}
    assert infeasible_pairs(pairs) == [missing]


def test_a_pair_alone_that_made_other_grasps_is_told(pair: PairMeasures) -> None:
    other = replace(pair.run.result, grasps=pair.grasps[::-1])
    assert pair_record(replace(pair, alone=PairRun(result=other, wall_s=1.0, cpu_s=1.0)))["alone_same_grasps"] is False
    assert "alone_wall_s" not in pair_record(replace(pair, alone=None))


def test_no_worker_is_refused() -> None:
    with pytest.raises(InputError, match="workers is 0"):
        BenchConfig(workers=0)
