"""Tasks on worker processes: order, errors, early ends and deaths."""

from __future__ import annotations

import math
import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import time
from typing import Any

import psutil
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.parallel import WorkerDiedError, available_cpus, beside, run_tasks

# Workers can import only what is installed, so the tasks are functions of the standard library.


def _workers() -> list[Any]:
    # What multiprocessing itself knows: a process that was just started still has its parent's command line.
    return multiprocessing.active_children()


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_every_task_is_answered_once_whatever_the_worker_count(workers):
    tasks = [(float(i),) for i in range(7)]
    answers = dict(run_tasks(math.sqrt, tasks, workers=workers))
    assert answers == {i: math.sqrt(i) for i in range(7)}


def test_no_tasks_give_nothing():
    assert list(run_tasks(math.sqrt, [], workers=3)) == []


def test_workers_default_to_the_processors_this_process_may_use():
    assert 1 <= available_cpus() <= (os.cpu_count() or 1)


@pytest.mark.parametrize("workers", [0, -2])
def test_worker_count_below_one_is_refused(workers):
    with pytest.raises(InputError, match=f"workers is {workers}"):
        list(run_tasks(math.sqrt, [(1.0,)], workers=workers))


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_of_a_task_reaches_the_caller(workers):
    with pytest.raises(ValueError, match="math domain error"):
        list(run_tasks(math.sqrt, [(4.0,), (-1.0,), (9.0,)], workers=workers))
    assert _workers() == []


def test_closing_early_ends_the_workers_at_once():
    tasks = run_tasks(time.sleep, [(0.0,), (600.0,), (600.0,)], workers=2)
    assert next(tasks) == (0, None)
    tasks.close()
    assert _workers() == []


def test_a_killed_worker_is_reported_as_such():
    with pytest.raises(WorkerDiedError, match="memory ran out"):
        list(run_tasks(os._exit, [(3,), (3,)], workers=2))
    assert _workers() == []


def test_workers_use_one_thread_and_leave_the_environment_as_it_was(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    seen = dict(run_tasks(os.getenv, [("OMP_NUM_THREADS",), ("MKL_NUM_THREADS",)], workers=2))
    assert seen == {0: "1", 1: "1"}
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_the_environment_is_restored_when_a_task_cannot_be_started(monkeypatch):
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with pytest.raises(TypeError):
        list(run_tasks(math.sqrt, [(1.0,), 2.0], workers=2))  # the second task is no tuple
    assert "MKL_NUM_THREADS" not in os.environ
    assert _workers() == []


def test_workers_ignore_an_interrupt_that_the_parent_decides_about():
    seen = dict(run_tasks(signal.getsignal, [(signal.SIGINT,), (signal.SIGINT,)], workers=2))
    assert set(seen.values()) == {signal.SIG_IGN}


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="there are no masks of signals here")
@pytest.mark.parametrize("held", [True, False])
def test_a_caller_who_holds_interrupts_back_goes_on_doing_so(held):
    before = signal.pthread_sigmask(signal.SIG_BLOCK if held else signal.SIG_UNBLOCK, [signal.SIGINT])
    try:
        assert dict(run_tasks(math.sqrt, [(4.0,), (9.0,)], workers=2)) == {0: 2.0, 1: 3.0}
        after_tasks = signal.pthread_sigmask(signal.SIG_BLOCK, [])
        with beside(math.sqrt, 4.0, workers=2) as result:
            after_beside = signal.pthread_sigmask(signal.SIG_BLOCK, [])
            assert result() == 2.0
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    assert (signal.SIGINT in after_tasks, signal.SIGINT in after_beside) == (held, held)


def test_an_interrupt_while_workers_start_is_the_parents_too():
    script = (
        "import math, os, signal\n"
        "from concurrent.futures import ProcessPoolExecutor\n"
        "from neuralgrasps.parallel import run_tasks\n"
        "submit = ProcessPoolExecutor.submit\n"
        "def interrupted(*args):\n"
        "    future = submit(*args)\n"
        "    os.killpg(0, signal.SIGINT)\n"  # the worker is not yet through its first lines
        "    return future\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, lambda *_: print('heard'))\n"
        "    ProcessPoolExecutor.submit = interrupted\n"
        "    print(sorted(run_tasks(math.sqrt, [(4.0,), (9.0,)], workers=2)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, start_new_session=True
    )
    assert done.stderr == ""
    assert done.stdout.splitlines()[0] == "heard"
    assert done.stdout.splitlines()[-1] == "[(0, 2.0), (1, 3.0)]"


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_while_workers_start_ends_them_all(workers):
    script = (
        "import os, signal, time\n"
        "from multiprocessing import Process, active_children\n"
        "from neuralgrasps.parallel import beside, run_tasks\n"
        "start = Process.start\n"
        "def interrupted(self):\n"
        "    start(self)\n"
        "    signal.raise_signal(signal.SIGINT)\n"  # the pool does not know of the worker yet
        "if __name__ == '__main__':\n"
        "    from multiprocessing.context import SpawnProcess\n"
        "    SpawnProcess.start = interrupted\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    try:\n"
        f"        if {workers} == 1:\n"
        "            with beside(time.sleep, 600.0, workers=2):\n"
        "                print('begun')\n"
        "        list(run_tasks(time.sleep, [(600.0,), (600.0,)], workers=2))\n"
        "    except KeyboardInterrupt:\n"
        "        print(active_children())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, start_new_session=True, timeout=120
    )
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_workers_end_with_a_killed_parent():
    script = (
        "import time\nfrom neuralgrasps.parallel import run_tasks\n"
        "if __name__ == '__main__':\n"
        "    for _ in run_tasks(time.sleep, [(0.0,), (600.0,), (600.0,)], workers=2):\n"
        "        print('up', flush=True)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None and parent.stdout.readline() == "up\n"
    children = psutil.Process(parent.pid).children()
    assert len(children) >= 2  # two workers, and what multiprocessing tracks its resources with
    parent.kill()
    parent.wait()
    _, alive = psutil.wait_procs(children, timeout=60)
    parent.stdout.close()
    for process in alive:
        process.kill()
    assert alive == []


def test_results_do_not_depend_on_the_order_of_completion():
    answers = list(run_tasks(operator.mul, [(i, i) for i in range(20)], workers=2))
    assert sorted(answers) == [(i, i * i) for i in range(20)]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_task_beside_answers_when_asked(workers):
    with beside(math.pow, 3.0, 2.0, workers=workers) as result:
        assert len(_workers()) == workers - 1
        assert result() == 9.0
        assert _workers() == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_beside_reaches_who_asks(workers):
    with beside(math.sqrt, -1.0, workers=workers) as result, pytest.raises(ValueError, match="math domain error"):
        result()
    assert _workers() == []


def test_a_body_that_fails_ends_the_task_beside():
    with pytest.raises(KeyError), beside(time.sleep, 600.0, workers=2):
        raise KeyError
    assert _workers() == []


def test_a_task_beside_that_dies_is_told():
    with beside(os._exit, 3, workers=2) as result, pytest.raises(WorkerDiedError, match="memory"):
        result()


def test_a_task_beside_needs_a_worker():
    with pytest.raises(InputError, match="workers is 0"), beside(math.sqrt, 4.0, workers=0):
        pass
