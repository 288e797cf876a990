"""The net that reads a hand's 21 joints and its mask from a depth crop.

A residual net down to 6 x 6 cells with a way back up. At 12 x 12 cells every cell is an anchor (A2J): for each joint it
says where the joint is from here (du, dv), how deep it is, and with what weight that counts. How far the anchors'
votes should be trusted is said too, as the width of a Laplace distribution. At 24 x 24 cells each tells which of its
4 x 4 pixels show the hand.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.fusion import fuse_conv_bn_eval

from neuralgrasps.human.nets.crop import CROP
from neuralgrasps.human.skeleton import NUM_JOINTS

CELLS = CROP // 8
CONDITIONS = 4
_WIDTHS = (32, 64, 128, 256)


class JointVotes(NamedTuple):
    """What the net says about N crops.

    Attributes:
        joints: (N, 21, 3) u, v in crop widths from the crop's middle, and depth from the crop's reference depth in
            units of 0.1 m; log_width: (N, 21) natural log of the expected error, units of 0.1 m.
        mask: (N, 96, 96) log odds that a pixel shows the hand.
    """

    joints: Tensor
    log_width: Tensor
    mask: Tensor


class _Unit(nn.Module):
    """Convolution, batch norm, rectifier."""

    def __init__(self, inputs: int, outputs: int, *, size: int = 3, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.norm(self.conv(x)), inplace=True)


class _Residual(nn.Module):
    """Two convolutions beside a straight way."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = _Unit(width, width)
        self.conv = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(width)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.norm(self.conv(self.first(x))), inplace=True)


class JointNet(nn.Module):
    """Crops (N, 2, 96, 96) of centred depth and its validity, and conditions (N, 4), to `JointVotes`; see `crop`."""

    def __init__(self, *, blocks: int = 2) -> None:
        super().__init__()
        a, b, c, d = _WIDTHS
        self.stem = nn.Conv2d(2, a, 5, 2, 2, bias=False)
        self.stem_norm: nn.Module = nn.BatchNorm2d(a)
        self.condition = nn.Linear(CONDITIONS, a)
        self.fine = nn.Sequential(_Unit(a, b, stride=2), _Residual(b))
        self.middle = nn.Sequential(_Unit(b, c, stride=2), *(_Residual(c) for _ in range(blocks)))
        self.coarse = nn.Sequential(_Unit(c, d, stride=2), *(_Residual(d) for _ in range(blocks)))
        self.up = nn.Conv2d(d, c, 1)
        self.join = _Residual(c)
        self.votes = nn.Sequential(_Unit(c, c), nn.Conv2d(c, 5 * NUM_JOINTS, 1))
        self.up_fine = nn.Conv2d(c, b, 1)
        self.mask = nn.Sequential(_Unit(b, b), nn.Conv2d(b, 16, 1))
        grid = (torch.arange(CELLS) + 0.5) / CELLS - 0.5
        self.anchors = torch.stack([grid.repeat(CELLS), grid.repeat_interleave(CELLS)])  # float32 in any net

    def forward(self, crops: Tensor, conditions: Tensor) -> JointVotes:
        stem = self.stem_norm(self.stem(crops)) + self.condition(conditions)[:, :, None, None]
        fine = self.fine(F.relu(stem, inplace=True))
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        joined = self.join(middle + F.interpolate(self.up(coarse), scale_factor=2.0))
        mask = self.mask(fine + F.interpolate(self.up_fine(joined), scale_factor=2.0))
        return self._tally(self.votes(joined), F.pixel_shuffle(mask, 4)[:, 0])

    def fused(self) -> JointNet:
        """This net, for use: batch norms folded into the convolutions; weights are frozen."""
        self.eval().requires_grad_(False)
        for module in self.modules():
            if isinstance(module, _Unit | _Residual) and isinstance(module.norm, nn.BatchNorm2d):
                module.conv, module.norm = fuse_conv_bn_eval(module.conv, module.norm), nn.Identity()
        if isinstance(self.stem_norm, nn.BatchNorm2d):
            self.stem, self.stem_norm = fuse_conv_bn_eval(self.stem, self.stem_norm), nn.Identity()
        return self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def _tally(self, votes: Tensor, mask: Tensor) -> JointVotes:
        votes = votes.flatten(2).reshape(len(votes), 5, NUM_JOINTS, CELLS * CELLS).float()
        weight = votes[:, 0].softmax(-1)
        u = (weight * (votes[:, 1] + self.anchors[0])).sum(-1)
        v = (weight * (votes[:, 2] + self.anchors[1])).sum(-1)
        z, log_width = (weight * votes[:, 3]).sum(-1), (weight * votes[:, 4]).sum(-1)
        return JointVotes(torch.stack([u, v, z], -1), log_width, mask.float())
