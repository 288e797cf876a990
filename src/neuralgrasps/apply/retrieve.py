"""Nearest and farthest grasps by code: exact L1 in the contact block, re-ranked by contact map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.model.codes import CELLS, CodeBook, ObjectCodec, contact_blocks
from neuralgrasps.objects.symmetry import SymmetryGroup

RERANK = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrieveResult:
    """The best grasps of a gallery for each of Q queries, best first.

    Attributes:
        index: (Q, K) int64 rows of the gallery, -1 where it held fewer than K matching grasps.
        code_distance: (Q, K) mean absolute difference of the contact blocks; inf where index is -1.
        map_distance: (Q, K) mean absolute difference of the contact maps; nan where there are none to compare.
        symmetry: (Q, K) int64 which of the object's symmetries was used, 0 = none: with S = rotations[symmetry],
            the gallery grasp moved by S is the one that resembles the query, so use `S @ X_OH`.
    """

    index: np.ndarray
    code_distance: np.ndarray
    map_distance: np.ndarray
    symmetry: np.ndarray


def retrieve(
    queries: CodeBook,
    gallery: CodeBook,
    *,
    object_name: str,
    hand: str | None = None,
    count: int = 5,
    rerank: int = RERANK,
    farthest: bool = False,
    include_test: bool = False,
) -> RetrieveResult:
    """The grasps of the gallery that touch the object most (or least) like each query does.

    Args:
        queries: Q codes on the same object, of any hand.
        gallery: what to search; only its grasps of `object_name`, and of `hand` if given, take part.
        include_test: search grasps marked as test grasps too (a query taken from them then finds itself).
        count: K, results per query.
        rerank: how many of the best by code are put in order by contact map, when both sides hold maps; 0 = none.
        farthest: the least similar instead.
    Raises:
        UnknownNameError: the gallery does not know the hand or object.
        InputError: no grasp of the gallery matches, or count < 1.
    """
    rows = _matching_rows(gallery, object_name, hand, count, include_test)
    return _ranked(
        queries.contact_block[:, None],
        queries.contact_maps[:, None],
        gallery,
        rows,
        count=count,
        rerank=rerank,
        farthest=farthest,
    )


def retrieve_symmetric(
    queries: CodeBook,
    gallery: CodeBook,
    *,
    symmetry: SymmetryGroup,
    codec: ObjectCodec,
    points_O: np.ndarray,
    hand: str | None = None,
    count: int = 5,
    rerank: int = RERANK,
    include_test: bool = False,
) -> RetrieveResult:
    """`retrieve`, with every grasp of the gallery allowed in all orientations that the object cannot tell apart.

    Args:
        queries: Q codes with contact maps (their maps are turned instead of the gallery's).
        hand, count, rerank, include_test: as for `retrieve`.
        symmetry: the object's rotations; codec: its cells; points_O: (P, 3) its contact points.
    """
    if queries.contact_maps.shape[1] != len(points_O):
        raise ShapeError(
            f"queries hold contact maps of {queries.contact_maps.shape[1]} points; the object has {len(points_O)}."
        )
    rows = _matching_rows(gallery, codec.name, hand, count, include_test)
    maps = rotated_maps(queries.contact_maps, points_O, symmetry)
    blocks = contact_blocks(maps, codec)
    blocks[:, 0] = queries.contact_block
    return _ranked(blocks, maps, gallery, rows, count=count, rerank=rerank, farthest=False)


def rotated_maps(maps: np.ndarray, points_O: np.ndarray, symmetry: SymmetryGroup) -> np.ndarray:
    """Contact maps (Q, S, P) that queries (Q, P) have when the grasp is moved back by each symmetry.

    For symmetry S the value at point p is the query's at the contact point nearest to S p: the map of
    the query moved by the inverse of S. A gallery grasp with that map, moved by S, has the query's.
    """
    tree = KDTree(points_O)
    turned = [tree.query(points_O @ X[:3, :3].T + X[:3, 3])[1] for X in symmetry.rotations]
    return maps[:, np.stack(turned)]


def _matching_rows(gallery: CodeBook, object_name: str, hand: str | None, count: int, include_test: bool) -> np.ndarray:
    if count < 1:
        raise InputError(f"count is {count}; expected at least 1.")
    rows = np.flatnonzero(gallery.where(hand=hand, object_name=object_name, is_test=None if include_test else False))
    if not len(rows):
        whose = f"hand '{hand}'" if hand else "any hand"
        kind = "grasps" if include_test else "training grasps"
        raise InputError(f"the gallery holds no {kind} of '{object_name}' by {whose}; add some before retrieving.")
    return rows


def _ranked(
    blocks: np.ndarray,
    maps: np.ndarray,
    gallery: CodeBook,
    rows: np.ndarray,
    *,
    count: int,
    rerank: int,
    farthest: bool,
) -> RetrieveResult:
    """Rank gallery rows for queries given in S versions each: blocks (Q, S, 96), maps (Q, S, P)."""
    queries, versions = blocks.shape[:2]
    sign = -1.0 if farthest else 1.0
    distance = cdist(blocks.reshape(-1, CELLS), gallery.contact_block[rows], "cityblock") / CELLS
    distance = distance.reshape(queries, versions, len(rows))
    version = (sign * distance).argmin(axis=1)  # (Q, R)
    best = np.take_along_axis(distance, version[:, None], axis=1)[:, 0]
    kept = min(count, len(rows))
    index = np.full((queries, count), -1, np.int64)
    code_distance = np.full((queries, count), np.inf)
    map_distance = np.full((queries, count), np.nan)
    symmetry = np.zeros((queries, count), np.int64)
    has_maps = maps.shape[-1] > 0 and gallery.contact_maps.shape[1] == maps.shape[-1]
    for i in range(queries):
        order = np.argsort(sign * best[i], kind="stable")[: max(kept, rerank if has_maps else 0)]
        if has_maps:
            own = maps[i, version[i, order]]
            by_map = np.abs(own - gallery.contact_maps[rows[order]]).mean(axis=1)
            if rerank:
                again = np.argsort(sign * by_map[:rerank], kind="stable")
                again = np.concatenate([again, np.arange(len(again), len(order))])
                order, by_map = order[again], by_map[again]
            map_distance[i, :kept] = by_map[:kept]
        order = order[:kept]
        index[i, :kept] = rows[order]
        code_distance[i, :kept] = best[i, order]
        symmetry[i, :kept] = version[i, order]
    return RetrieveResult(index=index, code_distance=code_distance, map_distance=map_distance, symmetry=symmetry)
