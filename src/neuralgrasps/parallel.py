"""Run independent tasks on worker processes; results do not depend on their number."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import pairwise
from multiprocessing.connection import wait as wait_for
from typing import Any

from neuralgrasps.errors import InputError, NeuralGraspsError

# Each worker is one process with one thread: libraries must not start more.
_ONE_THREAD = {
    name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
}


class WorkerDiedError(NeuralGraspsError, RuntimeError):
    """A worker process ended without an answer (out of memory, or killed)."""


def available_cpus() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _start_worker() -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides what happens then.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C is held back, and then as it was: who had it held back keeps that."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # from here on an exception may come


@contextmanager
def _starting() -> Iterator[None]:
    """What is started inside inherits an environment that asks numerical libraries for one thread.

    It also inherits that Ctrl-C is held back, until `_start_worker` ignores it: else one that comes while a worker is
    starting ends it with a traceback. Here it is heard at the end, when all workers are known and can be ended.
    """
    with _interrupts_held(), _one_thread(), _heard_later(signal.SIGINT), _heard_later(signal.SIGTERM):
        yield


@contextmanager
def _one_thread() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _heard_later(number: int) -> Iterator[None]:
    """A signal that this process handles is handled at the end; in its main thread, where signals are handled."""
    handler = signal.getsignal(number)
    if handler in (None, signal.SIG_IGN) or threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []
    signal.signal(number, lambda number, _: heard.append(number))
    try:
        yield
    finally:
        signal.signal(number, handler)
        if heard:
            signal.raise_signal(number)


def thread_map(function: Callable[[Any], Any], items: Sequence[Any], *, threads: int) -> list[Any]:
    """`[function(item) for item in items]` on `threads` threads; worth it for compiled code that frees the interpreter.

    Raises:
        InputError: fewer than one thread. Exception: whatever `function` raised first, in the order of the items.
    """
    if threads < 1:
        raise InputError(f"threads is {threads}; expected at least 1.")
    if threads == 1 or len(items) <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(threads, len(items))) as pool:
        return list(pool.map(function, items))


@contextmanager
def beside(function: Callable[..., Any], *arguments: Any, workers: int | None = None) -> Iterator[Callable[[], Any]]:
    """Run `function(*arguments)` in a process of its own while the body of the `with` statement goes on.

    Yields a function that waits for the result, returns it, and ends the process. With `workers=1` it does the work
    itself. A body that ends without asking ends the process. What must be importable and picklable: see `run_tasks`.

    Raises:
        InputError: fewer than one worker. From the yielded function: what `function` raised, or WorkerDiedError.
    """
    workers = available_cpus() if workers is None else workers
    if workers < 1:
        raise InputError(f"workers is {workers}; expected at least 1.")
    if workers == 1:
        yield lambda: function(*arguments)
        return
    pool, future = _pool(1), None

    def result() -> Any:
        assert future is not None
        try:
            return future.result()
        except BrokenProcessPool as error:
            raise _died() from error
        finally:
            pool.shutdown(wait=True)

    try:
        with _starting():
            future = pool.submit(function, *arguments)
        yield result
    finally:
        _end(pool, at_once=future is None or not future.done())


def blocks(count: int, parts: int) -> list[slice]:
    """Slices that cut `count` items into `parts` runs of nearly equal length."""
    edges = [count * i // parts for i in range(parts + 1)]
    return [slice(a, b) for a, b in pairwise(edges)]


def run_tasks(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], *, workers: int | None = None
) -> Iterator[tuple[int, Any]]:
    """Yield (index of the task, `function(*task)`) as tasks finish.

    Workers are spawned, never forked (compiled code with threads does not survive a fork). With `workers=1`
    everything runs in this process. `function` must be importable and the tasks picklable. When the caller stops early
    or is interrupted, waiting tasks are dropped and running workers are ended.

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
    pool = _pool(min(workers, len(tasks)))
    waiting: dict[Any, int] = {}
    finished = False
    try:
        with _starting():
            for index, task in enumerate(tasks):
                waiting[pool.submit(function, *task)] = index
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                yield waiting.pop(future), future.result()
        finished = True
    except BrokenProcessPool as error:
        raise _died() from error
    finally:
        _end(pool, at_once=not finished)


def _pool(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker)


def _end(pool: ProcessPoolExecutor, *, at_once: bool) -> None:
    """End the workers; `at_once`: in the middle of what they do."""
    for process in list((pool._processes or {}).values()):
        if at_once:
            process.terminate()
    pool.shutdown(wait=True, cancel_futures=True)


def _died() -> WorkerDiedError:
    return WorkerDiedError(
        "a worker process ended without an answer. Most often memory ran out: try fewer workers (--workers 1). In "
        "a script of your own, call this below `if __name__ == '__main__':`, for every worker imports that script."
    )
