"""What the detector's cells should have said, and how far they were off."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from neuralgrasps.human.nets.detector_net import STRIDES, Cells

_CENTRE_RADIUS = 1.5  # cells so near the box's middle belong to it, cell widths (FCOS)
_LARGE_PX, _SMALL_PX = 36.0, 52.0  # longer side: fine cells take boxes up to the second, coarse ones from the first on
_FOCUS = 2.0  # exponent of the quality focal loss
_SIDE_SHARE, _BOX_SHARE = 0.5, 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HandLabels:
    """The hands in a batch of images, padded to H of them.

    Attributes:
        boxes: (N, H, 4) u_min, v_min, u_max, v_max, pixels.
        right: (N, H) bool, right hands.
        known: (N, H) bool, which entries are hands to be found.
        ignored: (N, H) bool, hands too small a part of which is seen to ask for: cells inside are left alone.
    """

    boxes: Tensor
    right: Tensor
    known: Tensor
    ignored: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorLoss:
    """Parts of the loss (scalars); `total` is what is made small."""

    total: Tensor
    score: Tensor
    box: Tensor
    side: Tensor


def detector_loss(cells: Cells, labels: HandLabels) -> DetectorLoss:
    """Quality focal loss of the scores, GIoU of the boxes, cross entropy of the sides, per cell that has a hand.

    Source:
        Tian et al. 2019 (cells near the middle), Rezatofighi et al. 2019 (GIoU), Li et al. 2020 (Eq. 6: the score's
        target is the overlap of the cell's own box).
    """
    hand = owners(cells, labels)
    has = hand >= 0
    image, cell = has.nonzero(as_tuple=True)
    owned = hand[image, cell]
    truth, found = labels.boxes[image, owned], cells.boxes[image, cell]
    overlap, generalised = box_overlap(found, truth)
    count = max(len(image), 1)
    target = torch.zeros_like(cells.score)
    target[image, cell] = overlap.detach().clamp(0.0, 1.0)
    focal = (torch.sigmoid(cells.score) - target).abs() ** _FOCUS
    entropy = F.binary_cross_entropy_with_logits(cells.score, target, reduction="none")
    counted = ~_ignored(cells, labels) | has
    score = (focal * entropy * counted).sum() / count
    quality = target[image, cell]
    box = ((1.0 - generalised) * quality.clamp(min=0.1)).sum() / quality.clamp(min=0.1).sum().clamp(min=1e-6)
    right = labels.right[image, owned].float()
    side = F.binary_cross_entropy_with_logits(cells.right[image, cell], right, reduction="sum") / count
    return DetectorLoss(total=score + _BOX_SHARE * box + _SIDE_SHARE * side, score=score, box=box, side=side)


def owners(cells: Cells, labels: HandLabels) -> Tensor:
    """(N, K) which hand each cell should find, -1 for none.

    A hand's cells lie within 1.5 cells of its middle and in its box; where hands meet, the smaller box wins.
    """
    middle = 0.5 * (labels.boxes[..., :2] + labels.boxes[..., 2:])
    size = labels.boxes[..., 2:] - labels.boxes[..., :2]
    longer = size.amax(-1)[:, None]  # (N, 1, H)
    off = (cells.centres[:, None] - middle[:, None]).abs()  # (N, K, H, 2)
    reach = torch.minimum(_CENTRE_RADIUS * cells.strides[:, None, None], 0.5 * size[:, None])
    near = (off <= reach).all(-1)
    fine = (cells.strides == STRIDES[0])[None, :, None]
    fits = torch.where(fine, longer <= _SMALL_PX, longer >= _LARGE_PX)
    cost = torch.where(near & fits & labels.known[:, None], longer, torch.inf)
    best, hand = cost.min(-1)
    return torch.where(torch.isfinite(best), hand, -1)


def box_overlap(boxes: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
    """Intersection over union, and the generalised one (-1 to 1), of boxes (..., 4) pair by pair."""
    inner = (torch.minimum(boxes[..., 2:], others[..., 2:]) - torch.maximum(boxes[..., :2], others[..., :2])).clamp(0.0)
    outer = torch.maximum(boxes[..., 2:], others[..., 2:]) - torch.minimum(boxes[..., :2], others[..., :2])
    common, hull = inner.prod(-1), outer.prod(-1).clamp(min=1e-6)
    union = (_areas(boxes) + _areas(others) - common).clamp(min=1e-6)
    return common / union, common / union - (hull - union) / hull


def _areas(boxes: Tensor) -> Tensor:
    return (boxes[..., 2:] - boxes[..., :2]).clamp(0.0).prod(-1)


def _ignored(cells: Cells, labels: HandLabels) -> Tensor:
    """(N, K) cells within a hand that neither counts as one nor as none."""
    low, high = labels.boxes[:, None, :, :2], labels.boxes[:, None, :, 2:]
    inside = ((cells.centres[:, None] >= low) & (cells.centres[:, None] <= high)).all(-1)
    return (inside & labels.ignored[:, None]).any(-1)
