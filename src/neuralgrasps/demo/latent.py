"""Measure the latent space on grasps that training never saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.distance import cdist

from neuralgrasps.apply.retrieve import retrieve
from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.demo.measure import Progress
from neuralgrasps.evaluate.embedding import embed_codes
from neuralgrasps.evaluate.reconstruction import (
    HandReconstruction,
    ObjectReconstruction,
    reconstruct_hands,
    reconstruct_object,
)
from neuralgrasps.evaluate.retrieval import RetrievalScores, score_codebook
from neuralgrasps.model.codes import CodeBook, join_codes
from neuralgrasps.model.infer import infer_grasps
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import SurfaceErrors, hand_surface_distances, surface_errors
from neuralgrasps.model.train import TrainResult
from neuralgrasps.parallel import run_tasks
from neuralgrasps.seeds import child_rng

OBSERVED_POINTS = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class PairMeasures:
    """Held-out grasps of one hand on one object.

    Attributes:
        encoded: surface error of the decoded codes of known joints (the code keeps the grasp, so this is rounding).
        inferred: the same, with the published measure, for grasps inferred from unlabelled hand points.
        codes: the inferred codes, one per test grasp.
    """

    hand: str
    object: str
    encoded: SurfaceErrors
    inferred: HandReconstruction
    codes: CodeBook


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectMeasures:
    """One object's held-out grasps: retrieval by encoded and by inferred codes, reconstruction of object and hands."""

    object: str
    scores: RetrievalScores
    inferred_scores: RetrievalScores
    shape: ObjectReconstruction
    pairs: tuple[PairMeasures, ...]

    @property
    def encoded_error_m(self) -> float:
        return float(np.mean([p.encoded.mean_m for p in self.pairs]))

    @property
    def inferred_error_m(self) -> float:
        return float(np.mean([p.inferred.surface.mean_m for p in self.pairs]))

    @property
    def inferred_p95_m(self) -> float:
        """The worst hand's 95th percentile."""
        return max(p.inferred.surface.p95_m for p in self.pairs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A grasp in a retrieval row; `similarity` of its contact map to the query's."""

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
class Embedding:
    """A t-SNE picture: points (N, 2), hand of each, a note for each."""

    title: str
    points: np.ndarray
    hands: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentMeasures:
    """Everything measured of the latent space.

    Attributes:
        maps: (hand, object) -> (N, P) contact maps. retrieval: examples to show. maps_2d: t-SNE pictures.
    """

    objects: tuple[ObjectMeasures, ...]
    maps: Mapping[tuple[str, str], np.ndarray]
    retrieval: tuple[RetrievalExample, ...]
    maps_2d: tuple[Embedding, ...]

    @property
    def encoded_error_m(self) -> float:
        return float(np.mean([o.encoded_error_m for o in self.objects]))

    @property
    def inferred_error_m(self) -> float:
        return float(np.mean([o.inferred_error_m for o in self.objects]))

    @property
    def gap_encoded(self) -> float:
        """Mean over the objects of Near GT - Near Z."""
        return float(np.mean([o.scores.gap for o in self.objects]))

    @property
    def gap_inferred(self) -> float:
        """The same, with codes inferred from observed hand points."""
        return float(np.mean([o.inferred_scores.gap for o in self.objects]))


def measure_latent(
    trained: TrainResult, dataset: GraspDataset, *, seed: int, workers: int, progress: Progress | None = None
) -> LatentMeasures:
    """Encode, infer, reconstruct and retrieve the test grasps of a dataset."""
    field, book = trained.field, trained.codebook
    gallery = book[book.where(is_test=False)]
    pairs = _measure_pairs(field, book, dataset, seed=seed, workers=workers, progress=progress)
    return LatentMeasures(
        objects=tuple(_measure_object(field, book, dataset, name, pairs) for name in dataset.objects),
        maps={pair: dataset.contact_maps(*pair) for pair in dataset.pairs},
        retrieval=tuple(
            example for name in dataset.objects if (example := _example(book, gallery, name, "human")) is not None
        ),
        maps_2d=_embeddings(book, seed),
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
    """Infer a pair's test grasps from `OBSERVED_POINTS` unlabelled points of the hand's surface each, and compare."""
    known, gallery = book[book.where(is_test=True)], book[book.where(is_test=False)]
    packed, test = field.packed[hand], known.grasp_index
    grasps = dataset.grasps(hand, obj)[test]
    clouds = [
        sample_posed_surface(packed, X_OH, q, OBSERVED_POINTS, child_rng(seed, "observed", hand, obj, int(index)))
        for X_OH, q, index in zip(grasps.X_OH, grasps.q, test, strict=True)
    ]
    found = infer_grasps(clouds, field, gallery, hand=hand, object_name=obj)
    codes = replace(found.codes, grasp_index=test)
    with torch.no_grad():
        decoded = field.decode(torch.as_tensor(known.values.astype(np.float64)), hand=hand, object_name=obj)
    exact = hand_surface_distances(packed, decoded.X_OH.numpy(), decoded.q.numpy(), grasps.X_OH, grasps.q, seed=seed)
    return PairMeasures(
        hand=hand,
        object=obj,
        encoded=surface_errors(exact),
        inferred=reconstruct_hands(field, dataset, codes, hand=hand, object_name=obj, seed=seed),
        codes=codes,
    )


def _measure_object(
    field: KinematicField, book: CodeBook, dataset: GraspDataset, name: str, measured: Sequence[PairMeasures]
) -> ObjectMeasures:
    pairs = tuple(p for p in measured if p.object == name)
    # the book holds each hand's test grasps together, in the order of the pairs
    inferred = join_codes([p.codes for p in pairs])
    return ObjectMeasures(
        object=name,
        scores=score_codebook(book, object_name=name),
        inferred_scores=score_codebook(book, object_name=name, queries=inferred),
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
    distance = cdist(query.contact_maps, among.contact_maps, "cityblock")[0]
    scale = float(max(distance.max(), 1e-12))

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


def _embeddings(book: CodeBook, seed: int) -> tuple[Embedding, ...]:
    """t-SNE of the contact part of the codes, one picture per object."""
    pictures = []
    for name in book.objects:
        rows = book[book.where(object_name=name)]
        if len(rows) < 10:
            continue
        hands = tuple(rows.hands[i] for i in rows.hand_index)
        kinds = ("test" if t else "train" for t in rows.is_test)
        notes = tuple(
            f"{hand}, grasp {i} ({kind})" for hand, i, kind in zip(hands, rows.grasp_index, kinds, strict=True)
        )
        pictures.append(
            Embedding(title=name, points=embed_codes(rows.contact_block, seed=seed), hands=hands, notes=notes)
        )
    return tuple(pictures)
