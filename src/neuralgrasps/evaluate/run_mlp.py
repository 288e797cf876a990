"""Measure a run of the `MlpField`: the same tables, for one object, from the codes that the run holds."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from neuralgrasps.dataset.samples import Normalisation, contact_maps
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.reconstruction import ObjectReconstruction, score_object_shapes, score_shapes
from neuralgrasps.evaluate.retrieval import score_codebook
from neuralgrasps.evaluate.run_evaluate import PARTS, RERANK, Progress
from neuralgrasps.evaluate.run_pairs import MeasureConfig
from neuralgrasps.evaluate.run_scores import (
    LEARNED,
    SDF_AND_MAPS,
    SDF_SAMPLES,
    HandRow,
    ObjectRow,
    RunScores,
    SimilarityRow,
    hand_row,
    object_row,
    similarity_row,
)
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.field_surface import FieldSurface, coarse_points
from neuralgrasps.model.mlp_run import MlpRun
from neuralgrasps.model.reconstruct import Shape, SurfaceErrors, posed_hands, surface_errors
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_seed


@dataclass(frozen=True, slots=True, kw_only=True)
class _Case:
    """Codes of one part that were found in one way."""

    part: str
    given: str
    book: CodeBook


@dataclass(frozen=True, slots=True, kw_only=True)
class _Measured:
    """Some grasps of one hand: the row, the distances it is made from, and the objects that the same codes say."""

    row: HandRow
    distances_m: np.ndarray
    objects: list[FieldSurface]


def evaluate_mlp_run(
    run: MlpRun,
    packed: Mapping[str, PackedHand],
    obj: ObjectModel,
    *,
    part: str = "test",
    config: MeasureConfig | None = None,
    progress: Progress | None = None,
) -> RunScores:
    """Measure a published field and its codes.

    Training grasps have the codes learned with the field. Unseen ones have those that the published inference finds
    from signed distances, and, as rows of their own, those placed by contact maps too. Shapes, hands and objects alike,
    are meshes of the zero surface on a grid, good to a few tenths of a millimetre, stray surfaces included: in the unit
    ball, or as far as the true hand reaches. The object is that of the same codes as the hands.

    Args:
        packed: the hands, by name; obj: the field's object.
        config: `per_pair` grasps of each hand and part have their shapes measured; retrieval takes all.
    Raises:
        InputError: no such part, no codes of it, or the run keeps no grasps.
    """
    if part not in PARTS:
        raise InputError(f"part is '{part}'; expected 'test', 'train' or 'both'.")
    config = config or MeasureConfig(per_pair=1)
    name = run.field.object_name
    cases = [case for case in _cases(run) if case.part in PARTS[part]]
    if not cases:
        raise InputError(f"the run holds no codes of {part} grasps; infer them when training, or give --part train.")
    hands: list[HandRow] = []
    objects: list[ObjectRow] = []
    similarities: list[SimilarityRow] = []
    errors: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    pooled: dict[tuple[str, str], SurfaceErrors] = {}
    for case in cases:
        key = case.part, case.given
        similarities.append(_similarity(case, name))
        measured = _hands(run, packed, obj, case, config, progress)
        hands += [one.row for one in measured.values()]
        errors[key] = {hand: 1e3 * one.distances_m.mean(axis=(1, 2)) for hand, one in measured.items()}
        pooled[key] = surface_errors(np.concatenate([one.distances_m for one in measured.values()]))
        surfaces = [surface for one in measured.values() for surface in one.objects]
        objects.append(object_row(_object(run, obj, surfaces, config), part=case.part, given=case.given))
    return RunScores(
        field="MlpField",
        hands=tuple(hands),
        objects=tuple(objects),
        similarities=tuple(similarities),
        pooled=pooled,
        times_ms={"retrieve": _retrieve_ms(run.codebook.metric)},
        errors_mm=errors,
        conditions=_conditions(run, config),
    )


def _cases(run: MlpRun) -> list[_Case]:
    """What there is to measure, the published way of finding codes first."""
    book = run.codebook
    cases = []
    if book.where(is_test=True).any():
        cases.append(_Case(part="test", given=SDF_SAMPLES, book=book))
        if run.placed is not None:
            cases.append(_Case(part="test", given=SDF_AND_MAPS, book=run.placed))
    if book.where(is_test=False).any():
        cases.append(_Case(part="train", given=LEARNED, book=book))
    return cases


def _conditions(run: MlpRun, config: MeasureConfig) -> dict[str, str]:
    words = {
        "queries": f"{config.queries:,} per grasp in the unit ball",
        "grasps": f"{config.per_pair} of each hand for shapes, all for retrieval",
        "object": "surfaces of the same codes as the hands', both ways",
        "seed": str(config.seed),
    }
    return words | {key: str(run.notes[key]) for key in ("test_codes", "placed_codes") if key in run.notes}


def _similarity(case: _Case, name: str) -> SimilarityRow:
    plain, again = (
        score_codebook(case.book, object_name=name, part=case.part, rerank=rerank) for rerank in (0, RERANK)
    )
    return similarity_row(plain, again, part=case.part, given=case.given, object_name=name)


def _hands(
    run: MlpRun,
    packed: Mapping[str, PackedHand],
    obj: ObjectModel,
    case: _Case,
    config: MeasureConfig,
    progress: Progress | None,
) -> dict[str, _Measured]:
    """By hand that has grasps in the part."""
    measured = {}
    for i, hand in enumerate(case.book.hands):
        rows = case.book[case.book.where(hand=hand, is_test=case.part == "test")][: config.per_pair]
        if len(rows):
            measured[hand] = _shapes(run, packed[hand], obj, hand, rows, case, config)
        if progress is not None:
            progress("grasps", i + 1, len(case.book.hands), f"{hand}, {case.part}")
    return measured


def _shapes(
    run: MlpRun, packed: PackedHand, obj: ObjectModel, hand: str, rows: CodeBook, case: _Case, config: MeasureConfig
) -> _Measured:
    """Scores of the grasps of some codes of a hand."""
    name, frame = run.field.object_name, run.field.normalisation
    if (hand, name) not in run.grasps:
        raise InputError(
            f"the run keeps no grasps of '{hand}' on '{name}'; train again with a version that keeps them."
        )
    index = rows.grasp_index.astype(np.int64)
    grasps = run.grasps[hand, name][index]
    true_hands = posed_hands(packed, grasps.X_OH, grasps.q)
    reach = max(1.0, *(_reach(shape, frame) for shape in true_hands))
    surfaces = [_surfaces(run, code, reach) for code in rows.values]
    scores = score_shapes(
        {case.given: [pair["hand"] for pair in surfaces]},
        true_hands,
        normalisation=frame,
        seeds=[child_seed(config.seed, "shapes", hand, name, int(i)) for i in index],
        queries=config.queries,
        points=config.points,
    )[case.given]
    radius = run.contact_decay * frame.scale_m
    true = contact_maps(packed, grasps.X_OH, grasps.q, obj.points_O, radius_m=radius)
    said = [np.exp(-np.maximum(pair["hand"].signed_distance(obj.points_O), 0.0) / radius) for pair in surfaces]
    row = hand_row(scores, np.abs(np.stack(said) - true), part=case.part, given=case.given, object_name=name, hand=hand)
    return _Measured(row=row, distances_m=scores.distances_m, objects=[pair["object"] for pair in surfaces])


def _surfaces(run: MlpRun, code: np.ndarray, reach: float) -> dict[Literal["object", "hand"], FieldSurface]:
    """What a code says of both shapes within a ball; the coarse grid is decoded once for both."""
    field, frame = run.field, run.field.normalisation
    coarse = field.distances(code)(coarse_points(frame, reach=reach))
    return {
        "object": FieldSurface(field.distance(code, "object"), normalisation=frame, coarse_m=coarse[0], reach=reach),
        "hand": FieldSurface(field.distance(code, "hand"), normalisation=frame, coarse_m=coarse[1], reach=reach),
    }


def _reach(shape: Shape, frame: Normalisation) -> float:
    """How far from the object's centre a shape reaches, normalised units."""
    points = frame.to_unit(shape.surface_points(2_000, np.random.default_rng(0)))
    return 1.05 * float(np.linalg.norm(points, axis=1).max())


def _object(
    run: MlpRun, obj: ObjectModel, surfaces: Sequence[FieldSurface], config: MeasureConfig
) -> ObjectReconstruction:
    return score_object_shapes(
        surfaces, obj.mesh, object_name=run.field.object_name, normalisation=run.field.normalisation,
        seed=config.seed, queries=config.queries, points=config.points,
    )  # fmt: skip


def _retrieve_ms(values: np.ndarray) -> float:
    """Wall-clock milliseconds to order all codes by L1 distance to one."""
    times = []
    for query in values[:20]:
        start = time.perf_counter()
        np.argsort(np.abs(values - query).sum(axis=1), kind="stable")
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))
