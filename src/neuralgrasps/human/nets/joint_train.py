"""Train the joint net on crops made as it learns; stops and goes on from its last checkpoint."""

from __future__ import annotations

import json
import math
import multiprocessing
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass
from multiprocessing.synchronize import Barrier
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from neuralgrasps.errors import InputError
from neuralgrasps.human.nets.crop import DEPTH_UNIT_M
from neuralgrasps.human.nets.joint_images import CropBatch, CropMix, make_crops
from neuralgrasps.human.nets.joint_net import JointNet, JointVotes
from neuralgrasps.human.nets.joint_score import JointScore, score_joints
from neuralgrasps.human.scenes.grasp_bank import GraspBank
from neuralgrasps.human.scenes.kit import SceneKit, scene_kit
from neuralgrasps.seeds import child_rng

_PATIENCE_S = 900.0  # for the slowest worker
_TEST_SEED = 2**31  # training images have the seeds below, test images those from here on


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTrainConfig:
    """How the joint net is trained.

    Attributes:
        images: crops in all; the learning rate falls along a cosine to its end. batch: per step.
        rate: largest learning rate, reached after `warm` images; weight_decay: of AdamW.
        average: images over which the shipped weights are averaged.
        mask_share, root_share, width_share: weights of the mask's, the root-relative and the confidence loss beside the
            joints'.
        workers: processes of one thread each that share a batch. bf16: compute in bfloat16.
        test_images: crops of the fixed test set; test_every: images between two tests and checkpoints.
    """

    images: int = 1_250_000
    batch: int = 96
    rate: float = 3e-3
    warm: int = 20_000
    weight_decay: float = 0.02
    average: int = 60_000
    mask_share: float = 0.3
    root_share: float = 0.5
    width_share: float = 0.05
    workers: int = 3
    bf16: bool = True
    test_images: int = 2048
    test_every: int = 50_000

    def __post_init__(self) -> None:
        for name in ("images", "batch", "workers", "test_images", "test_every"):
            if getattr(self, name) < 1:
                raise InputError(f"joint training: {name} is {getattr(self, name)}; expected at least 1.")


@dataclass(frozen=True, slots=True)
class Ranks:
    """What workers share: `gradients` (2, workers, parameters) in shared memory, written in turns; a barrier."""

    gradients: Tensor
    barrier: Barrier


def train_joints(
    bank: GraspBank,
    config: JointTrainConfig,
    *,
    seed: int = 0,
    report: Callable[[dict[str, float]], None] | None = None,
    checkpoint: Path | None = None,
) -> JointNet:
    """Train a net on scenes of a bank's grasps with `config.workers` processes; go on from `checkpoint` if it is there.

    Returns the net with the averaged weights, in evaluation mode.
    """
    context = multiprocessing.get_context("spawn")
    size = sum(p.numel() for p in JointNet().parameters())
    ranks = Ranks(
        torch.zeros(2, config.workers, size).share_memory_(), context.Barrier(config.workers, timeout=_PATIENCE_S)
    )
    others = [
        context.Process(target=_work, args=(bank, config, seed, ranks, rank, None, checkpoint), daemon=True)
        for rank in range(1, config.workers)
    ]
    for process in others:
        process.start()
    training = _work(bank, config, seed, ranks, 0, report, checkpoint)
    for process in others:
        process.join()
    return training.averaged


def _work(
    bank: GraspBank,
    config: JointTrainConfig,
    seed: int,
    ranks: Ranks,
    rank: int,
    report: Callable[[dict[str, float]], None] | None,
    checkpoint: Path | None,
) -> JointTraining:
    training = JointTraining(config, seed=seed, ranks=ranks, rank=rank)
    if checkpoint is not None and checkpoint.exists():
        training.load(checkpoint)
    ranks.barrier.wait()  # nobody saves before all have read
    training.run(scene_kit(bank), report=report, checkpoint=checkpoint)
    return training


