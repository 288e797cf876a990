"""Measure the grasps of one hand on one object: what a worker of `evaluate_run` does."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.dataset.samples import contact_maps, normalisation_of
from neuralgrasps.evaluate.observe import observe_hand, observe_hand_one_view
from neuralgrasps.evaluate.reconstruction import ShapeScores, decoded_grasps, score_shapes
from neuralgrasps.evaluate.run_scores import ALL_OVER, KNOWN, ONE_VIEW
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.infer import infer_grasps, one_view_config
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import QUERIES, posed_hands
from neuralgrasps.seeds import child_seed


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureConfig:
    """What is measured of a run's grasps.

    Attributes:
        queries: points asked per grasp by the published measure.
        points: per surface and grasp, for surface distances.
        observed: also find the unseen grasps again from observed points.
        observed_points: points of each observation. view_noise_m: of one view, along the rays; all-over points have
            none.
        per_pair: grasps of the training part whose shapes are measured, per hand and object (retrieval takes all).
        seed: of queries, surface points and observations.
    """

    queries: int = QUERIES
    points: int = 1000
    observed: bool = True
    observed_points: int = 1024
    view_noise_m: float = 0.001
    per_pair: int = 5
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PairTask:
    """One hand and object: the field of just these, true grasps, their codes and those to search among.

    Attributes:
        X_OH (N, 4, 4), q (N, J): the true grasps, in the order of `book`, whose contact maps are theirs.
        gallery: codes of the pair's training grasps.
    """

    field: KinematicField
    hand: str
    object: str
    part: str
    book: CodeBook
    gallery: CodeBook
    X_OH: np.ndarray
    q: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class PairResult:
    """Scores by input; `map_errors`: input -> (N, P); `codes`: input -> codes found, in the order of the task."""

    hand: str
    object: str
    part: str
    shapes: dict[str, ShapeScores]
    map_errors: dict[str, np.ndarray]
    codes: dict[str, CodeBook] = field(default_factory=dict)


def measure_pair(task: PairTask, config: MeasureConfig) -> PairResult:
    """Reconstruct the grasps from each kind of input and compare with the true ones."""
    found = {KNOWN: decoded_grasps(task.field, task.book.values, hand=task.hand, object_name=task.object)}
    codes: dict[str, CodeBook] = {}
    if config.observed and task.part == "test":
        for given, (X_OH, q, book) in _infer(task, config).items():
            found[given] = (X_OH, q)
            codes[given] = replace(book, grasp_index=task.book.grasp_index)
    packed, obj = task.field.packed[task.hand], task.field.object(task.object)
    radius = task.field.object_codecs[task.object].radius_m
    shapes = score_shapes(
        {given: posed_hands(packed, X_OH, q) for given, (X_OH, q) in found.items()},
        posed_hands(packed, task.X_OH, task.q),
        normalisation=normalisation_of(obj.points_O),
        seeds=_seeds(task, config, "shapes"),
        queries=config.queries,
        points=config.points,
    )
    true_maps = contact_maps(packed, task.X_OH, task.q, obj.points_O, radius_m=radius)
    errors = {
        given: np.abs(contact_maps(packed, X_OH, q, obj.points_O, radius_m=radius) - true_maps)
        for given, (X_OH, q) in found.items()
    }
    return PairResult(
        hand=task.hand, object=task.object, part=task.part, shapes=shapes, map_errors=errors, codes=codes
    )


def _infer(task: PairTask, config: MeasureConfig) -> dict[str, tuple[np.ndarray, np.ndarray, CodeBook]]:
    """Pose, joints and codes found from observed points, by input."""
    packed, hand, obj = task.field.packed[task.hand], task.field.hand(task.hand), task.field.object(task.object)
    whole, view = [], []
    for X_OH, q, seed in zip(task.X_OH, task.q, _seeds(task, config, "observed"), strict=True):
        whole.append(observe_hand(packed, X_OH, q, seed=seed, points=config.observed_points))
        view.append(
            observe_hand_one_view(
                hand, obj, X_OH, q, seed=seed, noise_m=config.view_noise_m, points=config.observed_points
            )
        )
    common = {"hand": task.hand, "object_name": task.object}
    results = {
        ALL_OVER: infer_grasps(whole, task.field, task.gallery, **common),
        ONE_VIEW: infer_grasps(
            view, task.field, task.gallery, **common, config=one_view_config(config.view_noise_m)
        ),
    }
    return {given: (r.X_OH, r.q, r.codes) for given, r in results.items()}


def _seeds(task: PairTask, config: MeasureConfig, what: str) -> list[int]:
    return [child_seed(config.seed, what, task.hand, task.object, int(i)) for i in task.book.grasp_index]
