"""The 21 joints of a hand, in the order that hand trackers use, on the human hand model of any size and side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.hands.hand import Hand, PartKind
from neuralgrasps.hands.variants import mirrored_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

JOINT_NAMES = (
    "wrist",
    "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip",
    "index_mcp", "index_pip", "index_dip", "index_tip",
    "middle_mcp", "middle_pip", "middle_dip", "middle_tip",
    "ring_mcp", "ring_pip", "ring_dip", "ring_tip",
    "little_mcp", "little_pip", "little_dip", "little_tip",
)  # fmt: skip
NUM_JOINTS = len(JOINT_NAMES)
WRIST = 0
TIPS = (4, 8, 12, 16, 20)
BONES = tuple((0 if k % 4 == 1 else k - 1, k) for k in range(1, NUM_JOINTS))
"""Pairs of joints to draw lines between."""

SMALLEST, LARGEST = 0.66, 0.92
"""Sizes of people's hands as scales of the model: 166 to 232 mm from wrist to middle fingertip."""

_FINGERS = ("thumb", "index", "middle", "ring", "little")


@dataclass(frozen=True, slots=True, kw_only=True)
class Skeleton:
    """Where the 21 joints sit on a hand.

    Attributes:
        links: (21,) int32 the link that each joint is fixed to; points_L: (21, 3) its place there, metres.
    """

    links: np.ndarray
    points_L: np.ndarray


def skeleton(hand: Hand) -> Skeleton:
    """The joints of the built-in human hand, or of one scaled or mirrored.

    The wrist is the base's origin; a fingertip is where the last phalanx ends on its axis.

    Raises:
        InputError: another hand, without five fingers of these names.
    """
    if tuple(sorted(f.name for f in hand.fingers)) != tuple(sorted(_FINGERS)):
        names = ", ".join(f.name for f in hand.fingers)
        raise InputError(f"hand '{hand.name}' has the fingers {names}; expected {', '.join(_FINGERS)}: a human hand.")
    links, points = [0], [np.zeros(3)]
    for finger in _FINGERS:
        chain = next(f for f in hand.fingers if f.name == finger).links
        base, (middle, last) = chain[0], chain[2:4]
        links += [base, middle, last, last]
        points += [np.zeros(3), np.zeros(3), np.zeros(3), _tip(hand, last)]
    return Skeleton(links=np.array(links, np.int32), points_L=np.array(points))


def joint_points(hand: Hand, X_CH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(..., 21, 3) the joints of posed hands, in the frame that X_CH (..., 4, 4) maps into; q (..., 20)."""
    bones = skeleton(hand)
    X_HL = forward_numpy(hand.tree, q)[..., bones.links, :, :]
    points_H = (X_HL[..., :3, :3] @ bones.points_L[:, :, None])[..., 0] + X_HL[..., :3, 3]
    return points_H @ np.swapaxes(X_CH[..., :3, :3], -1, -2) + X_CH[..., None, :3, 3]


@cache
def human_hand(side: str = "right") -> Hand:
    """The built-in human hand at scale 1, right or left.

    Raises:
        InputError: another side.
    """
    if side not in ("right", "left"):
        raise InputError(f"side is '{side}'; expected 'right' or 'left'.")
    right = load_hand("human")
    return right if side == "right" else mirrored_hand(right)


def _tip(hand: Hand, link: int) -> np.ndarray:
    """(3,) the end of a link's capsule that is farther from the link's origin."""
    part = next(p for p in hand.parts if p.link == link and p.kind == PartKind.CAPSULE)
    ends = [part.X_LP[:3, 3] + sign * (part.size[1] + part.size[0]) * part.X_LP[:3, 2] for sign in (-1.0, 1.0)]
    return max(ends, key=lambda end: float(np.linalg.norm(end)))
