"""Train the joint net on crops made as it learns; stops and goes on from its last checkpoint."""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from multiprocessing.context import SpawnProcess
from multiprocessing.synchronize import Barrier
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.errors import InputError
from neuralgrasps.human.nets.joint_images import CropBatch, CropMix, make_crops
from neuralgrasps.human.nets.joint_loss import JointLossWeights, camera_points, joint_loss
from neuralgrasps.human.nets.joint_net import JointNet
from neuralgrasps.human.nets.joint_score import JointScore, score_joints
from neuralgrasps.human.scenes.grasp_bank import GraspBank
from neuralgrasps.human.scenes.kit import SceneKit, scene_kit
from neuralgrasps.human.scenes.random_scene import SceneMix
from neuralgrasps.model.train_state import load_training, numpy_arrays, read_tensors, save_training
from neuralgrasps.seeds import child_rng

Report = Callable[[dict[str, float]], None]
_PATIENCE_S = 900.0  # for the slowest worker
FINE_RATE = 1e-3
"""Largest learning rate of a training that starts from trained weights."""
_SCENES = SceneMix(held=0.72, near=0.1)
_CROPS = CropMix(turned=0.5, poor=0.3)
_TEST_SEED = 2**31  # training images have the seeds below, test images those from here on


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTrainConfig:
    """How the joint net is trained.

    Attributes:
        images: crops in all; the learning rate falls along a cosine to its end. batch: per step.
        rate: largest learning rate, reached after `warm` images (FINE_RATE is good for trained weights); weight_decay:
            of AdamW.
        average: images over which the shipped weights are averaged.
        loss: weights of its parts.
        workers: processes of one thread each that share a batch. bf16: compute in bfloat16.
        test_images: crops of the fixed test set; test_every: images between two tests and checkpoints.
    """

    images: int = 1_250_000
    batch: int = 96
    rate: float = 3e-3
    warm: int = 20_000
    weight_decay: float = 0.02
    average: int = 60_000
    loss: JointLossWeights = field(default_factory=JointLossWeights)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Job:
    """What all workers of a training get; see `train_joints`."""

    bank: GraspBank
    config: JointTrainConfig
    seed: int
    start: JointNet | None
    checkpoint: Path | None


def train_joints(
    bank: GraspBank,
    config: JointTrainConfig,
    *,
    seed: int = 0,
    start: JointNet | None = None,
    report: Report | None = None,
    checkpoint: Path | None = None,
) -> JointNet:
    """Train a net on scenes of a bank's grasps with `config.workers` processes.

    Returns the net with the averaged weights, in evaluation mode.

    Args:
        start: weights to start from; random ones when None.
        report: told the figures of every test.
        checkpoint: file that keeps the training meanwhile; a training of the same settings that is there is gone on
            from.
    """
    context = multiprocessing.get_context("spawn")
    size = sum(p.numel() for p in JointNet().parameters())
    ranks = Ranks(
        torch.zeros(2, config.workers, size).share_memory_(), context.Barrier(config.workers, timeout=_PATIENCE_S)
    )
    job = _Job(bank=bank, config=config, seed=seed, start=start, checkpoint=checkpoint)
    others = [context.Process(target=_work, args=(job, ranks, rank), daemon=True) for rank in range(1, config.workers)]
    with _running(others):
        training = _work(job, ranks, 0, report)
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    return training.averaged


@contextmanager
def _running(processes: list[SpawnProcess]) -> Iterator[None]:
    """Processes that run beside the body and end with it; where it fails, at once: they would wait for it."""
    for process in processes:
        process.start()
    try:
        yield
    except BaseException:
        for process in processes:
            process.terminate()
        raise
    finally:
        for process in processes:
            process.join()


