"""Train the network that tells right hands from left ones, on crops of right hands and their mirror images."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional as F

from neuralgrasps.human.joint_images import CropBatch, CropMix, make_crops
from neuralgrasps.human.random_scene import SceneMix
from neuralgrasps.human.scene_kit import SceneKit
from neuralgrasps.human.side_net import SideNet
from neuralgrasps.model.optimise import Progress, one_cycle
from neuralgrasps.model.train_state import torch_threads
from neuralgrasps.seeds import child_rng, child_seed

_CROPS = CropMix(refined=0.0, shift=0.15, size=0.25)
_SCENES = SceneMix(farthest_m=1.3)
_RATE, _DECAY = 3e-3, 0.02
_SURE = math.log(0.8 / 0.2)  # logit


def train_side(
    kit: SceneKit, *, images: int = 300_000, batch: int = 128, seed: int = 0, progress: Progress | None = None
) -> SideNet:
    """Train on so many crops; one thread draws, one learns."""
    torch.manual_seed(child_seed(seed, "side weights"))
    net: SideNet = SideNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.AdamW(net.parameters(), lr=_RATE, weight_decay=_DECAY)
    steps = -(-images // batch)
    with torch_threads(1):
        for step, crops in enumerate(_batches(kit, steps, batch, seed)):
            for group in optimiser.param_groups:
                group["lr"] = _RATE * one_cycle(step / steps)
            inputs = torch.from_numpy(crops.inputs).contiguous(memory_format=torch.channels_last)
            with torch.autocast("cpu", torch.bfloat16):
                right = net(inputs)
            loss = F.softplus(-right).mean()  # all are right hands; the mirror gives the left ones
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            if progress is not None:
                progress(step + 1, steps, float(loss.detach()))
    return net.eval()


def side_crops(kit: SceneKit, count: int, seed: int) -> CropBatch:
    """`count` (not 0) crops of right hands, boxes as far off as a detector's."""
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
    with torch.inference_mode():
        right = torch.cat([net(torch.from_numpy(part)) for part in np.array_split(crops.inputs, 10)]).numpy()
    good, sure = right > 0, np.abs(right) > _SURE
    return SideAccuracy(
        all=float(good.mean()),
        clear=float(good[crops.visible > 0.4].mean()),
        holding=float(good[crops.holds].mean()),
        where_sure=float(good[sure].mean()) if sure.any() else float("nan"),
        sure=float(sure.mean()),
    )


def _batches(kit: SceneKit, steps: int, batch: int, seed: int) -> Iterator[CropBatch]:
    def draw(step: int) -> CropBatch:
        seeds = child_rng(seed, "side batch", step).integers(0, 2**32, batch, dtype=np.uint32)
        return make_crops(kit, seeds, scene=_SCENES, crop=_CROPS)

    with ThreadPoolExecutor(1) as drawer:
        coming = drawer.submit(draw, 0)
        for step in range(steps):
            crops = coming.result()
            if step + 1 < steps:
                coming = drawer.submit(draw, step + 1)
            yield crops
