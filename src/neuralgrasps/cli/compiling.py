"""How long a run spends compiling: once for each version and machine, and no part of its speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener

WORTH_SAYING_S = 0.5
BEGINS = "compiling, about a minute, first run only"


class CompileClock(Listener):
    """Wall seconds during which compilation ran; compilations inside others are counted once.

    Attributes:
        seconds: so far.
    """

    def __init__(self, on_begin: Callable[[], None]) -> None:
        self.seconds = 0.0
        self._on_begin: Callable[[], None] | None = on_begin
        self._depth, self._start = 0, 0.0

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            self._start = time.perf_counter()
        self._depth += 1
        begin, self._on_begin = self._on_begin, None
        if begin is not None:
            begin()

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._start


@contextmanager
def compile_clock(on_begin: Callable[[], None]) -> Iterator[CompileClock]:
    """Measure compilation in this process; `on_begin` is called once, when the first begins."""
    clock = CompileClock(on_begin)
    with install_listener("numba:compile", clock):
        yield clock


def of_it_compiling(compile_s: float) -> str:
    """ ", 38 s of it compiling (first run only)"; "" when next to nothing was compiled."""
    return f", {compile_s:.0f} s of it compiling (first run only)" if compile_s >= WORTH_SAYING_S else ""
