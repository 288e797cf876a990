"""Progress of long work on stderr: a bar on a terminal, now and then a plain line elsewhere, nothing for quick work."""

from __future__ import annotations

import threading
import time
from collections import deque
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.table import Column
from rich.text import Text

SHOW_AFTER_S = 1.0
LINE_EVERY_S = 5.0
HEARTBEAT_S = 10.0  # outside a terminal, silent work says how long it has been running
_RATE_WINDOW_S = 30.0
_RATE_SHARE, _RATE_AFTER_S, _RATE_ITEMS = 0.05, 5.0, 3  # less than this says nothing about the time left


class ProgressBar:
    """Counts, rate and time left of one piece of work, or of several stages after another.

    Use it in a `with` block and hand it (or `stage`) to a library function as its `progress` callback. The bar
    disappears at the end; what a finished stage took stays as a line.
    """

    def __init__(self, console: Console, title: str, unit: str = "") -> None:
        self._console, self._title, self._unit = console, title, unit
        self._lock = threading.Lock()
        self._bar: Progress | None = None
        self._closed = False
        self._stage: str | None = None
        self._done, self._total, self._text = 0, 0, ""
        self._first_done = 0
        self._start = self._line_at = time.monotonic()
        self._marks: deque[tuple[float, int]] = deque()  # when how many were done, lately
        self._timer = threading.Timer(SHOW_AFTER_S, self._show)
        self._timer.daemon = True
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        self._start = self._line_at = time.monotonic()
        if self._console.is_terminal:
            self._timer.start()
        else:
            threading.Thread(target=self._beat, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.cancel()
        self._ended.set()
        with self._lock:
            self._closed = True
            if self._bar is not None:
                self._bar.stop()
        if error is None:
            self._finish_stage()

    def __call__(self, done: int, total: int | None, text: object = "") -> None:
        """`done` of `total` (None or 0 = not known) with a few words on the latest one."""
        if self._done == 0 and done > 0 and not self._first_done and time.monotonic() - self._start < 0.05:
            self._first_done = done  # kept from an earlier run: not this run's speed
        if done != self._done:
            self._mark(done)
        self._done, self._total, self._text = done, total or 0, str(text)
        with self._lock:
            if self._bar is not None and not self._closed:
                self._refresh(self._bar)
        if not self._console.is_terminal:
            self._line()

    def stage(self, stage: str, done: int, total: int | None, text: object = "") -> None:
        """The same for work in stages; a new name closes the stage before."""
        if stage != self._stage:
            self._finish_stage()
            self._stage, self._done, self._first_done = stage, 0, 0
            self._marks.clear()
            self._start = self._line_at = time.monotonic()
        self(done, total, text)

    def _mark(self, done: int) -> None:
        now = time.monotonic()
        self._marks.append((now, done))
        while len(self._marks) > _RATE_ITEMS and self._marks[0][0] < now - _RATE_WINDOW_S:
            self._marks.popleft()

    @property
    def _rate(self) -> float | None:
        """Items per second lately, without the first, which pays for warming up; None when too few were done."""
        marks = tuple(self._marks)  # the heartbeat's thread reads them too
        if len(marks) < _RATE_ITEMS:
            return None
        (start, first), (end, last) = marks[0], marks[-1]
        return (last - first) / (end - start) if last > first and end > start else None

    def _beat(self) -> None:
        """Outside a terminal: a line when none came for a while."""
        while not self._ended.wait(HEARTBEAT_S / 4):
            if time.monotonic() - self._line_at >= HEARTBEAT_S:
                self._line()

    @property
    def _label(self) -> str:
        return self._stage or self._title

    def _finish_stage(self) -> None:
        if self._stage is None:
            return
        wall = time.monotonic() - self._start
        count = f"{self._total}" if self._total > 1 else ""
        self._console.print(f"  {self._stage:<32} {count:>6}  {wall:6.1f} s")
        self._stage = None

    def _show(self) -> None:
        with self._lock:
            if self._closed:
                return
            self._bar = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}", table_column=Column(no_wrap=True)),
                BarColumn(bar_width=12),
                _Numbers(self._unit),
                TextColumn("{task.fields[text]}", style="dim", table_column=Column(no_wrap=True, ratio=1)),
                console=self._console,
                transient=True,
                expand=True,
            )
            self._bar.add_task(self._label, total=None, text="", first=0, rate=None)
            self._refresh(self._bar)
            self._bar.start()

    def _refresh(self, bar: Progress) -> None:
        task = bar.tasks[0]
        if task.description != self._label:
            bar.reset(task.id)
        bar.update(
            task.id,
            description=self._label,
            completed=self._done,
            total=self._total or None,
            text=self._text,
            first=self._first_done,
            rate=self._rate,
        )

    def _line(self) -> None:
        now = time.monotonic()
        if now - self._line_at < LINE_EVERY_S:
            return
        self._line_at = now
        elapsed = now - self._start
        numbers = numbers_text(self._done, self._total, self._first_done, elapsed, self._unit, rate=self._rate)
        self._console.print(f"{self._label}: {numbers}" + (f" ({self._text})" if self._text else ""))


class _Numbers(ProgressColumn):
    """ "12/60 grasps, 3.1/s, 0:15 left"."""

    def __init__(self, unit: str) -> None:
        super().__init__(table_column=Column(no_wrap=True))
        self._unit = unit

    def render(self, task: Task) -> Text:
        total = int(task.total or 0)
        first = int(task.fields["first"])
        done, elapsed, rate = int(task.completed), task.elapsed or 0.0, task.fields["rate"]
        return Text(numbers_text(done, total, first, elapsed, self._unit, rate=rate))


def numbers_text(done: int, total: int, first: int, elapsed_s: float, unit: str, *, rate: float | None = None) -> str:
    """Count, rate and time left in words; `first` were there before the clock started.

    `rate`: of late, per second; None takes the mean. Neither is said before enough was done to know it.
    """
    if not total and not done:
        return clock(elapsed_s)
    count = f"{done}/{total}" if total else f"{done}"
    words = [f"{count} {unit}".strip()]
    fresh = done - first
    known = not total or fresh >= _RATE_SHARE * total or (elapsed_s >= _RATE_AFTER_S and fresh >= _RATE_ITEMS)
    if total and done >= total:  # what follows reports nothing: no rate that sinks and sinks
        words.append(clock(elapsed_s))
    elif known and fresh > 0 and elapsed_s > 0:
        rate = rate or fresh / elapsed_s
        words.append(f"{rate:.1f}/s" if rate >= 1 else f"{rate * 60:.1f}/min")
        if total:
            words.append(f"{clock((total - done) / rate)} left")
    else:
        words.append(clock(elapsed_s))
    return ", ".join(words)


def clock(seconds: float) -> str:
    """ "0:07", "12:30" or "1:02:03"."""
    minutes, s = divmod(round(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02d}:{s:02d}" if hours else f"{m}:{s:02d}"
