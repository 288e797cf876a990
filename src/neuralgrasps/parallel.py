"""Run independent tasks on worker processes; results do not depend on their number."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from neuralgrasps.errors import InputError, NeuralGraspsError

# Each worker is one process with one thread: libraries must not start more.
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")}


class WorkerDiedError(NeuralGraspsError, RuntimeError):
    """A worker process ended without an answer (out of memory, or killed)."""


def available_cpus() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _ignore_interrupts() -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides what happens then.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_tasks(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], *, workers: int | None = None
) -> Iterator[tuple[int, Any]]:
    """Yield (index of the task, `function(*task)`) as tasks finish.

    Workers are spawned, never forked (compiled code with threads does not survive a fork). With `workers=1` everything runs in this
    process. `function` must be importable and the tasks picklable. When the caller stops early or is interrupted,
    waiting tasks are dropped and running workers are ended.

    Raises:
        WorkerDiedError: a worker was killed.
        Exception: whatever `function` raised.
    """
    workers = available_cpus() if workers is None else workers
    if workers < 1:
        raise InputError(f"workers is {workers}; expected at least 1.")
    if workers == 1 or len(tasks) <= 1:
        for index, task in enumerate(tasks):
            yield index, function(*task)
        return
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    pool = ProcessPoolExecutor(
        min(workers, len(tasks)), mp_context=multiprocessing.get_context("spawn"), initializer=_ignore_interrupts
    )
    waiting: dict[Any, int] = {}
    try:
        waiting = {pool.submit(function, *task): index for index, task in enumerate(tasks)}
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                yield waiting.pop(future), future.result()
    except BrokenProcessPool as error:
        raise WorkerDiedError(
            "a worker process ended without an answer, most often for lack of memory. Try fewer workers (--workers 1)."
        ) from error
    finally:
        for process in list((pool._processes or {}).values()):
            if waiting:
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)
