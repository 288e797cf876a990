"""The benchmark of demonstrations: synthetic videos of people's grasps, watched, transferred and carried out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.demonstrate_trials import VideoRecord, VideoTask, measure_video
from neuralgrasps.evaluate.hand_fit_bench import hand_fit_figures
from neuralgrasps.evaluate.pose_bench_methods import Library, open_library
from neuralgrasps.parallel import available_cpus, run_tasks

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DemonstrateBenchConfig:
    """How much is measured.

    Attributes:
        videos: demonstrations per object. hidden: badly seen ones per object.
        fits: frames of the fit to noisy joints and a known mask, over all objects.
        hand, arm: what repeats the grasps. seed: root of every random number.
    """

    videos: int = 10
    hidden: int = 10
    fits: int = 70
    hand: str = "fetch"
    arm: str = "fetch"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.videos < 1 or self.fits < 1 or self.hidden < 0:
            raise InputError(
                f"{self.videos} videos per object, {self.hidden} badly seen ones, and {self.fits} fits; expected at "
                "least 1 of each, or none badly seen."
            )


HIDDEN_SHARE = (0.4, 0.8)
"""Of the hand that is seen at the grasp of a badly seen demonstration."""
QUICK = DemonstrateBenchConfig(videos=2, hidden=2, fits=21)
"""The amounts of `--quick`."""


@dataclass(slots=True, kw_only=True)
class DemonstrateBench:
    """All demonstrations, in an order that does not depend on the number of workers.

    Attributes:
        videos: the usual ones. hidden: those in which the hand is badly seen (`HIDDEN_SHARE`).
        fit: figures of the fit to noisy joints. workers: processes. wall_s: of all of it.
    """

    videos: list[VideoRecord] = field(default_factory=list)
    hidden: list[VideoRecord] = field(default_factory=list)
    fit: dict[str, float] = field(default_factory=dict)
    workers: int = 1
    wall_s: float = 0.0


def bench_demonstrate(
    library: Library,
    *,
    config: DemonstrateBenchConfig,
    workers: int | None = None,
    progress: Progress | None = None,
) -> DemonstrateBench:
    """Record, watch, transfer and carry out every demonstration.

    Args:
        library: the objects, and the run whose stored grasps are searched.
        workers: processes, of one thread each; progress: called as (done, total, what was done last).
    """
    bench = DemonstrateBench(workers=workers or available_cpus())
    targets = range(len(open_library(library)))
    tasks: list[tuple[Any, ...]] = [("fit", library, config)]
    for count, share in ((config.videos, None), (config.hidden, HIDDEN_SHARE)):
        tasks += [
            ("video", VideoTask(
                library=library, target=t, index=i, hand=config.hand, arm=config.arm, seed=config.seed, share=share
            ))
            for i in range(count)
            for t in targets
        ]  # fmt: skip
    results: list[Any] = [None] * len(tasks)
    begun = time.perf_counter()
    for done, (index, found) in enumerate(run_tasks(_work, tasks, workers=workers), start=1):
        results[index] = found
        if progress is not None:
            progress(done, len(tasks), tasks[index][0])
    bench.wall_s = time.perf_counter() - begun
    usual = 1 + config.videos * len(targets)
    bench.fit, bench.videos, bench.hidden = results[0], results[1:usual], results[usual:]
    return bench


def _work(kind: str, *arguments: Any) -> Any:
    if kind == "video":
        return measure_video(*arguments)
    library, config = arguments
    return hand_fit_figures(open_library(library), count=config.fits, seed=config.seed)
