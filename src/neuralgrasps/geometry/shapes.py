"""Exact signed distances to simple solids in torch, differentiable in the points and the sizes.

Solids are centred on the origin of their own frame, axis along z; metres, negative inside. Points are (..., 3) and
sizes broadcast against the points' batch axes. Gradients are finite everywhere (zero where the distance has no
direction, as at a sphere's centre).
"""

from __future__ import annotations

import torch
from torch import Tensor

from neuralgrasps.errors import check_shape

Size = Tensor | float


def sdf_box(p: Tensor, half: Tensor) -> Tensor:
    """Box of half sizes `half` (..., 3): (...)."""
    check_shape("p", tuple(p.shape), (3,))
    d = p.abs() - half
    return _norm(d.clamp(min=0)) + d.max(dim=-1).values.clamp(max=0)


def sdf_sphere(p: Tensor, r: Size) -> Tensor:
    """Sphere of radius `r`: (...)."""
    check_shape("p", tuple(p.shape), (3,))
    return _norm(p) - r


def sdf_capsule(p: Tensor, r: Size, half_len: Size) -> Tensor:
    """All points within `r` of the segment from z = -half_len to half_len: (...)."""
    check_shape("p", tuple(p.shape), (3,))
    over = (p[..., 2].abs() - half_len).clamp(min=0)
    x, y, over = torch.broadcast_tensors(p[..., 0], p[..., 1], over)
    return _norm(torch.stack([x, y, over], dim=-1)) - r


def sdf_cylinder(p: Tensor, r: Size, half_h: Size) -> Tensor:
    """Cylinder of radius `r` with flat caps at z = +-half_h: (...)."""
    check_shape("p", tuple(p.shape), (3,))
    d = torch.stack(torch.broadcast_tensors(_norm(p[..., :2]) - r, p[..., 2].abs() - half_h), dim=-1)
    return _norm(d.clamp(min=0)) + d.max(dim=-1).values.clamp(max=0)


def sdf_convex(p: Tensor, vertices: Tensor, faces: Tensor) -> Tensor:
    """Convex polytope of vertices (V, 3) and outward wound triangles `faces` (F, 3): (...).

    Inside it is the largest distance to a face's plane, outside the distance to the nearest triangle. Memory grows
    with points x faces.
    """
    check_shape("p", tuple(p.shape), (3,))
    a, b, c = vertices[faces.long()].to(p.dtype).unbind(dim=1)
    cross = torch.linalg.cross(b - a, c - a)
    area = _norm(cross)
    a, b, c, normal = (v[area > 0] for v in (a, b, c, cross))
    normal = torch.nn.functional.normalize(normal, dim=-1, eps=0.0)
    q = p.unsqueeze(-2)
    height = ((q - a) * normal).sum(-1)
    deepest = height.max(dim=-1).values
    in_triangle = torch.ones_like(height, dtype=torch.bool)
    squared = torch.full_like(height, torch.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, offset = end - start, q - start
        in_triangle &= (torch.linalg.cross(edge.expand_as(offset), offset) * normal).sum(-1) >= 0
        along = ((offset * edge).sum(-1) / (edge * edge).sum(-1)).clamp(0, 1)
        squared = torch.minimum(squared, (offset - along.unsqueeze(-1) * edge).square().sum(-1))
    nearest = torch.where(in_triangle, height.square(), squared).min(dim=-1).values
    outside = (deepest > 0) & (nearest > 0)
    return torch.where(outside, torch.where(outside, nearest, torch.ones_like(nearest)).sqrt(), deepest)


def _norm(v: Tensor) -> Tensor:
    """Length over the last axis, with gradient 0 instead of NaN where it is 0."""
    squared = v.square().sum(dim=-1)
    positive = squared > 0
    return torch.where(positive, torch.where(positive, squared, torch.ones_like(squared)).sqrt(), squared)
