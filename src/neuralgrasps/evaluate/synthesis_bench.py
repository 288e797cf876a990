"""Run the synthesis benchmark: every hand on every object, all at once and one by one, then measure the grasps."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.epsilon_check import EpsilonCheck, check_epsilon, grasp_wrench_sets
from neuralgrasps.evaluate.synthesis_figures import synthesis_figures
from neuralgrasps.evaluate.synthesis_pairs import (
    PairMeasures,
    PairRun,
    measure_pair,
    run_pair,
    time_pair,
    warm_kind,
    warm_up,
)
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import available_cpus, run_tasks
from neuralgrasps.synthesis.synthesise import SynthesisConfig

Progress = Callable[[str, int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchConfig:
    """What is run.

    Attributes:
        synthesis: settings of every pair; its `count` is the number of grasps wanted.
        seed: root of every random number.
        workers: processes for the table, threads for a pair alone; all processors when None.
        alone: also time each feasible pair alone.
        epsilon_checks: wrench sets that are compared with Qhull; 0 for none.
    """

    synthesis: SynthesisConfig = field(default_factory=SynthesisConfig)
    seed: int = 0
    workers: int | None = None
    alone: bool = True
    epsilon_checks: int = 1000

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers is {self.workers}; expected at least 1.")


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchResult:
    """What was measured: `figures` over all `pairs` (object by object, hands in the order given)."""

    pairs: tuple[PairMeasures, ...]
    epsilon: EpsilonCheck | None
    figures: dict[str, float]


def bench_synthesis(
    hands: Sequence[Hand],
    objects: Sequence[ObjectModel],
    *,
    config: BenchConfig | None = None,
    progress: Progress | None = None,
) -> BenchResult:
    """Synthesise for every hand and object, and measure.

    First all pairs at once, one per worker process: their CPU times give the rates, and the wall time from before the
    first process starts (compiled loops are on disk by then) to the last grasp is `table_wall_s`. Then each pair that
    had enough grasps once more, alone, with as many threads, after a few uncounted grasps of a box by the same hand.
    Hands and objects are loaded before.

    Args:
        hands, objects: of different names. config: see `BenchConfig`. progress: called with (stage, done, total, text).
    """
    config, say = config or BenchConfig(), progress or (lambda *_: None)
    workers = config.workers or available_cpus()
    pairs = [(hand, obj) for obj in objects for hand in hands]
    say("loading compiled loops", 0, 0, "")
    for is_jaw in sorted({hand.is_jaw for hand in hands}):
        warm_kind(is_jaw)  # compiles them where that was not done before, so that no worker has to
    wall = time.perf_counter()
    runs = _run_table(pairs, config, workers, say)
    table_wall_s = time.perf_counter() - wall
    measures = _measure(pairs, runs, config, workers, say)
    if config.alone:
        measures = _time_alone(pairs, measures, config, workers, say)
    sets = [p.grasps for p in measures]
    count = min(config.epsilon_checks, 4 * sum(map(len, sets)))  # more would be the same again
    wrench_sets = grasp_wrench_sets(sets, {obj.name: obj for obj in objects}, count=count, seed=config.seed)
    checked = None
    if wrench_sets:
        checked = check_epsilon(wrench_sets, workers=workers, progress=lambda *a: say("epsilon against Qhull", *a))
    return BenchResult(
        pairs=tuple(measures),
        epsilon=checked,
        figures=synthesis_figures(measures, table_wall_s=table_wall_s, epsilon=checked),
    )


def _run_table(
    pairs: Sequence[tuple[Hand, ObjectModel]], config: BenchConfig, workers: int, say: Progress
) -> list[PairRun]:
    # dexterous hands take longest: first in, so that no worker ends alone
    order = sorted(range(len(pairs)), key=lambda i: -pairs[i][0].num_dofs)
    tasks = [(*pairs[i], config.synthesis, config.seed) for i in order]
    runs: dict[int, PairRun] = {}
    say("all pairs at once", 0, len(pairs), "")
    for index, run in run_tasks(run_pair, tasks, workers=workers):
        runs[order[index]] = run
        hand, obj = pairs[order[index]]
        say("all pairs at once", len(runs), len(pairs), f"{hand.name} on {obj.name}")
    return [runs[i] for i in range(len(pairs))]


def _measure(
    pairs: Sequence[tuple[Hand, ObjectModel]], runs: Sequence[PairRun], config: BenchConfig, workers: int, say: Progress
) -> list[PairMeasures]:
    wanted, protocol = config.synthesis.count, config.synthesis.protocol
    tasks = [(*pair, run, wanted, protocol) for pair, run in zip(pairs, runs, strict=True)]
    found: dict[int, PairMeasures] = {}
    for index, measures in run_tasks(measure_pair, tasks, workers=workers):
        found[index] = measures
        say("measuring", len(found), len(pairs), "")
    return [found[i] for i in range(len(pairs))]


def _time_alone(
    pairs: Sequence[tuple[Hand, ObjectModel]],
    measures: Sequence[PairMeasures],
    config: BenchConfig,
    threads: int,
    say: Progress,
) -> list[PairMeasures]:
    """Each feasible pair once more, with the whole process to itself."""
    timed = list(measures)
    warm: set[str] = set()
    say("one pair at a time", 0, len(pairs), "")
    for i, (hand, obj) in enumerate(pairs):
        if measures[i].is_feasible:
            if hand.name not in warm:
                warm_up(hand, threads=threads)
                warm.add(hand.name)
            timed[i] = timed[i].with_alone(time_pair(hand, obj, config.synthesis, config.seed, threads=threads))
        say("one pair at a time", i + 1, len(pairs), f"{hand.name} on {obj.name}")
    return timed
