"""The hand that fits work on: the right one of size 1, in arrays. A left hand is fitted as its mirror image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.hands.variants import mirror_matrix
from neuralgrasps.human.seen import Side
from neuralgrasps.human.skeleton import Skeleton, human_hand, skeleton
from neuralgrasps.model.fit_prior import spread_points

FLIP_X = np.diag([-1.0, 1.0, 1.0, 1.0])
"""What turns camera coordinates into those of the mirrored image, and back."""

_SPACING_M = 0.004
_PROBES = 160


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RightHand:
    """The right hand of size 1: `packed` with surface points, its `bones`, and spread surface points, by link.

    Attributes:
        probe_L: (K, 3) in the frames of their links `probe_link` (K,).
    """

    packed: PackedHand
    bones: Skeleton
    probe_L: np.ndarray
    probe_link: np.ndarray


@cache
def right_hand() -> RightHand:
    """The right hand of size 1, made once."""
    hand = human_hand("right")
    packed = pack_hand(hand, spacing=_SPACING_M)
    probe = spread_points(packed, _PROBES)
    return RightHand(
        packed=packed, bones=skeleton(hand), probe_L=packed.point_L[probe], probe_link=packed.point_link[probe]
    )


def righted(X_CH: np.ndarray, side: Side) -> np.ndarray:
    """The pose of the right hand in the mirrored image, of a hand in the image; and the other way round."""
    if side == "right":
        return np.array(X_CH, np.float64)
    return FLIP_X @ X_CH @ mirror_matrix(human_hand("right"))
