"""The benchmark of pose estimation: which scenes which estimator sees, run on worker processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from neuralgrasps.errors import InputError, NeuralGraspsError
from neuralgrasps.evaluate.pose import diameter_m
from neuralgrasps.evaluate.pose_bench_methods import (
    BASELINE,
    CONTACT,
    OURS,
    Library,
    MethodTrial,
    TableTrial,
    has_grasps,
    measure_methods,
    open_library,
    open_library_run,
)
from neuralgrasps.evaluate.pose_bench_trials import (
    ContactTrial,
    IdentityTrial,
    TrackTrial,
    measure_contact,
    measure_identity,
    measure_tracking,
)
from neuralgrasps.evaluate.pose_peers import PEERS, MissingPeerError, check_peer
from neuralgrasps.parallel import blocks, run_tasks
from neuralgrasps.seeds import child_rng

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseBenchConfig:
    """How much is measured; all but `background` and `frames` count per object.

    Attributes:
        scenes: scenes per set for our estimator.
        others: scenes per set for the published methods; peers: for those of other libraries; the first ones of ours.
        identity: scenes of the occluded and the hard set whose object is asked for; left_out: occluded ones asked of
            the library without the object; background: scenes of unknown things.
        held: grasps per hand and object that contact is tried on. sequences: of `frames` frames, tracked.
        seed: root of every random number.
    """

    scenes: int = 20
    others: int = 8
    peers: int = 8
    identity: int = 8
    left_out: int = 4
    background: int = 100
    held: int = 9
    sequences: int = 2
    frames: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        if self.scenes < 1:
            raise InputError(f"{self.scenes} scenes per object and set; expected at least 1.")


QUICK = PoseBenchConfig(
    scenes=10, others=4, peers=3, identity=3, left_out=1, background=28, held=1, sequences=1, frames=10
)
"""The amounts of `--quick`."""


@dataclass(slots=True)
class PoseBench:
    """All trials of a benchmark, in an order that does not depend on the number of workers.

    Attributes:
        absent: by method or kind of trial ("contact term", "identity"), why it was not measured.
        diameters_m: by object.
    """

    methods: list[MethodTrial] = field(default_factory=list)
    tables: list[TableTrial] = field(default_factory=list)
    identity: list[IdentityTrial] = field(default_factory=list)
    contact: list[ContactTrial] = field(default_factory=list)
    tracking: list[TrackTrial] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)
    diameters_m: dict[str, float] = field(default_factory=dict)


def bench_pose(
    library: Library, *, config: PoseBenchConfig, workers: int | None = None, progress: Progress | None = None
) -> PoseBench:
    """Measure our estimator, the published ones and the peers on the same scenes, and what ours does besides.

    Args:
        library: the objects, and the run whose grasps are used.
        workers: processes, of one thread each; progress: called as (done, total, last kind of trials).
    Raises:
        UnknownNameError: an object that does not exist; InputError: no object, or an object too small to be seen.
    """
    objects = open_library(library)
    bench = PoseBench(diameters_m={obj.name: diameter_m(obj) for obj in objects})
    counts = _counts(library, config, bench)
    if CONTACT not in counts:
        library = replace(library, run=None)
    tasks = _tasks(library, config, counts, bench)
    results: list[Any] = [None] * len(tasks)
    for done, (index, found) in enumerate(run_tasks(_work, tasks, workers=workers), start=1):
        results[index] = found
        if progress is not None:
            progress(done, len(tasks), tasks[index][0])
    for (kind, *_), found in zip(tasks, results, strict=True):
        if kind == "methods":
            bench.methods += found[0]
            bench.tables += found[1]
        else:
            getattr(bench, kind).extend(found)
    return bench


_KINDS: Mapping[str, Callable[..., Any]] = {
    "methods": measure_methods, "identity": measure_identity, "contact": measure_contact, "tracking": measure_tracking,
}  # fmt: skip


def _work(kind: str, *arguments: Any) -> Any:
    return _KINDS[kind](*arguments)


def _counts(library: Library, config: PoseBenchConfig, bench: PoseBench) -> dict[str, int]:
    """Scenes per object and set of every method that can run here; why others cannot is noted."""
    others, peers = min(config.others, config.scenes), min(config.peers, config.scenes)
    counts = {OURS: config.scenes, BASELINE: others}
    reason = _why_no_run(library)
    if reason:
        bench.absent |= {CONTACT: reason, "contact term": reason}
    else:
        counts[CONTACT] = others
    for name in PEERS:
        try:
            check_peer(name)
        except MissingPeerError as error:
            bench.absent[name] = str(error)
        else:
            counts[name] = peers
    return counts


def _why_no_run(library: Library) -> str:
    """Why no grasps are known for the objects; empty when some are."""
    if library.run is None:
        return "no shipped run has grasps of these objects."
    try:
        run = open_library_run(library)
    except NeuralGraspsError as error:
        return str(error)
    if any(has_grasps(run, obj.name) for obj in open_library(library)):
        return ""
    return f"run '{library.run}' has no grasps of these objects."


def _tasks(
    library: Library, config: PoseBenchConfig, counts: Mapping[str, int], bench: PoseBench
) -> list[tuple[Any, ...]]:
    """(kind, arguments) of every piece of work, a few seconds each; those of one object are spread over the run."""
    targets, seed = range(len(library.sources)), config.seed
    tasks: list[tuple[Any, ...]] = []
    for part in _parts(config.scenes, 4):
        tasks += [("methods", library, target, part, dict(counts), seed) for target in targets]
    if len(targets) > 1:
        amounts = {"occluded": config.identity, "hard": config.identity, "left out": config.left_out}
        for kind, amount in amounts.items():
            for part in _parts(amount, 5):
                tasks += [("identity", library, target, kind, part, seed) for target in targets]
        tasks += [("identity", library, 0, "background", part, seed) for part in _parts(config.background, 5)]
    else:
        bench.absent["identity"] = "the library holds one object; expected at least two to tell apart."
    if "contact term" not in bench.absent:
        tasks += _contact_tasks(library, config)
    for part in _parts(config.sequences, 1):
        tasks += [("tracking", library, target, part, config.frames, seed) for target in targets]
    return tasks


def _contact_tasks(library: Library, config: PoseBenchConfig) -> list[tuple[Any, ...]]:
    run, names = open_library_run(library), [obj.name for obj in open_library(library)]
    tasks: list[tuple[Any, ...]] = []
    for (hand, name), grasps in run.grasps.items():
        if name not in names:
            continue
        rng = child_rng(config.seed, "held grasps", hand, name)
        chosen = rng.permutation(len(grasps))[: config.held].tolist()
        tasks += [("contact", library, hand, name, chosen[part], config.seed) for part in blocks(len(chosen), 2)]
    return [task for task in tasks if task[4]]


def _parts(count: int, size: int) -> list[Sequence[int]]:
    """0 to `count` - 1 in runs of at most `size`."""
    return [range(first, min(first + size, count)) for first in range(0, count, size)]
