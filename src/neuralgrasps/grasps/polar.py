"""Largest distance from the origin in a polar polytope {x : w_i . x <= 1 for all i} in 6D, with a proof.

Outer approximation: start from a huge simplex around the polar; take its farthest vertex; if some w_i . x <= 1 is
violated there, cut with the most violated one, else that vertex is the answer. It touches only what is far out, 21 cuts
and 1,000 vertices for a typical grasp, while the polar itself has many thousands. Seen from the other side, each vertex
is a facet of a polytope inside the hull of the w_i that grows where it is nearest to the origin.

Why the answer is exact, ties and coplanar w_i included: the facets always form a closed surface around the origin, made
of points of the hull, because a cut replaces facets by the cone over their rim, and the point of the cone lies beyond
the planes of the facets it replaces. A closed surface whose facets' planes are all at least 1 / |x| away encloses the
ball of that radius. The vertex that ends the search is in the polar, so no larger ball fits. Neither argument needs the
vertices to be in general position, nor the surface to be convex; the only rounding is that of w_i . x = 1 at the
vertices, which are convex combinations of earlier ones.

No function here allocates, slices or raises: all of them also compile for other devices.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit

OVERFLOW = -1.0
_TOLERANCE = 1e-10  # violation, relative to 1, below which a constraint holds
_NONE = -1  # in `mates`: not joined yet, where a new vertex v on the edge is written -2 - v


class PolarScratch(NamedTuple):
    """Scratch for one search at a time. V = room for vertices, W = room for constraints.

    Vertex v has constraints basis[8 v + j], j = 0..5 (negative: of the first simplex); its edge j, along which it
    leaves constraint j, is numbered 8 v + j and ends where edge mates[8 v + j] starts. Unused vertices are at 0.

    Attributes:
        x: (6, V) vertices; squared: (V,) squared norm, -1 = unused; gap: (V,) violation of the cut.
        basis, mates: (8 V,) int32.
        cut_off, free: (V,) int32 vertices; rim: (8 V,) int32 edges.
        columns: (6, W) constraints, no entry above 1 in size; values: (W,).
        counts: (3,) int64: vertices in use, cuts, vertices made in all.
    """

    x: np.ndarray
    squared: np.ndarray
    gap: np.ndarray
    basis: np.ndarray
    mates: np.ndarray
    cut_off: np.ndarray
    free: np.ndarray
    rim: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    counts: np.ndarray


@njit(cache=True, error_model="numpy")
def polar_scratch(constraints, vertices):  # type: ignore[no-untyped-def]
    """Scratch with room for so many constraints and vertices (about 190 bytes each)."""
    return PolarScratch(
        np.empty((6, vertices)),
        np.empty(vertices),
        np.empty(vertices),
        np.empty(8 * vertices, np.int32),
        np.empty(8 * vertices, np.int32),
        np.empty(vertices + 1, np.int32),
        np.empty(vertices, np.int32),
        np.empty(8 * vertices, np.int32),
        np.empty((6, constraints)),
        np.empty(constraints),
        np.zeros(3, np.int64),
    )


def _regular_simplex() -> np.ndarray:
    """(7, 6) unit vectors with equal angles between them."""
    corners = np.zeros((7, 6))
    for k in range(6):
        corners[k, k] = np.sqrt(1.0 - sum(c * c for c in corners[k, :k].tolist()))
        for i in range(k + 1, 7):
            products = [a * b for a, b in zip(corners[k, :k].tolist(), corners[i, :k].tolist(), strict=True)]
            corners[i, k] = (-1.0 / 6.0 - sum(products)) / corners[k, k]
    corners.flags.writeable = False
    return corners


_SIMPLEX = _regular_simplex()


@njit(cache=True, error_model="numpy")
def _start(x, squared, basis, mates, inner):  # type: ignore[no-untyped-def]
    """The simplex around the ball of radius `inner`; vertex v lies on all of its 7 constraints but v."""
    for v in range(7):
        squared[v] = 0.0
        for k in range(6):
            x[k, v] = -6.0 * inner * _SIMPLEX[v, k]
            squared[v] += x[k, v] * x[k, v]
        for j in range(6):
            other = j if j < v else j + 1
            basis[8 * v + j] = -1 - other
            mates[8 * v + j] = 8 * other + (v if v < other else v - 1)
        basis[8 * v + 6] = basis[8 * v + 7] = _NONE


@njit(cache=True, error_model="numpy")
def _farthest(squared, used):  # type: ignore[no-untyped-def]
    top, best = 0, squared[0]
    for v in range(1, used):
        if squared[v] > best:
            top, best = v, squared[v]
    return top


@njit(cache=True, error_model="numpy")
def _support(x, top, columns, count, values):  # type: ignore[no-untyped-def]
    """Largest w_i . x at vertex `top`, and its i."""
    a, b, c, d, e, f = x[0, top], x[1, top], x[2, top], x[3, top], x[4, top], x[5, top]
    for i in range(count):
        values[i] = (
            a * columns[0, i] + b * columns[1, i] + c * columns[2, i]
            + d * columns[3, i] + e * columns[4, i] + f * columns[5, i]
        )  # fmt: skip
    support, row = values[0], 0
    for i in range(1, count):
        if values[i] > support:
            support, row = values[i], i
    return support, row


@njit(cache=True, error_model="numpy")
def _find_rim(x, columns, row, used, gap, mates, cut_off, rim):  # type: ignore[no-untyped-def]
    """List the vertices beyond constraint `row`, and their edges that cross it; returns how many."""
    a, b, c = columns[0, row], columns[1, row], columns[2, row]
    d, e, f = columns[3, row], columns[4, row], columns[5, row]
    for v in range(used):
        gap[v] = a * x[0, v] + b * x[1, v] + c * x[2, v] + d * x[3, v] + e * x[4, v] + f * x[5, v] - 1.0
    removed = 0
    for v in range(used):  # written without branches, which would be mispredicted
        cut_off[removed] = v
        removed += gap[v] > 0.0
    crossing = 0
    for p in range(removed):
        first = 8 * cut_off[p]
        for j in range(6):
            edge = first + j
            rim[crossing] = edge
            crossing += not gap[mates[edge] >> 3] > 0.0  # nan, too, is one of the two
    return removed, crossing


@njit(cache=True, error_model="numpy")
def _make_vertices(x, squared, gap, basis, mates, rim, crossing, row, used, free, spare):  # type: ignore[no-untyped-def]
    """A vertex where each edge of the rim crosses constraint `row`; returns vertices in use.

    -1: constraint `row` has been cut with before, and only rounding lets vertices on it violate it.
    """
    repeated = 0
    for q in range(crossing):
        edge = rim[q]
        mate = mates[edge]
        u, v = edge >> 3, mate >> 3
        if spare > 0:
            spare -= 1
            z = free[spare]
        else:
            z = used
            used += 1
        t = gap[u] / (gap[u] - gap[v])
        size = 0.0
        for k in range(6):
            at = x[k, u] + t * (x[k, v] - x[k, u])
            x[k, z] = at
            size += at * at
        squared[z] = size
        for j in range(8):
            constraint = basis[8 * u + j]
            repeated += constraint == row
            basis[8 * z + j] = constraint
            mates[8 * z + j] = _NONE
        slot = 8 * z + (edge & 7)
        basis[slot] = row
        mates[slot] = mate
        mates[mate] = slot
        mates[edge] = -2 - z
    return used if repeated == 0 else -1


@njit(cache=True, error_model="numpy")
def _join_vertices(basis, mates, rim, crossing):  # type: ignore[no-untyped-def]
    """Join each new vertex to the five others around it: walk about their common 2D face through removed vertices."""
    for q in range(crossing):
        edge = rim[q]
        new = 8 * (-2 - mates[edge])
        for j in range(6):
            if mates[new + j] != _NONE:
                continue
            enter, here, out = edge & 7, 8 * (edge >> 3), j
            left = basis[edge]  # of the vertex walked from, the constraint that is not on the face and not left next
            came = mates[here + out]
            while came >= 0:
                enter = came & 7
                here = came - enter
                out = (
                    1 * (basis[here + 1] == left) + 2 * (basis[here + 2] == left) + 3 * (basis[here + 3] == left)
                    + 4 * (basis[here + 4] == left) + 5 * (basis[here + 5] == left)
                )  # fmt: skip
                left = basis[came]
                came = mates[here + out]
            other = 8 * (-2 - came) + enter
            mates[new + j] = other
            mates[other] = new + j


@njit(cache=True, error_model="numpy")
def farthest_vertex(s, count, inner, floor):  # type: ignore[no-untyped-def]
    """Search the polar of s.columns[:, :count], cut to the simplex around the ball of radius `inner`.

    Ends at the farthest vertex, or early when some direction has a support of at most `floor`, or when the polar is
    known to reach beyond `inner`.

    Returns:
        Largest w_i . x at the last vertex x, and |x|, or `OVERFLOW` when the scratch was too small. Their ratio is
        never below the radius of the largest ball in the hull of the w_i, and is that radius when x is the farthest
        vertex (largest w_i . x at most 1 + tolerance).
    """
    _start(s.x, s.squared, s.basis, s.mates, inner)
    used, spare, made, cuts = 7, 0, 7, 0
    tolerance = max(_TOLERANCE, 1e-14 * inner)
    while True:
        top = _farthest(s.squared, used)
        support, row = _support(s.x, top, s.columns, count, s.values)
        reach = math.sqrt(s.squared[top])
        s.counts[0], s.counts[1], s.counts[2] = used, cuts, made
        if not support > max(1.0 + tolerance, floor * reach) or reach >= inner * support:
            return support, reach
        removed, crossing = _find_rim(s.x, s.columns, row, used, s.gap, s.mates, s.cut_off, s.rim)
        if used + max(crossing - spare, 0) > s.squared.shape[0]:
            return support, OVERFLOW
        used = _make_vertices(
            s.x, s.squared, s.gap, s.basis, s.mates, s.rim, crossing, row, used, s.free, spare
        )  # fmt: skip
        if used < 0:
            return support, reach
        spare = max(spare - crossing, 0)
        _join_vertices(s.basis, s.mates, s.rim, crossing)
        for p in range(removed):
            v = s.cut_off[p]
            s.squared[v] = -1.0
            for k in range(6):
                s.x[k, v] = 0.0
            s.free[spare] = v
            spare += 1
        made += crossing
        cuts += 1
