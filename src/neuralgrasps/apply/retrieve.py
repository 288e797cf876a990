"""Nearest and farthest grasps by code: exact L1 in the metric part of the codes, re-ranked by contact map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from neuralgrasps.apply.code_index import CodeIndex
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.model.codes import CodeBook, ObjectCodec, contact_blocks
from neuralgrasps.objects.symmetry import SymmetryGroup

RERANK = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrieveResult:
    """The best grasps of a gallery for each of Q queries, best first.

    Attributes:
        index: (Q, K) int64 rows of the gallery, -1 where it held fewer than K matching grasps.
        code_distance: (Q, K) mean absolute difference of the metric parts; inf where index is -1.
        map_distance: (Q, K) mean absolute difference of the contact maps; nan where there are none to compare.
        symmetry: (Q, K) int64 which of the object's symmetries was used, 0 = none: with S = rotations[symmetry],
            the gallery grasp moved by S is the one that resembles the query, so use `S @ X_OH`.
    """

    index: np.ndarray
    code_distance: np.ndarray
    map_distance: np.ndarray
    symmetry: np.ndarray

    def __repr__(self) -> str:
        queries, count = self.index.shape
        words = [
            f"{queries} {'query' if queries == 1 else 'queries'}",
            f"{count} {'grasp' if count == 1 else 'grasps'} each",
        ]
        found = self.code_distance[self.index >= 0]
        if len(found):
            words.append("code distance " + "-".join(dict.fromkeys(f"{v:.3f}" for v in (found.min(), found.max()))))
        return f"RetrieveResult({', '.join(words)})"


class Gallery:
    """A code book put in order for many searches: each hand's grasps of an object lie together.

    Attributes:
        book: the codes, in their own order; results count in it.
    """

    def __init__(self, book: CodeBook, *, backend: str = "native") -> None:
        """Index a code book.

        Args:
            backend: of `CodeIndex`.
        """
        self.book = book
        groups = np.stack([book.object_index, book.is_test, book.hand_index]).astype(np.int64)
        self._order = np.lexsort(groups[::-1])
        self._groups = groups[:, self._order]
        self._index = CodeIndex(book.metric[self._order], backend=backend) if len(book) else None

    def parts(self, *, object_name: str, hand: str | None, include_test: bool) -> list[slice]:
        """Slices of the ordered rows that hold the matching grasps."""
        wanted = self.book.where(hand=hand, object_name=object_name, is_test=None if include_test else False)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], wanted[self._order].astype(np.int8), [0]])))
        return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]

    def nearest(self, codes: np.ndarray, count: int, parts: list[slice]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the book and L1 distances (Q, K) nearest to codes (Q, D); -1 and inf where there are fewer."""
        assert self._index is not None
        row, distance = self._index.search(codes, count, parts=parts)
        return np.where(row < 0, -1, self._order[row]), distance

    def farthest(self, codes: np.ndarray, count: int, parts: list[slice]) -> tuple[np.ndarray, np.ndarray]:
        """The same for the farthest."""
        rows = np.concatenate([self._order[part] for part in parts])
        distance = cdist(codes, self.book.metric[rows], "cityblock")
        order = np.argsort(-distance, axis=1, kind="stable")[:, :count]
        return rows[order], np.take_along_axis(distance, order, axis=1).astype(np.float32)


