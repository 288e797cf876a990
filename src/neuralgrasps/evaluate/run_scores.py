"""What `evaluate_run` found, as flat rows that tables and JSON are made from, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from neuralgrasps.evaluate.published import published_chamfer_of, published_similarities
from neuralgrasps.evaluate.reconstruction import F_SCORES_M, ObjectReconstruction, ShapeScores
from neuralgrasps.evaluate.retrieval import RetrievalScores
from neuralgrasps.model.reconstruct import SurfaceErrors

KNOWN, ALL_OVER, ONE_VIEW = "known", "observed all over", "observed in one view"
SDF_SAMPLES, SDF_AND_MAPS, LEARNED = "signed distances", "signed distances and contact maps", "learned code"
INPUTS: Mapping[str, str] = {
    KNOWN: "pose and joints are given: the code holds the grasp by construction, nothing is inferred",
    ALL_OVER: "only points on the whole surface of the hand are given, without labels, pose or joints",
    ONE_VIEW: "only the points of the hand that one depth camera sees are given, the object and the hand in the way",
    SDF_SAMPLES: "signed distances to hand and object at sample points are given, nothing else, as in the published "
    "inference",
    SDF_AND_MAPS: "besides signed distances, a loss that the published inference lacks: codes are drawn to where their "
    "contact maps belong, which are read off the same exact distances and would retrieve as well without any network",
    LEARNED: "the code was learned together with the field, from signed distances",
}
BELOW_PERFECT = 0.999  # ratios to a perfect field's score nearer 1 are rounding
SIMILARITY_NAMES = ("near_z", "near_gt", "far_z", "far_gt")


@dataclass(frozen=True, slots=True, kw_only=True)
class HandRow:
    """Reconstructed hands of one hand and object.

    Attributes:
        part: "test" (unseen) or "train". input: one of `INPUTS`.
        chamfer_e3, oracle_e3: the published measure x 1e-3, and a perfect field's score on the same queries. That is
            no lower bound: a hollow or flattened shape can score less.
        paper_e3: the paper's figure, for its own hands and grasps; None for other objects and hands.
        surface_*_mm: surface to surface, both ways pooled.
        f_1mm, f_2mm: mean F-scores over the grasps (`model.reconstruct.f_score`).
        contact_error_mean, contact_error_p95: |difference| of the contact maps of decoded and true hand, in [0, 1].
        wrong: grasps with a mean surface error above 10 mm; wrong_suspected: those of them that inference doubts;
            doubted: grasps that it doubts, right or wrong. infer_ms: median processor time of one inference.
    """

    part: str
    input: str
    object: str
    hand: str
    grasps: int
    chamfer_e3: float
    oracle_e3: float
    paper_e3: float | None
    surface_mean_mm: float
    surface_median_mm: float
    surface_p95_mm: float
    f_1mm: float
    f_2mm: float
    contact_error_mean: float
    contact_error_p95: float
    wrong: int = 0
    wrong_suspected: int = 0
    doubted: int = 0
    infer_ms: float | None = None

    @property
    def over_oracle(self) -> float:
        return self.chamfer_e3 / self.oracle_e3

    @property
    def perfect_meets_paper(self) -> bool | None:
        """Whether a perfect field's score is at or below the paper's figure; not whether any field's could be."""
        return None if self.paper_e3 is None else self.oracle_e3 <= self.paper_e3

    @property
    def below_perfect(self) -> bool:
        """Whether the score is below a perfect field's: a sign of a hollow or flattened shape, not of a better one."""
        return self.over_oracle < BELOW_PERFECT


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectRow:
    """The field's object against the mesh; columns as in `HandRow`.

    Attributes:
        input: None where the object is the same for all inputs. shapes: how many codes' objects were measured.
    """

    part: str
    object: str
    chamfer_e3: float
    oracle_e3: float
    paper_e3: float | None
    surface_mean_mm: float
    surface_p95_mm: float
    input: str | None = None
    shapes: int = 1

    @property
    def over_oracle(self) -> float:
        return self.chamfer_e3 / self.oracle_e3

    @property
    def perfect_meets_paper(self) -> bool | None:
        """Whether a perfect field's score is at or below the paper's figure; not whether any field's could be."""
        return None if self.paper_e3 is None else self.oracle_e3 <= self.paper_e3

    @property
    def below_perfect(self) -> bool:
        """As in `HandRow`."""
        return self.over_oracle < BELOW_PERFECT


