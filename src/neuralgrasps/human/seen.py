"""What is seen of a hand in a frame: its box, its joints, and the hand model fitted to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.skeleton import human_hand

Side = Literal["right", "left"]


@dataclass(frozen=True, slots=True, kw_only=True)
class HandBox:
    """A hand found in an image.

    Attributes:
        u_min, v_min, u_max, v_max: edges of its box, pixels of the full image (u to the right, v down).
        score: how sure it is that a hand is there, 0 to 1.
        side: right or left; side_score: how sure that is, 0.5 to 1.
    """

    u_min: float
    v_min: float
    u_max: float
    v_max: float
    score: float
    side: Side
    side_score: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenJoints:
    """The 21 joints of a hand as seen in one frame.

    Attributes:
        points_C: (21, 3) camera frame, metres, order of `skeleton.JOINT_NAMES`; nan for a joint that is not known.
        weight: (21,) how far each can be trusted, 0 to 1.
        mask: (h, w) bool, pixels of the full image that show the hand (not what it holds); None when not known.
        side: right or left.
        source: what they come from, for messages: "depth net", a file's name.
    """

    points_C: np.ndarray
    weight: np.ndarray
    mask: np.ndarray | None
    side: Side
    source: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedHand:
    """The human hand model posed as in one frame.

    Attributes:
        X_CH: (4, 4) base (wrist) in the camera frame; q: (20,) joints, rad; scale: size, 1 = the built-in model.
        side: right or left; the model is `hand`.
        joints_C: (21, 3) its joints, metres.
        cloud_rms_m: root mean square distance of the depth points used to its surface, outliers set aside; nan if none.
        joint_rms_m: the same of the seen joints to its joints.
        penetration_m: how deep it is in the object, where one was given.
        confidence: 0 to 1, how far the fit can be trusted. reasons: what speaks against it, in words.
    """

    X_CH: np.ndarray
    q: np.ndarray
    scale: float
    side: Side
    joints_C: np.ndarray
    cloud_rms_m: float
    joint_rms_m: float
    penetration_m: float
    confidence: float
    reasons: tuple[str, ...] = ()

    @property
    def hand(self) -> Hand:
        """The hand model of this size and side."""
        return scaled_hand(human_hand(self.side), self.scale)
