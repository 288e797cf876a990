"""Rotations in torch: (..., 3, 3) matrices, differentiable, any leading batch axes, dtype and device of the input.

Rotation vectors and angles are in radians. Quaternions are wxyz and meant for files. exp and log keep full precision
near the identity and near half a turn.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from neuralgrasps.errors import InputError, check_shape

# Below this squared angle series replace formulas that divide by it; five terms err by less than 1e-17.
_SMALL = 1e-2


def hat(w: Tensor) -> Tensor:
    """(..., 3) vector to its (..., 3, 3) cross product matrix: hat(w) v = w x v."""
    check_shape("w", tuple(w.shape), (3,))
    x, y, z = w.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).unflatten(-1, (3, 3))


def angle_coefficients(squared: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sin(t) / t, (1 - cos t) / t^2 and (t - sin t) / t^3 from t^2 (...), smooth at 0."""
    small = squared < _SMALL
    t2 = torch.where(small, torch.ones_like(squared), squared)
    t = t2.sqrt()
    sine, half = torch.sin(t), torch.sin(0.5 * t)
    s = torch.where(small, squared, torch.zeros_like(squared))
    a = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72)))
    b = (1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90)))) / 2
    c = (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110)))) / 6
    return (
        torch.where(small, a, sine / t),
        torch.where(small, b, 2 * half * half / t2),
        torch.where(small, c, (t - sine) / (t2 * t)),
    )


def exp_so3(w: Tensor) -> Tensor:
    """(..., 3) rotation vector to (..., 3, 3) matrix (Rodrigues)."""
    W = hat(w)
    a, b, _ = angle_coefficients(w.square().sum(-1))
    eye = torch.eye(3, dtype=w.dtype, device=w.device)
    return eye + a[..., None, None] * W + b[..., None, None] * (W @ W)


def log_so3(R: Tensor) -> Tensor:
    """(..., 3, 3) matrix to (..., 3) rotation vector of length 0 to pi; at exactly pi either of the two."""
    q = quaternion_from_matrix(R)
    w, v = q[..., 0], q[..., 1:]
    squared = v.square().sum(-1)
    small = squared < 1e-3
    s = torch.where(small, squared, torch.zeros_like(squared))
    n = torch.where(small, torch.ones_like(squared), squared).sqrt()
    series = 1 + s * (1 / 6 + s * (3 / 40 + s * (5 / 112 + s * (35 / 1152))))  # arcsin(n) / n
    factor = 2 * torch.where(small, series, torch.atan2(n, w) / n)
    return factor.unsqueeze(-1) * v


def matrix_from_6d(r: Tensor) -> Tensor:
    """(..., 6), two stacked columns of any length, to (..., 3, 3) by Gram-Schmidt (Zhou et al. 2019)."""
    check_shape("r", tuple(r.shape), (6,))
    x = torch.nn.functional.normalize(r[..., :3], dim=-1)
    y = r[..., 3:]
    y = torch.nn.functional.normalize(y - (x * y).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def matrix_to_6d(R: Tensor) -> Tensor:
    """(..., 3, 3) to (..., 6): its first column, then its second."""
    check_shape("R", tuple(R.shape), (3, 3))
    return torch.cat([R[..., :, 0], R[..., :, 1]], dim=-1)


def matrix_from_quaternion(q: Tensor) -> Tensor:
    """(..., 4) wxyz quaternion of any non-zero length to (..., 3, 3)."""
    check_shape("q", tuple(q.shape), (4,))
    w, x, y, z = torch.nn.functional.normalize(q, dim=-1, eps=1e-30).unbind(-1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def quaternion_from_matrix(R: Tensor) -> Tensor:
    """(..., 3, 3) to the (..., 4) wxyz unit quaternion with w >= 0.

    4 q_i q is linear in R for each component i; the largest of the four is at least 1, so nothing cancels.
    """
    check_shape("R", tuple(R.shape), (3, 3))
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in R.unbind(-2))
    rows = [
        torch.stack([1 + a + e + i, h - f, c - g, d - b], dim=-1),
        torch.stack([h - f, 1 + a - e - i, b + d, c + g], dim=-1),
        torch.stack([c - g, b + d, 1 - a + e - i, f + h], dim=-1),
        torch.stack([d - b, c + g, f + h, 1 - a - e + i], dim=-1),
    ]
    candidates = torch.stack(rows, dim=-2)
    best = candidates.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)
    index = best[..., None, None].expand(*best.shape, 1, 4)
    q = torch.nn.functional.normalize(candidates.gather(-2, index).squeeze(-2), dim=-1)
    return torch.where(q[..., :1] < 0, -q, q)


def matrix_from_rpy(rpy: Tensor) -> Tensor:
    """(..., 3) roll, pitch, yaw about fixed x, y, z to Rz(yaw) Ry(pitch) Rx(roll)."""
    check_shape("rpy", tuple(rpy.shape), (3,))
    cr, cp, cy = torch.cos(rpy).unbind(-1)
    sr, sp, sy = torch.sin(rpy).unbind(-1)
    entries = [
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp, cp * sr, cp * cr,
    ]  # fmt: skip
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def geodesic_angle(Ra: Tensor, Rb: Tensor) -> Tensor:
    """Angle (...) in [0, pi] of the rotation from Ra to Rb (..., 3, 3), precise at both ends."""
    check_shape("Ra", tuple(Ra.shape), (3, 3))
    check_shape("Rb", tuple(Rb.shape), (3, 3))
    D = Ra.transpose(-1, -2) @ Rb
    twice_sine2 = (
        (D[..., 2, 1] - D[..., 1, 2]).square()
        + (D[..., 0, 2] - D[..., 2, 0]).square()
        + (D[..., 1, 0] - D[..., 0, 1]).square()
    )
    positive = twice_sine2 > 0
    sine2 = torch.where(positive, torch.where(positive, twice_sine2, torch.ones_like(twice_sine2)).sqrt(), twice_sine2)
    return torch.atan2(sine2, D.diagonal(dim1=-2, dim2=-1).sum(-1) - 1)


def random_rotations(count: int, seed: int) -> Tensor:
    """(count, 3, 3) float64 rotations, uniform over SO(3)."""
    generator = torch.Generator().manual_seed(seed)
    return matrix_from_quaternion(torch.randn(count, 4, generator=generator, dtype=torch.float64))


def super_fibonacci_rotations(count: int) -> Tensor:
    """(count, 3, 3) float64 rotations spread evenly over SO(3), deterministic.

    Source:
        Alexa, "Super-Fibonacci Spirals", CVPR 2022.
    """
    if count < 1:
        raise InputError(f"count is {count}; expected at least 1.")
    s = torch.arange(count, dtype=torch.float64) + 0.5
    alpha = 2 * math.pi * s / math.sqrt(2)
    beta = 2 * math.pi * s / 1.533751168755204288118041
    r, big_r = (s / count).sqrt(), (1 - s / count).sqrt()
    xyzw = [r * alpha.sin(), r * alpha.cos(), big_r * beta.sin(), big_r * beta.cos()]
    return matrix_from_quaternion(torch.stack([xyzw[3], *xyzw[:3]], dim=-1))
