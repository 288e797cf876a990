"""Measure a run of the `MlpField`: the same tables, for one object, from the codes that the run holds."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from neuralgrasps.dataset.samples import contact_maps
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.reconstruction import ObjectReconstruction, ShapeScores, score_object, score_shapes
from neuralgrasps.evaluate.retrieval import score_codebook
from neuralgrasps.evaluate.run_evaluate import PARTS, RERANK, Progress
from neuralgrasps.evaluate.run_pairs import MeasureConfig
from neuralgrasps.evaluate.run_scores import (
    KNOWN,
    LEARNED,
    SDF_SAMPLES,
    HandRow,
    RunScores,
    SimilarityRow,
    hand_row,
    object_row,
    similarity_row,
)
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.model.field_surface import FieldSurface
from neuralgrasps.model.mlp_run import MlpRun
from neuralgrasps.model.reconstruct import posed_hands, surface_errors
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_seed


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

    Training grasps have the codes learned with the field, unseen ones those inferred from signed distances, as in the
    paper. Shapes are meshes of the zero surface, stray ones included, on a grid: good to a few tenths of a millimetre.

    Args:
        packed: the hands, by name; obj: the field's object.
        config: `per_pair` grasps of each hand and part have their shapes measured; retrieval takes all.
    Raises:
        InputError: no such part, no codes of it, or the run keeps no grasps.
    """
    if part not in PARTS:
        raise InputError(f"part is '{part}'; expected 'test', 'train' or 'both'.")
    config = config or MeasureConfig(per_pair=1)
    hands: list[HandRow] = []
    similarities: list[SimilarityRow] = []
    errors: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    pooled: dict[tuple[str, str], list[np.ndarray]] = {}
    book = run.codebook
    parts = [p for p in PARTS[part] if book.where(is_test=p == "test").any()]
    if not parts:
        raise InputError(f"the run holds no codes of {part} grasps; infer them when training, or give --part train.")
    for name in parts:
        given = SDF_SAMPLES if name == "test" else LEARNED
        plain, again = (
            score_codebook(book, object_name=run.field.object_name, part=name, rerank=rerank) for rerank in (0, RERANK)
        )
        similarities.append(similarity_row(plain, again, part=name, given=given, object_name=run.field.object_name))
        for i, hand in enumerate(book.hands):
            scores, maps = _shapes(run, packed[hand], obj, hand, name, config)
            if not len(scores):
                continue
            row = hand_row(scores, maps, part=name, given=given, object_name=run.field.object_name, hand=hand)
            hands.append(row)
            errors.setdefault((name, given), {})[hand] = 1e3 * scores.distances_m.mean(axis=(1, 2))
            pooled.setdefault((name, given), []).append(scores.distances_m)
            if progress is not None:
                progress("grasps", i + 1, len(book.hands), f"{hand}, {name}")
    shape = _object(run, obj, config)
    return RunScores(
        field="MlpField",
        hands=tuple(hands),
        objects=tuple(object_row(shape, part=name) for name in parts),
        similarities=tuple(similarities),
        pooled={key: surface_errors(np.concatenate(all_of)) for key, all_of in pooled.items()},
        times_ms={"retrieve": _retrieve_ms(book.metric)},
        errors_mm=errors,
        conditions={
            "queries": f"{config.queries:,} per grasp in the unit ball",
            "grasps": f"{config.per_pair} of each hand for shapes, all for retrieval",
            "seed": str(config.seed),
        },
    )


def _shapes(
    run: MlpRun, packed: PackedHand, obj: ObjectModel, hand: str, part: str, config: MeasureConfig
) -> tuple[ShapeScores, np.ndarray]:
    """Scores and |differences| of contact maps of some grasps of a hand."""
    name = run.field.object_name
    rows = run.codebook[run.codebook.where(hand=hand, is_test=part == "test")][: config.per_pair]
    if len(rows) and (hand, name) not in run.grasps:
        raise InputError(
            f"the run keeps no grasps of '{hand}' on '{name}'; train again with a version that keeps them."
        )
    index = rows.grasp_index.astype(np.int64)
    frame = run.field.normalisation
    if not len(rows):
        none = np.zeros(0)
        return ShapeScores(chamfer=none, oracle=none, distances_m=np.zeros((0, 2, config.points))), none
    grasps = run.grasps[hand, name][index]
    fields = [FieldSurface(run.field.distance(code, "hand"), normalisation=frame) for code in rows.values]
    scores = score_shapes(
        {KNOWN: fields},
        posed_hands(packed, grasps.X_OH, grasps.q),
        normalisation=frame,
        seeds=[child_seed(config.seed, "shapes", hand, name, int(i)) for i in index],
        queries=config.queries,
        points=config.points,
    )[KNOWN]
    radius = 0.05 * frame.scale_m
    true = contact_maps(packed, grasps.X_OH, grasps.q, obj.points_O, radius_m=radius)
    said = np.stack([np.exp(-np.maximum(f.signed_distance(obj.points_O), 0.0) / radius) for f in fields])
    return scores, np.abs(said - true)


def _object(run: MlpRun, obj: ObjectModel, config: MeasureConfig) -> ObjectReconstruction:
    """The object as the first training code says it."""
    code = run.codebook.values[np.flatnonzero(run.codebook.where(is_test=False))[0]]
    return score_object(
        run.field.distance(code, "object"), obj.mesh, object_name=run.field.object_name,
        normalisation=run.field.normalisation, seed=config.seed, queries=config.queries,
    )  # fmt: skip


def _retrieve_ms(values: np.ndarray) -> float:
    """Wall-clock milliseconds to order all codes by L1 distance to one."""
    times = []
    for query in values[:20]:
        start = time.perf_counter()
        np.argsort(np.abs(values - query).sum(axis=1), kind="stable")
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))
