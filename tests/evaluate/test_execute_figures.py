"""Figures and tables of execution from records made by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from neuralgrasps.evaluate.execute_bench import ExecuteBench
from neuralgrasps.evaluate.execute_bench_trials import SceneRecord, TrialRecord
from neuralgrasps.evaluate.execute_figures import FIGURES, execute_figures, execute_tables
from neuralgrasps.evaluate.shares import mcnemar_p, wilson_interval

TRIAL = TrialRecord(
    pair="fetch+fetch", object="can", index=0, place=0, method="ours", success=True, success_retry=True, cause="",
    detail="", pose_right=True, pose_error_mm=1.0, pose_error_deg=1.0, plan_cpu_s=0.02, look_cpu_s=0.1,
    grasps_cpu_s=0.0, wall_s=2.0, paths=2, collisions=0,
)  # fmt: skip
SCENE = SceneRecord(
    pair="fetch+fetch",
    object="can",
    index=0,
    draws=1,
    found=True,
    plan_cpu_s=0.02,
    grasps_cpu_s=0.1,
    tried=1,
    wall_s=0.0,
    reasons=(),
)


def failed(cause: str, **more: Any) -> TrialRecord:
    return replace(TRIAL, **{"success": False, "success_retry": False, "cause": cause, **more})


def bench(*, scenes: list[SceneRecord] | None = None, trials: list[TrialRecord] | None = None) -> ExecuteBench:
    return ExecuteBench(scenes=scenes or [], trials=trials or [], workers=4)


def test_success_by_method_robot_and_clutter() -> None:
    trials = [
        TRIAL,
        failed("slip", index=1, success_retry=True),
        failed("perception", index=2, wall_s=8.0),
        *(replace(TRIAL, method="true", index=k) for k in range(3)),
        failed("no plan", method="baseline"),
        replace(TRIAL, pair="panda+allegro"),
        failed("slip", pair="panda+allegro", index=1),
        replace(TRIAL, pair="panda+allegro", method="true"),
        *(replace(TRIAL, pair="clutter", place=k) for k in range(3)),
        failed("collision", pair="clutter", place=3, success_retry=True, collisions=1),
    ]
    figures = execute_figures(bench(trials=trials))
    assert figures == {
        "success_ours": pytest.approx(1 / 3),
        "success_true": 1.0,
        "success_baseline": 0.0,
        "success_retry_ours": pytest.approx(2 / 3),
        "trials_per_min": pytest.approx(60.0 * 4 / 4.0),  # 2, 2 and 8 s
        "clutter_success": 0.75,
        "clutter_retry_success": 1.0,
        "paths_checked": 2.0 * len(trials),
        "collisions": 1.0,
        "success_panda_allegro": 0.5,
        "success_panda_allegro_true": 1.0,
    }
    assert set(figures) <= set(FIGURES)


def test_planning_times_and_what_cannot_be_solved() -> None:
    """Four scenes of the can, one that only the long run solved, one that nothing did; and one of another robot."""
    scenes = [
        *(replace(SCENE, index=k, plan_cpu_s=0.01 * (k + 1)) for k in range(3)),
        replace(SCENE, index=3, plan_cpu_s=0.05, found=False, draws=4, reasons=("flat", "flat", "far")),
        replace(SCENE, index=4, found=False, plan_cpu_s=math.nan, draws=30, reasons=("flat",) * 30),
        replace(SCENE, pair="panda+allegro", draws=2, reasons=("flat",), plan_cpu_s=9.0),
    ]
    figures = execute_figures(bench(scenes=scenes))
    assert figures["plan_median_ms"] == pytest.approx(25.0)
    assert figures["plan_p95_ms"] == pytest.approx(30 + 0.85 * 20)
    assert figures["plan_found"] == pytest.approx(3 / 4)
    assert figures["infeasible_share"] == pytest.approx((3 + 30) / (3 + 4 + 30))
    assert figures["infeasible_share_panda_allegro"] == pytest.approx(1 / 2)
    assert set(figures) <= set(FIGURES)
    rows = execute_tables(bench(scenes=scenes))["scenes"]
    assert [(r["pair"], r["scenes"], r["drawn"], r["why_not"]) for r in rows] == [
        ("fetch+fetch", 4, 37, "flat"),
        ("panda+allegro", 1, 2, "flat"),
    ]
    assert rows[0]["found"] == pytest.approx(3 / 4) and rows[0]["plan_median_ms"] == pytest.approx(25.0)


def test_a_scene_in_which_only_the_long_run_found_grasps_hides_no_times() -> None:
    scenes = [SCENE, replace(SCENE, index=1, found=False, plan_cpu_s=math.nan)]
    (row,) = execute_tables(bench(scenes=scenes))["scenes"]
    assert row["plan_median_ms"] == pytest.approx(20.0) and row["scenes"] == 2 and row["found"] == 0.5
    assert execute_figures(bench(scenes=scenes))["plan_median_ms"] == pytest.approx(20.0)


def test_nothing_measured_gives_no_shares() -> None:
    assert execute_figures(bench()) == {"paths_checked": 0.0, "collisions": 0.0}
    assert all(rows == [] for rows in execute_tables(bench()).values())


def test_the_table_of_successes_has_intervals() -> None:
    trials = [*(replace(TRIAL, index=k) for k in range(9)), failed("slip", index=9, pose_right=False)]
    trials += [replace(TRIAL, object="box", index=k) for k in range(5)]
    rows = {r["object"]: r for r in execute_tables(bench(trials=trials))["success"]}
    assert list(rows) == ["box", "can", "all"]
    assert (rows["can"]["count"], rows["can"]["success"], rows["can"]["pose_right"]) == (10, 0.9, 0.9)
    assert (rows["can"]["low"], rows["can"]["high"]) == wilson_interval(9, 10)
    assert (rows["all"]["low"], rows["all"]["high"]) == wilson_interval(14, 15)
    assert rows["all"]["count"] == 15 and rows["box"]["success"] == 1.0


def test_causes_are_counted_by_method() -> None:
    trials = [TRIAL, failed("slip", index=1), failed("slip", index=2), failed("perception", index=3)]
    trials += [failed("no plan", method="true", index=k) for k in range(2)]
    rows = execute_tables(bench(trials=trials))["causes"]
    assert [(r["method"], r["cause"], r["count"]) for r in rows] == [
        ("ours", "perception", 1),
        ("ours", "slip", 2),
        ("true", "no plan", 2),
    ]


def test_methods_are_compared_on_the_scenes_that_they_share() -> None:
    """Of one object, scenes 0 to 9: both 0, only ours 1 to 6, only the baseline 7; 8 and 9 ours alone saw."""
    ours = [failed("slip", index=k) if k == 7 else replace(TRIAL, index=k) for k in range(10)]
    base = [
        replace(TRIAL, method="baseline", index=k) if k in (0, 7) else failed("slip", method="baseline", index=k)
        for k in range(8)
    ]
    other = [replace(t, pair="panda+allegro", success=not t.success) for t in base]  # another robot's scenes
    (row,) = execute_tables(bench(trials=[*ours, *base[::-1], *other]))["mcnemar"]
    assert (row["first"], row["second"], row["count"]) == ("ours", "baseline", 8)
    assert (row["only_first"], row["only_second"]) == (6, 1)
    assert row["p"] == pytest.approx(2 * (1 + 7) / 2**7)
    assert row["p"] == mcnemar_p([True] * 7 + [False], [True] + [False] * 6 + [True])
