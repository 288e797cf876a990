"""How well grasps are carried over: every hand's unseen grasps to every hand, against the best grasp that is known."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.apply.transfer import TransferConfig, TransferResult, transfer
from neuralgrasps.apply.transfer_kernels import map_differences
from neuralgrasps.apply.transfer_pair import known_maps, target_of, transfer_pair
from neuralgrasps.apply.transfer_query import TransferQuery, contact_radius, query_from_grasp
from neuralgrasps.errors import InputError
from neuralgrasps.grasps.contact_map import contact_distance_matrix, contact_map_packed
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.model.checkpoint import Run
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.sim.validate import validate_grasps

PROTOCOL = "dexgraspbench"  # whole trial that judges the first results; the transfer tries by its own
OTHERS = ("dexgraspbench-hard", "shake")  # chose nothing either, unless `robust` weighs half the friction
_SHORTLIST = 40  # turned known grasps, by maps read off a table, whose exact maps decide the oracle


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferBenchConfig:
    """What is measured.

    Attributes:
        queries: per hand and object, to each target hand. hands: all of the run when empty.
        parts: also retrieval alone and generation alone. seed: of the searches.
        transfer: how grasps are carried over; its `scale` is the object's, see `published_scale`.
    """

    queries: int = 10
    hands: tuple[str, ...] = ()
    parts: bool = True
    seed: int = 0
    transfer: TransferConfig = field(default_factory=lambda: TransferConfig(count=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferTrial:
    """One query and one target hand; similarities are nan where nothing was found.

    Attributes:
        object, source, target, query: which; query is the place in the source hand's grasps.
        held: the first result held in `PROTOCOL`. similarity: its. generated: it is a new grasp. tried: trials it took.
        oracle: similarity of the known grasp most alike, the object's symmetry used; oracle_plain: not used.
        cpu_s, wall_s: of the transfer, one thread, everything that is kept per pair at hand.
        others: by protocol of `OTHERS`, whether the first result held there.
        retrieved, generated_alone: similarity of the first result of each method alone.
    """

    object: str
    source: str
    target: str
    query: int
    held: bool
    similarity: float
    generated: bool
    tried: int
    oracle: float
    oracle_plain: float
    cpu_s: float
    wall_s: float
    others: Mapping[str, bool]
    retrieved: float = float("nan")
    generated_alone: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferBench:
    """All trials, in order, how often known grasps hold under the other protocols, and the wall time."""

    trials: tuple[TransferTrial, ...]
    known_others: Mapping[str, float]
    config: TransferBenchConfig
    wall_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """One target hand on one object: queries with their source hands and places."""

    hand: Hand
    obj: ObjectModel
    known: GraspSet
    queries: tuple[tuple[Hand, int, np.ndarray, np.ndarray], ...]
    scale: float
    config: TransferBenchConfig


def bench_transfer(
    run: Run,
    *,
    config: TransferBenchConfig | None = None,
    objects: Sequence[str] = (),
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> TransferBench:
    """Carry grasps that a run was not fitted to over to every hand, searching only those that it was fitted to.

    Args:
        run: with its grasps. objects: only these, all when empty.
        workers: processes, all processors when None; figures but times do not depend on it.
        progress: called with (pairs of target hand and object done, pairs).
    Raises:
        InputError: the run has no grasps, or none of these.
    """
    config = config or TransferBenchConfig()
    begin = time.perf_counter()
    known, unseen = split_grasps(run)
    names = [o for o in run.field.objects if not objects or o in objects]
    hands = config.hands or tuple(run.field.hands)
    tasks = [(_task(run, known, unseen, hands, hand, name, config),) for name in names for hand in hands]
    if not tasks or not any(task.queries for (task,) in tasks):
        raise InputError("the run holds no unseen grasps of these hands and objects; nothing to carry over.")
    done: dict[int, list[TransferTrial]] = {}
    for index, trials in run_tasks(_try_all, tasks, workers=workers):
        done[index] = trials
        if progress is not None:
            progress(len(done), len(tasks))
    return TransferBench(
        trials=tuple(trial for index in range(len(tasks)) for trial in done[index]),
        known_others=_known_others([g for (h, o), g in known.items() if h in hands and o in names]),
        config=config,
        wall_s=time.perf_counter() - begin,
    )


def _known_others(sets: Sequence[GraspSet]) -> dict[str, float]:
    """Share of known grasps that hold in each of `OTHERS`, where all have been tried in it."""
    return {
        name: float(np.concatenate([g.succeeded(name) for g in sets]).mean())
        for name in OTHERS
        if all(name in g.verdicts for g in sets)
    }


def split_grasps(run: Run) -> tuple[dict[tuple[str, str], GraspSet], dict[tuple[str, str], np.ndarray]]:
    """By (hand, object): the grasps that the run was fitted to, and the places of those it was not, test ones first."""
    book = run.codebook
    known, unseen = {}, {}
    for (hand, name), grasps in run.grasps.items():
        rows = np.flatnonzero(book.where(hand=hand, object_name=name))
        fitted = book.grasp_index[rows[~book.is_test[rows]]]
        test = book.grasp_index[rows[book.is_test[rows]]]
        spare = np.setdiff1d(np.arange(len(grasps)), np.concatenate([fitted, test]))
        known[hand, name], unseen[hand, name] = grasps[fitted], np.concatenate([test, spare]).astype(np.int64)
    return known, unseen


def published_scale(query_maps: np.ndarray, known: np.ndarray) -> float:
    """Largest distance of the matrix of unseen and known grasps of an object, all hands together: similarity 0."""
    return float(contact_distance_matrix(query_maps, known).max())


def _task(
    run: Run,
    known: Mapping[tuple[str, str], GraspSet],
    unseen: Mapping[tuple[str, str], np.ndarray],
    hands: Sequence[str],
    target: str,
    name: str,
    config: TransferBenchConfig,
) -> _Task:
    obj, radius = run.field.object(name), contact_radius(run.field.object(name))
    queries: list[tuple[Hand, int, np.ndarray, np.ndarray]] = []
    asked: list[np.ndarray] = []
    searched: list[np.ndarray] = []
    for source in hands:
        hand, grasps, packed = run.field.hand(source), run.grasps[source, name], pack_shapes(run.field.hand(source))
        places = unseen[source, name]
        for some, maps in ((grasps[places], asked), (known[source, name], searched)):
            maps.append(contact_map_packed(obj.points_O, packed, some.X_OH, some.q, radius=radius))
        queries += [(hand, int(i), grasps.X_OH[i], grasps.q[i]) for i in places[: config.queries]]
    return _Task(
        hand=run.field.hand(target), obj=obj, known=known[target, name], queries=tuple(queries),
        scale=published_scale(np.concatenate(asked), np.concatenate(searched)), config=config,
    )  # fmt: skip


def _try_all(task: _Task) -> list[TransferTrial]:
    """Every query of a task; a first one is carried over beforehand and thrown away, so that all is warm."""
    config = replace(task.config.transfer, scale=task.scale)
    trials: list[TransferTrial] = []
    for number, (source, place, X_OH, q) in enumerate(task.queries):
        query = query_from_grasp(source, task.obj, X_OH, q)
        if number == 0:
            _carry(task, query, config)
        trials.append(_try(task, query, place, config))
    return trials


def _carry(task: _Task, query: TransferQuery, config: TransferConfig) -> tuple[TransferResult, float, float]:
    """The result, and its CPU and wall seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = transfer(query, task.hand, task.obj, known=task.known, config=config, seed=task.config.seed)
    return found, time.process_time() - cpu, time.perf_counter() - wall


