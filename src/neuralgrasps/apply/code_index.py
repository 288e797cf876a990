"""Exact nearest codes by L1 distance among very many.

Sums over groups of neighbouring columns give a lower bound of an L1 distance: |sum a - sum b| <= sum |a - b|. All rows
are first bounded by their group sums, an eighth of the work and memory; only rows whose bound does not exceed
the distance of the last result are compared in full. Nothing is approximate but float32 itself: rows whose distances
differ by less than its rounding may change places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, NeuralGraspsError, ShapeError
from neuralgrasps.parallel import available_cpus, thread_map

GROUP = 8  # columns per group
_BLOCK = 4096  # rows bounded together: their bounds stay in the cache
_THREAD_ROWS = 65_536  # fewer rows than this are not worth another thread


class MissingFaissError(NeuralGraspsError, ImportError):
    """The optional faiss is asked for and not installed."""


class CodeIndex:
    """Rows (N, D) to search by L1 distance.

    Attributes:
        values: (N, D) float32, as given.
    """

    def __init__(self, values: np.ndarray, *, backend: str = "native") -> None:
        """Index rows.

        Args:
            values: (N, D) numbers, N >= 1, whose distances fit float32.
            backend: "native", or "faiss" (needs the extra `retrieve`; exact too, slower here).
        Raises:
            ShapeError: not (N >= 1, D >= 1). InputError: not finite, or no such backend.
            MissingFaissError: faiss is not installed.
        """
        rows = np.ascontiguousarray(values, np.float32)
        if rows.ndim != 2 or 0 in rows.shape:
            raise ShapeError(f"values has shape {np.shape(values)}; expected (N >= 1, D >= 1).")
        if not np.isfinite(rows).all() or float(np.abs(rows).max()) > 1e37 / rows.shape[1]:
            raise InputError("some codes are not finite or too large for distances in float32; expected known codes.")
        if backend not in ("native", "faiss"):
            raise InputError(f"backend is '{backend}'; expected 'native' or 'faiss'.")
        self.values = rows
        self._faiss = _faiss_index(rows) if backend == "faiss" else None
        if backend == "native":
            starts = np.arange(0, rows.shape[1], GROUP)
            sums = np.add.reduceat(rows, starts, axis=1, dtype=np.float64)
            self._starts = starts
            self._sums = np.ascontiguousarray(sums.T, np.float32)  # (G, N)
            self._slack = _slack(rows)

    def __len__(self) -> int:
        return len(self.values)

    def search(
        self, queries: np.ndarray, count: int, *, parts: Sequence[slice] | None = None, threads: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The nearest rows of each query, nearest first; equal distances in the order of the rows.

        Args:
            queries: (Q, D).
            count: K results.
            parts: only rows in these slices, which do not overlap (step 1); all when None.
            threads: as many as processors when None; the result does not depend on it.
        Returns:
            index (Q, K) int64, -1 where there were fewer than K rows; distance (Q, K) float32, inf there: the sum of
            absolute differences.
        Raises:
            ShapeError: queries are not (Q, D). InputError: count < 1, or a query is not finite.
        """
        asked = np.ascontiguousarray(queries, np.float32)
        if asked.ndim != 2 or asked.shape[1] != self.values.shape[1]:
            raise ShapeError(f"queries has shape {np.shape(queries)}; expected (Q, {self.values.shape[1]}).")
        if count < 1 or not np.isfinite(asked).all():
            raise InputError(f"count is {count}, or a query is not finite; expected at least 1 and finite numbers.")
        ranges = [slice(*part.indices(len(self))[:2]) for part in parts] if parts is not None else [slice(0, len(self))]
        if self._faiss is not None:
            return _search_faiss(self._faiss, asked, count, ranges)
        threads = available_cpus() if threads is None else threads
        pieces = [piece for part in ranges for piece in _pieces(part, threads)]
        sums = np.add.reduceat(asked, self._starts, axis=1, dtype=np.float64).astype(np.float32)
        slack = self._slack + _slack(asked)

        def one(piece: slice) -> tuple[np.ndarray, np.ndarray]:
            index = np.full((len(asked), count), -1, np.int64)
            distance = np.full((len(asked), count), np.inf, np.float32)
            for q in range(len(asked)):
                _nearest(self.values, self._sums, asked[q], sums[q], piece.start, piece.stop, slack, index[q],
                         distance[q])  # fmt: skip
            return index, distance

        found = thread_map(one, pieces, threads=threads)
        if not found:
            return np.full((len(asked), count), -1, np.int64), np.full((len(asked), count), np.inf, np.float32)
        return merged([index for index, _ in found], [distance for _, distance in found], count)


