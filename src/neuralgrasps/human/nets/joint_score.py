"""What a joint net is worth on test crops: its joints and its mask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.human.nets.joint_errors import procrustes_error, root_relative_error
from neuralgrasps.human.nets.joint_images import CropBatch

VISIBLE = 0.4
"""Figures are of hands that are seen to more than this share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointScore:
    """Mean distances over joints, mm, on hands that hold something and are seen to more than VISIBLE.

    Attributes:
        absolute_mm: in the camera frame. root_relative_mm, procrustes_mm: see `joint_errors`. all_root_relative_mm:
            over all hands, empty and hidden ones too.
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
    relative = root_relative_error(points_C, true_C)
    measured = truth.inputs[:, 1] > 0
    hand = (truth.mask > 0) & measured
    found = masks & measured
    iou = (hand & found)[chosen].sum() / max((hand | found)[chosen].sum(), 1)
    return JointScore(
        absolute_mm=1e3 * float(np.linalg.norm(points_C - true_C, axis=-1)[chosen].mean()),
        root_relative_mm=1e3 * float(relative[chosen].mean()),
        procrustes_mm=1e3 * float(procrustes_error(points_C[chosen], true_C[chosen]).mean()),
        all_root_relative_mm=1e3 * float(relative.mean()),
        mask_iou=float(iou),
    )