@dataclass(frozen=True, slots=True, kw_only=True)
class SimilarityRow:
    """Retrieval on one object among all hands; `paper_*` are the paper's figures for its own grasps.

    Attributes:
        near_z_reranked: of the nearest among the first 20 by code, put in order by contact map.
        recall_at_k: share of queries whose nearest grasp by contact map is among the k nearest by code.
    """

    part: str
    input: str
    object: str
    queries: int
    gallery: int
    near_z: float
    near_gt: float
    far_z: float
    far_gt: float
    near_z_reranked: float
    recall_at_1: float
    recall_at_5: float
    recall_at_10: float
    paper_near_z: float | None
    paper_near_gt: float | None
    paper_far_z: float | None
    paper_far_gt: float | None

    @property
    def gap(self) -> float:
        return self.near_gt - self.near_z

    @property
    def gap_reranked(self) -> float:
        return self.near_gt - self.near_z_reranked


@dataclass(frozen=True, slots=True, kw_only=True)
class RunScores:
    """Everything measured of a run.

    Attributes:
        field: which field the figures belong to, "KinematicField" or "MlpField".
        pooled: (part, input) -> surface errors over all surface points of all grasps.
        times_ms: figure -> milliseconds (`evaluate_run` says of what).
        errors_mm: (part, input) -> hand -> mean surface error of each grasp, mm, for histograms.
        conditions: what was given and how much of it, as name and text.
    """

    field: str
    hands: tuple[HandRow, ...]
    objects: tuple[ObjectRow, ...]
    similarities: tuple[SimilarityRow, ...]
    pooled: Mapping[tuple[str, str], SurfaceErrors]
    times_ms: Mapping[str, float]
    errors_mm: Mapping[tuple[str, str], Mapping[str, np.ndarray]]
    conditions: Mapping[str, str]

    @property
    def parts_and_inputs(self) -> tuple[tuple[str, str], ...]:
        """(part, input) in the order measured."""
        return tuple(dict.fromkeys((row.part, row.input) for row in self.similarities))

    def summary(self, part: str, given: str) -> dict[str, float]:
        """Figures of one part and input over all objects and hands.

        Surface errors are over all surface points, F-scores and contact errors over the grasps, shares over the grasps;
        `chamfer_over_oracle` is the mean over the columns of the table, similarities are means over the objects.
        """
        hands = [r for r in self.hands if (r.part, r.input) == (part, given)]
        similar = [r for r in self.similarities if (r.part, r.input) == (part, given)]
        names = ("gap", "gap_reranked", "recall_at_1", "recall_at_5", "recall_at_10")
        figures = {name: _mean([getattr(r, name) for r in similar]) for name in names}
        if not hands:
            return figures
        count = sum(r.grasps for r in hands)
        pooled = self.pooled[part, given]
        figures |= {
            "grasps": count,
            "chamfer_over_oracle": _mean([r.over_oracle for r in hands]),
            "chamfer_over_oracle_worst": max(r.over_oracle for r in hands),
            "surface_mean_mm": 1e3 * pooled.mean_m,
            "surface_median_mm": 1e3 * pooled.median_m,
            "surface_p95_mm": 1e3 * pooled.p95_m,
            "wrong_basins": sum(r.wrong for r in hands) / count,
            "wrong_suspected": sum(r.wrong_suspected for r in hands) / max(1, sum(r.wrong for r in hands)),
            "doubted": sum(r.doubted for r in hands) / count,
        }
        for name in ("f_1mm", "f_2mm", "contact_error_mean"):
            figures[name] = sum(getattr(r, name) * r.grasps for r in hands) / count
        return figures

    def against_paper(self, part: str, given: str) -> dict[str, tuple[str, ...]]:
        """Columns ("object: hand") by how they stand to the paper's figures.

        Keys: "at_or_below"; "above" although a perfect field would not be; "above_as_a_perfect_field", where the
        paper's figure is below what a perfect field scores on these shapes.
        """
        sides: dict[str, list[str]] = {"at_or_below": [], "above": [], "above_as_a_perfect_field": []}
        for row in self._columns(part, given):
            if row.paper_e3 is None:
                continue
            below = row.chamfer_e3 <= row.paper_e3
            side = "at_or_below" if below else "above" if row.perfect_meets_paper else "above_as_a_perfect_field"
            sides[side].append(_column_name(row))
        return {key: tuple(names) for key, names in sides.items()}

    def objects_of(self, part: str, given: str) -> tuple[ObjectRow, ...]:
        """The rows of objects that belong to an input."""
        return tuple(r for r in self.objects if r.part == part and r.input in (None, given))

    def below_perfect(self, part: str, given: str) -> tuple[str, ...]:
        """Columns ("object: hand") that score below a perfect field, so that their score says little."""
        return tuple(_column_name(row) for row in self._columns(part, given) if row.below_perfect)

    def chamfer_note(self, part: str, given: str) -> str:
        """What to say beside the published measure; empty when no column scores below a perfect field."""
        names = self.below_perfect(part, given)
        if not names:
            return ""
        return (
            f"Below a perfect field's score: {len(names)} ({', '.join(names)}). That is no better than perfect: the "
            "measure compares a filled shape with a surface, so a hollow or flattened one scores less. Go by the "
            "surface errors there."
        )

    def _columns(self, part: str, given: str) -> list[HandRow | ObjectRow]:
        hands = (r for r in self.hands if (r.part, r.input) == (part, given))
        return [*self.objects_of(part, given), *hands]

    def record(self) -> dict[str, Any]:
        """The rows and summaries for JSON."""
        return {
            "field": self.field,
            "conditions": dict(self.conditions),
            "inputs": {given: INPUTS[given] for _, given in self.parts_and_inputs},
            "summary": [
                {"part": part, "input": given, **self.summary(part, given)} for part, given in self.parts_and_inputs
            ],
            "against_paper": [
                {
                    "part": part,
                    "input": given,
                    **self.against_paper(part, given),
                    "below_a_perfect_field": self.below_perfect(part, given),
                }
                for part, given in self.parts_and_inputs
            ],
            "times_ms": dict(self.times_ms),
            "hands": [asdict(r) | {"chamfer_over_oracle": r.over_oracle} for r in self.hands],
            "objects": [asdict(r) | {"chamfer_over_oracle": r.over_oracle} for r in self.objects],
            "retrieval": [asdict(r) | {"gap": r.gap, "gap_reranked": r.gap_reranked} for r in self.similarities],
        }


