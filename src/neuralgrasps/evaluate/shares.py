"""Shares of successes: how sure they are, and whether two methods on the same scenes differ."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.stats import binomtest

from neuralgrasps.errors import InputError


def wilson_interval(successes: int, trials: int, *, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a share; (nan, nan) without trials.

    Raises:
        InputError: more successes than trials, or fewer than 0.
    """
    if not 0 <= successes <= trials:
        raise InputError(f"{successes} successes of {trials} trials; expected 0 to {trials}.")
    if trials == 0:
        return float("nan"), float("nan")
    interval = binomtest(successes, trials).proportion_ci(confidence_level=confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mcnemar_p(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Two-sided exact p-value of McNemar's test: do two methods succeed equally often on the same N scenes?

    Raises:
        InputError: sequences of different lengths.
    """
    if len(first) != len(second):
        raise InputError(f"McNemar's test got {len(first)} and {len(second)} outcomes; expected the same scenes.")
    only_first = sum(a and not b for a, b in zip(first, second, strict=True))
    only_second = sum(b and not a for a, b in zip(first, second, strict=True))
    differing = only_first + only_second
    return 1.0 if differing == 0 else float(binomtest(only_first, differing).pvalue)
