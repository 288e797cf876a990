"""Measure the latent space on grasps that training never saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.distance import cdist

from neuralgrasps.apply.retrieve import retrieve
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.demo.measure import Progress
from neuralgrasps.evaluate.denoise import DenoiseScore, correction_gain
from neuralgrasps.evaluate.embedding import Embedding, embed_book
from neuralgrasps.evaluate.observe import observe_hand, observe_hand_one_view
from neuralgrasps.evaluate.reconstruction import (
    HandReconstruction,
    ObjectReconstruction,
    reconstruct_hands,
    reconstruct_object,
)
from neuralgrasps.evaluate.retrieval import RetrievalScores, score_codebook
from neuralgrasps.model.codes import CodeBook, join_codes
from neuralgrasps.model.infer import infer_grasps, one_view_config
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import SurfaceErrors, hand_surface_distances, surface_errors
from neuralgrasps.model.train import TrainResult
from neuralgrasps.parallel import run_tasks
from neuralgrasps.seeds import child_seed


@dataclass(frozen=True, slots=True, kw_only=True)
class PairMeasures:
    """Held-out grasps of one hand on one object, the hand and the object's pose known.

    Attributes:
        known: surface error of codes encoded from pose and joints (the code keeps them, so this is rounding).
        complete: the same, with the published measure, for grasps found from points all over the hand, without noise.
        one_view: surface error of grasps found from what one depth camera sees, with noise.
        complete_codes, view_codes: the codes found, one per test grasp.
    """

    hand: str
    object: str
    known: SurfaceErrors
    complete: HandReconstruction
    one_view: SurfaceErrors
    complete_codes: CodeBook
    view_codes: CodeBook


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectMeasures:
    """One object's held-out grasps: retrieval by each kind of code, reconstruction of object and hands."""

    object: str
    known: RetrievalScores
    complete: RetrievalScores
    one_view: RetrievalScores
    shape: ObjectReconstruction
    pairs: tuple[PairMeasures, ...]

    def mean_error_m(self, kind: str) -> float:
        """Mean surface error over the hands; `kind` is "known", "complete" or "one_view"."""
        return float(
            np.mean([p.complete.surface.mean_m if kind == "complete" else getattr(p, kind).mean_m for p in self.pairs])
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A grasp in a retrieval row; `similarity` of its contact map to the query's, scaled as in `score_retrieval`."""

    hand: str
    grasp: int
    similarity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrievalExample:
    """A held-out grasp, the nearest training grasp of every hand by code, and the farthest of all."""

    object: str
    query: Found
    nearest: tuple[Found, ...]
    farthest: Found

    @property
    def all(self) -> tuple[Found, ...]:
        """Query, nearest ones, farthest."""
        return (self.query, *self.nearest, self.farthest)


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentMeasures:
    """Everything measured of the latent space.

    Attributes:
        maps: (hand, object) -> (N, P) contact maps. retrieval: examples to show.
        book: all codes; maps_2d: t-SNE pictures of it.
        correction: what the trained network gains on held-out codes that are off.
    """

    objects: tuple[ObjectMeasures, ...]
    maps: Mapping[tuple[str, str], np.ndarray]
    retrieval: tuple[RetrievalExample, ...]
    book: CodeBook
    maps_2d: tuple[Embedding, ...]
    correction: tuple[DenoiseScore, ...]

    def mean_error_m(self, kind: str) -> float:
        """Mean surface error over objects and hands; `kind` is "known", "complete" or "one_view"."""
        return float(np.mean([o.mean_error_m(kind) for o in self.objects]))

    def gap(self, kind: str) -> float:
        """Mean over the objects of Near GT - Near Z, by codes of that kind."""
        return float(np.mean([getattr(o, kind).gap for o in self.objects]))


def measure_latent(
    trained: TrainResult, dataset: GraspDataset, *, seed: int, workers: int, progress: Progress | None = None
) -> LatentMeasures:
    """Encode, infer, reconstruct and retrieve the test grasps of a dataset."""
    field, book = trained.field, trained.codebook
    gallery = book[book.where(is_test=False)]
    pairs = _measure_pairs(field, book, dataset, seed=seed, workers=workers, progress=progress)
    places = {name: (codec.points_O, codec.offset_O) for name, codec in field.object_codecs.items()}
    return LatentMeasures(
        objects=tuple(_measure_object(field, book, dataset, name, pairs) for name in dataset.objects),
        maps={pair: dataset.contact_maps(*pair) for pair in dataset.pairs},
        retrieval=tuple(
            example for name in dataset.objects if (example := _example(book, gallery, name, "human")) is not None
        ),
        book=book,
        maps_2d=embed_book(book, places, seed=seed),
        correction=correction_gain(field, dataset, seed=seed),
    )


def _measure_pairs(
    field: KinematicField, book: CodeBook, dataset: GraspDataset, *, seed: int, workers: int, progress: Progress | None
) -> list[PairMeasures]:
    """One task per hand and object, in the order of the dataset's pairs."""
    tasks = []
    for hand, obj in dataset.pairs:
        if len(dataset.split(hand, obj).test):
            small = KinematicField(
                hands={hand: field.hands[hand]}, objects={obj: field.objects[obj]},
                hand_codecs={hand: field.hand_codecs[hand]}, object_codecs={obj: field.object_codecs[obj]},
            )  # fmt: skip
            tasks.append((small, book[book.where(hand=hand, object_name=obj)], dataset, hand, obj, seed))
    results: dict[int, PairMeasures] = {}
    for index, result in run_tasks(_measure_pair, tasks, workers=workers):
        results[index] = result
        if progress is not None:
            progress(len(results), len(tasks), f"{result.hand} on {result.object}")
    return [results[i] for i in range(len(tasks))]


def _measure_pair(
    field: KinematicField, book: CodeBook, dataset: GraspDataset, hand: str, obj: str, seed: int
) -> PairMeasures:
    """Find a pair's test grasps from observed points of the hand, and compare."""
    known, gallery = book[book.where(is_test=True)], book[book.where(is_test=False)]
    packed, test = field.packed[hand], known.grasp_index
    grasps = dataset.grasps(hand, obj)[test]
    complete, view = [], []
    for X_OH, q, index in zip(grasps.X_OH, grasps.q, test, strict=True):
        at = child_seed(seed, "observed", hand, obj, int(index))
        complete.append(observe_hand(packed, X_OH, q, seed=at))
        view.append(observe_hand_one_view(field.hands[hand], field.objects[obj], X_OH, q, seed=at))
    from_all = infer_grasps(complete, field, gallery, hand=hand, object_name=obj)
    from_view = infer_grasps(view, field, gallery, hand=hand, object_name=obj, config=one_view_config())
    with torch.no_grad():
        decoded = field.decode(torch.as_tensor(known.values.astype(np.float64)), hand=hand, object_name=obj)

    def errors(X_OH: np.ndarray, q: np.ndarray) -> SurfaceErrors:
        return surface_errors(hand_surface_distances(packed, X_OH, q, grasps.X_OH, grasps.q, seed=seed))

    complete_codes = replace(from_all.codes, grasp_index=test)
    return PairMeasures(
        hand=hand,
        object=obj,
        known=errors(decoded.X_OH.numpy(), decoded.q.numpy()),
        complete=reconstruct_hands(field, dataset, complete_codes, hand=hand, object_name=obj, seed=seed),
        one_view=errors(from_view.X_OH, from_view.q),
        complete_codes=complete_codes,
        view_codes=replace(from_view.codes, grasp_index=test),
    )


def _measure_object(
    field: KinematicField, book: CodeBook, dataset: GraspDataset, name: str, measured: Sequence[PairMeasures]
) -> ObjectMeasures:
    # the book holds each hand's test grasps together, in the order of the pairs
    pairs = tuple(p for p in measured if p.object == name)
    return ObjectMeasures(
        object=name,
        known=score_codebook(book, object_name=name),
        complete=score_codebook(book, object_name=name, queries=join_codes([p.complete_codes for p in pairs])),
        one_view=score_codebook(book, object_name=name, queries=join_codes([p.view_codes for p in pairs])),
        shape=reconstruct_object(field, dataset, object_name=name),
        pairs=pairs,
    )


def _example(book: CodeBook, gallery: CodeBook, object_name: str, query_hand: str) -> RetrievalExample | None:
    """The first held-out grasp of `query_hand` (else of the first hand that has one) and its neighbours."""
    asked = book[book.where(object_name=object_name, is_test=True)]
    hands = [asked.hands[i] for i in asked.hand_index]
    if not hands:
        return None
    first = hands.index(query_hand) if query_hand in hands else 0
    query = asked[first]
    among = gallery[gallery.where(object_name=object_name)]
    distances = cdist(asked.contact_maps, among.contact_maps, "cityblock")
    distance, scale = distances[first], float(max(distances.max(), 1e-12))  # as in the table: `score_retrieval`

    def found(row: int) -> Found:
        return Found(
            hand=among.hands[among.hand_index[row]],
            grasp=int(among.grasp_index[row]),
            similarity=float(1.0 - distance[row] / scale),
        )

    present = sorted({among.hands[i] for i in among.hand_index})
    nearest = [retrieve(query, among, object_name=object_name, hand=hand, count=1).index[0, 0] for hand in present]
    far = retrieve(query, among, object_name=object_name, count=1, farthest=True).index[0, 0]
    return RetrievalExample(
        object=object_name,
        query=Found(hand=hands[first], grasp=int(query.grasp_index[0]), similarity=1.0),
        nearest=tuple(found(int(row)) for row in nearest),
        farthest=found(int(far)),
    )
