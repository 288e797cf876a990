"""The balance of the published training draw: half the points positive to either shape, half non-positive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import ShapeError


@dataclass(frozen=True, slots=True, kw_only=True)
class SignLists:
    """For each of N scenes of M points, the points of either sign, as orders of all its points.

    A point outside one shape and inside the other is in both lists, and every point is in at least one. A draw is
    index arithmetic alone: with u uniform in [0, 1), `positive[scene, floor(u * positive_count[scene])]`.

    Attributes:
        positive: (N, M) int32 permutation of 0 .. M - 1 a row: first, ascending, the points with a positive signed
            distance to either shape (outside at least one), then, ascending, all others.
        positive_count: (N,) int32 length of that first part.
        non_positive, non_positive_count: the same for points with a non-positive distance to either shape (inside or
            on at least one).
    """

    positive: np.ndarray
    positive_count: np.ndarray
    non_positive: np.ndarray
    non_positive_count: np.ndarray


def sign_lists(sdf_object: np.ndarray, sdf_hand: np.ndarray) -> SignLists:
    """Where a trainer may draw from so that half its points are positive to either shape and half non-positive.

    Args:
        sdf_object, sdf_hand: (N, M) signed distances of the same points to both shapes, negative inside, any unit.
    Raises:
        ShapeError: they are not two arrays of the same shape (N, M).

    Source:
        Khargonkar et al. 2022, published training code.
    """
    sdf_object, sdf_hand = np.asarray(sdf_object), np.asarray(sdf_hand)
    if sdf_object.ndim != 2 or sdf_object.shape != sdf_hand.shape:
        raise ShapeError(
            f"sdf_object has shape {sdf_object.shape} and sdf_hand {sdf_hand.shape}; expected the same (N, M) for both."
        )
    positive, positive_count = _order((sdf_object > 0) | (sdf_hand > 0))
    non_positive, non_positive_count = _order((sdf_object <= 0) | (sdf_hand <= 0))
    return SignLists(
        positive=positive,
        positive_count=positive_count,
        non_positive=non_positive,
        non_positive_count=non_positive_count,
    )


def _order(member: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, M) int32 members first, each part ascending, and (N,) int32 how many they are."""
    order = np.argsort(~member, axis=1, kind="stable").astype(np.int32)
    return order, member.sum(axis=1, dtype=np.int32)


def balanced_draw(lists: SignLists, uniform: np.ndarray) -> np.ndarray:
    """Indices (N, K) int64 of drawn points: the first half of each row positive to either shape, the rest non-positive.

    The plain statement of the draw; trainers repeat it on their device. Where a scene has no point of one kind, all
    its points are of the other, and both halves are drawn from them.

    Args:
        lists: of N scenes.
        uniform: (N, K) independent numbers in [0, 1).
    Raises:
        ShapeError: `uniform` does not have one row per scene.
    """
    scenes, points = lists.positive.shape
    if uniform.ndim != 2 or len(uniform) != scenes:
        raise ShapeError(f"uniform has shape {uniform.shape}; expected ({scenes}, K), a row per scene.")
    half = (uniform.shape[1] + 1) // 2
    drawn = []
    for order, count, u in (
        (lists.positive, lists.positive_count, uniform[:, :half]),
        (lists.non_positive, lists.non_positive_count, uniform[:, half:]),
    ):
        length = np.where(count > 0, count, points)[:, None]
        place = np.minimum((u * length).astype(np.int64), length - 1)
        drawn.append(np.take_along_axis(order, place, axis=1))
    return np.concatenate(drawn, axis=1).astype(np.int64)
