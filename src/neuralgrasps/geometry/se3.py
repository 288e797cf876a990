"""Rigid transforms in torch: plain (..., 4, 4) tensors and pure functions, differentiable, any leading batch axes.

X_AB maps B coordinates into A: p_A = X_AB p_B. Twists are (..., 6) [v, w], translation first, metres and radians.
Results keep the dtype and device of the input.
"""

from __future__ import annotations

import torch
from torch import Tensor

from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.rotation import angle_coefficients, exp_so3, hat, log_so3


def make_transform(R: Tensor, t: Tensor) -> Tensor:
    """(..., 4, 4) from rotation R (..., 3, 3) and translation t (..., 3); their batch axes broadcast."""
    check_shape("R", tuple(R.shape), (3, 3))
    check_shape("t", tuple(t.shape), (3,))
    batch = torch.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    top = torch.cat([R.expand(*batch, 3, 3), t.unsqueeze(-1).expand(*batch, 3, 1)], dim=-1)
    bottom = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=top.dtype, device=top.device).expand(*batch, 1, 4)
    return torch.cat([top, bottom], dim=-2)


def inverse(X_AB: Tensor) -> Tensor:
    """X_BA, from the transpose of the rotation."""
    check_shape("X_AB", tuple(X_AB.shape), (4, 4))
    Rt = X_AB[..., :3, :3].transpose(-1, -2)
    return make_transform(Rt, -(Rt @ X_AB[..., :3, 3:]).squeeze(-1))


def transform_points(X_AB: Tensor, points_B: Tensor) -> Tensor:
    """Points (..., M, 3) in B to A; the batch axes of X_AB (..., 4, 4) and of the points broadcast."""
    return rotate_vectors(X_AB, points_B) + X_AB[..., None, :3, 3]


def rotate_vectors(X_AB: Tensor, v_B: Tensor) -> Tensor:
    """Directions (..., M, 3) in B to A: the rotation only."""
    check_shape("X_AB", tuple(X_AB.shape), (4, 4))
    check_shape("vectors or points", tuple(v_B.shape), (None, 3))
    return v_B @ X_AB[..., :3, :3].transpose(-1, -2)


def exp_se3(xi: Tensor) -> Tensor:
    """(..., 6) twist [v, w] to (..., 4, 4)."""
    check_shape("xi", tuple(xi.shape), (6,))
    v, w = xi[..., :3], xi[..., 3:]
    W = hat(w)
    _, b, c = angle_coefficients(w.square().sum(-1))
    Wv = (W @ v.unsqueeze(-1)).squeeze(-1)
    WWv = (W @ Wv.unsqueeze(-1)).squeeze(-1)
    return make_transform(exp_so3(w), v + b.unsqueeze(-1) * Wv + c.unsqueeze(-1) * WWv)


def log_se3(X: Tensor) -> Tensor:
    """(..., 4, 4) to the (..., 6) twist [v, w] with |w| <= pi, so that exp_se3(log_se3(X)) = X."""
    check_shape("X", tuple(X.shape), (4, 4))
    w, t = log_so3(X[..., :3, :3]), X[..., :3, 3]
    W = hat(w)
    Wt = (W @ t.unsqueeze(-1)).squeeze(-1)
    WWt = (W @ Wt.unsqueeze(-1)).squeeze(-1)
    return torch.cat([t - 0.5 * Wt + _inverse_coefficient(w).unsqueeze(-1) * WWt, w], dim=-1)


def _inverse_coefficient(w: Tensor) -> Tensor:
    """(1 - (t / 2) cot(t / 2)) / t^2 with t = |w| (..., 3), smooth at 0: the W^2 term of the inverse left Jacobian."""
    squared = w.square().sum(-1)
    small = squared < 1e-2
    s = torch.where(small, squared, torch.zeros_like(squared))
    t2 = torch.where(small, torch.ones_like(squared), squared)
    half = 0.5 * t2.sqrt()
    series = 1 / 12 + s * (1 / 720 + s * (1 / 30240 + s * (1 / 1209600 + s / 47900160)))
    return torch.where(small, series, (1 - half * torch.cos(half) / torch.sin(half)) / t2)
