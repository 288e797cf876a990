"""Right or left: a small head on what the joint net sees in the crop round a hand.

A left hand is a right one in the mirror, so that the answer is what the network says of the crop less what it says of
the mirrored crop. From one bit per image a network of its own learned nothing in 40,000 crops; the lower half of the
joint net, which learned where joints of right hands are, tells the sides apart after 8,000.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from neuralgrasps.human.nets.joint_net import JointNet

_SEEN, _WIDTH, _CELLS = 128, 64, 6


class SideNet(nn.Module):
    """Crops (N, 2, 96, 96) and conditions (N, 4) of `crop.take_crop` to (N,) logits that the hand is a right one.

    Args:
        joints: the trained joint net whose lower half is taken over; untrained when None, for weights to be read.
    """

    def __init__(self, joints: JointNet | None = None) -> None:
        super().__init__()
        whole = JointNet() if joints is None else joints
        self.stem, self.stem_norm, self.condition = whole.stem, whole.stem_norm, whole.condition
        self.fine, self.middle = whole.fine, whole.middle
        self.register_buffer("mean", torch.zeros(1, _SEEN, 1, 1))
        self.register_buffer("spread", torch.ones(1, _SEEN, 1, 1))
        self.body = nn.Sequential(
            nn.Conv2d(_SEEN, _WIDTH, 3, padding=1), nn.ReLU(), nn.Dropout2d(0.2),
            nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1), nn.ReLU(),
        )  # fmt: skip
        self.drop = nn.Dropout(0.3)
        self.places, self.kinds = nn.Linear(_WIDTH * _CELLS**2, 1), nn.Linear(_WIDTH, 1)

    def forward(self, crops: Tensor, conditions: Tensor) -> Tensor:
        turned = conditions * conditions.new_tensor([1.0, -1.0, 1.0, 1.0])
        return self.right(self.seen(crops, conditions)) - self.right(self.seen(crops.flip(-1), turned))

    def seen(self, crops: Tensor, conditions: Tensor) -> Tensor:
        """(N, 128, 6, 6) what the joint net's lower half sees."""
        stem = self.stem_norm(self.stem(crops)) + self.condition(conditions)[:, :, None, None]
        return F.avg_pool2d(self.middle(self.fine(F.relu(stem))), 2)

    def right(self, seen: Tensor) -> Tensor:
        """(N,) what speaks for a right hand in what is `seen` of a crop, its mirror image aside."""
        body = self.body((seen.float() - cast(Tensor, self.mean)) / cast(Tensor, self.spread))
        return (self.places(self.drop(body.flatten(1))) + self.kinds(body.mean((2, 3))))[:, 0].float()
