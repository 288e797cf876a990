"""The published loss of one object's decoder and free codes, on one batch."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor, nn

from neuralgrasps.model.losses import clamped_l1
from neuralgrasps.model.mlp_field import MlpDecoder
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.seeds import child_seed


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """What one step of training sees.

    Attributes:
        scenes: (n,) int64 scenes of the points.
        rows: (n, K, 5) float32 points and distances to object and hand, normalised units.
        anchor, first, second: (T,) int64 scenes of the triplets.
        map_first, map_second: (T,) L2 distance of the anchor's contact map to the two others'.
    """

    scenes: Tensor
    rows: Tensor
    anchor: Tensor
    first: Tensor
    second: Tensor
    map_first: Tensor
    map_second: Tensor

    def tensors(self) -> dict[str, Tensor]:
        """By name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True, slots=True, kw_only=True)
class LossParts:
    """Scalars: `total` is what is minimised; the others before their weights, `sdf` the sum over object and hand."""

    total: Tensor
    sdf: Tensor
    triplet: Tensor
    prior: Tensor

    def stacked(self) -> Tensor:
        """(4,) without gradient: total, sdf, triplet, prior."""
        return torch.stack([self.total, self.sdf, self.triplet, self.prior]).detach()


def triplet_of_distances(
    codes: Tensor, anchor: Tensor, first: Tensor, second: Tensor, map_first: Tensor, map_second: Tensor
) -> Tensor:
    """`losses.variable_margin_triplet` for known contact-map distances of the anchors to both others (T,)."""
    swap = map_second < map_first
    positive, negative = torch.where(swap, second, first), torch.where(swap, first, second)
    margin = (map_second - map_first).abs()
    near, far = ((codes[anchor] - codes[k]).square().sum(-1).clamp(min=1e-12).sqrt() for k in (positive, negative))
    return (near - far + margin).clamp(min=0).mean()


class LatentModel(nn.Module):
    """A decoder and one free code per scene: everything that is trained."""

    def __init__(self, decoder: MlpDecoder, codes: Tensor, config: MlpTrainConfig) -> None:
        super().__init__()
        self.decoder = decoder
        self.codes = nn.Parameter(codes)
        self.config = config

    def forward(self, batch: Batch, step: int, rank: int, prior_weight: float) -> LossParts:
        """The loss of a batch. Dropout and noise depend on seed, step and rank only."""
        config, device = self.config, self.codes.device
        torch.manual_seed(child_seed(config.seed, "noise", rank, step))
        self.decoder.dropout_seed = child_seed(config.seed, "rank", rank)
        self.decoder.dropout_step = step
        self.decoder.fast = config.precision == "bf16" and self.codes.dtype == torch.float32
        seen = self.codes[batch.scenes]
        if config.code_noise and self.training:
            seen = seen + config.code_noise * torch.randn_like(seen)
        rows = batch.rows.to(self.codes.dtype)
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=config.precision == "bf16"):
            out = self.decoder(rows[..., :3], seen)
        sdf = 2.0 * clamped_l1(out, rows[..., 3:], clamp=config.clamp)
        maps = batch.map_first.to(sdf.dtype), batch.map_second.to(sdf.dtype)
        triplet = triplet_of_distances(self.codes, batch.anchor, batch.first, batch.second, *maps)
        prior = self.codes[batch.scenes].norm(dim=-1).mean()
        total = sdf + config.triplet_weight * triplet + prior_weight * prior
        return LossParts(total=total, sdf=sdf, triplet=triplet, prior=prior)
