"""How far a posed hand reaches in a direction, exactly: the support function of its convex parts. Torch-free."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from neuralgrasps.geometry.plane import Plane
from neuralgrasps.hands.hand import ConvexPart, Hand, PartKind
from neuralgrasps.kinematics.forward_kernels import forward_fast


def part_extent(part: ConvexPart, directions_L: np.ndarray) -> np.ndarray:
    """Largest n . p over the points p of a part, for directions n (..., 3) in its link's frame; (...) metres."""
    n = directions_L @ part.X_LP[:3, :3]
    a, b, _ = part.size
    if part.kind == PartKind.BOX:
        own = np.abs(n) @ part.size
    elif part.kind == PartKind.HULL:
        own = (n @ part.vertices.T).max(axis=-1)
    elif part.kind == PartKind.CYLINDER:
        own = a * np.hypot(n[..., 0], n[..., 1]) + b * np.abs(n[..., 2])
    else:
        along = b * np.abs(n[..., 2]) if part.kind == PartKind.CAPSULE else 0.0
        own = a * np.linalg.norm(n, axis=-1) + along
    return own + directions_L @ part.X_LP[:3, 3]


def hand_extent(
    hand: Hand, q: np.ndarray, directions_H: np.ndarray, *, links: Iterable[int] | None = None
) -> np.ndarray:
    """Largest n . p over the points p of N hands at joints q (N, J), for one direction each (N, 3) in H; (N,) metres.

    Args:
        links: only the parts of these links; default all.
    """
    X_HL = forward_fast(hand.tree, q)
    wanted = set(range(hand.tree.num_links)) if links is None else set(links)
    farthest = np.full(len(q), -np.inf)
    for part in hand.parts:
        if part.link in wanted:
            X = X_HL[:, part.link]
            n_L = np.einsum("nij,ni->nj", X[:, :3, :3], directions_H)
            here = part_extent(part, n_L) + np.einsum("ni,ni->n", directions_H, X[:, :3, 3])
            farthest = np.maximum(farthest, here)
    return farthest


def lowest_height(
    hand: Hand, X_OH: np.ndarray, q: np.ndarray, plane_O: Plane, *, links: Iterable[int] | None = None
) -> np.ndarray:
    """(N,) height of the lowest point of N hands, at X_OH (N, 4, 4) and q (N, J), above a plane of O, metres."""
    down_H = np.einsum("nij,i->nj", X_OH[:, :3, :3], -plane_O.normal)
    return plane_O.height(X_OH[:, :3, 3]) - hand_extent(hand, q, down_H, links=links)
