"""The square crop of a depth image round a hand's box, as the joint net reads it, and the way back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.camera import Intrinsics

CROP = 96
BOX_MARGIN = 1.2
"""A crop is so much wider than the longer side of the hand's box."""
DEPTH_UNIT_M = 0.1
_FARTHEST = 3.0  # of a depth from the reference, in units, that the net tells from others


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crop:
    """One crop.

    Attributes:
        inputs: (2, 96, 96) float32: depth from the reference in DEPTH_UNIT_M, at most 3 off and 0 where nothing was
            measured; 1 where something was.
        conditions: (4,) float32: width of the crop in metres at the reference depth; the slopes x / z and y / z of the
            ray through its middle; the reference depth, metres.
        u, v: middle, pixels of the image; side: width, pixels; depth_m: the reference depth.
        rows, columns: (96,) int64 pixels of the image that the crop's are; -1 beyond its edge.
    """

    inputs: np.ndarray
    conditions: np.ndarray
    u: float
    v: float
    side: float
    depth_m: float
    rows: np.ndarray
    columns: np.ndarray


def take_crop(
    depth: np.ndarray, intrinsics: Intrinsics, *, u: float, v: float, side: float, depth_m: float | None = None
) -> Crop | None:
    """The crop with its middle at (u, v), `side` pixels wide; None where nothing was measured in it.

    Args:
        depth: (h, w) metres, 0 where nothing was measured.
        depth_m: the reference depth; default the median of the middle of the crop.
    """
    k = intrinsics
    offsets = (np.arange(CROP) - 0.5 * (CROP - 1)) * (side / CROP)
    columns, rows = _within(u + offsets, k.width), _within(v + offsets * (k.fx / k.fy), k.height)
    seen = depth[np.maximum(rows, 0)[:, None], np.maximum(columns, 0)].astype(np.float32)
    seen[rows < 0] = 0.0
    seen[:, columns < 0] = 0.0
    z0 = middle_depth(seen) if depth_m is None else depth_m
    if not z0 > 0:
        return None
    inputs = np.empty((2, CROP, CROP), np.float32)
    fill_input(seen, z0, inputs)
    conditions = np.array([side * z0 / k.fx, (u - k.cx) / k.fx, (v - k.cy) / k.fy, z0], np.float32)
    return Crop(
        inputs=inputs, conditions=conditions, u=u, v=v, side=side, depth_m=float(z0), rows=rows, columns=columns
    )  # fmt: skip


def mirrored(crop: Crop) -> Crop:
    """What the mirrored image would give, x to -x: a left hand's crop as a right hand's."""
    conditions = crop.conditions * np.array([1.0, -1.0, 1.0, 1.0], np.float32)
    return replace(crop, inputs=np.ascontiguousarray(crop.inputs[:, :, ::-1]), conditions=conditions)


def turned(crop: Crop) -> Crop:
    """What the image turned by 180 degrees would give: x to -x and y to -y."""
    conditions = crop.conditions * np.array([1.0, -1.0, -1.0, 1.0], np.float32)
    return replace(crop, inputs=np.ascontiguousarray(crop.inputs[:, ::-1, ::-1]), conditions=conditions)


def crop_points(joints: np.ndarray, conditions: np.ndarray) -> np.ndarray:
    """Camera-frame points (..., K, 3), metres, of u, v, depth in a crop's units (..., K, 3); conditions (..., 4)."""
    width, x, y, z0 = (conditions[..., k, None] for k in range(4))
    z = z0 + DEPTH_UNIT_M * joints[..., 2]
    return np.stack([(x + joints[..., 0] * width / z0) * z, (y + joints[..., 1] * width / z0) * z, z], axis=-1)


def full_mask(crop: Crop, mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) bool: the crop's mask (96, 96) spread over the pixels of the image it stands for."""
    out = np.zeros(shape, bool)
    scale = CROP / crop.side
    columns = np.floor((np.arange(shape[1]) - crop.u) * scale + 0.5 * CROP).astype(np.int64)
    first = round(crop.v) - int(crop.side) - 2
    rows = np.arange(max(first, 0), min(first + 2 * int(crop.side) + 4, shape[0]))
    in_crop = np.floor((rows - crop.v) * scale + 0.5 * CROP).astype(np.int64)
    inside_u, inside_v = (columns >= 0) & (columns < CROP), (in_crop >= 0) & (in_crop < CROP)
    out[np.ix_(rows[inside_v], inside_u)] = mask[in_crop[inside_v]][:, columns[inside_u]]
    return out


def _within(places: np.ndarray, size: int) -> np.ndarray:
    nearest = np.floor(places + 0.5).astype(np.int64)
    nearest[(nearest < 0) | (nearest >= size)] = -1
    return nearest


@njit(cache=True, error_model="numpy")
def middle_depth(seen):  # type: ignore[no-untyped-def]
    """Median depth of the middle half of a crop (or of all of it, where nothing was measured there); 0 if none."""
    for first, last in ((CROP // 4, 3 * CROP // 4), (0, CROP)):
        values = np.empty((last - first) * (last - first) // 4 + 1, np.float32)
        count = 0
        for row in range(first, last, 2):
            for column in range(first, last, 2):
                if seen[row, column] > 0.0:
                    values[count] = seen[row, column]
                    count += 1
        if count > 0:
            return np.float64(np.median(values[:count]))
    return 0.0


@njit(cache=True, error_model="numpy")
def fill_input(seen, z0, out):  # type: ignore[no-untyped-def]
    """Write the net's two input images (2, 96, 96) of a crop's depths (96, 96), metres, 0 where not measured."""
    for row in range(seen.shape[0]):
        for column in range(seen.shape[1]):
            z = seen[row, column]
            if z > 0.0:
                out[0, row, column] = min(max((z - z0) / DEPTH_UNIT_M, -_FARTHEST), _FARTHEST)
                out[1, row, column] = 1.0
            else:
                out[0, row, column] = 0.0
                out[1, row, column] = 0.0
