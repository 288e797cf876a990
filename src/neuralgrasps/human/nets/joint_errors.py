"""How far seen or fitted joints are from the true ones, as the field measures it."""

from __future__ import annotations

import numpy as np

from neuralgrasps.errors import check_shape
from neuralgrasps.human.skeleton import NUM_JOINTS, WRIST


def root_relative_error(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean distance of the joints to the true ones once both wrists are put at the origin.

    Args:
        joints, truth: (..., 21, 3), metres.
    Returns:
        (...) metres, over the 20 joints that are not the wrist: it would count as 0 error.
    Raises:
        ShapeError: not 21 joints.
    """
    _check(joints, truth)
    off = (joints - joints[..., WRIST : WRIST + 1, :]) - (truth - truth[..., WRIST : WRIST + 1, :])
    distance = np.linalg.norm(off, axis=-1)
    return np.asarray(np.delete(distance, WRIST, axis=-1).mean(axis=-1))


def procrustes_error(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean distance over the 21 joints after the best rotation, shift and scale of `joints` onto `truth`, metres.

    Args and errors as for `root_relative_error`.
    Source:
        Umeyama 1991; the measure "PA" of hand pose benchmarks.
    """
    _check(joints, truth)
    a = joints - joints.mean(axis=-2, keepdims=True)
    b = truth - truth.mean(axis=-2, keepdims=True)
    left, stretch, right = np.linalg.svd(np.swapaxes(b, -1, -2) @ a)
    sign = np.ones(stretch.shape)
    sign[..., -1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    R = left @ (sign[..., :, None] * right)
    scale = (stretch * sign).sum(axis=-1) / np.maximum((a**2).sum(axis=(-1, -2)), 1e-18)
    moved = scale[..., None, None] * (a @ np.swapaxes(R, -1, -2))
    return np.asarray(np.linalg.norm(moved - b, axis=-1).mean(axis=-1))


def _check(joints: np.ndarray, truth: np.ndarray) -> None:
    check_shape("joints", np.shape(joints), (NUM_JOINTS, 3))
    check_shape("truth", np.shape(truth), (NUM_JOINTS, 3))
