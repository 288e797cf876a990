"""Training losses."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.kinematics.forward import forward_kinematics


class HandPoints:
    """Material points of a hand, to measure how far two of its grasps are apart.

    Attributes:
        hand: the hand; points_L: (K, 3) float32 points in their link frames; links: (K,) int64.
    """

    def __init__(self, hand: Hand, packed: PackedHand, *, count: int = 96) -> None:
        if len(packed.point_L) == 0:
            raise InputError(f"hand '{hand.name}' has no surface points; pack it with a smaller spacing.")
        middle = 0.5 * (hand.tree.lower + hand.tree.upper)
        X_HL = forward_kinematics(hand.tree, torch.as_tensor(middle)).numpy()
        posed = np.einsum("kij,kj->ki", X_HL[packed.point_link, :3, :3], packed.point_L)
        posed += X_HL[packed.point_link, :3, 3]
        chosen = farthest_points(posed, min(count, len(posed)))
        self.hand = hand
        self.points_L = torch.as_tensor(packed.point_L[chosen], dtype=torch.float32)
        self.links = torch.as_tensor(packed.point_link[chosen].astype(np.int64))

    def posed(self, X_OH: Tensor, q: Tensor) -> Tensor:
        """(N, K, 3) the points on hands X_OH (N, 4, 4), q (N, J); object frame, metres."""
        X_OL = X_OH[:, None] @ forward_kinematics(self.hand.tree, q)
        X = X_OL.index_select(1, self.links.to(q.device))
        points = self.points_L.to(dtype=q.dtype, device=q.device)
        return (X[..., :3, :3] @ points[:, :, None]).squeeze(-1) + X[..., :3, 3]


def point_distances(decoded_O: Tensor, true_O: Tensor) -> Tensor:
    """(N,) mean distance between matching points (N, K, 3), metres; smooth at zero."""
    return ((decoded_O - true_O).square().sum(-1) + 1e-12).sqrt().mean(-1)


def clamped_l1(predicted: Tensor, true: Tensor, *, clamp: float) -> Tensor:
    """Mean |predicted - clamp(true)| (scalar).

    Only the target is clamped: clamping the prediction too would remove its gradient where it is worst.
    """
    return (predicted - true.clamp(-clamp, clamp)).abs().mean()


def variable_margin_triplet(
    codes: Tensor, contact_maps: Tensor, anchor: Tensor, first: Tensor, second: Tensor
) -> Tensor:
    """Triplet loss whose margin is the difference of the contact-map distances (scalar).

    Of the two others, the one with the nearer contact map is the positive, so the margin is not negative.

    Args:
        codes: (N, D); contact_maps: (N, P); anchor, first, second: (T,) indices.
    Source:
        Khargonkar et al. 2022, Eq. 3-4.
    """
    map_first = (contact_maps[anchor] - contact_maps[first]).norm(dim=-1)
    map_second = (contact_maps[anchor] - contact_maps[second]).norm(dim=-1)
    swap = map_second < map_first
    positive, negative = torch.where(swap, second, first), torch.where(swap, first, second)
    margin = (map_second - map_first).abs()
    near, far = ((codes[anchor] - codes[k]).norm(dim=-1) for k in (positive, negative))
    return (near - far + margin).clamp(min=0).mean()