def hand_row(
    scores: ShapeScores, map_errors: np.ndarray, *, part: str, given: str, object_name: str, hand: str
) -> HandRow:
    """The row of one pair, nothing inferred; `map_errors`: |differences| of contact maps, any shape."""
    surface = scores.surface
    first, second = (float(scores.f_scores(threshold).mean()) for threshold in F_SCORES_M)
    return HandRow(
        part=part,
        input=given,
        object=object_name,
        hand=hand,
        grasps=len(scores),
        chamfer_e3=1e3 * float(scores.chamfer.mean()),
        oracle_e3=1e3 * float(scores.oracle.mean()),
        paper_e3=published_chamfer_of(object_name, hand, part=part),
        surface_mean_mm=1e3 * surface.mean_m,
        surface_median_mm=1e3 * surface.median_m,
        surface_p95_mm=1e3 * surface.p95_m,
        f_1mm=first,
        f_2mm=second,
        contact_error_mean=float(map_errors.mean()),
        contact_error_p95=float(np.quantile(map_errors, 0.95)),
    )


def object_row(shape: ObjectReconstruction, *, part: str, given: str | None = None) -> ObjectRow:
    """The row of one object; `given` None where it is the same for all inputs."""
    return ObjectRow(
        part=part,
        object=shape.object,
        chamfer_e3=1e3 * shape.chamfer,
        oracle_e3=1e3 * shape.oracle,
        paper_e3=published_chamfer_of(shape.object, "object", part=part),
        surface_mean_mm=1e3 * shape.surface.mean_m,
        surface_p95_mm=1e3 * shape.surface.p95_m,
        input=given,
        shapes=shape.shapes,
    )


def similarity_row(
    plain: RetrievalScores, reranked: RetrievalScores, *, part: str, given: str, object_name: str
) -> SimilarityRow:
    """The row of one object: pure code, and re-ranked."""
    paper: dict[str, Any] = dict.fromkeys(f"paper_{name}" for name in SIMILARITY_NAMES)
    published = published_similarities(object_name, part=part)
    if published is not None:
        paper = dict(zip(paper, published, strict=True))
    return SimilarityRow(
        part=part,
        input=given,
        object=object_name,
        queries=plain.queries,
        gallery=plain.gallery,
        **{name: getattr(plain, name) for name in SIMILARITY_NAMES},
        near_z_reranked=reranked.near_z,
        **{f"recall_at_{k}": plain.recall_at[k] for k in (1, 5, 10)},
        **paper,
    )


def _column_name(row: HandRow | ObjectRow) -> str:
    return f"{row.object}: {row.hand if isinstance(row, HandRow) else 'object'}"


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
