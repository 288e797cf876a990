"""Figures and tables of `transfer_bench`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from neuralgrasps.evaluate.shares import wilson_interval
from neuralgrasps.evaluate.transfer_bench import OTHERS, TransferBench, TransferTrial

FIGURES = (
    "transfer_success", "transfer_similarity_minus_oracle", "transfer_without_result",
    "transfer_similarity_missing_as_zero_minus_oracle", "transfer_s", "transfer_similarity", "oracle_similarity",
    "oracle_similarity_no_symmetry", "transfer_similarity_minus_oracle_no_symmetry", "transfer_not_below_oracle",
    "transfer_p95_s", "transfer_wall_s", "transfer_success_hard", "transfer_success_shake", "known_success_hard",
    "known_success_shake", "generated_share", "trials_per_transfer", "retrieve_alone_similarity",
    "generate_alone_similarity", "transfer_other_hand_similarity_minus_oracle",
    "transfer_same_hand_similarity_minus_oracle",
)  # fmt: skip
_SHORT = {"dexgraspbench-hard": "hard", "shake": "shake"}


def transfer_figures(bench: TransferBench) -> dict[str, float]:
    """The figures under the names of `FIGURES`; what was not measured is left out."""
    trials = bench.trials
    other = [t for t in trials if t.source != t.target]
    same = [t for t in trials if t.source == t.target]
    figures = {
        "transfer_success": _mean(trials, lambda t: t.held),
        "transfer_similarity_minus_oracle": _over_oracle(trials),
        "transfer_without_result": float(sum(not np.isfinite(t.similarity) for t in trials)),
        "transfer_similarity_missing_as_zero_minus_oracle": _mean(trials, _over_oracle_or_zero),
        "transfer_s": _mean(trials, lambda t: t.cpu_s),
        "transfer_similarity": _mean(trials, lambda t: t.similarity),
        "oracle_similarity": _mean(trials, lambda t: t.oracle),
        "oracle_similarity_no_symmetry": _mean(trials, lambda t: t.oracle_plain),
        "transfer_similarity_minus_oracle_no_symmetry": _mean(trials, lambda t: t.similarity - t.oracle_plain),
        "transfer_not_below_oracle": _mean(trials, lambda t: t.similarity >= t.oracle),
        "transfer_p95_s": float(np.quantile([t.cpu_s for t in trials], 0.95)),
        "transfer_wall_s": _mean(trials, lambda t: t.wall_s),
        "generated_share": _mean(trials, lambda t: t.generated),
        "trials_per_transfer": _mean(trials, lambda t: t.tried),
        "transfer_other_hand_similarity_minus_oracle": _over_oracle(other),
        "transfer_same_hand_similarity_minus_oracle": _over_oracle(same),
    }
    for name in OTHERS:
        figures[f"transfer_success_{_SHORT[name]}"] = _mean(trials, partial(_other, name=name))
        if name in bench.known_others:
            figures[f"known_success_{_SHORT[name]}"] = bench.known_others[name]
    if bench.config.parts:
        figures |= {
            "retrieve_alone_similarity": _mean(trials, lambda t: t.retrieved),
            "generate_alone_similarity": _mean(trials, lambda t: t.generated_alone),
        }
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def transfer_tables(bench: TransferBench) -> dict[str, list[dict[str, Any]]]:
    """Rows by pair of hands, by target hand and by object."""
    trials = bench.trials
    return {
        "pairs": _rows(trials, lambda t: {"source": t.source, "target": t.target}),
        "targets": _rows([t for t in trials if t.source != t.target], lambda t: {"target": t.target})
        + _rows([t for t in trials if t.source == t.target], lambda t: {"target": f"{t.target} (same hand)"}),
        "objects": _rows(trials, lambda t: {"object": t.object}),
    }


def _rows(trials: Sequence[TransferTrial], label: Callable[[TransferTrial], Mapping[str, str]]) -> list[dict[str, Any]]:
    groups: dict[tuple[str, ...], list[TransferTrial]] = {}
    for trial in trials:
        groups.setdefault(tuple(label(trial).values()), []).append(trial)
    return [{**label(own[0]), **_row(own)} for own in groups.values()]


def _row(trials: Sequence[TransferTrial]) -> dict[str, Any]:
    held = sum(t.held for t in trials)
    low, high = wilson_interval(held, len(trials))
    return {
        "count": len(trials),
        "success": held / len(trials),
        "low": low,
        "high": high,
        "similarity": _mean(trials, lambda t: t.similarity),
        "oracle": _mean(trials, lambda t: t.oracle),
        "oracle_no_symmetry": _mean(trials, lambda t: t.oracle_plain),
        "minus_oracle": _over_oracle(trials),
        "retrieved": _mean(trials, lambda t: t.retrieved),
        "generated_alone": _mean(trials, lambda t: t.generated_alone),
        "generated_share": _mean(trials, lambda t: t.generated),
        "hard": _mean(trials, lambda t: t.others[OTHERS[0]]),
        "shake": _mean(trials, lambda t: t.others[OTHERS[1]]),
        "cpu_s": _mean(trials, lambda t: t.cpu_s),
    }


def _other(trial: TransferTrial, *, name: str) -> float:
    return float(trial.others[name])


def _over_oracle(trials: Sequence[TransferTrial]) -> float:
    return _mean(trials, lambda t: t.similarity - t.oracle)


def _over_oracle_or_zero(trial: TransferTrial) -> float:
    """Similarity above the oracle's, 0 taken for what was not found."""
    return (trial.similarity if np.isfinite(trial.similarity) else 0.0) - trial.oracle


def _mean(trials: Sequence[TransferTrial], value: Callable[[TransferTrial], float]) -> float:
    """Mean over the trials in which there is a value; nan when there is none."""
    values = np.array([value(t) for t in trials], np.float64)
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else float("nan")
