"""What a hand that touches the object says about its pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, check_shape


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactPoints:
    """Points of a hand of known pose that touch the object.

    Attributes:
        points_C: (K, 3) camera frame, metres, K >= 1.
        sigma_m: how far, in the standard deviation, they may be off: calibration of the arm, and the pads.
    Raises:
        InputError: no points, points that are not finite, or a deviation that is not positive.
    """

    points_C: np.ndarray
    sigma_m: float = 0.003

    def __post_init__(self) -> None:
        check_shape("contact points_C", np.shape(self.points_C), (3,))
        points = np.asarray(self.points_C, np.float64).reshape(-1, 3)
        if not len(points) or not np.isfinite(points).all():
            raise InputError(f"{len(points)} contact points were given, not all finite; expected at least one.")
        if not 0.0 < self.sigma_m < 0.05:
            raise InputError(f"sigma_m of the contacts is {self.sigma_m}; expected above 0 and below 0.05 m.")
