"""Train the head that tells right hands from left ones, on crops of right hands and their mirror images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from neuralgrasps.human.nets.joint_images import CropBatch, CropMix, make_crops
from neuralgrasps.human.nets.joint_net import JointNet
from neuralgrasps.human.nets.side_net import SideNet
from neuralgrasps.human.scenes.kit import SceneKit
from neuralgrasps.human.scenes.random_scene import SceneMix
from neuralgrasps.model.optimise import Progress, one_cycle
from neuralgrasps.model.train_state import torch_threads
from neuralgrasps.seeds import child_rng, child_seed

_CROPS = CropMix(refined=0.0, shift=0.15, size=0.25)
_SCENES = SceneMix(farthest_m=1.3)
_BLOCK = 200  # crops drawn and looked at together
_BATCH, _EPOCHS = 128, 6
_RATE, _DECAY = 2e-3, 0.05
_SURE = math.log(0.8 / 0.2)  # logit


def train_side(
    kit: SceneKit, joints: JointNet, *, images: int = 28_000, seed: int = 0, progress: Progress | None = None
) -> SideNet:
    """Look at so many crops with the lower half of a trained joint net, then train a head on what it saw.

    Args:
        progress: told the crops looked at, and a loss once there is one.
    """
    torch.manual_seed(child_seed(seed, "side weights"))
    net = SideNet(joints).eval().requires_grad_(False)
    with torch_threads(1):
        seen, mirrored = _seen_of_crops(net, kit, images, seed, progress)
        net.mean.copy_(seen.float().mean((0, 2, 3), keepdim=True))  # type: ignore[operator]
        net.spread.copy_(seen.float().std((0, 2, 3), keepdim=True) + 1e-3)  # type: ignore[operator]
        _train_head(net, seen, mirrored, images, progress)
    return net.eval()


def side_crops(kit: SceneKit, count: int, seed: int) -> CropBatch:
    """`count` crops of right hands, boxes as far off as a detector's."""
    seeds = child_rng(seed, "side crops").integers(0, 2**32, count, dtype=np.uint32)
    return make_crops(kit, seeds, scene=_SCENES, crop=_CROPS._replace(measure_visible=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class SideAccuracy:
    """Shares of crops whose side is right: of all, of hands more than 40 % in view, of those that hold something, and
    of those that the network is sure of (at 0.8), with `sure` their share."""

    all: float
    clear: float
    holding: float
    where_sure: float
    sure: float


def side_accuracy(net: SideNet, crops: CropBatch) -> SideAccuracy:
    """Test a network on crops of right hands."""
    said = []
    with torch.inference_mode():
        for inputs, conditions in zip(
            np.array_split(crops.inputs, 10), np.array_split(crops.conditions, 10), strict=True
        ):
            said.append(net(torch.from_numpy(inputs), torch.from_numpy(conditions)))
    right = torch.cat(said).numpy()
    good, sure = right > 0, np.abs(right) > _SURE
    return SideAccuracy(
        all=float(good.mean()),
        clear=float(good[crops.visible > 0.4].mean()),
        holding=float(good[crops.holds].mean()),
        where_sure=float(good[sure].mean()) if sure.any() else float("nan"),
        sure=float(sure.mean()),
    )


def _seen_of_crops(
    net: SideNet, kit: SceneKit, images: int, seed: int, progress: Progress | None
) -> tuple[Tensor, Tensor]:
    """(N, 128, 6, 6) half precision, what is seen of right hands and of the same in the mirror."""
    seen, mirrored = [], []
    for first in range(0, images, _BLOCK):
        count = min(_BLOCK, images - first)
        seeds = child_rng(seed, "side2", first).integers(0, 2**32, count, dtype=np.uint32)
        crops = make_crops(kit, seeds, scene=_SCENES, crop=_CROPS)
        inputs, conditions = torch.from_numpy(crops.inputs), torch.from_numpy(crops.conditions)
        turned = conditions * torch.tensor([1.0, -1.0, 1.0, 1.0])
        with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
            seen.append(net.seen(inputs, conditions).half())
            mirrored.append(net.seen(inputs.flip(-1), turned).half())
        if progress is not None:
            progress(first + count, images, float("nan"))
    return torch.cat(seen), torch.cat(mirrored)


def _train_head(net: SideNet, seen: Tensor, mirrored: Tensor, images: int, progress: Progress | None) -> None:
    parts = (net.body, net.places, net.kinds)
    weights = [weight.requires_grad_() for part in parts for weight in part.parameters()]
    optimiser = torch.optim.AdamW(weights, lr=_RATE, weight_decay=_DECAY)
    steps = _EPOCHS * math.ceil(len(seen) / _BATCH)
    step = 0
    net.train()
    for _ in range(_EPOCHS):
        for rows in torch.randperm(len(seen)).split(_BATCH):
            optimiser.param_groups[0]["lr"] = _RATE * one_cycle(step / steps)
            with torch.autocast("cpu", torch.bfloat16):
                right = net.right(seen[rows]) - net.right(mirrored[rows])
            loss = F.softplus(-right).mean()  # all are right hands
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            step += 1
        if progress is not None:
            progress(images, images, float(loss.detach()))
    net.requires_grad_(False)
