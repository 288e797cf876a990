"""Better shapes of a path that is free: fewer corners, a shorter way, round corners."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

EdgeCheck = Callable[[np.ndarray, np.ndarray], bool]

_SAGITTA = 2.5e-4  # rad or metres between a rounded corner and the chords it is given by
_SMALLEST = 8.0  # corners are tried down to this fraction of the cut
_SAME_S = 1e-9  # two points nearer than this are one
_LEAST_GAIN = 0.05  # share of the path's length, below which a shortcut is not worth its checks


def shorten(
    q: np.ndarray, edge_is_free: EdgeCheck, velocity: np.ndarray, *, rng: np.random.Generator, tries: int
) -> np.ndarray:
    """A shorter free path (T', D) with the same ends: needless waypoints removed, then random shortcuts.

    Lengths are in seconds at top speed, `|dq / velocity|`, so that slow joints count as much as they cost.

    Args:
        q: (T, D) waypoints of a free path.
    """
    q = _skip(_distinct(q, velocity), edge_is_free)
    for _ in range(tries):
        if len(q) == 2:
            break
        q = _shortcut(q, edge_is_free, velocity, np.sort(rng.random(2)))
    return _skip(q, edge_is_free)


def _skip(q: np.ndarray, edge_is_free: EdgeCheck) -> np.ndarray:
    """From each waypoint on to the farthest that a free line leads to."""
    kept = [0]
    while kept[-1] < len(q) - 1:
        last = kept[-1]
        kept.append(next((k for k in range(len(q) - 1, last + 1, -1) if edge_is_free(q[last], q[k])), last + 1))
    return q[kept]


def _shortcut(q: np.ndarray, edge_is_free: EdgeCheck, velocity: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """A line between two points of the path (their shares of its length), where it is free and shorter."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0) / velocity, axis=1))])
    s0, s1 = ends * s[-1]
    i, j = np.minimum(np.searchsorted(s, [s0, s1], side="right") - 1, len(q) - 2)
    if i == j:
        return q
    a = q[i] + (q[i + 1] - q[i]) * ((s0 - s[i]) / (s[i + 1] - s[i]))
    b = q[j] + (q[j + 1] - q[j]) * ((s1 - s[j]) / (s[j + 1] - s[j]))
    gain = (s1 - s0) - np.linalg.norm((b - a) / velocity)
    if gain < _LEAST_GAIN * s[-1] or not edge_is_free(a, b):
        return q
    return np.concatenate([q[: i + 1], a[None], b[None], q[j + 1 :]])


def round_corners(q: np.ndarray, edge_is_free: EdgeCheck, velocity: np.ndarray, *, cut_s: float) -> np.ndarray:
    """Corners replaced by parabolas that touch both sides, given by chords.

    Args:
        q: (T, D) waypoints. cut_s: length cut off each side, seconds at top speed, at most half of the side; halved
            until the chords are free, down to an eighth; then the corner stays.
    """
    q = _distinct(q, velocity)
    if len(q) < 3 or cut_s <= 0:
        return q
    side = np.linalg.norm(np.diff(q, axis=0) / velocity, axis=1)
    pieces = [q[:1]]
    for k in range(1, len(q) - 1):
        most = min(cut_s, 0.5 * side[k - 1], 0.5 * side[k])
        pieces.append(_rounded(q[k - 1 : k + 2], side[k - 1 : k + 1], most, edge_is_free))
    return _distinct(np.concatenate([*pieces, q[-1:]]), velocity)  # neighbours may meet half-way


def _distinct(q: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """The waypoints without repeated ones; both ends stay exactly."""
    out = q[np.append(True, np.linalg.norm(np.diff(q, axis=0) / velocity, axis=1) > _SAME_S)]
    if len(out) == 1:
        return q[[0, -1]]
    out[-1] = q[-1]
    return out


def _rounded(corner: np.ndarray, side: np.ndarray, most: float, edge_is_free: EdgeCheck) -> np.ndarray:
    """Points (K, D) in place of the middle one of `corner` (3, D), whose sides have the given lengths."""
    before, tip, after = corner
    cut = most
    while cut >= most / _SMALLEST:
        a, b = tip + (before - tip) * (cut / side[0]), tip + (after - tip) * (cut / side[1])
        bend = a - 2.0 * tip + b
        chords = max(2, int(np.ceil(np.sqrt(np.abs(bend).max() / (4.0 * _SAGITTA)))))
        u = np.linspace(0.0, 1.0, chords + 1)[:, None]
        points = a + 2.0 * u * (tip - a) + u**2 * bend
        if all(edge_is_free(p, r) for p, r in pairwise(points)):
            return points
        cut /= 2.0
    return tip[None]
