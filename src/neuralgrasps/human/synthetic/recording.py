"""The noun `RecordedDemonstration`: the video of a hand that grasps an object, and what is exactly so in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.human.seen import Side
from neuralgrasps.perception.frame import Frame

UNITS_PER_METRE = 10000
"""Of the stored depth: whole tenths of a millimetre."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DemonstrationTruth:
    """What is exactly so in the T frames of a demonstration; C is the camera of all of them.

    Attributes:
        object: its name. side, scale: of the hand. kind: "power" or "precision".
        X_CO: (T, 4, 4) the object. X_CH: (T, 4, 4) the hand's base (wrist); q: (T, 20) joints, rad.
        joints_C: (T, 21, 3) joints of the hand, metres.
        hand_mask: (T, h, w) bool, pixels that show the hand (not the arm).
        visible: (T,) share of the hand's outline, parts outside the image included, that is seen in the image.
        still: first frame of the closed hand that keeps still, and the first after these; grasp_frame: their middle.
        X_OH: (4, 4) the grasp.
        notes: sizes and resting poses that were drawn first, and why they gave no grasp; what stands before the hand.
    """

    object: str
    side: Side
    scale: float
    kind: str
    X_CO: np.ndarray
    X_CH: np.ndarray
    q: np.ndarray
    joints_C: np.ndarray
    hand_mask: np.ndarray
    visible: np.ndarray
    still: tuple[int, int]
    grasp_frame: int
    X_OH: np.ndarray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedDemonstration:
    """A demonstration as a camera recorded it, and the truth.

    Attributes:
        depth_units: (T, h, w) uint16 z-depth in tenths of a millimetre, 0 = nothing measured.
        colour: (T, h, w, 3) uint8.
        intrinsics: the camera; X_WC: (4, 4) its pose, world z up, the table at z = 0.
        rate_hz: frames per second. seed: what it was made with.
    """

    depth_units: np.ndarray
    colour: np.ndarray
    intrinsics: Intrinsics
    X_WC: np.ndarray
    rate_hz: float
    seed: int
    truth: DemonstrationTruth

    def __len__(self) -> int:
        return len(self.depth_units)

    def frame(self, index: int) -> Frame:
        """One frame, as read from files."""
        return Frame(
            depth=self.depth_units[index] / float(UNITS_PER_METRE), intrinsics=self.intrinsics,
            colour=self.colour[index], X_WC=self.X_WC, name=f"{index:06d}",
        )  # fmt: skip

    @property
    def frames(self) -> list[Frame]:
        """All frames; each holds its depth in float64, 2.4 MB at 640 x 480."""
        return [self.frame(i) for i in range(len(self))]