def _work(job: _Job, ranks: Ranks, rank: int, report: Report | None = None) -> JointTraining:
    training = JointTraining(job.config, seed=job.seed, start=job.start, ranks=ranks, rank=rank)
    key = _key(job)
    if job.checkpoint is not None:
        training.restore(job.checkpoint, key)
    ranks.barrier.wait()  # nobody saves before all have read

    def keep() -> None:
        if job.checkpoint is not None:
            training.keep(job.checkpoint, key)

    training.run(scene_kit(job.bank), report=report, keep=keep)
    return training


def _key(job: _Job) -> str:
    """sha256 (hex) of what a training is made from."""
    digest = hashlib.sha256(json.dumps([asdict(job.config), job.seed], sort_keys=True).encode())
    arrays = [job.bank.points_O, job.bank.X_OH, job.bank.q]
    if job.start is not None:
        arrays += numpy_arrays(job.start.state_dict()).values()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


class JointTraining:
    """One of the workers that train a net: each takes a part of every batch, and all take the same mean step.

    Args:
        config: see `JointTrainConfig`; seed: of weights and images; start: weights to start from.
        ranks: what the workers share; rank: which one this is. The first tests, reports and keeps.
    """

    def __init__(
        self,
        config: JointTrainConfig,
        *,
        seed: int = 0,
        start: JointNet | None = None,
        ranks: Ranks | None = None,
        rank: int = 0,
    ) -> None:
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        self.config, self.seed, self.done = config, seed, 0
        self.ranks, self.rank = ranks, rank
        self.net = JointNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        if start is not None:
            self.net.load_state_dict(start.state_dict())
        self.averaged = deepcopy(self.net).eval()
        decays = [p for p in self.net.parameters() if p.ndim > 1]
        others = [p for p in self.net.parameters() if p.ndim <= 1]
        groups = [{"params": decays, "weight_decay": config.weight_decay}, {"params": others, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, config.rate, betas=(0.9, 0.99), fused=True)

    def run(self, kit: SceneKit, *, report: Report | None = None, keep: Callable[[], None] | None = None) -> None:
        """Train to `config.images`; every `config.test_every` images tell `report` figures, then call `keep`."""
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
                if keep is not None:
                    keep()
                losses = []

    def keep(self, file: Path, key: str) -> None:
        """Write everything that is needed to go on; `key` recognises the training."""
        tensors = {f"mean.{name}": value for name, value in self.averaged.state_dict().items()}
        tensors["done"] = torch.tensor(self.done)
        save_training(file, self.net, self.optimiser, tensors=tensors, notes={"key": key})

    def restore(self, file: Path, key: str) -> None:
        """Go on from what `keep` wrote, where it was of the same training."""
        if not file.is_file() or read_tensors(file)[1].get("key") != key:
            return
        kept = load_training(file, self.net, self.optimiser)
        self.averaged.load_state_dict({k.removeprefix("mean."): v for k, v in kept.items() if k.startswith("mean.")})
        self.done = int(kept["done"])
        for weight, moments in self.optimiser.state.items():  # the fused step reads both in the order of memory
            for name in ("exp_avg", "exp_avg_sq"):
                moments[name] = torch.empty_like(weight).copy_(moments[name])

    def _crops(self, kit: SceneKit) -> CropBatch:
        seeds = child_rng(self.seed, "crops", self.done).integers(0, _TEST_SEED, self.config.batch, dtype=np.uint32)
        return make_crops(kit, seeds[self.rank :: self.config.workers], scene=_SCENES, crop=_CROPS)

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
        loss = joint_loss(votes, batch, config.loss)
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

    def _tell(self, test: CropBatch, losses: list[float], clock: float, report: Report | None) -> None:
        score = test_net(self.averaged, test, bf16=self.config.bf16)
        if report is not None:
            figures = {"images": self.done, "loss": float(np.mean(losses)), "s": round(time.monotonic() - clock, 1)}
            report(figures | {name: round(value, 4) for name, value in asdict(score).items()})


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


def log_to(file: Path) -> Report:
    """A `report` that adds one line of JSON to a file."""

    def report(figures: dict[str, float]) -> None:
        with file.open("a") as log:
            log.write(json.dumps(figures) + "\n")

    return report
