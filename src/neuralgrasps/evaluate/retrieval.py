"""How well codes find similar grasps: the published similarities, their gap, and recall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from neuralgrasps.errors import InputError
from neuralgrasps.model.codes import CodeBook


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrievalScores:
    """Contact-map similarities (1 = same, 0 = the most different pair of the matrix), averaged over queries.

    Attributes:
        near_z, near_gt: similarity of the grasp nearest by code, and of the nearest by contact map (the best possible).
        far_z, far_gt: of the farthest by code, and of the farthest by contact map.
        recall_at: k -> share of queries whose nearest grasp by contact map is among the k nearest by code.
        queries, gallery: sizes.
    """

    near_z: float
    near_gt: float
    far_z: float
    far_gt: float
    recall_at: dict[int, float]
    queries: int
    gallery: int

    @property
    def gap(self) -> float:
        """near_gt - near_z, >= 0; 0 = the codes find the best there is."""
        return self.near_gt - self.near_z


def score_retrieval(
    query_codes: np.ndarray,
    gallery_codes: np.ndarray,
    query_maps: np.ndarray,
    gallery_maps: np.ndarray,
    *,
    same: bool = False,
    rerank: int = 0,
    ranking_maps: np.ndarray | None = None,
    recall: tuple[int, ...] = (1, 5, 10),
) -> RetrievalScores:
    """The published retrieval measure.

    Distances are L1, between codes and between contact maps, each matrix divided by its maximum;
    similarity is 1 - distance.

    Args:
        query_codes (Q, D), gallery_codes (G, D): what to compare by L1 (`CodeBook.metric`).
        query_maps (Q, P), gallery_maps (G, P): the true contact maps.
        same: queries are the gallery; a grasp is not its own neighbour.
        rerank: reorder this many nearest by code with contact maps before taking the nearest (0 = pure code).
        ranking_maps: (Q, P) the queries' maps to re-rank with, as a user would know them; the true ones if None.
    Raises:
        InputError: no queries, or fewer than one (two, if `same`) grasps to find.
    Source:
        Khargonkar et al. 2022, Sec. 5 and its published code.
    """
    if not len(query_codes) or len(gallery_codes) < 1 + same:
        raise InputError(f"{len(query_codes)} queries and {len(gallery_codes)} gallery grasps; expected some of both.")
    by_code = cdist(query_codes, gallery_codes, "cityblock")
    by_map = cdist(query_maps, gallery_maps, "cityblock")
    similarity = 1.0 - by_map / max(float(by_map.max()), 1e-12)
    allowed = ~np.eye(len(by_code), dtype=bool) if same else np.ones(by_code.shape, bool)
    near_code = np.where(allowed, by_code, np.inf)
    order = np.argsort(near_code, axis=1, kind="stable")
    if rerank:
        known = by_map if ranking_maps is None else cdist(ranking_maps, gallery_maps, "cityblock")
        order = _reranked(order, np.where(allowed, known, np.inf), rerank)
    rows = np.arange(len(by_code))
    best = np.where(allowed, by_map, np.inf).argmin(axis=1)
    worst = np.where(allowed, by_map, -np.inf).argmax(axis=1)
    far = np.where(allowed, by_code, -np.inf).argmax(axis=1)
    return RetrievalScores(
        near_z=float(similarity[rows, order[:, 0]].mean()),
        near_gt=float(similarity[rows, best].mean()),
        far_z=float(similarity[rows, far].mean()),
        far_gt=float(similarity[rows, worst].mean()),
        recall_at={k: float((order[:, :k] == best[:, None]).any(axis=1).mean()) for k in recall},
        queries=len(by_code),
        gallery=by_code.shape[1],
    )


def _reranked(order: np.ndarray, by_map: np.ndarray, count: int) -> np.ndarray:
    head = order[:, :count]
    again = np.argsort(np.take_along_axis(by_map, head, axis=1), axis=1, kind="stable")
    return np.concatenate([np.take_along_axis(head, again, axis=1), order[:, count:]], axis=1)


def score_codebook(
    codebook: CodeBook,
    *,
    object_name: str,
    hand: str | None = None,
    part: str = "test",
    queries: CodeBook | None = None,
    rerank: int = 0,
) -> RetrievalScores:
    """Scores of one object's codes, of one hand or of all hands together (as published).

    Args:
        part: "test": unseen grasps find training grasps; "train": training grasps find other training grasps.
        queries: codes to search with instead of the book's own test codes (for example inferred from observed
            points), of all test grasps or some, in any order: `grasp_index` and the hand's name say which grasp each
            is of. The truth stays the book's contact maps.
        rerank: see `score_retrieval`; with `queries`, their own contact maps do the re-ranking.
    Raises:
        InputError: no such part, or a query is not of one of the book's test grasps.
    """
    if part not in ("test", "train"):
        raise InputError(f"part is '{part}'; expected 'test' or 'train'.")
    train = codebook[codebook.where(hand=hand, object_name=object_name, is_test=False)]
    asked = train if part == "train" else codebook[codebook.where(hand=hand, object_name=object_name, is_test=True)]
    codes, ranking = asked.metric, None
    if queries is not None:
        if part == "train":
            raise InputError("queries stand for test grasps; part is 'train'.")
        asked = asked[_places(asked, queries)]
        codes, ranking = queries.metric, queries.contact_maps if queries.contact_maps.shape[1] else None
    return score_retrieval(
        codes,
        train.metric,
        asked.contact_maps,
        train.contact_maps,
        same=part == "train",
        rerank=rerank,
        ranking_maps=ranking,
    )


def _places(asked: CodeBook, queries: CodeBook) -> np.ndarray:
    """(Q,) row of `asked` that each query is of."""
    place = {
        (asked.hands[h], int(g)): i for i, (h, g) in enumerate(zip(asked.hand_index, asked.grasp_index, strict=True))
    }
    wanted = [(queries.hands[h], int(g)) for h, g in zip(queries.hand_index, queries.grasp_index, strict=True)]
    for hand, grasp in wanted:
        if (hand, grasp) not in place:
            raise InputError(f"query code of grasp {grasp} of '{hand}' is not of one of the {len(asked)} test grasps.")
    return np.array([place[key] for key in wanted], np.int64)
