"""A table under the object: which hands, and which straight ways out of them, stay clear of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.hands.chains import moved_links
from neuralgrasps.hands.extent import lowest_height
from neuralgrasps.hands.hand import Hand
from neuralgrasps.synthesis.jaw import leaves_room
from neuralgrasps.synthesis.squeeze import pregrasp_joints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Support:
    """The plane that an object lies on, and how far hands keep from it.

    Attributes:
        plane: in the object frame O, its normal up, away from the table.
        clearance_m: least height of any point of the hand above the plane.
        retreat_m: way that the hand goes back, straight along its approach axis (the palm's z, backwards), without
            coming nearer to the plane than that.
    """

    plane: Plane
    clearance_m: float = 0.003
    retreat_m: float = 0.10

    def __post_init__(self) -> None:
        if not (np.isfinite(self.clearance_m) and self.clearance_m >= 0):
            raise InputError(f"support: clearance_m is {self.clearance_m}; expected 0 or more, metres.")
        if not (np.isfinite(self.retreat_m) and self.retreat_m >= 0):
            raise InputError(f"support: retreat_m is {self.retreat_m}; expected 0 or more, metres.")

    def least_height(
        self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, *, links: Iterable[int] | None = None
    ) -> np.ndarray:
        """(N,) height of the lowest point of rigid hands on their whole way back, metres; exact.

        A straight way through a half space is lowest at one of its ends.

        Args:
            X_OH: (N, 4, 4); q: (N, J) joints, kept all the way. links: only these; default all.
        """
        rise = self.retreat_m * self.steepness(hand, X_OH)
        return lowest_height(hand, X_OH, q, self.plane, links=links) + np.minimum(rise, 0.0)

    def steepness(self, hand: Hand, X_OH: np.ndarray) -> np.ndarray:
        """(N,) how steeply hands come down, 1 straight from above, 0 level, negative from below."""
        return -(X_OH[:, :3, :3] @ hand.X_HP[:3, 2]) @ self.plane.normal

    def clears(self, hand: Hand, X_OH: np.ndarray, *postures: np.ndarray) -> np.ndarray:
        """(N,) bool: hands at X_OH (N, 4, 4) keep their distance all the way back in each of the postures (N, J)."""
        clear = np.ones(len(X_OH), bool)
        for q in postures:
            clear &= self.least_height(hand, X_OH, q) >= self.clearance_m
        return clear

    def clears_open(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
        """`clears` of what closing does not move: the rest may still leave the plane, or come nearer, on the way."""
        moving = moved_links(hand.tree)[:, hand.closing_rate != 0].any(axis=1)
        return self.least_height(hand, X_OH, q, links=np.flatnonzero(~moving)) >= self.clearance_m

    def allows(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None) -> np.ndarray:
        """(N,) bool: hands clear the plane, closed and before closing, and jaws can be put over the object.

        Args:
            q: (N, J) closed; q_pregrasp: (N, J) before; default a little more open.
        """
        before = pregrasp_joints(hand, q) if q_pregrasp is None else q_pregrasp
        return self.clears(hand, X_OH, q, before) & leaves_room(hand, q)

    def __str__(self) -> str:
        """For provenance."""
        x, y, z = self.plane.normal
        return (
            f"normal {x:.6f} {y:.6f} {z:.6f} offset {self.plane.offset_m:.6f} m, clearance {self.clearance_m:g} m, "
            f"retreat {self.retreat_m:g} m"
        )
