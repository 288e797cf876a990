"""What the joint net is trained to make small."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from neuralgrasps.human.nets.crop import DEPTH_UNIT_M
from neuralgrasps.human.nets.joint_images import CropBatch
from neuralgrasps.human.nets.joint_net import JointVotes

_SMOOTH = 0.02  # units of 0.1 m; shorter distances count by their square


@dataclass(frozen=True, slots=True, kw_only=True)
class JointLossWeights:
    """Weights beside that of the joints in the camera frame, which is 1.

    Attributes:
        root: of the joints from the wrist; aligned: of the joints after the best rotation, shift and scale; width: of
            the expected error; mask: of the mask.
    """

    root: float = 0.5
    aligned: float = 0.7
    width: float = 0.05
    mask: float = 0.3


def joint_loss(votes: JointVotes, batch: CropBatch, weights: JointLossWeights) -> Tensor:
    """Distances in units of 0.1 m: in the camera frame, from the wrist, aligned; the expected error and the mask."""
    points = camera_points(votes.joints, torch.from_numpy(batch.conditions)) / DEPTH_UNIT_M
    truth = torch.from_numpy(batch.joints_C) / DEPTH_UNIT_M
    errors = points - truth
    distance = _smooth_length(errors)
    relative = _smooth_length(errors - errors[:, :1])
    width = votes.log_width.clamp(-5.0, 2.0)
    confidence = width + distance.detach() / width.exp()
    mask = F.binary_cross_entropy_with_logits(votes.mask, torch.from_numpy(batch.mask).float())
    return (
        distance.mean()
        + weights.root * relative.mean()
        + weights.aligned * aligned_distance(points, truth).mean()
        + weights.width * confidence.mean()
        + weights.mask * mask
    )


def camera_points(joints: Tensor, conditions: Tensor) -> Tensor:
    """(N, 21, 3) camera frame, metres, of what the net says; `crop.crop_points` with gradients."""
    width, x, y, z0 = (conditions[:, k, None] for k in range(4))
    z = z0 + DEPTH_UNIT_M * joints[..., 2]
    return torch.stack([(x + joints[..., 0] * width / z0) * z, (y + joints[..., 1] * width / z0) * z, z], dim=-1)


def aligned_distance(points: Tensor, truth: Tensor) -> Tensor:
    """(N, K) distances of points (N, K, 3) to the true ones after the best rotation, shift and scale of each N.

    Gradients hold rotation and scale fixed: at the best ones, the sum of squares does not change with them.

    Source:
        Umeyama 1991, as `joint_errors.procrustes_error`.
    """
    a, b = points - points.mean(-2, keepdim=True), truth - truth.mean(-2, keepdim=True)
    with torch.no_grad():
        left, stretch, right = torch.linalg.svd((b.mT @ a).double())
        sign = torch.ones_like(stretch)
        sign[..., -1] = torch.sign(torch.linalg.det(left) * torch.linalg.det(right))
        scale = (stretch * sign).sum(-1) / a.double().square().sum((-1, -2)).clamp_min(1e-12)
        R = (scale[..., None, None] * (left @ (sign[..., :, None] * right))).to(points.dtype)
    return _smooth_length(a @ R.mT - b)


def _smooth_length(errors: Tensor) -> Tensor:
    """Length over the last axis, quadratic near 0."""
    return (errors.square().sum(-1) + _SMOOTH**2).sqrt() - _SMOOTH
