"""Figures and tables of `bench execute` from its records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from neuralgrasps.evaluate.execute_bench import ExecuteBench
from neuralgrasps.evaluate.execute_bench_trials import VARIANTS, SceneRecord, TrialRecord
from neuralgrasps.evaluate.shares import mcnemar_p, wilson_interval

FETCH_PAIR, PANDA_PAIR, CLUTTER = "fetch+fetch", "panda+allegro", "clutter"
METHODS = VARIANTS
FIGURES = (
    *(f"success_{m.replace(' ', '_')}" for m in METHODS),
    "success_retry_ours",
    "success_of_all_drawn",
    "clutter_success",
    "clutter_retry_success",
    "plan_median_ms",
    "plan_p95_ms",
    "plan_with_grasps_median_ms",
    "plan_with_grasps_p95_ms",
    "plan_found",
    "paths_checked",
    "collisions",
    "trials_per_min",
    "success_panda_allegro",
    "success_panda_allegro_true",
    "success_panda_allegro_unproven",
    "success_panda_allegro_of_all_drawn",
    "infeasible_share",
    "infeasible_share_panda_allegro",
)


def execute_figures(bench: ExecuteBench) -> dict[str, float]:
    """The figures that could be measured."""
    figures: dict[str, float] = {}
    for method in METHODS:
        own = _of(bench.trials, FETCH_PAIR, method)
        if own:
            figures[f"success_{method.replace(' ', '_')}"] = _share(t.success for t in own)
    ours = _of(bench.trials, FETCH_PAIR, "ours")
    if ours:
        figures["success_retry_ours"] = _share(t.success_retry for t in ours)
        spent = sum(t.wall_s for t in ours) + sum(s.wall_s for s in bench.scenes if s.pair == FETCH_PAIR)
        figures["trials_per_min"] = 60.0 * bench.workers * len(ours) / spent
    clutter = [t for t in bench.trials if t.pair == CLUTTER]
    if clutter:
        figures["clutter_success"] = _share(t.success for t in clutter)
        figures["clutter_retry_success"] = _share(t.success_retry for t in clutter)
    scenes = [s for s in bench.scenes if s.pair == FETCH_PAIR]
    planned = [s for s in scenes if np.isfinite(s.plan_cpu_s)]
    if planned:
        cpu = 1e3 * np.array([s.plan_cpu_s for s in planned])
        figures |= {"plan_median_ms": float(np.median(cpu)), "plan_p95_ms": float(np.percentile(cpu, 95))}
        whole = cpu + 1e3 * np.array([s.grasps_cpu_s for s in planned])
        figures["plan_with_grasps_median_ms"] = float(np.median(whole))
        figures["plan_with_grasps_p95_ms"] = float(np.percentile(whole, 95))
        figures["success_of_all_drawn"] = _of_all_drawn(ours, scenes)
        figures["plan_found"] = _share(s.found for s in scenes if _solved(s))
        figures["infeasible_share"] = _infeasible(scenes)
    figures["paths_checked"] = float(sum(t.paths for t in bench.trials))
    figures["collisions"] = float(sum(t.collisions for t in bench.trials))
    for method, end in (("ours", ""), ("true", "_true"), ("unproven", "_unproven")):
        own = _of(bench.trials, PANDA_PAIR, method)
        if own:
            figures[f"success_panda_allegro{end}"] = _share(t.success for t in own)
    panda = [s for s in bench.scenes if s.pair == PANDA_PAIR]
    if panda:
        figures["success_panda_allegro_of_all_drawn"] = _of_all_drawn(_of(bench.trials, PANDA_PAIR, "ours"), panda)
        figures["infeasible_share_panda_allegro"] = _infeasible(panda)
    return figures


def execute_tables(bench: ExecuteBench) -> dict[str, list[dict[str, Any]]]:
    """Table 2 (success per object and method with Wilson's interval), causes, and McNemar's tests."""
    return {
        "success": _success_rows(bench.trials),
        "causes": _cause_rows(bench.trials),
        "mcnemar": _mcnemar_rows(bench.trials),
        "scenes": _scene_rows(bench.scenes),
    }


def _success_rows(trials: Sequence[TrialRecord]) -> list[dict[str, Any]]:
    rows = []
    for pair, method in dict.fromkeys((t.pair, t.method) for t in trials):
        own = _of(trials, pair, method)
        for name in (*sorted({t.object for t in own}), "all"):
            mine = [t for t in own if name in (t.object, "all")]
            low, high = wilson_interval(sum(t.success for t in mine), len(mine))
            rows.append(
                {
                    "pair": pair,
                    "method": method,
                    "object": name,
                    "count": len(mine),
                    "success": _share(t.success for t in mine),
                    "low": low,
                    "high": high,
                    "with_retry": _share(t.success_retry for t in mine),
                    "pose_right": _share(t.pose_right for t in mine),
                }
            )
    return rows


def _cause_rows(trials: Sequence[TrialRecord]) -> list[dict[str, Any]]:
    rows = []
    for pair, method in dict.fromkeys((t.pair, t.method) for t in trials):
        for cause, count in sorted(Counter(t.cause for t in _of(trials, pair, method) if t.cause).items()):
            rows.append({"pair": pair, "method": method, "cause": cause, "count": count})
    return rows


def _mcnemar_rows(trials: Sequence[TrialRecord]) -> list[dict[str, Any]]:
    by_method = {m: {(t.object, t.index): t.success for t in _of(trials, FETCH_PAIR, m)} for m in METHODS}
    rows = []
    for first, second in combinations(METHODS, 2):
        shared = sorted(by_method[first].keys() & by_method[second].keys())
        if not shared:
            continue
        a, b = [by_method[first][k] for k in shared], [by_method[second][k] for k in shared]
        rows.append(
            {
                "first": first,
                "second": second,
                "count": len(shared),
                "only_first": sum(x and not y for x, y in zip(a, b, strict=True)),
                "only_second": sum(y and not x for x, y in zip(a, b, strict=True)),
                "p": mcnemar_p(a, b),
            }
        )
    return rows


def _scene_rows(scenes: Sequence[SceneRecord]) -> list[dict[str, Any]]:
    rows = []
    for pair, name in dict.fromkeys((s.pair, s.object) for s in scenes):
        own = [s for s in scenes if (s.pair, s.object) == (pair, name)]
        solved = [s for s in own if _solved(s)]
        cpu = [1e3 * s.plan_cpu_s for s in solved if np.isfinite(s.plan_cpu_s)] or [float("nan")]
        reasons = Counter(r for s in own for r in s.reasons)
        rows.append(
            {
                "pair": pair,
                "object": name,
                "scenes": len(solved),
                "drawn": sum(s.draws for s in own),
                "found": _share(s.found for s in solved),
                "plan_median_ms": float(np.median(cpu)),
                "plan_p95_ms": float(np.percentile(cpu, 95)),
                "grasps_tried_median": float(np.median([s.tried for s in own])),
                "why_not": reasons.most_common(1)[0][0] if reasons else "",
            }
        )
    return rows


def _of(trials: Sequence[TrialRecord], pair: str, method: str) -> list[TrialRecord]:
    return [t for t in trials if (t.pair, t.method) == (pair, method)]


def _solved(scene: SceneRecord) -> bool:
    return scene.draws > len(scene.reasons)


def _of_all_drawn(trials: Sequence[TrialRecord], scenes: Sequence[SceneRecord]) -> float:
    """Share lifted when scenes that nothing solves count as failed."""
    return sum(t.success for t in trials) / max(sum(s.draws for s in scenes), 1)


def _infeasible(scenes: Sequence[SceneRecord]) -> float:
    return sum(len(s.reasons) for s in scenes) / max(sum(s.draws for s in scenes), 1)


def _share(outcomes: Iterable[bool]) -> float:
    values = list(outcomes)
    return float(np.mean(values)) if values else float("nan")
