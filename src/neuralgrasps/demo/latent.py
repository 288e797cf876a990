"""Measure the latent space on grasps that training never saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.distance import cdist

from neuralgrasps.apply.retrieve import retrieve
from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.samples import hand_distances
from neuralgrasps.demo.measure import Progress
from neuralgrasps.evaluate.embedding import embed_codes
from neuralgrasps.evaluate.retrieval import RetrievalScores, score_codebook
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.model.codes import CodeBook, join_codes
from neuralgrasps.model.infer import InferResult, infer_grasps
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import PublishedChamfer, hand_surface_distances, published_chamfer
from neuralgrasps.model.train import TrainResult
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.seeds import child_rng, child_seed

OBSERVED_POINTS = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectMeasures:
    """One object's held-out grasps.

    Attributes:
        scores: retrieval by encoded codes; observed_scores: by codes inferred from unlabelled hand points.
        encoded_error_m, observed_error_m: (T,) mean two-sided surface distance of the decoded and of the inferred hand.
        object_error_m: mean |distance grid| on the object's true surface.
        chamfer, chamfer_oracle: the published reconstruction measure of the inferred hand, and what a perfect
            field scores.
    """

    object: str
    scores: RetrievalScores
    observed_scores: RetrievalScores
    encoded_error_m: np.ndarray
    observed_error_m: np.ndarray
    object_error_m: float
    chamfer: float
    chamfer_oracle: float


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
    def encoded_error_m(self) -> np.ndarray:
        return np.concatenate([o.encoded_error_m for o in self.objects])

    @property
    def observed_error_m(self) -> np.ndarray:
        return np.concatenate([o.observed_error_m for o in self.objects])

    @property
    def gap_encoded(self) -> float:
        """Mean over the objects of Near GT - Near Z."""
        return float(np.mean([o.scores.gap for o in self.objects]))

    @property
    def gap_observed(self) -> float:
        """The same, with codes inferred from observed hand points."""
        return float(np.mean([o.observed_scores.gap for o in self.objects]))


def measure_latent(
    trained: TrainResult, dataset: GraspDataset, *, seed: int, workers: int, progress: Progress | None = None
) -> LatentMeasures:
    """Encode, infer, reconstruct and retrieve the test grasps of a dataset."""
    field, book = trained.field, trained.codebook
    gallery = book[book.where(is_test=False)]
    inferred = _infer_all(field, dataset, gallery, seed=seed, workers=workers, progress=progress)
    maps = {pair: dataset.contact_maps(*pair) for pair in dataset.pairs}
    return LatentMeasures(
        objects=tuple(_measure_object(trained, dataset, name, inferred, seed) for name in dataset.objects),
        maps=maps,
        retrieval=tuple(
            example for name in dataset.objects if (example := _example(book, gallery, name, "human")) is not None
        ),
        maps_2d=_embeddings(book, seed),
    )


def _infer_all(
    field: KinematicField,
    dataset: GraspDataset,
    gallery: CodeBook,
    *,
    seed: int,
    workers: int,
    progress: Progress | None,
) -> dict[tuple[str, str], InferResult]:
    """Every test grasp from `OBSERVED_POINTS` unlabelled points of its hand's surface; one task per pair."""
    pairs = [pair for pair in dataset.pairs if len(dataset.split(*pair).test)]
    tasks = []
    for hand, obj in pairs:
        chosen = dataset.grasps(hand, obj)[dataset.split(hand, obj).test]
        clouds = [
            sample_posed_surface(
                field.packed[hand],
                chosen.X_OH[i],
                chosen.q[i],
                OBSERVED_POINTS,
                child_rng(seed, "observed", hand, obj, i),
            )
            for i in range(len(chosen))
        ]
        rows = gallery[gallery.where(hand=hand, object_name=obj)]
        small = KinematicField(
            hands={hand: field.hands[hand]}, objects={obj: field.objects[obj]},
            hand_codecs={hand: field.hand_codecs[hand]}, object_codecs={obj: field.object_codecs[obj]},
        )  # fmt: skip
        tasks.append((clouds, small, rows, hand, obj))
    results: dict[tuple[str, str], InferResult] = {}
    for index, result in run_tasks(_infer_pair, tasks, workers=workers):
        results[pairs[index]] = result
        if progress is not None:
            progress(len(results), len(tasks), " on ".join(pairs[index]))
    return results


def _infer_pair(
    clouds: Sequence[np.ndarray], field: KinematicField, gallery: CodeBook, hand: str, obj: str
) -> InferResult:
    return infer_grasps(clouds, field, gallery, hand=hand, object_name=obj)


def _measure_object(
    trained: TrainResult,
    dataset: GraspDataset,
    name: str,
    inferred: Mapping[tuple[str, str], InferResult],
    seed: int,
) -> ObjectMeasures:
    field, book = trained.field, trained.codebook
    asked = book[book.where(object_name=name, is_test=True)]
    hands = [hand for hand, obj in dataset.pairs if obj == name and (hand, obj) in inferred]
    # the book lists each hand's grasps together, in the order of its hands
    observed = join_codes([inferred[hand, name].codes for hand in hands])
    encoded_error: list[np.ndarray] = []
    observed_error: list[np.ndarray] = []
    chamfers = []
    for hand in hands:
        grasps = dataset.grasps(hand, name)[dataset.split(hand, name).test]
        rows = asked[asked.where(hand=hand)]
        code = torch.as_tensor(rows.values, dtype=torch.float64)
        with torch.no_grad():
            decoded = field.decode(code, hand=hand, object_name=name)
        X_decoded, q_decoded = decoded.X_OH.numpy(), decoded.q.numpy()
        result, packed = inferred[hand, name], field.packed[hand]
        for X_OH, q, errors in (
            (X_decoded, q_decoded, encoded_error),
            (result.X_OH, result.q, observed_error),
        ):
            distances = hand_surface_distances(packed, X_OH, q, grasps.X_OH, grasps.q, seed=seed)
            errors.append(distances.mean(axis=1))
        chamfers.append(
            _chamfer(packed, dataset, name, (result.X_OH[:1], result.q[:1]), (grasps.X_OH[:1], grasps.q[:1]))
        )
    return ObjectMeasures(
        object=name,
        scores=score_codebook(book, object_name=name),
        observed_scores=score_codebook(book, object_name=name, queries=observed),
        encoded_error_m=np.concatenate(encoded_error),
        observed_error_m=np.concatenate(observed_error),
        object_error_m=_object_error(field.object(name), seed),
        chamfer=float(np.mean([c.chamfer for c in chamfers])),
        chamfer_oracle=float(np.mean([c.oracle for c in chamfers])),
    )


Posed = tuple[np.ndarray, np.ndarray]  # X_OH (1, 4, 4), q (1, J)


def _object_error(obj: ObjectModel, seed: int) -> float:
    points, _, _ = sample_surface(obj.mesh, 20_000, child_seed(seed, "object surface", obj.name))
    return float(np.abs(query_grid_numpy(obj.sdf, points)).mean())


def _chamfer(
    packed: PackedHand, dataset: GraspDataset, object_name: str, decoded: Posed, true: Posed
) -> PublishedChamfer:
    """The published measure of one decoded hand."""
    surface = sample_posed_surface(packed, true[0][0], true[1][0], 20_000, child_rng(0, "chamfer"))
    return published_chamfer(
        lambda points: hand_distances(packed, *decoded, points)[0],
        lambda points: hand_distances(packed, *true, points)[0],
        surface,
        normalisation=dataset.object(object_name).normalisation,
        seed=0,
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
