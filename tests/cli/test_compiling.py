"""The clock of compilation: counted once, begun once, silent when there was none."""

from __future__ import annotations

import time

from numba import njit

from neuralgrasps.cli.compiling import compile_clock, of_it_compiling


def test_compilation_is_timed_and_announced_once() -> None:
    @njit
    def inner(x: float) -> float:
        return 2.0 * x

    @njit
    def outer(x: float) -> float:
        return inner(x) + 1.0

    said: list[str] = []
    wall = time.perf_counter()
    with compile_clock(lambda: said.append("begins")) as clock:
        assert not said
        assert outer(1.0) == 3.0
        wall = time.perf_counter() - wall
        once = clock.seconds
        outer(2.0)
    assert said == ["begins"] and 0.0 < once <= wall
    assert clock.seconds == once  # nothing new to compile
    outer(1)  # another type, after the clock has stopped
    assert clock.seconds == once


def test_only_noticeable_compilation_is_worth_words() -> None:
    assert of_it_compiling(0.1) == "" and of_it_compiling(38.2) == ", 38 s of it compiling (first run only)"
