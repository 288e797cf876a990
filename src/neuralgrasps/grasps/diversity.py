"""How varied a set of grasps of one hand on one object is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.hands.hand import Hand

ENTROPY_BINS = 100
DIRECTIONS = 200  # on the sphere, for the approach coverage
COVER_RAD = np.deg2rad(30.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Diversity:
    """How varied a set of grasps is.

    Attributes:
        explained: (D,) share of the variance that each principal component explains, largest first. One large share =
            little variety; all 0 when all grasps are equal.
        entropy_bits: mean over joints of the entropy of the joint's value in 100 bins over its range; at most 6.64,
            and no more than log2(N) of N grasps: fewer than 100 cannot reach it, so compare sets of equal size.
        approach_coverage: share of 200 directions, evenly spread over the sphere of the object frame, within 30
            degrees of some grasp's approach (the palm's z axis). One approach alone covers 0.067.
        nearest_approach_rad: median over grasps of the angle to the nearest approach of another grasp.
        nearest_rotation_rad: median over grasps of the angle of the rotation to the palm orientation nearest to it
            among the others; a jaw turned by half a turn about its approach counts as the same. Positions do not enter:
            one grasp at two heights of a can is 0 apart.
    """

    explained: np.ndarray
    entropy_bits: float
    approach_coverage: float
    nearest_approach_rad: float
    nearest_rotation_rad: float


def grasp_diversity(hand: Hand, X_OH: np.ndarray, q: np.ndarray, *, length: float) -> Diversity:
    """Variety of N grasps in palm position (divided by `length`, metres), rotation entries and joints / range.

    Args:
        X_OH: (N, 4, 4); q: (N, J); N >= 2.
        length: size of the object, metres; see `characteristic_length`.
    """
    X_OH, q = np.asarray(X_OH, np.float64), np.asarray(q, np.float64)
    check_shape("X_OH", X_OH.shape, (None, 4, 4))
    check_shape("q", q.shape, (len(X_OH), hand.num_dofs))
    if len(q) < 2:
        raise InputError(f"diversity needs at least 2 grasps; got {len(q)}.")
    X_OP = X_OH @ hand.X_HP
    R_OP = X_OP[:, :3, :3]
    unit = (q - hand.tree.lower) / (hand.tree.upper - hand.tree.lower)
    features = np.concatenate([X_OP[:, :3, 3] / length, R_OP.reshape(-1, 9), unit], axis=1)
    variance = np.linalg.svd(features - features.mean(axis=0), compute_uv=False) ** 2
    total = variance.sum()
    approach = R_OP[:, :, 2]
    return Diversity(
        explained=variance / total if total > 1e-20 * len(q) else np.zeros_like(variance),  # less is rounding
        entropy_bits=_entropy_bits(unit),
        approach_coverage=approach_coverage(approach),
        nearest_approach_rad=_median_nearest(_angles_between(approach)),
        nearest_rotation_rad=_median_nearest(_rotations_between(R_OP, is_jaw=hand.is_jaw)),
    )


def approach_coverage(approach_O: np.ndarray) -> float:
    """Share of 200 directions within 30 degrees of one of the unit vectors `approach_O` (N, 3); 0 for none."""
    approach_O = np.asarray(approach_O, np.float64)
    check_shape("approach_O", approach_O.shape, (None, 3))
    near = (_sphere_directions(DIRECTIONS) @ approach_O.T).max(axis=1, initial=-np.inf)
    return float((near >= np.cos(COVER_RAD)).mean())


def _sphere_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors of a Fibonacci lattice: each stands for about the same area."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, k * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def _entropy_bits(unit: np.ndarray) -> float:
    """Mean over the columns of the entropy of their values, which lie in [0, 1]."""
    bits = []
    for column in np.clip(unit, 0.0, 1.0).T:
        share = np.histogram(column, bins=ENTROPY_BINS, range=(0.0, 1.0))[0] / len(column)
        share = share[share > 0]
        bits.append(-(share * np.log2(share)).sum())
    return float(np.mean(bits)) if bits else 0.0


def _angles_between(vectors: np.ndarray) -> np.ndarray:
    """(N, N) angles of unit vectors, exact also where they are nearly equal (an arc cosine is not)."""
    apart = np.linalg.norm(vectors[:, None] - vectors[None], axis=-1)
    return 2.0 * np.arcsin(np.minimum(apart / 2.0, 1.0))


def _rotations_between(R: np.ndarray, *, is_jaw: bool) -> np.ndarray:
    """(N, N) angles of the rotations between N orientations (3, 3)."""

    def angles(turned: np.ndarray) -> np.ndarray:
        apart = np.linalg.norm((R[:, None] - turned[None]).reshape(len(R), len(R), 9), axis=-1)
        return 2.0 * np.arcsin(np.minimum(apart / np.sqrt(8.0), 1.0))  # |R - S| = 2 sqrt(2) sin(angle / 2)

    return np.minimum(angles(R), angles(R * [-1.0, -1.0, 1.0])) if is_jaw else angles(R)


def _median_nearest(angles: np.ndarray) -> float:
    apart = angles.copy()
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))
