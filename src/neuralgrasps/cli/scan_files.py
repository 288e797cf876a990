"""Point clouds, depth images and masks from the files that cameras and tools write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from neuralgrasps.errors import InputError

_TEXT = (".xyz", ".txt", ".csv", ".pts")


def read_cloud(path: Path) -> np.ndarray:
    """(M, 3) float64 points of a PLY, NPY or text file (x y z per line, further columns are left out), as stored.

    Raises:
        InputError: missing, unreadable, or not points.
    """
    _check_exists(path, "point cloud")
    kind = path.suffix.lower()
    try:
        if kind == ".npy":
            points = np.load(path, allow_pickle=False)
        elif kind in _TEXT:
            lines = path.read_text(encoding="utf-8", errors="replace").replace(",", " ").splitlines()
            points = np.array(
                [line.split()[:3] for line in lines if line.strip() and line.lstrip()[0] in "+-.0123456789n"], float
            )
        elif kind == ".ply":
            points = _ply_points(path)
        else:
            raise InputError(f"point cloud '{path}' is of kind '{kind}'; expected .ply, .npy, {', '.join(_TEXT)}.")
    except (ValueError, EOFError, OSError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"point cloud '{path}' cannot be read: {_first_line(error)}.") from error
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise InputError(f"point cloud '{path}' holds {points.dtype} of shape {points.shape}; expected numbers (M, 3).")
    return points[:, :3].astype(np.float64)


def _ply_points(path: Path) -> np.ndarray:
    import trimesh

    try:
        loaded = trimesh.load(path, process=False)
    except Exception as error:  # the reader raises whatever its parser raises
        raise InputError(f"point cloud '{path}' cannot be read as PLY: {_first_line(error)}.") from error
    return np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), np.float64)


def read_depth(path: Path, units_per_metre: float | None) -> np.ndarray:
    """(h, w) float64 depth in metres, 0 = nothing measured.

    Args:
        path: 16-bit PNG or TIFF, or a NPY file.
        units_per_metre: of the file; None for 1000 (millimetres) in whole numbers, 1 in floating ones.
    Raises:
        InputError: missing, unreadable, or not a depth image.
    """
    _check_exists(path, "depth image")
    image = np.load(path, allow_pickle=False) if path.suffix.lower() == ".npy" else _image(path, "depth image")
    if image.ndim != 2 or image.dtype.kind not in "fiu":
        raise InputError(
            f"depth image '{path}' holds {image.dtype} of shape {image.shape}; expected one channel (height, width)."
        )
    if image.dtype == np.uint8:
        raise InputError(f"depth image '{path}' has 8 bits per pixel; expected 16 bits or floating point.")
    if units_per_metre is None:
        units_per_metre = 1.0 if image.dtype.kind == "f" else 1000.0
    if not units_per_metre > 0:
        raise InputError(f"--depth-scale is {units_per_metre}; expected units per metre, such as 1000 for millimetres.")
    depth = image.astype(np.float64) / units_per_metre
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0.0)


def read_mask(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool, the pixels of a mask image that are not 0.

    Raises:
        InputError: missing, unreadable, or of another size than the depth image.
    """
    _check_exists(path, "mask")
    mask = np.load(path, allow_pickle=False) if path.suffix.lower() == ".npy" else _image(path, "mask")
    mask = mask if mask.ndim == 2 else mask[..., :3].max(axis=-1)
    if mask.shape != shape:
        raise InputError(
            f"mask '{path}' is {mask.shape[1]} x {mask.shape[0]}; the depth image {shape[1]} x {shape[0]}."
        )
    return mask > 0


def _image(path: Path, what: str) -> np.ndarray:
    try:
        with Image.open(path) as image:
            return np.asarray(image)
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise InputError(f"{what} '{path}' cannot be read: {_first_line(error)}.") from error


def _check_exists(path: Path, what: str) -> None:
    if not path.is_file():
        raise InputError(f"{what} '{path}' does not exist.")
    if path.stat().st_size == 0:
        raise InputError(f"{what} '{path}' is empty (0 bytes).")


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200].rstrip(".") if lines else type(error).__name__
