"""How close a reconstructed shape is to the true one: the published measure, its oracle, and honest millimetres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.samples import Normalisation, ball_points, hand_distances
from neuralgrasps.errors import InputError
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.seeds import child_rng

SignedDistance = Callable[[np.ndarray], np.ndarray]
"""(M, 3) points in the object frame -> (M,) signed distances, metres."""

QUERIES = 100_000
INSIDE_UNIT = 1e-4  # the published code's threshold on the (normalised) distance


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedChamfer:
    """The published reconstruction measure, in squared normalised units, beside what a perfect field scores.

    Attributes:
        chamfer: of the reconstruction; inf when no query lies inside it.
        oracle: of the true signed distance, same queries. Not zero: the measure compares a filled
            interior with a surface, so only `chamfer` beside `oracle` means anything.
        inside: queries that the reconstruction says are inside.
    """

    chamfer: float
    oracle: float
    inside: int


def published_chamfer(
    reconstructed: SignedDistance,
    true: SignedDistance,
    surface_O: np.ndarray,
    *,
    normalisation: Normalisation,
    seed: int,
    queries: int = QUERIES,
) -> PublishedChamfer:
    """Squared two-sided Chamfer distance between the queries inside the reconstruction and the true surface.

    Args:
        surface_O: (S, 3) points of the true surface, object frame, metres.
        seed: of the `queries` uniform points in the unit ball.
    Source:
        Khargonkar et al. 2022, Sec. 5, with the threshold of the published code.
    """
    if queries < 1 or not len(surface_O):
        raise InputError(f"{queries} queries and {len(surface_O)} surface points; expected at least one of each.")
    unit = ball_points(queries, child_rng(seed, "reconstruction"))
    points_O = normalisation.to_object(unit)
    surface = normalisation.to_unit(surface_O)
    limit = INSIDE_UNIT * normalisation.scale_m
    inside = unit[reconstructed(points_O) < limit]
    return PublishedChamfer(
        chamfer=squared_chamfer(inside, surface),
        oracle=squared_chamfer(unit[true(points_O) < limit], surface),
        inside=len(inside),
    )


def squared_chamfer(a: np.ndarray, b: np.ndarray) -> float:
    """Mean squared distance to the nearest point, from (A, 3) to (B, 3) plus back; inf if one is empty."""
    if not len(a) or not len(b):
        return float("inf")
    return float((KDTree(b).query(a)[0] ** 2).mean() + (KDTree(a).query(b)[0] ** 2).mean())


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceErrors:
    """Distances between two surfaces, metres, both ways pooled; exact (no nearest sampled point involved).

    Attributes:
        mean_m, p95_m, max_m: over the sample points.
    """

    mean_m: float
    p95_m: float
    max_m: float


def surface_errors(distances_m: np.ndarray) -> SurfaceErrors:
    """Summary of |signed distances| of points of one surface to the other."""
    d = np.abs(np.asarray(distances_m, float)).ravel()
    return SurfaceErrors(mean_m=float(d.mean()), p95_m=float(np.quantile(d, 0.95)), max_m=float(d.max()))


def hand_surface_distances(
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    X_OH_true: np.ndarray,
    q_true: np.ndarray,
    *,
    seed: int,
    points: int = 1000,
) -> np.ndarray:
    """Surface-to-surface distances between N hands and the true ones, metres, (N, 2 * points).

    The first half: points of the given hand's surface to the true hand; the second half: the other way. Each
    is the exact |signed distance| at points uniform by area.
    """
    out = np.empty((len(X_OH), 2 * points))
    for i in range(len(X_OH)):
        rng = child_rng(seed, "surface", i)
        given = sample_posed_surface(packed, X_OH[i], q[i], points, rng)
        true = sample_posed_surface(packed, X_OH_true[i], q_true[i], points, rng)
        out[i, :points] = hand_distances(packed, X_OH_true[i : i + 1], q_true[i : i + 1], given)[0]
        out[i, points:] = hand_distances(packed, X_OH[i : i + 1], q[i : i + 1], true)[0]
    return np.abs(out)
