"""Pinhole cameras in the OpenCV convention: x right, y down, z forward; the centre of the first pixel is (0, 0)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, ShapeError


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera without distortion: u = fx * x / z + cx, v = fy * y / z + cy, in pixels.

    Attributes:
        fx, fy: focal lengths, pixels, > 0.
        cx, cy: principal point, pixels; integer coordinates are pixel centres.
        width, height: image size, pixels.
    Raises:
        InputError: a focal length or a size that is not positive and finite.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not all(math.isfinite(n) for n in numbers) or min(self.fx, self.fy) <= 0:
            raise InputError(f"camera fx, fy, cx, cy are {numbers}; expected finite numbers with fx and fy above 0.")
        if min(self.width, self.height) < 1:
            raise InputError(f"camera image is {self.width} x {self.height}; expected at least 1 x 1 pixels.")

    @staticmethod
    def from_fov(fov_y_rad: float, width: int, height: int) -> Intrinsics:
        """Square pixels, principal point in the middle, vertical field of view `fov_y_rad` (0 < fov < pi)."""
        if not 0 < fov_y_rad < math.pi:
            raise InputError(f"field of view is {fov_y_rad} rad; expected between 0 and pi.")
        focal = 0.5 * height / math.tan(0.5 * fov_y_rad)
        return Intrinsics(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) float64 camera matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def scaled(self, factor: int) -> Intrinsics:
        """The same view with `factor` x `factor` samples in place of every pixel."""
        shift = 0.5 * (factor - 1)
        return Intrinsics(
            self.fx * factor,
            self.fy * factor,
            self.cx * factor + shift,
            self.cy * factor + shift,
            self.width * factor,
            self.height * factor,
        )


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray | tuple[float, float, float] = (0, 0, 1)) -> np.ndarray:
    """Pose of a camera at `eye` that looks at `target`, its image upright with respect to `up`.

    Args:
        eye, target: (3,) world frame, metres, apart from each other.
        up: (3,) world direction shown upwards; when it is parallel to the view, another one is chosen.
    Returns:
        (4, 4) float64 X_WC.
    Raises:
        InputError: `eye` equals `target`, or `up` is zero.
    """
    eye, target, up = (np.asarray(a, np.float64) for a in (eye, target, up))
    forward = target - eye
    distance = float(np.linalg.norm(forward))
    if not distance > 0 or not np.linalg.norm(up) > 0:
        raise InputError(f"look_at got eye {eye}, target {target}, up {up}; expected eye != target and a non-zero up.")
    z = forward / distance
    x = np.cross(z, up / np.linalg.norm(up))
    if np.linalg.norm(x) < 1e-6:
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    X_WC = np.eye(4)
    X_WC[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    X_WC[:3, 3] = eye
    return X_WC


def pixel_rays(intrinsics: Intrinsics) -> np.ndarray:
    """(height, width, 3) float64 directions through the pixel centres, camera frame, with z = 1."""
    k = intrinsics
    rays = np.ones((k.height, k.width, 3))
    rays[..., 0] = (np.arange(k.width) - k.cx) / k.fx
    rays[..., 1] = ((np.arange(k.height) - k.cy) / k.fy)[:, None]
    return rays


def back_project(depth: np.ndarray, intrinsics: Intrinsics, *, mask: np.ndarray | None = None) -> np.ndarray:
    """Points seen by a depth image.

    Args:
        depth: (height, width) z-depth in metres; zero, negative, infinite and NaN pixels hold no measurement.
        mask: (height, width) bool, pixels to keep; all when None.
    Returns:
        (M, 3) float64 points, camera frame, metres, in row-major pixel order.
    Raises:
        ShapeError: `depth` or `mask` is not of the camera's size.
    """
    expected = (intrinsics.height, intrinsics.width)
    for name, array in (("depth", depth), ("mask", mask)):
        if array is not None and np.shape(array) != expected:
            raise ShapeError(f"{name} has shape {np.shape(array)}; the camera's images are {expected} (height, width).")
    z = np.asarray(depth, np.float64)
    valid = np.isfinite(z) & (z > 0)
    if mask is not None:
        valid &= np.asarray(mask, bool)
    row, column = np.nonzero(valid)
    z = z[row, column]
    x = (column - intrinsics.cx) / intrinsics.fx * z
    y = (row - intrinsics.cy) / intrinsics.fy * z
    return np.stack([x, y, z], axis=1)


def project(points_C: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Pixel coordinates (u along columns, v along rows) of points.

    Args:
        points_C: (..., 3) camera frame, metres.
    Returns:
        (..., 2) float64 (u, v); NaN for points at or behind the camera (z <= 0).
    """
    points_C = np.asarray(points_C, np.float64)
    if points_C.shape[-1:] != (3,):
        raise ShapeError(f"points_C has shape {points_C.shape}; expected (..., 3).")
    z = np.where(points_C[..., 2] > 0, points_C[..., 2], np.nan)
    u = intrinsics.fx * points_C[..., 0] / z + intrinsics.cx
    v = intrinsics.fy * points_C[..., 1] / z + intrinsics.cy
    return np.stack([u, v], axis=-1)
