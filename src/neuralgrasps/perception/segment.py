"""Cut an object out of a depth image by the height of the table it stands on."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, pixel_rays

JUMP_M = 0.02


def segment_above_table(
    depth: np.ndarray,
    intrinsics: Intrinsics,
    X_WC: np.ndarray,
    *,
    table_z_m: float,
    min_height_m: float = 0.006,
    max_height_m: float = 0.5,
    min_pixels: int = 50,
) -> list[np.ndarray]:
    """Connected regions of pixels that lie above a horizontal table.

    Args:
        depth: (h, w) z-depth, metres; 0, inf or nan = nothing measured.
        X_WC: (4, 4) camera pose, world z up. table_z_m: height of the table top in the world.
        min_height_m, max_height_m: band above the table that belongs to objects.
        min_pixels: smaller regions are dropped.
    Returns:
        Masks (h, w) bool, largest first; empty when nothing stands there.
    Raises:
        InputError: the depth image is not of the camera's size.
    """
    if np.shape(depth) != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth has shape {np.shape(depth)}; the camera's images are {intrinsics.height} x {intrinsics.width}."
        )
    z = np.asarray(depth, np.float64)
    valid = np.isfinite(z) & (z > 0)
    points_W = pixel_rays(intrinsics) * np.where(valid, z, 0.0)[..., None] @ X_WC[:3, :3].T + X_WC[:3, 3]
    height = points_W[..., 2] - table_z_m
    above = valid & (height > min_height_m) & (height < max_height_m)
    jump = _jumps(np.where(valid, z, np.nan))
    # 8-neighbours, so that single lost pixels do not cut a region
    labels, count = ndimage.label(above & ~jump, structure=np.ones((3, 3)))
    sizes = ndimage.sum_labels(above, labels, np.arange(1, count + 1)) if count else np.zeros(0)
    return [labels == i + 1 for i in np.argsort(-sizes, kind="stable") if sizes[i] >= min_pixels]


def _jumps(z: np.ndarray) -> np.ndarray:
    """Pixels whose depth differs by more than `JUMP_M` from a neighbour before them; nan jumps to nothing.

    Diagonal neighbours count too: regions are joined by them, and would leak through a slanted edge.
    """
    jump = np.zeros(z.shape, bool)
    jump[:, 1:] |= np.abs(z[:, 1:] - z[:, :-1]) > JUMP_M
    jump[1:] |= np.abs(z[1:] - z[:-1]) > JUMP_M
    jump[1:, 1:] |= np.abs(z[1:, 1:] - z[:-1, :-1]) > JUMP_M
    jump[1:, :-1] |= np.abs(z[1:, :-1] - z[:-1, 1:]) > JUMP_M
    return jump