def _try(task: _Task, query: TransferQuery, place: int, config: TransferConfig) -> TransferTrial:
    found, cpu_s, wall_s = _carry(task, query, config)
    oracle, plain = exact_oracle(query, task.hand, task.obj, task.known, config)
    first = found.grasps[:1]
    trial = TransferTrial(
        object=task.obj.name, source=query.source, target=task.hand.name, query=place,
        held=_holds(task, first, PROTOCOL), similarity=_first(found),
        generated=found.origin[:1] == ("generated",), tried=found.tried,
        oracle=1.0 - oracle / task.scale, oracle_plain=1.0 - plain / task.scale, cpu_s=cpu_s, wall_s=wall_s,
        others={name: _holds(task, first, name) for name in OTHERS},
    )  # fmt: skip
    if not task.config.parts:
        return trial
    alone = {
        method: _first(_carry(task, query, replace(config, method=method))[0]) for method in ("retrieve", "generate")
    }
    return replace(trial, retrieved=alone["retrieve"], generated_alone=alone["generate"])


def _first(found: TransferResult) -> float:
    return float(found.similarity[0]) if len(found.grasps) else float("nan")


def _holds(task: _Task, grasps: GraspSet, protocol: str) -> bool:
    return len(grasps) > 0 and bool(validate_grasps(task.hand, task.obj, grasps, protocol).success[0])


def exact_oracle(
    query: TransferQuery, hand: Hand, obj: ObjectModel, known: GraspSet, config: TransferConfig
) -> tuple[float, float]:
    """Least difference of contact maps from the query to a known grasp: turned by the object's symmetry, and not.

    Turned grasps are first compared at all points by a table of nearest points; the exact maps of the best decide.
    """
    pair = transfer_pair(hand, obj, config.protocol)
    maps = known_maps(pair, known, query.radius_m).maps
    weight = query.weight / query.weight.sum()
    plain = np.abs(maps - query.contact_map) @ weight
    if len(pair.turned) == 1:
        return float(plain.min()), float(plain.min())
    own = maps[:, pair.sparse]
    rough = np.stack([np.abs(own - query.contact_map[rows]).mean(axis=1) for rows in pair.turned])
    turns, rows = np.unravel_index(np.argsort(rough, axis=None, kind="stable")[:_SHORTLIST], rough.shape)
    X_OH = np.ascontiguousarray(obj.symmetry.rotations[turns] @ known.X_OH[rows])
    exact = map_differences(pair.problem.packed, target_of(query), X_OH, np.ascontiguousarray(known.q[rows]))
    return float(min(exact.min(), plain.min())), float(plain.min())
