"""How near a posed hand is to a part of an object's surface, exactly, by halving triangles. Torch-free."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.hands.packed import PackedHand, hand_distance, pose_links

_STACK = 128  # triangles that wait: three more for each of about 40 halvings, far beyond what is needed


class TriangleGroups(NamedTuple):
    """Triangles in groups, each within a ball.

    Attributes:
        triangles (T, 3, 3): corners, metres, object frame, those of one group after each other.
        start (G + 1,): triangles of group g are start[g]:start[g + 1].
        centre (G, 3), radius (G,): a ball around each group.
    """

    triangles: np.ndarray
    start: np.ndarray
    centre: np.ndarray
    radius: np.ndarray


def group_triangles(triangles: np.ndarray, *, size: float) -> TriangleGroups:
    """Triangles (T, 3, 3) in groups by the cells of `size` metres that their middles lie in."""
    if not len(triangles):
        return TriangleGroups(np.zeros((0, 3, 3)), np.zeros(1, np.int64), np.zeros((0, 3)), np.zeros(0))
    middle = triangles.mean(axis=1)
    cells = np.floor((middle - middle.min(axis=0)) / size).astype(np.int64)
    label = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(label, kind="stable")
    triangles = np.ascontiguousarray(triangles[order], np.float64)
    counts = np.bincount(label)
    start = np.concatenate([[0], np.cumsum(counts)])
    high = np.maximum.reduceat(triangles.max(axis=1), start[:-1])
    low = np.minimum.reduceat(triangles.min(axis=1), start[:-1])
    centre = (high + low) / 2
    reach = np.linalg.norm(triangles - np.repeat(centre, counts, axis=0)[:, None], axis=2).max(axis=1)
    return TriangleGroups(triangles, start, centre, np.maximum.reduceat(reach, start[:-1]))


@njit(cache=True, error_model="numpy")
def _ball(t):  # type: ignore[no-untyped-def]
    """Middle of a triangle (3, 3) and its distance to the farthest corner."""
    x, y, z = (t[0, 0] + t[1, 0] + t[2, 0]) / 3, (t[0, 1] + t[1, 1] + t[2, 1]) / 3, (t[0, 2] + t[1, 2] + t[2, 2]) / 3
    reach = 0.0
    for k in range(3):
        reach = max(reach, (t[k, 0] - x) ** 2 + (t[k, 1] - y) ** 2 + (t[k, 2] - z) ** 2)
    return x, y, z, math.sqrt(reach)


@njit(cache=True, error_model="numpy")
def _halve(t, stack, top):  # type: ignore[no-untyped-def]
    """Push the two halves of a triangle, cut at the middle of its longest edge, at `top`."""
    longest, edge = -1.0, 0
    for k in range(3):
        m = (k + 1) % 3
        length = (t[k, 0] - t[m, 0]) ** 2 + (t[k, 1] - t[m, 1]) ** 2 + (t[k, 2] - t[m, 2]) ** 2
        if length > longest:
            longest, edge = length, k
    other = (edge + 1) % 3
    for j in range(3):
        middle = 0.5 * (t[edge, j] + t[other, j])
        for k in range(3):
            stack[top, k, j] = t[k, j]
            stack[top + 1, k, j] = t[k, j]
        stack[top, edge, j] = middle
        stack[top + 1, other, j] = middle


@njit(cache=True, error_model="numpy")
def _triangle_distance(packed, X_HL, X_HO, triangle, best, enough, within, stack):  # type: ignore[no-untyped-def]
    """The lesser of `best` and the hand's distance to a triangle; ends early below `enough`.

    The distance changes by no more than one moves: far from the middle of a small triangle is far from all of it.
    """
    stack[0] = triangle
    top, work = 1, np.empty((3, 3))
    while top > 0 and best >= enough:
        top -= 1
        work[:] = stack[top]
        x, y, z, reach = _ball(work)
        hx, hy, hz = moved_point(X_HO, x, y, z)
        d = hand_distance(packed, X_HL, hx, hy, hz)
        best = min(best, d)
        if d - reach < best - within and top + 2 <= stack.shape[0]:
            _halve(work, stack, top)
            top += 2
    return best


@njit(cache=True, error_model="numpy")
def _distances(packed, groups, X_HO, q, most, enough, within, out):  # type: ignore[no-untyped-def]
    X_HL = np.empty((packed.parents.shape[0], 4, 4))
    stack = np.empty((_STACK, 3, 3))
    for n in range(len(q)):
        pose_links(packed, q[n], X_HL)
        best = most
        for g in range(len(groups.radius)):
            if best < enough:
                break
            c = groups.centre[g]
            hx, hy, hz = moved_point(X_HO[n], c[0], c[1], c[2])
            if hand_distance(packed, X_HL, hx, hy, hz) - groups.radius[g] >= best - within:
                continue
            for t in range(groups.start[g], groups.start[g + 1]):
                if best < enough:
                    break
                best = _triangle_distance(packed, X_HL, X_HO[n], groups.triangles[t], best, enough, within, stack)
        out[n] = best


def surface_distances(
    packed: PackedHand,
    groups: TriangleGroups,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    most: float = np.inf,
    enough: float = -np.inf,
    within: float = 1e-4,
) -> np.ndarray:
    """Signed distance of N hands to the nearest point of a surface.

    Args:
        packed: the hand (`pack_shapes` will do). X_OH: (N, 4, 4); q: (N, J).
        most: distances beyond it are given as it; enough: below it any distance is as good as the least. Both save
            time. within: what the distance may be too large by.
    Returns:
        (N,) metres, negative where the hand's solids reach over the surface; `most` for a surface of no triangles.
    """
    X_HO = np.stack([inverse_np(X) for X in X_OH]) if len(X_OH) else np.zeros((0, 4, 4))
    out = np.empty(len(X_OH))
    _distances(
        packed, groups, X_HO, np.ascontiguousarray(q, np.float64), float(most), float(enough), float(within), out
    )
    return out
