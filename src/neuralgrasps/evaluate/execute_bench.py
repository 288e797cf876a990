"""The benchmark of execution: which scenes, which robots, which pose methods, on worker processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from neuralgrasps.errors import InputError, NeuralGraspsError
from neuralgrasps.evaluate.execute_bench_trials import (
    VARIANTS,
    Found,
    SceneRecord,
    TrialRecord,
    measure_clutter,
    measure_single,
)
from neuralgrasps.evaluate.pose_bench_methods import Library, open_library, open_library_run
from neuralgrasps.parallel import available_cpus, run_tasks

Progress = Callable[[int, int, str], None]
FETCH, PANDA = ("fetch", "fetch"), ("panda", "allegro")
PAPER_METHODS = ("baseline", "contact")
_PANDA_VARIANTS = ("ours", "true", "unproven")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecuteBenchConfig:
    """How much is measured.

    Attributes:
        scenes: scenes per object for Fetch, all `VARIANTS` on each. panda_scenes: for Panda with the Allegro hand.
        clutter_scenes, clutter_objects: scenes with several objects for Fetch. seed: root of every random number.
    """

    scenes: int = 50
    panda_scenes: int = 20
    clutter_scenes: int = 20
    clutter_objects: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        if self.scenes < 1:
            raise InputError(f"{self.scenes} scenes per object; expected at least 1.")


QUICK = ExecuteBenchConfig(scenes=5, panda_scenes=2, clutter_scenes=2)
"""The amounts of `--quick`."""


@dataclass(slots=True, kw_only=True)
class ExecuteBench:
    """All scenes and trials, in an order that does not depend on the number of workers.

    Attributes:
        absent: pose methods that could not be run, and why. workers: processes. wall_s: of all of it.
    """

    scenes: list[SceneRecord] = field(default_factory=list)
    trials: list[TrialRecord] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)
    workers: int = 1
    wall_s: float = 0.0


def bench_execute(
    library: Library, *, config: ExecuteBenchConfig, workers: int | None = None, progress: Progress | None = None
) -> ExecuteBench:
    """Run every trial.

    Args:
        library: the objects, and the run whose stored grasps and field are used.
        workers: processes, of one thread each; progress: called as (done, total, what was done last).
    """
    bench = ExecuteBench(workers=workers or available_cpus())
    tasks = _tasks(library, config, _variants(library, bench))
    results: list[Found | None] = [None] * len(tasks)
    begun = time.perf_counter()
    for done, (index, found) in enumerate(run_tasks(_work, tasks, workers=workers), start=1):
        results[index] = found
        if progress is not None:
            progress(done, len(tasks), tasks[index][0])
    bench.wall_s = time.perf_counter() - begun
    for found in results:
        assert found is not None
        bench.scenes += found.scenes
        bench.trials += found.trials
    return bench


def _variants(library: Library, bench: ExecuteBench) -> tuple[str, ...]:
    reason = "no shipped run has a field of these objects."
    if library.run is not None:
        try:
            open_library_run(library)
        except NeuralGraspsError as error:
            reason = str(error)
        else:
            reason = ""
    if not reason:
        return VARIANTS
    bench.absent |= dict.fromkeys(PAPER_METHODS, reason)
    return tuple(v for v in VARIANTS if v not in PAPER_METHODS)


def _tasks(library: Library, config: ExecuteBenchConfig, variants: Sequence[str]) -> list[tuple[Any, ...]]:
    """(kind, arguments); pieces of some seconds, those of one object spread over the run."""
    targets, seed = range(len(open_library(library))), config.seed
    tasks: list[tuple[Any, ...]] = []
    for part in _parts(config.scenes, 5):
        tasks += [("single objects", library, target, *FETCH, part, variants, seed) for target in targets]
    for part in _parts(config.panda_scenes, 4):
        tasks += [("panda and allegro", library, target, *PANDA, part, _PANDA_VARIANTS, seed) for target in targets]
    count = min(config.clutter_objects, len(targets))
    if count > 1:
        tasks += [("clutter", library, *FETCH, part, count, seed) for part in _parts(config.clutter_scenes, 1)]
    return tasks


def _parts(count: int, size: int) -> list[Sequence[int]]:
    return [range(first, min(first + size, count)) for first in range(0, count, size)]


def _work(kind: str, *arguments: Any) -> Found:
    return measure_clutter(*arguments) if kind == "clutter" else measure_single(*arguments)
