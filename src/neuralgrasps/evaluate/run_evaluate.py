"""Measure a trained run: the paper's tables on its own unseen and training grasps, and honest figures beside them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.apply.retrieve import Gallery, retrieve
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.reconstruction import ObjectReconstruction, score_object
from neuralgrasps.evaluate.retrieval import score_codebook
from neuralgrasps.evaluate.run_pairs import MeasureConfig, PairResult, PairTask, measure_pair
from neuralgrasps.evaluate.run_scores import (
    ALL_OVER,
    KNOWN,
    ONE_VIEW,
    HandRow,
    ObjectRow,
    RunScores,
    SimilarityRow,
    hand_row,
    object_row,
    similarity_row,
)
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.codes import CodeBook, join_codes
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import SurfaceErrors, surface_errors
from neuralgrasps.parallel import run_tasks

RERANK = 20
PARTS: Mapping[str, tuple[str, ...]] = {"test": ("test",), "train": ("train",), "both": ("test", "train")}
_TIMED = 20

Progress = Callable[[str, int, int, str], None]
"""Called as progress(stage, done, total, text)."""


def evaluate_run(
    field: KinematicField,
    book: CodeBook,
    grasps: Mapping[tuple[str, str], GraspSet],
    *,
    part: str = "test",
    config: MeasureConfig | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> RunScores:
    """Measure a `KinematicField` and its codes on the grasps that it was fitted to and on those held out.

    Args:
        book: codes of training and test grasps; grasps: (hand, object) -> the set that `grasp_index` counts in.
        part: "test": unseen grasps look for training grasps; "train": training grasps look for other training grasps;
            or "both".
        workers: processes; the figures do not depend on them.
    Raises:
        InputError: no such part, or no grasps in it.
    """
    if part not in PARTS:
        raise InputError(f"part is '{part}'; expected 'test', 'train' or 'both'.")
    config = config or MeasureConfig()
    tasks = [task for name in PARTS[part] for task in _tasks(field, book, grasps, name, config)]
    if not tasks:
        raise InputError(f"the run holds no {part} grasps; build its dataset from at least 6 grasps per pair.")
    results = _measured(tasks, config, workers, progress)
    hands, objects, similarities = _rows(field, book, results, config)
    return RunScores(
        field="KinematicField",
        hands=tuple(hands),
        objects=tuple(objects),
        similarities=tuple(similarities),
        pooled=_pooled(results),
        times_ms=_times(field, book, grasps, results),
        errors_mm=_errors_by_hand(results),
        conditions=_conditions(book, results, config),
    )


def _tasks(
    field: KinematicField, book: CodeBook, grasps: Mapping[tuple[str, str], GraspSet], part: str, config: MeasureConfig
) -> list[PairTask]:
    tasks = []
    for name in book.objects:
        for hand in book.hands:
            rows = book[book.where(hand=hand, object_name=name, is_test=part == "test")]
            gallery = book[book.where(hand=hand, object_name=name, is_test=False)]
            if not len(rows):
                continue
            if part == "train" and len(rows) > config.per_pair:
                rows = rows[np.unique(np.linspace(0, len(rows) - 1, config.per_pair).astype(int))]
            chosen = grasps[hand, name][rows.grasp_index.astype(np.int64)]
            tasks.append(PairTask(field=_only(field, hand, name), part=part, book=rows, gallery=gallery, grasps=chosen))
    return tasks


def _only(field: KinematicField, hand: str, object_name: str) -> KinematicField:
    """The field of one hand and object: what a worker needs."""
    return KinematicField(
        hands={hand: field.hands[hand]},
        objects={object_name: field.objects[object_name]},
        hand_codecs={hand: field.hand_codecs[hand]},
        object_codecs={object_name: field.object_codecs[object_name]},
        decoder=field.decoder,
    )


def _measured(
    tasks: Sequence[PairTask], config: MeasureConfig, workers: int | None, progress: Progress | None
) -> list[PairResult]:
    """Results in the order of the tasks; hands with most joints go first, so that no worker ends alone."""
    order = sorted(range(len(tasks)), key=lambda i: -tasks[i].grasps.q.shape[1])
    done: dict[int, PairResult] = {}
    for index, result in run_tasks(measure_pair, [(tasks[i], config) for i in order], workers=workers):
        done[order[index]] = result
        if progress is not None:
            progress("grasps", len(done), len(tasks), f"{result.hand} on {result.object}, {result.part}")
    return [done[i] for i in range(len(tasks))]


def _rows(
    field: KinematicField, book: CodeBook, results: Sequence[PairResult], config: MeasureConfig
) -> tuple[list[HandRow], list[ObjectRow], list[SimilarityRow]]:
    hands = [_hand_row(r, given) for r in results for given in r.shapes]
    shapes = {name: _object(field, name, config) for name in dict.fromkeys(r.object for r in results)}
    parts = list(dict.fromkeys(r.part for r in results))
    objects = [object_row(shapes[r.object], part=part) for part in parts for r in _first_of_objects(results, part)]
    similarities = []
    for part in parts:
        for first in _first_of_objects(results, part):
            if book.where(object_name=first.object, is_test=False).sum() < 1 + (part == "train"):
                continue  # a held-out object: nothing to find
            pairs = [r for r in results if (r.part, r.object) == (part, first.object)]
            for given in dict.fromkeys(name for r in pairs for name in r.shapes):
                queries = None if given == KNOWN else join_codes([r.codes[given] for r in pairs if given in r.codes])
                plain, again = (
                    score_codebook(book, object_name=first.object, part=part, queries=queries, rerank=rerank)
                    for rerank in (0, RERANK)
                )
                similarities.append(similarity_row(plain, again, part=part, given=given, object_name=first.object))
    return hands, objects, similarities


def _hand_row(result: PairResult, given: str) -> HandRow:
    row = hand_row(
        result.shapes[given], result.map_errors[given],
        part=result.part, given=given, object_name=result.object, hand=result.hand,
    )  # fmt: skip
    if given not in result.cpu_s:
        return row
    wrong, doubted = result.wrong(given), result.suspect[given]
    return replace(
        row,
        wrong=int(wrong.sum()),
        wrong_suspected=int((wrong & doubted).sum()),
        doubted=int(doubted.sum()),
        infer_ms=1e3 * float(np.median(result.cpu_s[given])),
    )


def _groups(results: Sequence[PairResult]) -> dict[tuple[str, str], list[PairResult]]:
    """(part, input) -> results that have it."""
    groups: dict[tuple[str, str], list[PairResult]] = {}
    for result in results:
        for given in result.shapes:
            groups.setdefault((result.part, given), []).append(result)
    return groups


def _pooled(results: Sequence[PairResult]) -> dict[tuple[str, str], SurfaceErrors]:
    return {
        key: surface_errors(np.concatenate([r.shapes[key[1]].distances_m for r in group]))
        for key, group in _groups(results).items()
    }


def _errors_by_hand(results: Sequence[PairResult]) -> dict[tuple[str, str], dict[str, np.ndarray]]:
    """(part, input) -> hand -> mean surface error of each grasp, mm."""
    return {
        (part, given): {
            hand: np.concatenate([1e3 * r.shapes[given].distances_m.mean(axis=(1, 2)) for r in group if r.hand == hand])
            for hand in dict.fromkeys(r.hand for r in group)
        }
        for (part, given), group in _groups(results).items()
    }


def _first_of_objects(results: Sequence[PairResult], part: str) -> list[PairResult]:
    return list({r.object: r for r in reversed(results) if r.part == part}.values())[::-1]


def _object(field: KinematicField, name: str, config: MeasureConfig) -> ObjectReconstruction:
    obj = field.object(name)
    return score_object(
        lambda p: query_grid_numpy(obj.sdf, p), obj.mesh, object_name=name, seed=config.seed, queries=config.queries
    )


def _times(
    field: KinematicField, book: CodeBook, grasps: Mapping[tuple[str, str], GraspSet], results: Sequence[PairResult]
) -> dict[str, float]:
    """Milliseconds for one grasp, medians.

    `encode`: wall-clock, the code of a known grasp with its contact map, one thread. `retrieve`: wall-clock, its
    nearest among the training grasps of all hands on its object, re-ranked. `infer, ...`: processor time.
    """
    encode, find = [], []
    known = book.where(is_test=False)
    gallery = Gallery(book[known])
    for (hand, name), chosen in grasps.items():
        if not book.where(hand=hand, object_name=name).any() or not (known & book.where(object_name=name)).any():
            continue
        for i in range(min(len(chosen), 1 + _TIMED // max(len(grasps), 1))):
            one = chosen[i]
            start = time.perf_counter()
            code = field.encode(np.asarray(one.X_OH), np.asarray(one.q), hand=hand, object_name=name)
            middle = time.perf_counter()
            retrieve(code, gallery, object_name=name, rerank=RERANK)
            encode.append(middle - start)
            find.append(time.perf_counter() - middle)
    times = {"encode": 1e3 * float(np.median(encode)), "retrieve": 1e3 * float(np.median(find))} if find else {}
    for given in dict.fromkeys(given for r in results for given in r.cpu_s):
        times[f"infer, {given}"] = 1e3 * float(
            np.median(np.concatenate([r.cpu_s[given] for r in results if given in r.cpu_s]))
        )
    return times


def _conditions(book: CodeBook, results: Sequence[PairResult], config: MeasureConfig) -> dict[str, str]:
    words = {
        "queries": f"{config.queries:,} per grasp in the unit ball (the paper's text says 100,000, its script "
        "1,000,000)",
        "surface points": f"{config.points:,} on each surface of a grasp",
        "seed": str(config.seed),
    }
    for part in dict.fromkeys(r.part for r in results):
        measured = sum(len(next(iter(r.shapes.values()))) for r in results if r.part == part)
        whole = int(book.where(is_test=part == "test").sum())
        words[f"{part} grasps"] = f"{whole} for retrieval, {measured} for shapes"
    if any(r.cpu_s for r in results):
        noise = f"{1e3 * config.noise_m:g} mm noise"
        words[ALL_OVER] = f"1,024 points all over the hand, {noise} in each coordinate"
        words[ONE_VIEW] = f"at most 1,024 points that one depth camera sees, {noise} along its rays"
    if config.observed:
        left = [f"{r.hand} on {r.object}" for r in results if r.part == "test" and not r.cpu_s]
        if left:
            words["not inferred"] = f"{', '.join(left)}: no training grasps to start from"
    bare = [name for name in book.objects if not book.where(object_name=name, is_test=False).any()]
    if bare:
        words["no retrieval"] = f"{', '.join(bare)}: held out, no training grasps to find"
    return words
