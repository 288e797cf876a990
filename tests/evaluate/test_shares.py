"""Intervals and tests of shares against published numbers and sums by hand."""

from __future__ import annotations

import math

import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.shares import mcnemar_p, wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_against_published_intervals(successes: int, trials: int, low: float, high: float) -> None:
    """Newcombe, "Two-sided confidence intervals for the single proportion", 1998, table I, method 3."""
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_by_its_formula_and_its_mirror() -> None:
    z, n, k = 1.959963984540054, 50, 47
    share = k / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    assert wilson_interval(k, n) == pytest.approx((middle - half, middle + half), abs=1e-9)
    low, high = wilson_interval(n - k, n)
    assert wilson_interval(k, n) == pytest.approx((1 - high, 1 - low), abs=1e-12)
    assert wilson_interval(n, n)[1] == pytest.approx(1.0)
    wide, narrow = wilson_interval(k, n, confidence=0.99), wilson_interval(k, n, confidence=0.8)
    assert wide[0] < narrow[0] < share < narrow[1] < wide[1]


def test_wilson_without_trials_and_with_too_many_successes() -> None:
    assert all(math.isnan(bound) for bound in wilson_interval(0, 0))
    for successes, trials in ((3, 2), (-1, 2)):
        with pytest.raises(InputError, match=f"{successes} successes of {trials} trials"):
            wilson_interval(successes, trials)


def outcomes(both: int, only_first: int, only_second: int, neither: int) -> tuple[list[bool], list[bool]]:
    first = [True] * (both + only_first) + [False] * (only_second + neither)
    second = [True] * both + [False] * only_first + [True] * only_second + [False] * neither
    return first, second


@pytest.mark.parametrize(
    ("only_first", "only_second", "p"),
    [
        (9, 1, 2 * (1 + 10) / 2**10),
        (1, 9, 2 * (1 + 10) / 2**10),
        (5, 0, 2 / 2**5),
        (8, 3, 2 * (1 + 11 + 55 + 165) / 2**11),
        (4, 4, 1.0),
        (0, 0, 1.0),
    ],
)
def test_mcnemar_is_a_coin_toss_over_the_scenes_that_differ(only_first: int, only_second: int, p: float) -> None:
    for both, neither in ((0, 0), (30, 7)):
        assert mcnemar_p(*outcomes(both, only_first, only_second, neither)) == pytest.approx(p, abs=1e-12)


def test_mcnemar_wants_the_same_scenes() -> None:
    with pytest.raises(InputError, match="2 and 3 outcomes"):
        mcnemar_p([True, False], [True, False, True])
