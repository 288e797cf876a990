"""Contact maps: how near each object point is to a posed hand, and how alike two maps are.

phi(p) = exp(-max(d(p, hand), 0) / radius), in [0, 1], 1 on and inside the hand.
Source: Khargonkar et al. 2022, Sec. 3.2. Differs: metres and exact distances to the hand's solids, not to points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.hands.packed import hand_distance_many

if TYPE_CHECKING:
    from torch import Tensor

    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.hands.packed import PackedHand

RADIUS_M = 0.05
CHUNK_PAIRS = 65536  # hand-point pairs per call; bounds the memory of the exact distance


@overload
def contact_map(
    points_O: np.ndarray,
    hand: Hand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    radius: float = RADIUS_M,
    chunk_pairs: int = CHUNK_PAIRS,
) -> np.ndarray: ...


@overload
def contact_map(
    points_O: Tensor | np.ndarray,
    hand: Hand,
    X_OH: Tensor,
    q: Tensor,
    *,
    radius: float = RADIUS_M,
    chunk_pairs: int = CHUNK_PAIRS,
) -> Tensor: ...


def contact_map(
    points_O: Tensor | np.ndarray,
    hand: Hand,
    X_OH: Tensor | np.ndarray,
    q: Tensor | np.ndarray,
    *,
    radius: float = RADIUS_M,
    chunk_pairs: int = CHUNK_PAIRS,
) -> Tensor | np.ndarray:
    """Closeness of each object point to each posed hand, in [0, 1].

    Args:
        points_O: (P, 3) object surface points, object frame, metres, or (N, P, 3) per grasp; torch or numpy, like the
            other arrays.
        hand: the hand that `q` belongs to.
        X_OH: (N, 4, 4) hand base in the object frame; q: (N, J) rad or metres.
        radius: decay length, metres, > 0.
        chunk_pairs: grasps times points per step; the memory used is proportional to it.
    Returns:
        (N, P) float32: numpy when all three arrays are numpy, else torch on the device of `points_O`, differentiable in
        `X_OH` and `q`.
    Raises:
        ShapeError: an input's shape; InputError: radius not positive.
    """
    import torch  # noqa: PLC0415 - workers use the rest of this module without torch

    from neuralgrasps.hands.signed_distance import hand_signed_distance  # noqa: PLC0415 - imports torch

    _check_radius(radius)
    as_numpy = not any(isinstance(a, torch.Tensor) for a in (points_O, X_OH, q))
    points_O, X_OH, q = (
        a if isinstance(a, torch.Tensor) else torch.from_numpy(np.array(a, np.float64)) for a in (points_O, X_OH, q)
    )
    check_shape("points_O", tuple(points_O.shape), (None, 3))
    check_shape("X_OH", tuple(X_OH.shape), (None, 4, 4))
    check_shape("q", tuple(q.shape), (len(X_OH), hand.num_dofs))
    count, per_hand = len(X_OH), points_O.shape[-2]
    columns = max(1, min(per_hand, chunk_pairs))
    rows = max(1, chunk_pairs // columns)
    out: list[Tensor] = []
    for n in range(0, count, rows):
        parts = []
        for p in range(0, per_hand, columns):
            points = points_O[..., p : p + columns, :]
            points = points[n : n + rows] if points_O.ndim == 3 else points
            distance = hand_signed_distance(hand, X_OH[n : n + rows], q[n : n + rows], points)
            parts.append(torch.exp(-distance.clamp(min=0) / radius).to(torch.float32))
        out.append(torch.cat(parts, dim=-1) if parts else torch.zeros(len(X_OH[n : n + rows]), 0))
    maps = torch.cat(out) if out else torch.zeros(0, per_hand, dtype=torch.float32, device=points_O.device)
    return maps.numpy() if as_numpy else maps


def contact_map_packed(
    points_O: np.ndarray, packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, *, radius: float = RADIUS_M
) -> np.ndarray:
    """`contact_map` without torch, for workers: (P, 3), (N, 4, 4), (N, J) float64 -> (N, P) float32."""
    _check_radius(radius)
    points = np.ascontiguousarray(points_O, np.float64)
    check_shape("points_O", points.shape, (None, 3))
    out = np.empty((len(X_OH), len(points)), np.float32)
    distance = np.empty(len(points))
    for n in range(len(X_OH)):
        hand_distance_many(packed, np.ascontiguousarray(X_OH[n]), np.ascontiguousarray(q[n]), points, distance)
        out[n] = np.exp(-np.maximum(distance, 0.0) / radius)
    return out


def contact_map_from_points(points_O: np.ndarray, hand_points_O: np.ndarray, *, radius: float = RADIUS_M) -> np.ndarray:
    """The contact map of a hand known only as observed points.

    Args:
        points_O: (P, 3) object points; hand_points_O: (K, 3) points on the hand, K >= 1; same frame, metres.
        radius: decay length, metres, > 0.
    Returns:
        (P,) float32 in [0, 1].
    """
    _check_radius(radius)
    points, hand_points = np.asarray(points_O, np.float64), np.asarray(hand_points_O, np.float64)
    check_shape("points_O", points.shape, (None, 3))
    check_shape("hand_points_O", hand_points.shape, (None, 3))
    if not len(hand_points) or not np.isfinite(hand_points).all():
        raise InputError(
            "hand_points_O needs at least one point and only finite ones; drop missing depth pixels first."
        )
    distance, _ = cKDTree(hand_points).query(points)
    return np.exp(-distance / radius).astype(np.float32)


def contact_distance_matrix(maps_a: np.ndarray, maps_b: np.ndarray) -> np.ndarray:
    """Mean absolute difference of contact maps (N, P) and (M, P) over the same points -> (N, M) float64 in [0, 1]."""
    a, b = np.asarray(maps_a, np.float64), np.asarray(maps_b, np.float64)
    check_shape("maps_b", b.shape, (None, a.shape[-1]))
    return cdist(a, b, "cityblock") / max(a.shape[-1], 1)


def similarity_matrix(distances: np.ndarray) -> np.ndarray:
    """1 - distance / largest distance: 1 for equal, 0 for the farthest pair; all 1 when all are equal.

    Source: the published retrieval score (see `contact_distance_matrix` for the distance).
    """
    distances = np.asarray(distances, np.float64)
    largest = distances.max(initial=0.0)
    return 1.0 - distances / largest if largest > 0 else np.ones_like(distances)


def _check_radius(radius: float) -> None:
    if not radius > 0:
        raise InputError(f"radius is {radius}; expected a decay length > 0 in metres, such as {RADIUS_M}.")
