"""Planes: a unit normal and an offset, in any one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.se3_numpy import make_transform_np


@dataclass(frozen=True, slots=True)
class Plane:
    """The points p with normal . p + offset_m = 0; heights count along the normal.

    Attributes:
        normal: (3,) float64 unit normal; of a table, the direction up.
        offset_m: height of the frame's origin above the plane, metres.
    Raises:
        InputError: a normal that is not of unit length, or numbers that are not finite.
    """

    normal: np.ndarray
    offset_m: float

    def __post_init__(self) -> None:
        check_shape("normal", np.shape(self.normal), (3,))
        length = float(np.linalg.norm(self.normal))
        if not (abs(length - 1.0) < 1e-6 and np.isfinite(self.offset_m)):
            raise InputError(f"a plane's normal has length {length} and offset {self.offset_m}; expected 1 and finite.")

    def height(self, points: np.ndarray) -> np.ndarray:
        """Signed height of points (..., 3) above the plane, metres; (...) float64."""
        return np.asarray(points, np.float64) @ self.normal + self.offset_m

    def moved(self, X_AB: np.ndarray) -> Plane:
        """The plane of frame B as seen in frame A, given X_AB (4, 4)."""
        normal = X_AB[:3, :3] @ self.normal
        return Plane(normal / np.linalg.norm(normal), float(self.offset_m - normal @ X_AB[:3, 3]))


def standing_on(plane_O: Plane) -> np.ndarray:
    """X_WO (4, 4) that puts a plane of O at z = 0, its normal up, and O's origin above W's."""
    z = np.asarray(plane_O.normal, np.float64)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return make_transform_np(np.stack([x, np.cross(z, x), z]), [0.0, 0.0, float(plane_O.offset_m)])


def horizontal_plane(height_m: float, X_WC: np.ndarray) -> Plane:
    """The plane z = `height_m` of the world in the frame of a camera at `X_WC` (4, 4)."""
    return Plane(np.array([0.0, 0.0, 1.0]), -height_m).moved(np.linalg.inv(X_WC))
