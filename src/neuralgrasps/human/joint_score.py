"""How far seen joints are from the true ones: as they are, from the wrist, and after the best similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.human.joint_images import CropBatch
from neuralgrasps.human.skeleton import WRIST

VISIBLE = 0.4
"""Figures are of hands that are seen to more than this share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointScore:
    """Mean distances over joints, mm, on hands that hold something and are seen to more than VISIBLE.

    Attributes:
        absolute_mm: in the camera frame; root_relative_mm: wrists put on each other; procrustes_mm: after the best
            rotation, translation and scale. all_root_relative_mm: over all hands, empty and hidden ones too.
        mask_iou: of the mask, where anything was measured.
    """

    absolute_mm: float
    root_relative_mm: float
    procrustes_mm: float
    all_root_relative_mm: float
    mask_iou: float


def score_joints(points_C: np.ndarray, masks: np.ndarray, truth: CropBatch) -> JointScore:
    """Score N predictions (N, 21, 3), metres, and masks (N, 96, 96) bool."""
    true_C, chosen = truth.joints_C.astype(np.float64), truth.holds & (truth.visible > VISIBLE)
    relative = root_relative_errors(points_C, true_C)
    measured = truth.inputs[:, 1] > 0
    hand = (truth.mask > 0) & measured
    found = masks & measured
    iou = (hand & found)[chosen].sum() / max((hand | found)[chosen].sum(), 1)
    return JointScore(
        absolute_mm=1e3 * float(np.linalg.norm(points_C - true_C, axis=-1)[chosen].mean()),
        root_relative_mm=1e3 * float(relative[chosen].mean()),
        procrustes_mm=1e3 * float(procrustes_errors(points_C[chosen], true_C[chosen]).mean()),
        all_root_relative_mm=1e3 * float(relative.mean()),
        mask_iou=float(iou),
    )


def root_relative_errors(points: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(N, 21) distances, metres, after the wrists of (N, 21, 3) joints are put on each other."""
    errors = points - true
    return np.linalg.norm(errors - errors[:, WRIST : WRIST + 1], axis=-1)


def procrustes_errors(points: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(N, 21) distances, metres, after the similarity that brings `points` nearest to `true` in the mean square.

    Source:
        Umeyama 1991, "Least-squares estimation of transformation parameters between two point patterns".
    """
    middle, target = points.mean(axis=1, keepdims=True), true.mean(axis=1, keepdims=True)
    p, t = np.asarray(points - middle, np.float64), true - target
    U, values, Vt = np.linalg.svd(np.swapaxes(t, 1, 2) @ p)
    sign = np.ones_like(values)
    sign[:, 2] = np.sign(np.linalg.det(U @ Vt))
    R = (U * sign[:, None, :]) @ Vt
    scale = (values * sign).sum(axis=1) / np.maximum((p**2).sum(axis=(1, 2)), 1e-12)
    moved = scale[:, None, None] * (p @ np.swapaxes(R, 1, 2))
    return np.linalg.norm(moved - t, axis=-1)
