"""Wall time, CPU time and peak memory of this process and its workers, stage by stage."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import psutil

_PERIOD_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Cost of one stage. `peak_rss_bytes` sums the resident memory of all processes, sampled ten times a second."""

    name: str
    wall_s: float
    cpu_s: float
    peak_rss_bytes: int


class Meter:
    """Measures stages; use as a context manager, so that its sampling thread ends.

    `on_start` is called with the name of each stage as it begins.
    """

    def __init__(self, on_start: Callable[[str], None] | None = None) -> None:
        self._on_start = on_start
        self.stages: list[Stage] = []
        self._peak = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Meter:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the body of the `with` statement. CPU time of workers counts once they have ended."""
        if self._on_start is not None:
            self._on_start(name)
        self._peak = _resident_bytes()
        wall, cpu = time.perf_counter(), _cpu_s()
        yield
        self._peak = max(self._peak, _resident_bytes())
        self.stages.append(
            Stage(
                name=name,
                wall_s=time.perf_counter() - wall,
                cpu_s=_cpu_s() - cpu,
                peak_rss_bytes=self._peak,
            )
        )

    def _sample(self) -> None:
        while not self._stop.wait(_PERIOD_S):
            self._peak = max(self._peak, _resident_bytes())


def _cpu_s() -> float:
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in usage)


def _resident_bytes() -> int:
    """Resident memory of this process and its descendants; pages they share count once for each."""
    me = psutil.Process()
    total = 0
    for process in (me, *me.children(recursive=True)):
        try:
            total += process.memory_info().rss
        except psutil.Error:
            continue  # ended meanwhile
    return total
