"""The `Frame` noun: one depth image with its camera, and a colour image and a camera pose where they are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, ShapeError, check_shape
from neuralgrasps.geometry.camera import Intrinsics, pixel_rays
from neuralgrasps.geometry.plane import Plane

_NEAREST_M, _FARTHEST_M = 0.02, 20.0
_AT_REST_M, _AT_REST_DEG = 1e-3, 0.1  # a camera that moves less between frames is at rest
_NAMED = 6  # frames named in a message


@dataclass(frozen=True, slots=True)
class Frame:
    """What one depth camera saw at one moment.

    Attributes:
        depth: (h, w) z-depth, metres; 0 where nothing was measured. Given NaN, infinite and negative pixels become 0.
        intrinsics: the camera; its size is the image's.
        colour: (h, w, 3) uint8 red, green, blue, pixel by pixel on the depth image; None when there is none.
        X_WC: (4, 4) pose of the camera in the world, world z up; None when unknown.
        name: said in messages and file names.
    Raises:
        ShapeError: images of different sizes, or not of the camera's.
        InputError: no pixel was measured; a depth that cannot be in metres; a principal point far outside the image or
            a focal length that cannot be in pixels; a camera pose that is not a rigid motion.
    """

    depth: np.ndarray
    intrinsics: Intrinsics
    colour: np.ndarray | None = None
    X_WC: np.ndarray | None = None
    name: str = "frame"

    def __post_init__(self) -> None:
        object.__setattr__(self, "depth", _checked_depth(self.depth, self.intrinsics, self.name))
        _check_camera(self.intrinsics, self.name)
        if self.colour is not None:
            object.__setattr__(self, "colour", _checked_colour(self.colour, self.depth.shape, self.name))
        if self.X_WC is not None:
            object.__setattr__(self, "X_WC", checked_pose(self.X_WC, f"camera pose X_WC of '{self.name}'"))

    @property
    def points(self) -> np.ndarray:
        """(h, w, 3) float64 measured points, camera frame, metres; NaN where nothing was measured."""
        return pixel_rays(self.intrinsics) * np.where(self.depth > 0, self.depth, np.nan)[..., None]

    def height(self, plane: Plane) -> np.ndarray:
        """(h, w) float64 height of every pixel above a plane of the camera frame; NaN where nothing was measured."""
        k, n = self.intrinsics, plane.normal
        along = (np.arange(k.width) - k.cx) * (n[0] / k.fx)
        down = (np.arange(k.height) - k.cy) * (n[1] / k.fy) + n[2]
        height = (along + down[:, None]) * self.depth + plane.offset_m
        height[self.depth == 0] = np.nan
        return height


def camera_poses(frames: Sequence[Frame]) -> np.ndarray:
    """(T, 4, 4) the cameras of T frames in the world; identities, a camera at rest, where no frame says.

    Where only some say, and all the same, the camera is at rest there.

    Raises:
        InputError: only some frames say, and the camera moves between them.
    """
    known = [f.X_WC for f in frames if f.X_WC is not None]
    if not known:
        return np.tile(np.eye(4), (len(frames), 1, 1))
    poses = np.stack(known)
    if len(known) == len(frames):
        return poses
    shift_m, turn_deg = _largest_motion(poses)
    if shift_m > _AT_REST_M or turn_deg > _AT_REST_DEG:
        without = [f"{n} ('{f.name}')" for n, f in enumerate(frames) if f.X_WC is None]
        named = ", ".join(without[:_NAMED]) + (f" and {len(without) - _NAMED} more" if len(without) > _NAMED else "")
        raise InputError(
            f"the camera moves (by {1e3 * shift_m:.0f} mm and {turn_deg:.1f} degrees), but {len(without)} of "
            f"{len(frames)} frames have no camera pose X_WC: {named}. Leave these frames out, or give their poses."
        )
    return np.tile(poses[0], (len(frames), 1, 1))


def _largest_motion(X: np.ndarray) -> tuple[float, float]:
    """How far poses (T, 4, 4) are from the first at most: metres, degrees."""
    between = np.linalg.inv(X[0]) @ X
    turn = 2.0 * np.arcsin(
        np.clip(np.linalg.norm(between[:, :3, :3] - np.eye(3), axis=(1, 2)) / np.sqrt(8.0), 0.0, 1.0)
    )
    return float(np.linalg.norm(between[:, :3, 3], axis=1).max()), float(np.rad2deg(turn.max()))


def checked_pose(X: np.ndarray, what: str) -> np.ndarray:
    """(4, 4) float64 rigid motion nearest to a matrix that is one to a thousandth.

    Args:
        X: (4, 4), or (3, 4) without the last row.
        what: named in messages.
    Raises:
        InputError: of another shape, not finite, or not a rotation and a translation.
    """
    X = np.asarray(X)
    if X.shape not in {(4, 4), (3, 4)} or X.dtype.kind not in "fiu":
        raise InputError(f"{what} is {X.dtype} of shape {X.shape}; expected a 4 x 4 matrix of numbers.")
    X = X.astype(np.float64)
    if not np.isfinite(X).all():
        raise InputError(f"{what} holds numbers that are not finite.")
    if X.shape == (4, 4) and np.abs(X[3] - [0, 0, 0, 1]).max() > 1e-6:
        hint = " Transpose it: the translation belongs in the last column." if np.abs(X[:3, 3]).max() < 1e-9 else ""
        raise InputError(f"{what} has the last row {np.round(X[3], 4).tolist()}; expected 0 0 0 1.{hint}")
    rotation = X[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    determinant = float(np.linalg.det(rotation))
    if off > 1e-3 and determinant > 0:
        raise InputError(
            f"{what} is not rigid: its rotation times the transpose is {off:.2g} off the identity. Remove scale and "
            "shear from the upper left 3 x 3 numbers."
        )
    if determinant <= 0:
        raise InputError(
            f"{what} has a rotation of determinant {determinant:.3g}, a reflection or no rotation; expected 1. The "
            "camera frame is x right, y down, z forward, right-handed: check the signs of the columns."
        )
    left, _, right = np.linalg.svd(rotation)
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = left @ right, X[:3, 3]
    return out


def _checked_depth(depth: np.ndarray, intrinsics: Intrinsics, name: str) -> np.ndarray:
    depth = np.asarray(depth)
    expected = (intrinsics.height, intrinsics.width)
    if depth.shape != expected or depth.dtype.kind not in "fiu":
        raise ShapeError(
            f"depth of '{name}' is {depth.dtype} of shape {depth.shape}; the camera's images are {expected[0]} x "
            f"{expected[1]} (height x width), one number per pixel."
        )
    depth = depth.astype(np.float64)
    depth[~(np.isfinite(depth) & (depth > 0))] = 0.0
    measured = depth[depth > 0]
    if not len(measured):
        raise InputError(f"depth of '{name}' holds no measurement: every pixel is 0, negative or not finite.")
    median = float(np.median(measured))
    if not _NEAREST_M <= median <= _FARTHEST_M:
        cause = (
            "millimetres were read as metres, or the scale is too small"
            if median > _FARTHEST_M
            else "metres were read as millimetres, or the scale is too large"
        )
        raise InputError(
            f"depth of '{name}' has a median of {median:.4g} m; expected {_NEAREST_M} to {_FARTHEST_M:.0f} m. "
            f"Probably {cause}: give the units per metre with --depth-scale (1000 for millimetres, 1 for metres)."
        )
    return depth


def _check_camera(k: Intrinsics, name: str) -> None:
    if not (-k.width <= k.cx <= 2 * k.width and -k.height <= k.cy <= 2 * k.height):
        raise InputError(
            f"principal point of '{name}' is ({k.cx:g}, {k.cy:g}), far outside its {k.width} x {k.height} image; "
            "expected pixels near the middle. Were cx and cy given for another image size?"
        )
    if min(k.fx / k.width, k.fy / k.height) < 0.05:
        raise InputError(
            f"focal lengths of '{name}' are {k.fx:g} and {k.fy:g} pixels, too short for its {k.width} x {k.height} "
            "image; expected about its width. Millimetres or shares of the width must be turned into pixels."
        )


def _checked_colour(colour: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    colour = np.asarray(colour)
    check_shape(f"colour of '{name}'", colour.shape[-1:], (3,))
    if colour.shape[:-1] != shape:
        raise ShapeError(
            f"colour of '{name}' is {' x '.join(map(str, colour.shape[-2::-1]))} pixels but its depth image "
            f"{shape[1]} x {shape[0]} (width x height); expected colour registered to depth, pixel by pixel."
        )
    if colour.dtype != np.uint8:
        raise InputError(f"colour of '{name}' is {colour.dtype}; expected uint8, 0 to 255.")
    return colour