def merged(indices: Sequence[np.ndarray], distances: Sequence[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` best of several results of the same queries, each (Q, K) and of different rows; -1 comes last."""
    index, distance = np.concatenate(indices, axis=1), np.concatenate(distances, axis=1)
    order = np.lexsort((np.where(index < 0, np.iinfo(np.int64).max, index), distance), axis=1)[:, :count]
    return np.take_along_axis(index, order, axis=1), np.take_along_axis(distance, order, axis=1)


def _slack(rows: np.ndarray) -> float:
    """What float32 rounding can add to a bound or take from a distance: D additions, each of half a unit in the last
    place of a sum that is at most D times the largest number."""
    columns = rows.shape[1]
    return 6e-8 * columns * (columns / GROUP + 8) * float(np.abs(rows).max(initial=0.0))


def _pieces(part: slice, threads: int) -> list[slice]:
    """A slice cut for the threads."""
    rows = part.stop - part.start
    if rows <= 0:
        return []
    share = max(_THREAD_ROWS, -(-rows // threads))
    return [slice(i, min(i + share, part.stop)) for i in range(part.start, part.stop, share)]


@njit(cache=True, error_model="numpy", nogil=True)
def _bounds(sums, query, start, stop, out):  # type: ignore[no-untyped-def]
    """Lower bounds of the distances of rows start:stop into `out`."""
    for i in range(stop - start):
        out[i] = 0.0
    for g in range(sums.shape[0]):
        value = query[g]
        row = sums[g, start:stop]
        for i in range(stop - start):
            out[i] += abs(row[i] - value)


@njit(cache=True, error_model="numpy", nogil=True)
def _distance(row, query):  # type: ignore[no-untyped-def]
    """Sum of |differences|, added in a fixed order over eight lanes."""
    size = row.shape[0]
    lanes = np.zeros(8, np.float32)
    whole = size - size % 8
    for c in range(0, whole, 8):
        for k in range(8):
            lanes[k] += abs(row[c + k] - query[c + k])
    total = np.float32(0.0)
    for k in range(8):
        total += lanes[k]
    for c in range(whole, size):
        total += abs(row[c] - query[c])
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _keep(index, distance, row, d):  # type: ignore[no-untyped-def]
    """Insert a row into the sorted results unless it is no nearer than the last; the earlier row wins a tie."""
    k = distance.shape[0] - 1
    if not (d < distance[k] or (d == distance[k] and (index[k] < 0 or row < index[k]))):
        return
    while k > 0 and (d < distance[k - 1] or (d == distance[k - 1] and row < index[k - 1])):
        distance[k] = distance[k - 1]
        index[k] = index[k - 1]
        k -= 1
    distance[k] = d
    index[k] = row


@njit(cache=True, error_model="numpy", nogil=True)
def _nearest(values, sums, query, query_sums, start, stop, slack, index, distance):  # type: ignore[no-untyped-def]
    """Results (K,) of one query among rows start:stop, in place."""
    last = distance.shape[0] - 1
    bound = np.empty(stop - start, np.float32)
    # First the row with the least bound of each block: they make the limit tight at once.
    for first in range(0, stop - start, _BLOCK):
        end = min(first + _BLOCK, stop - start)
        _bounds(sums, query_sums, start + first, start + end, bound[first:end])
        least = first
        for i in range(first, end):
            if bound[i] < bound[least]:
                least = i
        if bound[least] - slack <= distance[last]:
            _keep(index, distance, start + least, _distance(values[start + least], query))
            bound[least] = np.inf  # done
    for i in range(stop - start):
        if bound[i] < np.inf and bound[i] - slack <= distance[last]:
            _keep(index, distance, start + i, _distance(values[start + i], query))


def _faiss_index(rows: np.ndarray):  # type: ignore[no-untyped-def]
    try:
        import faiss  # noqa: PLC0415 - optional
    except ImportError as error:
        raise MissingFaissError(
            "backend 'faiss' needs faiss, which is not installed: pip install 'neuralgrasps[retrieve]'. "
            "The default backend is exact as well and needs nothing."
        ) from error
    index = faiss.IndexFlat(rows.shape[1], faiss.METRIC_L1)
    index.add(rows)
    return index


def _search_faiss(index, queries: np.ndarray, count: int, ranges: Sequence[slice]):  # type: ignore[no-untyped-def]
    import faiss  # noqa: PLC0415 - optional

    found = []
    for part in ranges:
        chosen = faiss.SearchParameters(sel=faiss.IDSelectorRange(part.start, part.stop))
        distance, row = index.search(queries, count, params=chosen)
        found.append((row, np.where(row < 0, np.inf, distance).astype(np.float32)))
    return merged([row for row, _ in found], [distance for _, distance in found], count)
