"""The hand detector's network: anchor-free, one stage, on depth images of one focal length.

Every cell of two grids (8 and 16 pixels wide) says how sure it is that it lies in the middle of a hand, how far the
hand's box reaches from it to the left, top, right and bottom, and whether it is a right hand. Depth tells how large a
hand must look only when the focal length is known: all images are brought to one before (`detector_view.py`).

Source:
    Tian et al. 2019 (FCOS): cells as box centres, distances to four sides, shared heads. Differs: the score is
    trained to be the box's overlap (Li et al. 2020) in place of a separate centre-ness; the side is one more output.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.fusion import fuse_conv_bn_eval

STRIDES = (8, 16)

_MIDDLE_M, _SPREAD_M = 0.8, 0.4  # depth is fed as (z - middle) / spread, within +-3
_NEAR_SPREAD_M, _NEAR_LIMIT = 0.05, 4.0  # and against the mean around it, in units of 5 cm, within +-20 cm
_COARSE = 8  # the mean is taken over 24 x 24 pixels or so
_PRIOR = 0.01  # share of cells that hold a hand, at the start of training


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """What the network says, one row per cell of all grids.

    Attributes:
        score: (N, K) logit of how well the cell's box covers a hand.
        right: (N, K) logit that the hand is a right one.
        boxes: (N, K, 4) u_min, v_min, u_max, v_max, pixels of the network's image (they may lie outside of it).
        centres: (K, 2) u, v of the cells; strides: (K,) their widths, pixels.
    """

    score: Tensor
    right: Tensor
    boxes: Tensor
    centres: Tensor
    strides: Tensor


class DetectorNet(nn.Module):
    """Depth images in metres to `Cells`.

    Args:
        widths: channels at 2, 4, 8 and 16 pixels a cell; neck: channels of both grids and of the heads.
    """

    def __init__(self, widths: tuple[int, int, int, int] = (16, 32, 64, 96), neck: int = 64) -> None:
        super().__init__()
        w2, w4, w8, w16 = widths
        self.stem = ConvBlock(3, w2, stride=2)
        self.fine = nn.Sequential(ConvBlock(w2, w4, stride=2), ResidualBlock(w4))
        self.middle = nn.Sequential(ConvBlock(w4, w8, stride=2), ResidualBlock(w8), ResidualBlock(w8))
        self.coarse = nn.Sequential(ConvBlock(w8, w16, stride=2), ResidualBlock(w16), ResidualBlock(w16, dilation=2))
        self.lateral = nn.ModuleList([nn.Conv2d(w8, neck, 1), nn.Conv2d(w16, neck, 1)])
        self.mixed = ConvBlock(neck, neck)
        last = nn.Conv2d(neck, 6, 3, padding=1)
        nn.init.zeros_(cast(Tensor, last.bias)[1])
        nn.init.constant_(cast(Tensor, last.bias)[0], math.log(_PRIOR / (1.0 - _PRIOR)))
        nn.init.ones_(cast(Tensor, last.bias)[2:])
        self.head = nn.Sequential(ConvBlock(neck, neck), ConvBlock(neck, neck), last)
        self.scale = nn.Parameter(torch.ones(len(STRIDES)))

    def forward(self, depth: Tensor) -> Cells:
        """Cells of depth images (N, h, w), metres, 0 = not measured; h and w multiples of 16."""
        images = depth_channels(depth).contiguous(memory_format=torch.channels_last)
        middle = self.middle(self.fine(self.stem(images)))
        coarse = self.lateral[1](self.coarse(middle))
        up = F.interpolate(coarse, scale_factor=2.0, mode="nearest")
        levels = (self.mixed(F.relu(self.lateral[0](middle) + up)), F.relu(coarse))
        logits, extents, centres, strides = [], [], [], []
        for level, stride, scale in zip(levels, STRIDES, self.scale, strict=True):
            rows = self.head(level).permute(0, 2, 3, 1).flatten(1, 2).float()
            logits.append(rows[..., :2])
            extents.append(torch.exp((rows[..., 2:] * scale).clamp(max=6.0)) * (0.5 * stride))
            centres.append(cell_centres(level.shape[2], level.shape[3], stride, level.device))
            strides.append(torch.full((len(centres[-1]),), float(stride), device=level.device))
        said, reach, middles = torch.cat(logits, 1), torch.cat(extents, 1), torch.cat(centres)
        boxes = torch.cat([middles - reach[..., :2], middles + reach[..., 2:]], -1)
        return Cells(score=said[..., 0], right=said[..., 1], boxes=boxes, centres=middles, strides=torch.cat(strides))


def depth_channels(depth: Tensor) -> Tensor:
    """(N, 3, h, w) what the first layer sees: depth, depth against the mean around it, and where it was measured."""
    valid = (depth > 0).float()[:, None]
    z = depth[:, None].float()
    share = F.avg_pool2d(valid, _COARSE)
    wide = F.avg_pool2d(F.avg_pool2d(z, _COARSE), 3, stride=1, padding=1)
    mean = wide / F.avg_pool2d(share, 3, stride=1, padding=1).clamp(min=1e-3)
    around = F.interpolate(mean, scale_factor=float(_COARSE), mode="bilinear", align_corners=False)
    near = ((z - around) / _NEAR_SPREAD_M).clamp(-_NEAR_LIMIT, _NEAR_LIMIT) * valid
    far = ((z - _MIDDLE_M) / _SPREAD_M).clamp(-3.0, 3.0) * valid
    return torch.cat([far, near, valid], 1)


def cell_centres(rows: int, columns: int, stride: int, device: torch.device) -> Tensor:
    """(rows * columns, 2) u, v of the middle of each cell, row by row, pixels; pixel centres are whole numbers."""
    u = (torch.arange(columns, device=device) + 0.5) * stride - 0.5
    v = (torch.arange(rows, device=device) + 0.5) * stride - 0.5
    return torch.stack(torch.meshgrid(u, v, indexing="xy"), -1).reshape(-1, 2)


class ConvBlock(nn.Module):
    """3 x 3 convolution, batch normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=dilation, dilation=dilation, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.norm(self.conv(x)))


class ResidualBlock(nn.Module):
    """Two convolutions and the way around them."""

    def __init__(self, width: int, *, dilation: int = 1) -> None:
        super().__init__()
        self.first, self.second = ConvBlock(width, width, dilation=dilation), ConvBlock(width, width, dilation=dilation)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(self.first(x))


def fuse(net: nn.Module) -> None:
    """Change a network of these blocks for use: batch normalisation folded into the convolutions, weights frozen."""
    net.eval().requires_grad_(False)
    for module in net.modules():
        if isinstance(module, ConvBlock) and isinstance(module.norm, nn.BatchNorm2d):
            module.conv, module.norm = fuse_conv_bn_eval(module.conv, module.norm), nn.Identity()
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