def retrieve(
    queries: CodeBook,
    gallery: CodeBook | Gallery,
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
        gallery: what to search; only its grasps of `object_name`, and of `hand` if given, take part. A `Gallery` is
            worth it for many searches in very many codes.
        include_test: search grasps marked as test grasps too (a query taken from them then finds itself).
        count: K, results per query.
        rerank: how many of the best by code are put in order by contact map, when both sides hold maps; 0 = none.
        farthest: the least similar instead.
    Raises:
        UnknownNameError: the gallery does not know the hand or object.
        InputError: no grasp of the gallery matches, count < 1, or codes of another field.
    """
    where, parts = _matching(gallery, queries, object_name, hand, count, include_test)
    size = max(count, rerank)
    found = where.farthest if farthest else where.nearest
    rows, distance = found(queries.metric, size, parts)
    versions = np.zeros(rows.shape, np.int64)
    return _ranked(
        rows, distance, versions, queries.contact_maps[:, None], where.book, count=count, rerank=rerank,
        farthest=farthest,
    )  # fmt: skip


def retrieve_symmetric(
    queries: CodeBook,
    gallery: CodeBook | Gallery,
    *,
    symmetry: SymmetryGroup,
    codec: ObjectCodec,
    hand: str | None = None,
    count: int = 5,
    rerank: int = RERANK,
    include_test: bool = False,
) -> RetrieveResult:
    """`retrieve`, with every grasp of the gallery allowed in all orientations that the object cannot tell apart.

    Args:
        queries: Q codes with contact maps (their maps are turned instead of the gallery's).
        hand, count, rerank, include_test: as for `retrieve`.
        symmetry: the object's rotations; codec: its contact points and cells.
    """
    points_O = codec.points_O
    if queries.contact_maps.shape[1] != len(points_O):
        raise ShapeError(
            f"queries hold contact maps of {queries.contact_maps.shape[1]} points; the object has {len(points_O)}."
        )
    where, parts = _matching(gallery, queries, codec.name, hand, count, include_test)
    maps = rotated_maps(queries.contact_maps, points_O, symmetry)
    blocks = contact_blocks(maps, codec)
    blocks[:, 0] = queries.contact_block
    size = max(count, rerank)
    rows, distance, versions = [], [], []
    for version in range(blocks.shape[1]):
        row, far = where.nearest(blocks[:, version], size, parts)
        rows.append(row)
        distance.append(far)
        versions.append(np.full(row.shape, version))
    best = _best_versions(np.concatenate(rows, 1), np.concatenate(distance, 1), np.concatenate(versions, 1), size)
    return _ranked(*best, maps, where.book, count=count, rerank=rerank, farthest=False)


def rotated_maps(maps: np.ndarray, points_O: np.ndarray, symmetry: SymmetryGroup) -> np.ndarray:
    """Contact maps (Q, S, P) that queries (Q, P) have when the grasp is moved back by each symmetry.

    For symmetry S the value at point p is the query's at the contact point nearest to S p: the map of
    the query moved by the inverse of S. A gallery grasp with that map, moved by S, has the query's.
    """
    tree = KDTree(points_O)
    turned = [tree.query(points_O @ X[:3, :3].T + X[:3, 3])[1] for X in symmetry.rotations]
    return maps[:, np.stack(turned)]


def _matching(
    gallery: CodeBook | Gallery, queries: CodeBook, object_name: str, hand: str | None, count: int, include_test: bool
) -> tuple[Gallery, list[slice]]:
    if count < 1:
        raise InputError(f"count is {count}; expected at least 1.")
    where = gallery if isinstance(gallery, Gallery) else Gallery(gallery)
    if queries.metric_size != where.book.metric_size:
        raise InputError(
            f"queries compare {queries.metric_size} numbers, the gallery {where.book.metric_size}: "
            "they are codes of different fields."
        )
    parts = where.parts(object_name=object_name, hand=hand, include_test=include_test)
    if not parts:
        whose = f"hand '{hand}'" if hand else "any hand"
        kind = "grasps" if include_test else "training grasps"
        raise InputError(f"the gallery holds no {kind} of '{object_name}' by {whose}; add some before retrieving.")
    return where, parts


def _best_versions(
    rows: np.ndarray, distance: np.ndarray, versions: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of results (Q, M) that may name a row several times, each row's best version; the `count` best, nearest first."""
    order = np.lexsort((versions, rows, distance), axis=1)
    rows, distance, versions = (np.take_along_axis(a, order, axis=1) for a in (rows, distance, versions))
    for i in range(len(rows)):
        first = np.zeros(rows.shape[1], np.bool_)
        first[np.unique(rows[i], return_index=True)[1]] = True
        distance[i, ~first], rows[i, ~first] = np.inf, -1
    order = np.argsort(distance, axis=1, kind="stable")[:, :count]
    rows, distance, versions = (np.take_along_axis(a, order, axis=1) for a in (rows, distance, versions))
    return rows, distance, versions


def _ranked(
    rows: np.ndarray,
    distance: np.ndarray,
    versions: np.ndarray,
    maps: np.ndarray,
    gallery: CodeBook,
    *,
    count: int,
    rerank: int,
    farthest: bool,
) -> RetrieveResult:
    """The `count` best of rows (Q, M), in order by code, of queries with maps (Q, S, P) in each version."""
    queries, found = rows.shape
    sign = -1.0 if farthest else 1.0
    by_map = np.full(rows.shape, np.nan)
    if maps.shape[-1] > 0 and gallery.contact_maps.shape[1] == maps.shape[-1]:
        for i in range(queries):
            real = rows[i] >= 0
            own = maps[i, versions[i, real]]
            by_map[i, real] = np.abs(own - gallery.contact_maps[rows[i, real]]).mean(axis=1)
    key = np.where(np.isnan(by_map) | (np.arange(found) >= rerank), np.inf, sign * by_map)
    order = np.argsort(key, axis=1, kind="stable")[:, :count]
    index, code, map_distance, version = (
        np.take_along_axis(a, order, axis=1) for a in (rows, distance.astype(np.float64), by_map, versions)
    )
    blank = count - index.shape[1]
    fill = ((0, 0), (0, max(blank, 0)))
    return RetrieveResult(
        index=np.pad(index, fill, constant_values=-1),
        code_distance=np.pad(code / gallery.metric_size, fill, constant_values=np.inf),
        map_distance=np.pad(map_distance, fill, constant_values=np.nan),
        symmetry=np.pad(version, fill),
    )
