"""Exact unsigned distances at all nodes of a regular grid: a box tree over triangles, walked node by node.

Neighbouring nodes have nearly the same nearest triangle, so each walk starts from the one before it and visits few
boxes: half the work of independent queries, and just as exact.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.mesh_topology import Mesh
from neuralgrasps.geometry.shape_kernels import triangle_distance_squared

FloatArray = NDArray[np.float64]

_LEAF_SIZE = 4
_STACK = 128  # the tree halves triangle counts, so its depth is far below this


def grid_unsigned_distance(mesh: Mesh, origin: FloatArray, spacing: float, sides: tuple[int, int, int]) -> FloatArray:
    """Distance to `mesh` at the nodes origin + spacing * (i, j, k): `sides` float64, metres, exact.

    Uses up to 4 threads; the result does not depend on their number.
    """
    boxes, second_child, ranges, order = build_nodes(mesh.triangles, _LEAF_SIZE)
    triangles = np.ascontiguousarray(mesh.triangles[order])
    out = np.empty(sides)
    slabs = np.array_split(np.arange(sides[0]), min(sides[0], 16))

    def fill(slab: NDArray[np.int64]) -> None:
        _fill_slab(boxes, second_child, ranges, triangles, origin, spacing, slab[0], slab[-1] + 1, out)

    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        list(pool.map(fill, slabs))
    return out


@njit(cache=True, error_model="numpy")
def build_nodes(triangles, leaf_size):  # type: ignore[no-untyped-def]
    """A box tree over triangles (T, 3, 3), nodes in depth-first order.

    Returns:
        boxes (N, 6) low and high corner; second child (N,), -1 for a leaf (the first child is the next node);
        ranges (N, 2) into the order; order (T,) of the triangles.
    """
    count = triangles.shape[0]
    centre = np.empty((count, 3))
    for t in range(count):
        for a in range(3):
            centre[t, a] = (triangles[t, 0, a] + triangles[t, 1, a] + triangles[t, 2, a]) / 3.0
    order = np.arange(count)
    boxes = np.empty((2 * count, 6))
    second_child = np.full(2 * count, -1, dtype=np.int64)
    ranges = np.zeros((2 * count, 2), dtype=np.int64)
    stack = np.empty((_STACK, 3), dtype=np.int64)  # start, end, parent whose second child this is (or -1)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, count, -1
    top, used = 1, 0
    while top > 0:
        top -= 1
        start, end, parent = stack[top, 0], stack[top, 1], stack[top, 2]
        node = used
        used += 1
        if parent >= 0:
            second_child[parent] = node
        ranges[node, 0], ranges[node, 1] = start, end
        boxes[node, :3], boxes[node, 3:] = np.inf, -np.inf
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for s in range(start, end):
            for a in range(3):
                low[a] = min(low[a], centre[order[s], a])
                high[a] = max(high[a], centre[order[s], a])
                for c in range(3):
                    boxes[node, a] = min(boxes[node, a], triangles[order[s], c, a])
                    boxes[node, 3 + a] = max(boxes[node, 3 + a], triangles[order[s], c, a])
        if end - start <= leaf_size:
            continue
        axis = np.argmax(high - low)
        part = order[start:end].copy()
        order[start:end] = part[np.argsort(centre[part, axis])]
        middle = (start + end) // 2
        stack[top, 0], stack[top, 1], stack[top, 2] = middle, end, node
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = start, middle, -1
        top += 2
    return boxes[:used].copy(), second_child[:used].copy(), ranges[:used].copy(), order


@njit(cache=True, inline="always", error_model="numpy")
def box_distance_squared(boxes, node, x, y, z):  # type: ignore[no-untyped-def]
    dx = max(boxes[node, 0] - x, x - boxes[node, 3], 0.0)
    dy = max(boxes[node, 1] - y, y - boxes[node, 4], 0.0)
    dz = max(boxes[node, 2] - z, z - boxes[node, 5], 0.0)
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def _nearest(boxes, second_child, ranges, triangles, x, y, z, guess, nodes, bounds):  # type: ignore[no-untyped-def]
    """Nearest triangle and its squared distance, given any triangle as a first guess; nodes and bounds are scratch."""
    best = guess
    nearest = triangle_distance_squared(x, y, z, triangles, guess)
    nodes[0], bounds[0] = 0, box_distance_squared(boxes, 0, x, y, z)
    top = 1
    while top > 0:
        top -= 1
        if bounds[top] >= nearest:
            continue
        node = nodes[top]
        if second_child[node] < 0:
            for t in range(ranges[node, 0], ranges[node, 1]):
                d = triangle_distance_squared(x, y, z, triangles, t)
                if d < nearest:
                    nearest = d
                    best = t
            continue
        one, two = node + 1, second_child[node]
        d_one = box_distance_squared(boxes, one, x, y, z)
        d_two = box_distance_squared(boxes, two, x, y, z)
        if d_one < d_two:
            one, two, d_one, d_two = two, one, d_two, d_one
        if d_one < nearest:
            nodes[top], bounds[top] = one, d_one
            top += 1
        if d_two < nearest:
            nodes[top], bounds[top] = two, d_two
            top += 1
    return best, nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_slab(boxes, second_child, ranges, triangles, origin, spacing, i_start, i_end, out):  # type: ignore[no-untyped-def]
    nodes = np.empty(_STACK, dtype=np.int64)
    bounds = np.empty(_STACK)
    row_guess = 0
    for i in range(i_start, i_end):
        x = origin[0] + spacing * i
        for j in range(out.shape[1]):
            y = origin[1] + spacing * j
            guess = row_guess
            for k in range(out.shape[2]):
                z = origin[2] + spacing * k
                guess, squared = _nearest(boxes, second_child, ranges, triangles, x, y, z, guess, nodes, bounds)
                out[i, j, k] = np.sqrt(squared)
                if k == 0:
                    row_guess = guess
