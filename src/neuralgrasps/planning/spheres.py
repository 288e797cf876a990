"""Spheres that cover a convex part and stand out of it by no more than stated, as a tree.

The part's bounding box is cut into two again and again. A box around c with half diagonal r is dropped where it misses
the part (c is r or more outside), and is a leaf as soon as r plus the signed distance of c is the allowed excess: no
point of the sphere (c, r) is farther from the part than that. So the leaves hold the whole part, inside included, by
construction. Cuts are at multiples of the largest cell that fits a flat face.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.parts import bounding_sphere, hull_planes, part_distance

_DEEPEST = 40  # halvings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SphereTree:
    """Spheres of one part, fixed to its link, parents before children.

    A sphere's children are inside what it stands for: a node whose sphere is clear makes its whole branch clear. Go
    on with `i + 1` where node i is not clear, and with `skip[i]` where it is; node i is a leaf where the two agree.

    Attributes:
        centres_L: (S, 3) metres, link frame; radii: (S,) metres.
        skip: (S,) int64, the first node after the branch of each.
    """

    centres_L: np.ndarray
    radii: np.ndarray
    skip: np.ndarray

    @property
    def leaves(self) -> np.ndarray:
        """(S,) bool: the spheres that cover the part."""
        return np.asarray(self.skip == np.arange(len(self.skip)) + 1)


def cover_part(part: ConvexPart, *, excess_m: float) -> SphereTree:
    """Spheres that hold the whole part; no point of a leaf is farther than `excess_m` outside it.

    Raises:
        InputError: excess_m is not positive.
    """
    if not (excess_m > 0 and math.isfinite(excess_m)):
        raise InputError(f"excess_m is {excess_m}; expected a positive length in metres, e.g. 0.008.")
    middle, half = _bounding_box(part)
    if part.kind in (PartKind.SPHERE, PartKind.CAPSULE):
        nodes = _row_of_spheres(float(part.size[0]), float(part.size[1] * (part.kind == PartKind.CAPSULE)), excess_m)
    else:
        planes, triangles = hull_planes(part)
        cells = _cells(half, excess_m)
        nodes = _cut(int(part.kind), part.size, planes, triangles, middle, half, cells, excess_m)
    centres, radii, skip = nodes
    R, t = part.X_LP[:3, :3], part.X_LP[:3, 3]
    centre, radius = bounding_sphere(part)
    tree = SphereTree(centres_L=centres @ R.T + t, radii=radii, skip=skip)
    if radius < tree.radii[0]:  # the root may be any sphere around the part
        tree.centres_L[0], tree.radii[0] = centre, radius
    return tree


def _bounding_box(part: ConvexPart) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half sizes in the part frame."""
    a, b, _ = part.size
    if part.kind == PartKind.HULL:
        low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
        return (low + high) / 2, (high - low) / 2
    half = {PartKind.BOX: part.size, PartKind.CYLINDER: (a, a, b)}.get(part.kind, (a, a, a + b))
    return np.zeros(3), np.array(half, float)


def _cells(half: np.ndarray, excess_m: float) -> np.ndarray:
    """(3,) float64 numbers of cells along the sides of a box whose spheres stand out of it by no more than asked."""
    cells = np.ones(3)
    while np.linalg.norm(half / cells) - (half / cells).min() > excess_m:
        cells[np.argmax(half / cells)] += 1.0
    return cells


def _row_of_spheres(radius: float, half: float, excess_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A capsule's spheres, equal and on its axis, under one root."""
    if half == 0.0:
        return np.zeros((1, 3)), np.array([radius]), np.array([1])
    steps = math.ceil(half / math.sqrt((radius + excess_m) ** 2 - radius**2))
    z = np.linspace(-half, half, steps + 1)
    centres = np.zeros((len(z) + 1, 3))
    centres[1:, 2] = z
    radii = np.full(len(z) + 1, math.hypot(radius, half / steps))
    radii[0] = half + radius
    skip = np.arange(1, len(z) + 2)
    skip[0] = len(z) + 1
    return centres, radii, skip


@njit(cache=True, error_model="numpy")
def _cut(kind, size, planes, triangles, middle, half, cells, excess):  # type: ignore[no-untyped-def]
    """Nodes (S, 3), (S,), (S,) of one part in its own frame, depth first."""
    room = 256
    nodes, skip, above = np.empty((room, 4)), np.empty(room, np.int64), np.empty(room, np.int64)
    box = np.empty((2 * _DEEPEST + 2, 9))  # to do: middle, half sizes, cells along each side
    parent = np.empty(2 * _DEEPEST + 2, np.int64)
    box[0, :3], box[0, 3:6], box[0, 6:], parent[0] = middle, half, cells, -1
    waiting, count = 1, 0
    while waiting > 0:
        waiting -= 1
        x, y, z, hx, hy, hz = box[waiting, :6]
        radius = math.sqrt(hx * hx + hy * hy + hz * hz)
        distance = part_distance(kind, size, planes, triangles, x, y, z)
        if distance >= radius:
            continue
        if count == room:
            nodes = _longer(nodes)
            skip, above = np.concatenate((skip, np.empty_like(skip))), np.concatenate((above, np.empty_like(above)))
            room *= 2
        nodes[count, 0], nodes[count, 1], nodes[count, 2], nodes[count, 3] = x, y, z, radius
        above[count], skip[count] = parent[waiting], -1
        if radius + distance > excess * (1.0 + 1e-9):
            skip[count] = 0  # not a leaf
            waiting = _halve(box, parent, waiting, count)
        count += 1
    return _without_dead_ends(nodes[:count], skip[:count], above[:count])


@njit(cache=True, error_model="numpy")
def _halve(box, parent, place, node):  # type: ignore[no-untyped-def]
    """Put the two halves of the box at `place` there and behind it; the new number of waiting boxes."""
    h0, h1, h2 = box[place, 3], box[place, 4], box[place, 5]
    axis = 0 if h0 >= h1 and h0 >= h2 else (1 if h1 >= h2 else 2)
    cells = box[place, 6 + axis]
    first = math.floor(cells / 2.0) if cells >= 2.0 else cells / 2.0
    low, half = box[place, axis] - box[place, 3 + axis], box[place, 3 + axis]
    box[place + 1] = box[place]
    for k in range(2):
        share = (first if k == 0 else cells - first) / cells
        box[place + k, 6 + axis] = share * cells
        box[place + k, 3 + axis] = share * half
        box[place + k, axis] = low + share * half if k == 0 else low + (2.0 - share) * half
        parent[place + k] = node
    return place + 2


@njit(cache=True, error_model="numpy")
def _longer(rows):  # type: ignore[no-untyped-def]
    out = np.empty((2 * rows.shape[0], rows.shape[1]))
    out[: rows.shape[0]] = rows
    return out


@njit(cache=True, error_model="numpy")
def _without_dead_ends(nodes, skip, above):  # type: ignore[no-untyped-def]
    """Centres, radii and branch ends of the nodes that lead to a leaf."""
    count = skip.shape[0]
    alive = skip == -1  # leaves
    last = np.arange(count)  # the last node of each branch
    for i in range(count - 1, -1, -1):
        if above[i] >= 0:
            alive[above[i]] |= alive[i]
            last[above[i]] = max(last[above[i]], last[i])
    place = np.cumsum(alive)  # in the new order, plus 1
    kept = np.flatnonzero(alive)
    ends = np.empty(kept.shape[0], np.int64)
    for k in range(kept.shape[0]):
        ends[k] = place[last[kept[k]]]
    return nodes[kept, :3].copy(), nodes[kept, 3].copy(), ends