class JointTraining:
    """One of the workers that train a net: each takes a part of every batch, and all take the same mean step.

    Args:
        config: see `JointTrainConfig`; seed: of weights and images.
        ranks: what the workers share; rank: which one this is. The first tests, reports and saves.
    """

    def __init__(self, config: JointTrainConfig, *, seed: int = 0, ranks: Ranks | None = None, rank: int = 0) -> None:
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        self.config, self.seed, self.done = config, seed, 0
        self.ranks, self.rank = ranks, rank
        self.net = JointNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.averaged = deepcopy(self.net).eval()
        decays = [p for p in self.net.parameters() if p.ndim > 1]
        others = [p for p in self.net.parameters() if p.ndim <= 1]
        groups = [{"params": decays, "weight_decay": config.weight_decay}, {"params": others, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, config.rate, betas=(0.9, 0.99), fused=True)

    def run(
        self, kit: SceneKit, *, report: Callable[[dict[str, float]], None] | None = None, checkpoint: Path | None = None
    ) -> None:
        """Train to `config.images`; every `config.test_every` images tell `report` figures and write a checkpoint."""
        config = self.config
        test = test_crops(kit, config.test_images) if self.rank == 0 else None
        losses: list[float] = []
        clock = time.monotonic()
        while self.done < config.images:
            losses.append(self._step(self._crops(kit)))
            before, self.done = self.done, self.done + config.batch
            due = before // config.test_every != self.done // config.test_every or self.done >= config.images
            if test is not None and due:
                self._tell(test, losses, clock, report)
                if checkpoint is not None:
                    self.save(checkpoint)
                losses = []

    def save(self, file: Path) -> None:
        """Write everything that is needed to go on."""
        file.parent.mkdir(parents=True, exist_ok=True)
        state = {
            "net": self.net.state_dict(), "averaged": self.averaged.state_dict(), "done": self.done,
            "optimiser": self.optimiser.state_dict(), "config": asdict(self.config), "seed": self.seed,
        }  # fmt: skip
        torch.save(state, file.with_suffix(".part"))
        file.with_suffix(".part").replace(file)

    def load(self, file: Path) -> None:
        """Go on from what `save` wrote."""
        state = torch.load(file, weights_only=True)
        self.net.load_state_dict(state["net"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.done, self.seed = state["done"], state["seed"]

    def _crops(self, kit: SceneKit) -> CropBatch:
        seeds = child_rng(self.seed, "crops", self.done).integers(0, _TEST_SEED, self.config.batch, dtype=np.uint32)
        return make_crops(kit, seeds[self.rank :: self.config.workers])

    def _step(self, batch: CropBatch) -> float:
        config = self.config
        rate = config.rate * min(1.0, (self.done + config.batch) / config.warm)
        rate *= 0.5 * (1.0 + math.cos(math.pi * min(self.done / config.images, 1.0))) + 1e-3
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        inputs = torch.from_numpy(batch.inputs).contiguous(memory_format=torch.channels_last)
        conditions = torch.from_numpy(batch.conditions)
        self.net.train()
        with torch.autocast("cpu", torch.bfloat16, enabled=config.bf16):
            votes = self.net(inputs, conditions)
        loss = joint_loss(votes, batch, config)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        if self.ranks is not None:
            self._share_gradients(self.ranks)
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), 1.0)
        self.optimiser.step()
        self._average()
        return float(loss.detach())

    def _share_gradients(self, ranks: Ranks) -> None:
        """Replace this worker's gradients by the mean over all workers."""
        gradients = [p.grad for p in self.net.parameters() if p.grad is not None]
        slot = ranks.gradients[(self.done // self.config.batch) % 2]
        torch.cat([g.flatten() for g in gradients], out=slot[self.rank])
        ranks.barrier.wait()
        mean = slot.mean(0)
        first = 0
        for gradient in gradients:
            gradient.copy_(mean[first : first + gradient.numel()].view_as(gradient))
            first += gradient.numel()

    def _average(self) -> None:
        """Exponential mean of the weights, over fewer images at the start."""
        share = max(self.config.batch / self.config.average, 1.0 / (1.0 + self.done / self.config.batch))
        with torch.no_grad():
            state = self.net.state_dict()
            means = [m for m in self.averaged.state_dict().values() if m.is_floating_point()]
            news = [n for n in state.values() if n.is_floating_point()]
            torch._foreach_lerp_(means, news, share)

    def _tell(
        self, test: CropBatch, losses: list[float], clock: float, report: Callable[[dict[str, float]], None] | None
    ) -> None:
        score = test_net(self.averaged, test, bf16=self.config.bf16)
        if report is not None:
            figures = {"images": self.done, "loss": float(np.mean(losses)), "s": round(time.monotonic() - clock, 1)}
            report(figures | {name: round(value, 4) for name, value in asdict(score).items()})


def joint_loss(votes: JointVotes, batch: CropBatch, config: JointTrainConfig) -> Tensor:
    """Distances in units of 0.1 m, of the joints and of the joints from the wrist; the mask's cross entropy."""
    points = camera_points(votes.joints, torch.from_numpy(batch.conditions))
    errors = (points - torch.from_numpy(batch.joints_C)) / 0.1
    distance = _smooth_length(errors)
    relative = _smooth_length(errors - errors[:, :1])
    width = votes.log_width.clamp(-5.0, 2.0)
    confidence = width + distance.detach() / width.exp()
    mask = F.binary_cross_entropy_with_logits(votes.mask, torch.from_numpy(batch.mask).float())
    return (
        distance.mean()
        + config.root_share * relative.mean()
        + config.width_share * confidence.mean()
        + config.mask_share * mask
    )


def camera_points(joints: Tensor, conditions: Tensor) -> Tensor:
    """(N, 21, 3) camera frame, metres, of what the net says; `crop.crop_points` with gradients."""
    width, x, y, z0 = (conditions[:, k, None] for k in range(4))
    z = z0 + DEPTH_UNIT_M * joints[..., 2]
    return torch.stack([(x + joints[..., 0] * width / z0) * z, (y + joints[..., 1] * width / z0) * z, z], dim=-1)


def test_crops(kit: SceneKit, count: int, *, threads: int = 1) -> CropBatch:
    """The fixed test set: boxes off as a detector's, seeds that training never draws."""
    mix = CropMix(poor=0.0, measure_visible=True)
    return make_crops(kit, np.arange(_TEST_SEED, _TEST_SEED + count, dtype=np.uint32), crop=mix, threads=threads)


def test_net(net: JointNet, test: CropBatch, *, bf16: bool, block: int = 256) -> JointScore:
    """Errors on a test set of hands that hold something and are seen to more than 40 %."""
    points, masks = [], []
    for first in range(0, len(test.inputs), block):
        rows = slice(first, first + block)
        inputs = torch.from_numpy(test.inputs[rows]).contiguous(memory_format=torch.channels_last)
        conditions = torch.from_numpy(test.conditions[rows])
        with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            votes = net(inputs, conditions)
        points.append(camera_points(votes.joints, conditions).numpy())
        masks.append((votes.mask > 0).numpy())
    return score_joints(np.concatenate(points), np.concatenate(masks), test)


def log_to(file: Path) -> Callable[[dict[str, float]], None]:
    """A `report` that adds one line of JSON to a file."""

    def report(figures: dict[str, float]) -> None:
        with file.open("a") as log:
            log.write(json.dumps(figures) + "\n")

    return report


def _smooth_length(errors: Tensor) -> Tensor:
    """Length over the last axis, quadratic below 2 mm."""
    return (errors.square().sum(-1) + 0.02**2).sqrt() - 0.02
