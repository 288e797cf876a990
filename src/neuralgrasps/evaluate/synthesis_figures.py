"""The figures of the synthesis benchmark, from the measures of its pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from neuralgrasps.evaluate.epsilon_check import EpsilonCheck
from neuralgrasps.evaluate.synthesis_pairs import CORES, PairMeasures, percentile

Choice = Callable[[PairMeasures], bool]
_RATES: tuple[tuple[str, Choice], ...] = (
    ("jaws", lambda p: p.hand_kind == "jaws"),
    ("barrett", lambda p: p.hand == "barrett"),
    ("allegro", lambda p: p.hand == "allegro"),
    ("human", lambda p: p.hand == "human"),
)


def synthesis_figures(
    pairs: Sequence[PairMeasures], *, table_wall_s: float, epsilon: EpsilonCheck | None = None
) -> dict[str, float]:
    """Figures over pairs, units in the names; a figure that nothing was measured for is left out.

    `validated_per_min_4c_*`: all validated grasps by all CPU time, times 4 cores; pairs that are not feasible give
    their few grasps and all their time. `success_*`: all held by all tried in physics. `penetration_*`: over all
    grasps. `seconds_to_N_*`: median, and `..._max`, over the feasible pairs, each alone in a warm process.
    """
    figures: dict[str, float] = {}
    for name, chosen in _RATES:
        some = [p for p in pairs if chosen(p)]
        if cpu_s := sum(p.run.cpu_s for p in some):
            figures[f"validated_per_min_4c_{name}"] = 60.0 * CORES * sum(len(p.grasps) for p in some) / cpu_s
    for kind in ("jaws", "dexterous"):
        of_kind = [p for p in pairs if p.hand_kind == kind]
        alone = {p.wanted: [] for p in of_kind}  # type: dict[int, list[float]]
        for p in of_kind:
            if p.alone is not None and p.is_feasible:
                alone[p.wanted].append(p.alone.wall_s)
        for wanted, seconds in alone.items():
            if seconds:
                figures[f"seconds_to_{wanted}_{kind}"] = float(np.median(seconds))
                figures[f"seconds_to_{wanted}_{kind}_max"] = max(seconds)
        for shape in ("round", "boxes"):
            some = [p for p in of_kind if p.shape == shape]
            if tried := sum(p.run.result.tried for p in some):
                figures[f"success_{kind}_{shape}"] = sum(p.run.result.validated for p in some) / tried
    depth_mm = 1e3 * np.concatenate([p.depth_m for p in pairs]) if pairs else np.zeros(0)
    if len(depth_mm):
        figures["penetration_p95_mm"] = percentile(depth_mm, 95)
        figures["penetration_max_mm"] = percentile(depth_mm, 100)
    if epsilon is not None:
        figures["epsilon_ms"] = epsilon.closure_ms_mean
        figures["epsilon_sign_errors"] = float(epsilon.sign_errors)
    figures["table_wall_s"] = table_wall_s
    figures["pairs"] = float(len(pairs))
    figures["infeasible_pairs"] = float(sum(not p.is_feasible for p in pairs))
    return figures


def infeasible_pairs(pairs: Sequence[PairMeasures]) -> list[dict[str, Any]]:
    """The pairs with fewer grasps than wanted, and why."""
    return [
        {
            "hand": p.hand,
            "object": p.object,
            "wanted": p.wanted,
            "validated": len(p.grasps),
            "reason": p.run.result.reason,
        }
        for p in pairs
        if not p.is_feasible
    ]
