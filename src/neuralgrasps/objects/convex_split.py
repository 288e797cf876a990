"""Splitting a solid into nearly convex pieces by planes, judged on its signed distances.

A piece is the soup of the surface's triangles inside one convex cell; it stands for the convex hull of its
corners. What matters for grasping is how far that hull sticks out of the object, and this is cheap to measure on
the distance grid. Hence: take the piece with the most excess, try planes along the principal axes through the
place where its hull is farthest off and at a few even cuts, keep the best, repeat; then merge what can be merged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_numpy

_EVEN_CUTS = (0.2, 0.35, 0.5, 0.65, 0.8)
_THINNEST_M = 0.0015
_SAMPLES = 1500


@dataclass(frozen=True, slots=True)
class Piece:
    """Triangles of the surface in one cell, and their hull.

    Attributes:
        triangles: (T, 3, 3) clipped triangles.
        corners: (V, 3) hull vertices.
        volume: of the hull, m^3.
        excess: how much of the hull's surface lies how far outside the object (m^3, beyond the tolerance).
        worst: (3,) hull point that lies farthest outside; `protrusion`: how far, metres.
    """

    triangles: np.ndarray
    corners: np.ndarray
    volume: float
    excess: float
    worst: np.ndarray
    protrusion: float


def split_solid(triangles: np.ndarray, sdf: SdfGrid, *, tolerance_m: float, max_parts: int) -> list[Piece]:
    """Pieces whose hulls together fill the object.

    Args:
        triangles: (T, 3, 3) the surface, object frame.
        sdf: its signed distances.
        tolerance_m: hulls may stick out this far for nothing.
        max_parts: at most so many pieces.
    """
    whole = _make_piece(triangles, sdf, tolerance_m)
    if whole is None:
        return []
    pieces = [whole]
    for _ in range(3):  # merging frees room for more cuts
        pieces = _split_worst(pieces, sdf, tolerance_m, max_parts)
        count = len(pieces)
        pieces = _merge(pieces, sdf, tolerance_m)
        if len(pieces) == count or max(p.excess for p in pieces) <= 0.0:
            break
    return pieces


def _split_worst(pieces: Sequence[Piece], sdf: SdfGrid, tolerance: float, max_parts: int) -> list[Piece]:
    """Split the piece with the most excess until none has any, none can be split, or there are `max_parts`."""
    pieces = list(pieces)
    stuck: list[Piece] = []
    while len(pieces) < max_parts:
        open_pieces = [p for p in pieces if p.excess > 0.0 and not any(p is s for s in stuck)]
        if not open_pieces:
            break
        worst = max(open_pieces, key=lambda p: p.excess)
        children = _best_cut(worst, sdf, tolerance)
        if children is None:
            stuck.append(worst)
            continue
        pieces = [p for p in pieces if p is not worst] + list(children)
    return pieces


def _best_cut(piece: Piece, sdf: SdfGrid, tolerance: float) -> tuple[Piece, Piece] | None:
    best: tuple[Piece, Piece] | None = None
    best_cost = np.inf
    for normal, offset, preference in _candidate_planes(piece):
        below, above = clip_triangles(piece.triangles, normal, offset)
        first, second = _make_piece(below, sdf, tolerance), _make_piece(above, sdf, tolerance)
        if first is None or second is None:
            continue
        children = (first, second)
        # what is still too fat counts, and a little how much solid is still part of a fat piece: cutting a lid's rim
        # off a can gains nothing at once, but makes the can itself right
        left = sum(c.excess for c in children) / piece.excess
        fat = sum(c.volume for c in children if c.excess > 0.0) / piece.volume
        cost = left + 0.1 * fat + preference
        if cost < best_cost:
            best, best_cost = children, cost
    return best


def halve(piece: Piece) -> tuple[Piece, Piece] | None:
    """The piece cut across the middle of its longest principal axis; None where that leaves nothing on one side."""
    centred = piece.corners - piece.corners.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T
    along = piece.corners @ axes.T
    longest = int(np.argmax(np.ptp(along, axis=0)))
    offset = 0.5 * float(along[:, longest].min() + along[:, longest].max())
    sides = [_bare_piece(t) for t in clip_triangles(piece.triangles, axes[longest], offset)]
    return (sides[0], sides[1]) if sides[0] is not None and sides[1] is not None else None


def _bare_piece(triangles: np.ndarray) -> Piece | None:
    """A piece whose fit is not measured."""
    points = triangles.reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    return Piece(triangles, points[hull.vertices], float(hull.volume), 0.0, points[0], 0.0)


def _candidate_planes(piece: Piece) -> Iterator[tuple[np.ndarray, float, float]]:
    """(normal, offset, cost of preference): first through the bottom of the deepest hollow, then even cuts."""
    bottom = _deepest_point(piece)
    centred = piece.corners - piece.corners.mean(axis=0)
    for axis in np.linalg.eigh(centred.T @ centred)[1].T:
        along = piece.corners @ axis
        low, high = float(along.min()), float(along.max())
        if high - low < 2.0 * _THINNEST_M:
            continue
        cuts = [(float(bottom @ axis), 0.0)] + [(low + f * (high - low), 0.02) for f in _EVEN_CUTS]
        for offset, preference in cuts:
            if low + _THINNEST_M < offset < high - _THINNEST_M:
                yield axis, offset, preference


def _deepest_point(piece: Piece) -> np.ndarray:
    """(3,) the surface point farthest below the hull, among a sample of the triangles' corners."""
    points = piece.triangles.reshape(-1, 3)
    points = points[:: max(1, len(points) // 4000)]
    planes = ConvexHull(piece.corners).equations
    depth = np.full(len(points), np.inf)
    for plane in np.unique(np.round(planes, 4), axis=0):
        np.minimum(depth, -(points @ plane[:3] + plane[3]), out=depth)
    return points[int(np.argmax(depth))]


def clip_triangles(triangles: np.ndarray, normal: np.ndarray, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """The parts of triangles (T, 3, 3) with normal . p <= offset, and with >= offset, as (T', 3, 3) each."""
    height = triangles @ normal - offset
    above = height > 0.0
    count = above.sum(axis=1)
    mixed = (count == 1) | (count == 2)
    lone = np.where(count[mixed] == 1, above[mixed].argmax(axis=1), (~above[mixed]).argmax(axis=1))
    order = (lone[:, None] + np.arange(3)) % 3  # the corner that is alone on its side first
    rows = np.arange(len(order))[:, None]
    p, h = triangles[mixed][rows, order], height[mixed][rows, order]
    a, b, c = p[:, 0], p[:, 1], p[:, 2]
    ab = a + (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None] * (b - a)
    ac = a + (h[:, 0] / (h[:, 0] - h[:, 2]))[:, None] * (c - a)
    tip = np.stack([a, ab, ac], axis=1)
    rest = np.concatenate([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
    tip_above = h[:, 0] > 0.0
    rest_above = np.concatenate([~tip_above, ~tip_above])
    return (
        np.concatenate([triangles[count == 0], tip[~tip_above], rest[~rest_above]]),
        np.concatenate([triangles[count == 3], tip[tip_above], rest[rest_above]]),
    )


def _make_piece(triangles: np.ndarray, sdf: SdfGrid, tolerance: float) -> Piece | None:
    """The piece of these triangles; None when they enclose nothing."""
    return _hull_piece(triangles, triangles.reshape(-1, 3), sdf, tolerance)


def _hull_piece(triangles: np.ndarray, points: np.ndarray, sdf: SdfGrid, tolerance: float) -> Piece | None:
    if len(points) < 4:
        return None
    centre = points.mean(axis=0)
    try:
        hull = ConvexHull(points - centre)
    except QhullError:
        return None
    if hull.volume < 1e-10:
        return None
    samples = sample_triangles(points[hull.simplices], _SAMPLES)
    distance = query_grid_numpy(sdf, samples)
    worst = int(np.argmax(distance))
    excess = float(np.maximum(distance - tolerance, 0.0).mean()) * float(hull.area)
    return Piece(
        triangles, points[hull.vertices], float(hull.volume), excess, samples[worst], max(float(distance[worst]), 0.0)
    )


def sample_triangles(triangles: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) points spread over triangles (T, 3, 3) by area; the same every time."""
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    total = np.cumsum(area)
    unit = _halton(count)
    index = np.minimum(np.searchsorted(total, unit[:, 0] * total[-1], side="right"), len(area) - 1)
    root = np.sqrt(unit[:, 1])[:, None]
    v = unit[:, 2:]
    a, b, c = triangles[index, 0], triangles[index, 1], triangles[index, 2]
    return (1.0 - root) * a + root * (1.0 - v) * b + root * v * c


@lru_cache(maxsize=8)
def _halton(count: int) -> np.ndarray:
    """(count, 3) points of the Halton sequence in bases 2, 3, 5, without the first, zero."""
    columns = []
    for base in (2, 3, 5):
        index, value, digit = np.arange(1, count + 1), np.zeros(count), 1.0
        while index.any():
            digit /= base
            index, rest = np.divmod(index, base)
            value += digit * rest
        columns.append(value)
    return np.stack(columns, axis=1)


def _merge(pieces: Sequence[Piece], sdf: SdfGrid, tolerance: float) -> list[Piece]:
    """Merge pairs, best first, as long as the hull of both adds no excess."""
    left = list(pieces)
    tried: dict[tuple[int, int], Piece | None] = {}
    while len(left) > 1:
        best, best_gain = None, -1e-9
        for i in range(len(left)):
            for j in range(i):
                if not _touch(left[i], left[j]):
                    continue
                key = (id(left[j]), id(left[i]))
                if key not in tried:
                    tried[key] = _joined(left[i], left[j], sdf, tolerance)
                joined = tried[key]
                if joined is None:
                    continue
                gain = left[i].excess + left[j].excess - joined.excess
                if gain > best_gain:
                    best, best_gain = (i, j, joined), gain
        if best is None:
            break
        i, j, joined = best
        left = [p for k, p in enumerate(left) if k not in (i, j)] + [joined]
    return left


def _touch(a: Piece, b: Piece) -> bool:
    """Whether the boxes of two pieces come within a millimetre."""
    low = np.maximum(a.corners.min(axis=0), b.corners.min(axis=0))
    high = np.minimum(a.corners.max(axis=0), b.corners.max(axis=0))
    return bool((low <= high + 1e-3).all())


def _joined(a: Piece, b: Piece, sdf: SdfGrid, tolerance: float) -> Piece | None:
    triangles = np.concatenate([a.triangles, b.triangles])
    return _hull_piece(triangles, np.concatenate([a.corners, b.corners]), sdf, tolerance)
