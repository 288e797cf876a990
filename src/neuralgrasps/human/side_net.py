"""Right or left: a small network on the crop round a hand.

A left hand is a right one in the mirror, so that the network's answer is what it says of the crop less what it says of
the mirrored crop: right and left are told apart by nothing else.
"""

from __future__ import annotations

from torch import Tensor, nn

from neuralgrasps.human.detector_net import ConvBlock, ResidualBlock


class SideNet(nn.Module):
    """Crops (N, 2, 96, 96) of `crop.take_crop` to (N,) logits that the hand is a right one.

    Args:
        widths: channels at 2, 4, 8 and 16 pixels a cell.
    """

    def __init__(self, widths: tuple[int, int, int, int] = (16, 24, 48, 96)) -> None:
        super().__init__()
        w2, w4, w8, w16 = widths
        self.body = nn.Sequential(
            ConvBlock(2, w2, stride=2), ConvBlock(w2, w4, stride=2), ResidualBlock(w4), ConvBlock(w4, w8, stride=2),
            ResidualBlock(w8), ConvBlock(w8, w16, stride=2), ResidualBlock(w16),
        )  # fmt: skip
        self.answer = nn.Conv2d(w16, 1, 6)  # of the whole crop at once: where things are counts

    def forward(self, crops: Tensor) -> Tensor:
        return self.one_way(crops) - self.one_way(crops.flip(-1))

    def one_way(self, crops: Tensor) -> Tensor:
        """(N,) what the crops alone say."""
        return self.answer(self.body(crops)).flatten().float()
