"""Train the hand detector on images that are drawn meanwhile, by another process; a killed training goes on."""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from neuralgrasps.errors import DivergedError, InputError
from neuralgrasps.human.nets.detector_images import DetectorImages, ImageMaker, with_mirrored
from neuralgrasps.human.nets.detector_loss import HandLabels, detector_loss
from neuralgrasps.human.nets.detector_net import DetectorNet
from neuralgrasps.human.scenes.grasp_bank import GraspBank
from neuralgrasps.model.optimise import Progress, one_cycle
from neuralgrasps.model.train_state import load_training, numpy_arrays, read_tensors, save_training, torch_threads
from neuralgrasps.seeds import child_seed

CHECKPOINT_S = 30.0
_AHEAD = 4  # batches drawn before they are needed
_EMA_BORN = 10.0  # the mean of the weights reaches back a tenth of the steps at first


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorTrainConfig:
    """How the detector is trained.

    Attributes:
        images: in all, each seen once; half of them are the others in the mirror. batch: per step, an even number.
        learning_rate: peak of a one-cycle schedule (AdamW).
        mean_decay: of the running mean of the weights, which is what is kept.
        seed: of the start weights and of the images.
        threads: torch's threads; one more process draws the images.
    """

    images: int = 150_000
    batch: int = 48
    learning_rate: float = 2e-3
    weight_decay: float = 0.02
    mean_decay: float = 0.998
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        if self.images < 1 or self.batch < 2 or self.batch % 2 or self.threads < 1:
            raise InputError(
                f"images {self.images}, batch {self.batch}, threads {self.threads}; expected at least 1 of each, and "
                "an even batch."
            )

    @property
    def steps(self) -> int:
        return math.ceil(self.images / self.batch)


def train_detector(
    bank: GraspBank,
    *,
    config: DetectorTrainConfig,
    start: DetectorNet | None = None,
    state: Path | None = None,
    progress: Progress | None = None,
) -> DetectorNet:
    """Train a network; the result holds the mean weights.

    Args:
        bank: hands and the solids in them.
        start: weights to start from; random ones when None.
        state: file that keeps the training meanwhile; a training of the same config that is there is gone on from.
    Raises:
        DivergedError: the loss became NaN or infinite.
    """
    torch.manual_seed(child_seed(config.seed, "detector weights"))
    net: DetectorNet = DetectorNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    if start is not None:
        net.load_state_dict(start.state_dict())
    mean = DetectorNet()
    mean.load_state_dict(net.state_dict())
    optimiser = torch.optim.AdamW(net.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    key = _key(bank, config, net)
    first = _restore(state, key, net, mean, optimiser)
    saved = time.monotonic()
    with torch_threads(config.threads):
        for step, images in enumerate(_batches(bank, config, first), first):
            for group in optimiser.param_groups:
                group["lr"] = config.learning_rate * one_cycle(step / config.steps)
            loss = train_step(net, optimiser, images)
            if not math.isfinite(loss):
                raise DivergedError(f"the loss of step {step} is {loss}; lower the learning rate.")
            _follow(mean, net, min(config.mean_decay, (1.0 + step) / (_EMA_BORN + step)))
            if state is not None and time.monotonic() - saved > CHECKPOINT_S:
                _keep(state, key, net, mean, optimiser, step + 1)
                saved = time.monotonic()
            if progress is not None:
                progress(step + 1, config.steps, loss)
    if state is not None:
        state.unlink(missing_ok=True)
    return mean.eval()


def train_step(net: DetectorNet, optimiser: torch.optim.Optimizer, images: DetectorImages) -> float:
    """One gradient step; the loss before it."""
    net.train()
    with torch.autocast("cpu", torch.bfloat16):
        cells = net(torch.from_numpy(images.depth))
    loss = detector_loss(cells, hand_labels(images)).total
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
    optimiser.step()
    return float(loss.detach())


def hand_labels(images: DetectorImages) -> HandLabels:
    """What the loss needs to know of images."""
    arrays = (images.boxes, images.right, images.known, images.ignored)
    boxes, right, known, ignored = map(torch.from_numpy, arrays)
    return HandLabels(boxes=boxes, right=right, known=known, ignored=ignored)


_maker: list[ImageMaker] = []  # of this process


def _start_maker(bank: GraspBank) -> None:
    _maker.append(ImageMaker(bank))


def _draw(seed: int, first: int, count: int) -> DetectorImages:
    return with_mirrored(_maker[-1].draw(seed, first, count))


def _batches(bank: GraspBank, config: DetectorTrainConfig, first: int) -> Iterator[DetectorImages]:
    """The images of the steps from `first` on."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(1, mp_context=context, initializer=_start_maker, initargs=(bank,))
    waiting: deque[Future[DetectorImages]] = deque()
    try:
        for step in range(first, config.steps + _AHEAD):
            if step < config.steps:
                waiting.append(pool.submit(_draw, config.seed, step * config.batch // 2, config.batch // 2))
            if step >= first + _AHEAD and waiting:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _follow(mean: DetectorNet, net: DetectorNet, decay: float) -> None:
    with torch.no_grad():
        for kept, new in zip(mean.state_dict().values(), net.state_dict().values(), strict=True):
            if kept.is_floating_point():
                kept.lerp_(new, 1.0 - decay)
            else:
                kept.copy_(new)


def _key(bank: GraspBank, config: DetectorTrainConfig, net: DetectorNet) -> str:
    """sha256 (hex) of what a training is made from."""
    digest = hashlib.sha256(json.dumps(asdict(config), sort_keys=True).encode())
    for array in (bank.points_O, bank.X_OH, bank.q):
        digest.update(np.ascontiguousarray(array).tobytes())
    for array in numpy_arrays(net.state_dict()).values():
        digest.update(array.tobytes())
    return digest.hexdigest()


def _keep(
    state: Path, key: str, net: DetectorNet, mean: DetectorNet, optimiser: torch.optim.Optimizer, done: int
) -> None:
    tensors = {f"mean.{name}": value for name, value in mean.state_dict().items()}
    save_training(state, net, optimiser, tensors={**tensors, "done": torch.tensor(done)}, notes={"key": key})


def _restore(
    state: Path | None, key: str, net: DetectorNet, mean: DetectorNet, optimiser: torch.optim.Optimizer
) -> int:
    """Steps already done by a checkpoint of the same training, put into the arguments; 0 without one."""
    if state is None or not state.is_file() or read_tensors(state)[1].get("key") != key:
        return 0
    kept = load_training(state, net, optimiser)
    mean.load_state_dict({k.removeprefix("mean."): v for k, v in kept.items() if k.startswith("mean.")})
    return int(kept["done"])
