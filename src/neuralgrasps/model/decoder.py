"""The trained part of a field: moves codes that are off back to grasps, by what their contact block says.

The network sees the object as 96 points, its cells, in the frame of the coded palm, each with the closeness and the
distance to the hand that the code states. So it knows no object by name, gives the same answer however hand and object
are turned together, and serves objects that it was not trained on. One network for all hands, with a vector of its own
and an output for each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from neuralgrasps.geometry.rotation import exp_so3, matrix_from_6d, matrix_to_6d
from neuralgrasps.model.codes import CELLS, PALM, PALM_UNIT_M, POSTURE, ObjectCodec

SURE_LEVEL = 0.05  # below about this noise level codes are better than what the network knows of grasps
_TWIST = 6
_CELL_INPUTS = 5  # position in the palm frame, distance, closeness
_LEAST_CLOSENESS = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class DecoderConfig:
    """Size of the network.

    Attributes:
        cells: how many, those nearest to the hand, are looked at.
        cell_width, trunk_width, hand_width: of the network that sees one cell at a time, of the one behind it, and of
            each hand's vector.
    """

    cells: int = 48
    cell_width: int = 96
    trunk_width: int = 256
    hand_width: int = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class CellTensors:
    """Cells of the objects of N codes.

    Attributes:
        centres: (N, 96, 3) relative to the object's centre, metres. weights: (N, 96) what a block's numbers are divided
            by to get closeness. radius_m: (N,).
    """

    centres: Tensor
    weights: Tensor
    radius_m: Tensor

    def __getitem__(self, chosen: Tensor) -> CellTensors:
        return CellTensors(centres=self.centres[chosen], weights=self.weights[chosen], radius_m=self.radius_m[chosen])

    def expand(self, count: int) -> CellTensors:
        """The same object (N = 1) for `count` codes."""
        return CellTensors(
            centres=self.centres.expand(count, -1, -1),
            weights=self.weights.expand(count, -1),
            radius_m=self.radius_m.expand(count),
        )


def cell_tensors(codecs: list[ObjectCodec], *, dtype: torch.dtype, device: torch.device | str = "cpu") -> CellTensors:
    """Cells of K objects, one row each."""
    return CellTensors(
        centres=torch.as_tensor(np.stack([c.centres_O - c.offset_O for c in codecs]), dtype=dtype, device=device),
        weights=torch.as_tensor(np.stack([c.weights for c in codecs]), dtype=dtype, device=device),
        radius_m=torch.as_tensor([c.radius_m for c in codecs], dtype=dtype, device=device),
    )


class Decoder(nn.Module):
    """How far to move palm and posture of codes that are off, per unit of noise level."""

    def __init__(self, hands: tuple[str, ...], config: DecoderConfig | None = None) -> None:
        super().__init__()
        self.config = config or DecoderConfig()
        self.hands = tuple(hands)
        cell, trunk, own = self.config.cell_width, self.config.trunk_width, self.config.hand_width
        context = POSTURE + own + 1 + 3
        self.hand_vectors = nn.Parameter(torch.zeros(len(self.hands), own))
        self.cell_in = nn.Linear(_CELL_INPUTS, cell)
        self.context_in = nn.Linear(context, cell)
        self.cell_mid = nn.Linear(cell, cell)
        self.cell_out = nn.Linear(cell, cell)
        self.trunk = nn.Sequential(nn.Linear(2 * cell + context, trunk), nn.SiLU(), nn.Linear(trunk, trunk), nn.SiLU())
        self.heads = nn.Linear(trunk, len(self.hands) * (_TWIST + POSTURE))

    def initialise(self, generator: torch.Generator) -> None:
        """Random weights; the first outputs are near zero, so that training starts from what codes say."""
        with torch.no_grad():
            self.hand_vectors.normal_(generator=generator)
            for module in self.modules():
                if isinstance(module, nn.Linear):
                    bound = module.in_features**-0.5
                    module.weight.uniform_(-bound, bound, generator=generator)
                    module.bias.zero_()
            self.heads.weight.mul_(0.05)

    def forward(self, codes: Tensor, cells: CellTensors, level: Tensor, hand_index: Tensor) -> Tensor:
        """(N, 29) twist of the palm in its own frame (0.1 m, rad) and change of posture.

        Args:
            codes: (N, 128); cells: of their objects; level: (N,) > 0; hand_index: (N,) into `hands`.
        """
        R = matrix_from_6d(codes[:, CELLS + 3 : CELLS + PALM])
        palm = codes[:, CELLS : CELLS + 3] * PALM_UNIT_M
        position = (cells.centres - palm[:, None]) @ R / PALM_UNIT_M  # of the cells in the palm frame
        closeness = (codes[:, :CELLS] / cells.weights).clamp(_LEAST_CLOSENESS, 1.2)
        distance = -torch.log(closeness) * cells.radius_m[:, None] / PALM_UNIT_M
        inputs = torch.cat([position, distance[..., None], closeness[..., None]], dim=-1)
        nearest = closeness.topk(self.config.cells, dim=1).indices  # the others say little, and cost as much
        inputs = inputs.gather(1, nearest[..., None].expand(-1, -1, _CELL_INPUTS))
        middle = -(palm[:, None] @ R)[:, 0] / PALM_UNIT_M  # of the object in the palm frame
        scale = torch.log(level.clamp(min=1e-4))[:, None] / 4.0
        context = torch.cat([codes[:, CELLS + PALM :], self.hand_vectors[hand_index], scale, middle], dim=-1)
        x = nn.functional.relu(self.cell_in(inputs) + self.context_in(context)[:, None], inplace=True)
        x = self.cell_out(nn.functional.relu(self.cell_mid(x), inplace=True))
        features = self.trunk(torch.cat([x.mean(dim=1), x.amax(dim=1), context], dim=-1))
        every = self.heads(features).reshape(len(codes), len(self.hands), _TWIST + POSTURE)
        return every[torch.arange(len(codes), device=codes.device), hand_index]


def corrected_blocks(decoder: Decoder, codes: Tensor, cells: CellTensors, level: Tensor, hand_index: Tensor) -> Tensor:
    """Palm and posture blocks (N, 32) after the correction; arguments as for `Decoder.forward`.

    The correction is in proportion to the level, and less where a code is nearly right: it would only blur it there.
    """
    trust = level**3 / (level**2 + SURE_LEVEL**2)
    move = trust[:, None] * decoder(codes, cells, level, hand_index)
    R = matrix_from_6d(codes[:, CELLS + 3 : CELLS + PALM])
    position = codes[:, CELLS : CELLS + 3] + (R @ move[:, :3, None]).squeeze(-1)
    turned = matrix_to_6d(R @ exp_so3(move[:, 3:_TWIST]))
    return torch.cat([position, turned, codes[:, CELLS + PALM :] + move[:, _TWIST:]], dim=-1)
