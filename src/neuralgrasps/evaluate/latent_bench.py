"""What the shared latent space costs and yields: the measurements behind `neuralgrasps bench latent`."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.apply.code_index import CodeIndex
from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.read import GraspDataset, read_dataset
from neuralgrasps.dataset.schema import CloudKind, DatasetConfig
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.run_scores import KNOWN, ONE_VIEW, RunScores
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.train import TrainConfig, TrainResult, train
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng

INDEX_ROWS = 1_000_000
_QUERIES, _REPEATS = 20, 3

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneCost:
    """CPU-seconds of the data stage per scene (one hand on one object), one process.

    Attributes:
        samples_cpu_s: 40,000 exact signed distances to hand and object, contact map, all written to disk.
        clouds_cpu_s: the same and the point clouds of both, as seen by 128 virtual cameras.
        scenes: how many were made.
    """

    samples_cpu_s: float
    clouds_cpu_s: float
    scenes: int


def measure_scenes(
    folder: str | Path,
    grasp_sets: Sequence[GraspSet],
    *,
    hands: Mapping[str, Hand],
    objects: Mapping[str, ObjectModel],
    per_pair: int = 10,
    seed: int = 0,
) -> SceneCost:
    """Build the dataset of the first `per_pair` grasps of each set twice, in this process, everything stored.

    One scene is made and thrown away before, so that compiled loops are loaded.

    Args:
        folder: an empty one; gets the datasets.
    Raises:
        InputError: no grasps.
    """
    some = [grasps[: min(per_pair, len(grasps))] for grasps in grasp_sets if len(grasps)]
    if not some:
        raise InputError("no grasps to build a dataset from; expected at least one.")
    costs = []
    kinds: tuple[CloudKind, ...] = ("none", "rendered")
    for clouds in kinds:
        config = DatasetConfig(store_samples=True, clouds=clouds, seed=seed)
        common: dict[str, Any] = {"hands": hands, "objects": objects, "config": config, "workers": 1}
        build_dataset(Path(folder) / f"warm-{clouds}", [grasps[:1] for grasps in some], **common)
        start = time.process_time()
        build_dataset(Path(folder) / clouds, some, **common)
        costs.append(time.process_time() - start)
    scenes = sum(len(grasps) for grasps in some)
    return SceneCost(samples_cpu_s=costs[0] / scenes, clouds_cpu_s=costs[1] / scenes, scenes=scenes)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainCost:
    """A fitted field and what it cost; `wall_s` is of training alone, on `threads` threads."""

    result: TrainResult
    dataset: GraspDataset
    wall_s: float
    cpu_s: float
    threads: int
    grasps: int


def measure_training(
    folder: str | Path,
    grasp_sets: Sequence[GraspSet],
    *,
    hands: Mapping[str, Hand],
    objects: Mapping[str, ObjectModel],
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
) -> TrainCost:
    """Build a dataset of contact maps (samples are not needed) and train the default field on it."""
    build_dataset(
        folder, grasp_sets, hands=hands, objects=objects, workers=workers,
        config=DatasetConfig(store_samples=False, seed=seed),
    )  # fmt: skip
    dataset = read_dataset(folder)
    config = TrainConfig(seed=seed)
    told = None if progress is None else (lambda done, total, loss: progress(done, total, f"loss {loss:.4f}"))
    wall, cpu = time.perf_counter(), _cpu_s()
    result = train(dataset, hands=hands, objects=objects, config=config, progress=told)
    return TrainCost(
        result=result,
        dataset=dataset,
        wall_s=time.perf_counter() - wall,
        cpu_s=_cpu_s() - cpu,
        threads=config.threads,
        grasps=len(result.codebook),
    )


def _cpu_s() -> float:
    """Of this process and all that have ended under it."""
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchCost:
    """Exact L1 search among `rows` codes: median and least wall-clock milliseconds of one query, all cores.

    Attributes:
        exact: share of the queries whose results are those of a plain search over all rows.
    """

    median_ms: float
    least_ms: float
    rows: int
    queries: int
    exact: float


def measure_search(book: CodeBook, *, rows: int = INDEX_ROWS, count: int = 20, seed: int = 0) -> SearchCost:
    """Search one query at a time among jittered copies of the training codes; queries are the unseen codes.

    Copies are the codes plus normal noise of a tenth of each column's spread, so that they fill the space that real
    codes fill: `rows` real grasps are not to be had.
    """
    known = book.metric[book.where(is_test=False)]
    asked = book.metric[book.where(is_test=True)]
    if not len(known) or not len(asked):
        raise InputError(f"{len(known)} training and {len(asked)} unseen codes; expected some of both.")
    rng = child_rng(seed, "index")
    values = known[rng.integers(len(known), size=rows)].astype(np.float32)
    values += rng.standard_normal(values.shape, np.float32) * (0.1 * known.std(axis=0)).astype(np.float32)
    queries = asked[rng.permutation(len(asked))[:_QUERIES]].astype(np.float32)
    index = CodeIndex(values)
    index.search(queries[:1], count)
    times, right = [], []
    for query in queries:
        runs = []
        for _ in range(_REPEATS):
            start = time.perf_counter()
            found, _ = index.search(query[None], count)
            runs.append(time.perf_counter() - start)
        times.append(min(runs))
        right.append(_same_as_plain(values, query, found[0]))
    return SearchCost(
        median_ms=1e3 * float(np.median(times)),
        least_ms=1e3 * min(times),
        rows=rows,
        queries=len(queries),
        exact=float(np.mean(right)),
    )


def _same_as_plain(values: np.ndarray, query: np.ndarray, found: np.ndarray) -> bool:
    """Whether the rows found are as near as the nearest of a plain search, up to float32 rounding."""
    distance = np.concatenate(
        [np.abs(block - query).sum(axis=1, dtype=np.float64) for block in np.array_split(values, 16)]
    )
    best = np.sort(np.partition(distance, len(found) - 1)[: len(found)])
    return bool(np.allclose(np.sort(distance[found]), best, rtol=1e-5, atol=1e-6))


def figures_of_scores(scores: RunScores) -> dict[str, float]:
    """The figures that `evaluate_run` answers, under the names of the benchmark; what was not measured is left out."""
    known = scores.summary("test", KNOWN)
    figures = {
        "hand_surface_mean_mm": known["surface_mean_mm"],
        "hand_surface_p95_mm": known["surface_p95_mm"],
        "chamfer_over_oracle": known["chamfer_over_oracle"],
        "chamfer_over_oracle_worst": known["chamfer_over_oracle_worst"],
        "retrieval_gap": known["gap"],
        "retrieval_gap_reranked": known["gap_reranked"],
        "encode_ms": scores.times_ms["encode"],
    }
    if ("test", ONE_VIEW) in scores.parts_and_inputs:
        view = scores.summary("test", ONE_VIEW)
        figures |= {
            "observed_surface_median_mm": view["surface_median_mm"],
            "observed_surface_p95_mm": view["surface_p95_mm"],
            "observed_wrong_basins": view["wrong_basins"],
            "chamfer_over_oracle_observed": view["chamfer_over_oracle"],
            "retrieval_gap_observed": view["gap"],
            "retrieval_gap_observed_reranked": view["gap_reranked"],
            "infer_ms": scores.times_ms[f"infer, {ONE_VIEW}"],
        }
    return figures


def some_objects(grasp_sets: Sequence[GraspSet], names: Sequence[str]) -> list[GraspSet]:
    """The sets of these objects; of the first ones there are when none of them is there."""
    known = list(dict.fromkeys(g.object for g in grasp_sets))
    chosen = [name for name in names if name in known] or known[: len(names)]
    return [g for g in grasp_sets if g.object in chosen]
