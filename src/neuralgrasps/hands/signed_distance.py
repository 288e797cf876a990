"""Exact, differentiable signed distances to posed hands, in torch."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.errors import ShapeError, check_shape
from neuralgrasps.geometry.shapes import sdf_box, sdf_capsule, sdf_convex, sdf_cylinder, sdf_sphere
from neuralgrasps.hands.hand import ConvexPart, Hand, PartKind
from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.kinematics.forward import forward_kinematics

_CHUNK = 4_000_000  # point-part pairs evaluated at once, about 0.3 GB at float64


def hand_signed_distance(hand: Hand, X_OH: Tensor, q: Tensor, points_O: Tensor) -> Tensor:
    """Signed distances from points to posed hands, negative inside; differentiable in every argument.

    The least distance over the hand's parts: exact outside, and inside overlapping parts the depth in the deepest one.

    Where no gradient is asked for, a compiled kernel computes the same on the CPU.

    Args:
        hand: the hand.
        X_OH: (N, 4, 4) hand base in the object frame; q: (N, J) rad or metres.
        points_O: (N, M, 3), or (M, 3) for the same points for all hands; object frame, metres.
    Returns:
        (N, M) metres, dtype and device of the inputs.
    Raises:
        ShapeError: wrong shapes, or a number of joints that is not the hand's.
    """
    _check(hand, X_OH, q, points_O)
    differentiable = torch.is_grad_enabled() and any(v.requires_grad for v in (X_OH, q, points_O))
    if not differentiable and points_O.device.type == "cpu":
        return _compiled(hand, X_OH, q, points_O)
    return differentiable_distance(hand, X_OH, q, points_O)


def _compiled(hand: Hand, X_OH: Tensor, q: Tensor, points_O: Tensor) -> Tensor:
    """The same in the kernel that synthesis uses: about ten times fewer CPU-seconds, no gradient."""
    packed = pack_shapes(hand)
    poses, joints, points = (np.ascontiguousarray(v.detach().double().numpy()) for v in (X_OH, q, points_O))
    out = np.empty((len(poses), points.shape[-2]))
    for n in range(len(poses)):
        own = points if points.ndim == 2 else points[n % len(points)]
        hand_distance_many(packed, poses[n], joints[n], own, out[n])
    return torch.from_numpy(out).to(points_O.dtype)


def differentiable_distance(hand: Hand, X_OH: Tensor, q: Tensor, points_O: Tensor) -> Tensor:
    """`hand_signed_distance` by torch operations alone, on any device; same arguments, checked by the caller."""
    X_OL = X_OH.unsqueeze(-3) @ forward_kinematics(hand.tree, q)  # (N, L, 4, 4)
    points = points_O if points_O.ndim == 3 else points_O.unsqueeze(0)
    step = max(1, _CHUNK // max(1, len(X_OH) * len(hand.parts)))
    chunks = [_least_distance(hand, X_OL, points[:, i : i + step]) for i in range(0, points.shape[1], step)]
    return torch.cat(chunks, dim=1) if chunks else points.new_zeros(len(X_OH), 0)


def _check(hand: Hand, X_OH: Tensor, q: Tensor, points_O: Tensor) -> None:
    if X_OH.ndim != 3 or X_OH.shape[1:] != (4, 4):
        raise ShapeError(f"X_OH has shape {tuple(X_OH.shape)}; expected (N, 4, 4).")
    if q.ndim != 2 or q.shape[1] != hand.num_dofs or len(q) != len(X_OH):
        raise ShapeError(
            f"q has shape {tuple(q.shape)}; expected ({len(X_OH)}, {hand.num_dofs}) for hand '{hand.name}' and "
            f"{len(X_OH)} poses."
        )
    check_shape("points_O", tuple(points_O.shape), (None, 3))
    if points_O.ndim not in (2, 3) or (points_O.ndim == 3 and len(points_O) not in (1, len(X_OH))):
        raise ShapeError(f"points_O has shape {tuple(points_O.shape)}; expected (M, 3) or ({len(X_OH)}, M, 3).")


def _least_distance(hand: Hand, X_OL: Tensor, points_O: Tensor) -> Tensor:
    """(N, M) least distance over the parts; X_OL (N, L, 4, 4), points_O (N or 1, M, 3)."""
    least: Tensor | None = None
    for kind in PartKind:
        parts = [p for p in hand.parts if p.kind == kind]
        groups = [[p] for p in parts] if kind == PartKind.HULL else [parts] if parts else []
        for group in groups:
            d = _group_distance(kind, group, X_OL, points_O).amin(dim=1)
            least = d if least is None else torch.minimum(least, d)
    assert least is not None  # a Hand has parts
    return least


def _group_distance(kind: PartKind, parts: list[ConvexPart], X_OL: Tensor, points_O: Tensor) -> Tensor:
    """(N, B, M) distances to B parts of one kind."""
    links = torch.as_tensor([p.link for p in parts], device=X_OL.device)
    X_LP = torch.as_tensor(np.stack([p.X_LP for p in parts]), dtype=X_OL.dtype, device=X_OL.device)
    X_OP = X_OL.index_select(1, links) @ X_LP  # (N, B, 4, 4)
    p = (points_O.unsqueeze(1) - X_OP[..., None, :3, 3]) @ X_OP[..., :3, :3]  # rows times R = R^T times columns
    size = torch.as_tensor(np.stack([q.size for q in parts]), dtype=X_OL.dtype, device=X_OL.device)
    radius, length = size[:, None, 0], size[:, None, 1]
    match kind:
        case PartKind.BOX:
            return sdf_box(p, size[:, None, :])
        case PartKind.SPHERE:
            return sdf_sphere(p, radius)
        case PartKind.CAPSULE:
            return sdf_capsule(p, radius, length)
        case PartKind.CYLINDER:
            return sdf_cylinder(p, radius, length)
        case PartKind.HULL:
            vertices = torch.as_tensor(parts[0].vertices, dtype=X_OL.dtype, device=X_OL.device)
            return sdf_convex(p, vertices, torch.as_tensor(parts[0].faces, device=X_OL.device))
