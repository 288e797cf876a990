"""Measure the grasps of one hand on one object: what a worker of `evaluate_run` does."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from neuralgrasps.dataset.samples import contact_maps, normalisation_of
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.inference_bench import WRONG_BASIN_M, Condition, PairInference, infer_pair
from neuralgrasps.evaluate.reconstruction import ShapeScores, decoded_grasps, score_shapes
from neuralgrasps.evaluate.run_scores import ALL_OVER, KNOWN, ONE_VIEW
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.codes import CodeBook
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
        noise_m: of the observed points: of each coordinate all over, along the rays in one view. Inference is not
            told it, nor where the camera is.
        per_pair: grasps of the training part whose shapes are measured, per hand and object (retrieval takes all).
        seed: of queries, surface points and observations.
    """

    queries: int = QUERIES
    points: int = 1000
    observed: bool = True
    noise_m: float = 0.003
    per_pair: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        if self.queries < 1 or self.points < 1 or self.per_pair < 1:
            raise InputError(
                f"queries {self.queries}, points {self.points}, per_pair {self.per_pair}; expected at least 1 each."
            )
        if not self.noise_m >= 0:
            raise InputError(f"noise_m is {self.noise_m}; expected 0 or more metres.")

    @property
    def observations(self) -> dict[str, Condition]:
        """What is observed, by input."""
        return {
            ALL_OVER: Condition(one_view=False, noise_m=self.noise_m),
            ONE_VIEW: Condition(one_view=True, noise_m=self.noise_m),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class PairTask:
    """One hand and object: the field of just these, true grasps, their codes and those to search among.

    Attributes:
        grasps: the true ones, in the order of `book`. gallery: codes of the pair's training grasps.
    """

    field: KinematicField
    part: str
    book: CodeBook
    gallery: CodeBook
    grasps: GraspSet


@dataclass(frozen=True, slots=True, kw_only=True)
class PairResult:
    """What was found, by input.

    Attributes:
        shapes: scores. map_errors: (N, P) |differences| of contact maps. codes: those found, in the order of the task
            (none for known grasps: they are the book's).
        suspect: (N,) whether inference itself doubts the result. cpu_s: (N,) of one inference.
    """

    hand: str
    object: str
    part: str
    shapes: dict[str, ShapeScores]
    map_errors: dict[str, np.ndarray]
    codes: dict[str, CodeBook] = field(default_factory=dict)
    suspect: dict[str, np.ndarray] = field(default_factory=dict)
    cpu_s: dict[str, np.ndarray] = field(default_factory=dict)

    def wrong(self, given: str) -> np.ndarray:
        """(N,) bool: mean surface error above 10 mm, another grasp altogether."""
        return self.shapes[given].distances_m.mean(axis=(1, 2)) > WRONG_BASIN_M


def measure_pair(task: PairTask, config: MeasureConfig) -> PairResult:
    """Reconstruct the grasps from each kind of input and compare with the true ones."""
    hand, name = task.grasps.hand, task.grasps.object
    inferred: dict[str, PairInference] = {}
    if config.observed and task.part == "test" and len(task.gallery):  # without known grasps, nowhere to start
        for given, how in config.observations.items():
            inferred[given] = infer_pair(task.field, task.gallery, task.grasps, task.book.grasp_index, how, config.seed)
    books = {KNOWN: task.book} | {given: one.codes for given, one in inferred.items()}
    found = {
        given: decoded_grasps(task.field, book.values, hand=hand, object_name=name) for given, book in books.items()
    }
    packed, codec = task.field.packed[hand], task.field.object_codecs[name]
    shapes = score_shapes(
        {given: posed_hands(packed, X_OH, q) for given, (X_OH, q) in found.items()},
        posed_hands(packed, task.grasps.X_OH, task.grasps.q),
        normalisation=normalisation_of(codec.points_O),
        seeds=[child_seed(config.seed, "shapes", hand, name, int(i)) for i in task.book.grasp_index],
        queries=config.queries,
        points=config.points,
    )
    true_maps = contact_maps(packed, task.grasps.X_OH, task.grasps.q, codec.points_O, radius_m=codec.radius_m)
    errors = {
        given: np.abs(contact_maps(packed, X_OH, q, codec.points_O, radius_m=codec.radius_m) - true_maps)
        for given, (X_OH, q) in found.items()
    }
    return PairResult(
        hand=hand,
        object=name,
        part=task.part,
        shapes=shapes,
        map_errors=errors,
        codes={given: one.codes for given, one in inferred.items()},
        suspect={given: one.suspect for given, one in inferred.items()},
        cpu_s={given: one.seconds for given, one in inferred.items()},
    )
