"""Gradient steps of the correction network: the loss, the schedule, and going on where a killed training was."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.errors import DivergedError, InputError
from neuralgrasps.geometry.rotation import exp_so3
from neuralgrasps.model.codes import CELLS, PALM
from neuralgrasps.model.decoder import CellTensors, Decoder, DecoderConfig, cell_tensors, corrected_blocks
from neuralgrasps.model.kinematic_field import KinematicField, decode_blocks
from neuralgrasps.model.losses import point_distances
from neuralgrasps.model.train_data import HandData, Jitter
from neuralgrasps.model.train_state import STATE_FILE, load_training, read_tensors, save_training

Progress = Callable[[int, int, float], None]
"""Called as progress(steps done, all steps, latest loss)."""

CHECKPOINT_S = 30.0
WARM_UP = 0.1  # share of the steps in which the learning rate rises


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """How the correction network is trained.

    Attributes:
        seed: of the start weights, the jitter, the batches and the noise.
        steps: gradient steps; each sees `batch` grasps of every hand.
        learning_rate: peak of a one-cycle schedule (Adam).
        noise_min, noise_max: range of noise levels, in code units (0.1 = 1 cm, 0.1 rad, 5 % of a joint's range).
        contact_noise: noise of the contact block per unit of noise level.
        jitter: copies of each grasp, with contact blocks of their own, beside the grasp itself.
        threads: torch's threads while training, on any machine: sums come out the same only for the same number.
    """

    seed: int = 0
    steps: int = 2000
    batch: int = 64
    learning_rate: float = 3e-3
    noise_min: float = 0.02
    noise_max: float = 0.5
    contact_noise: float = 0.2
    jitter: Jitter = field(default_factory=Jitter)
    threads: int = 2
    decoder: DecoderConfig = field(default_factory=DecoderConfig)

    def __post_init__(self) -> None:
        if self.steps < 0 or self.batch < 1 or self.jitter.copies < 0:
            raise InputError(
                f"steps {self.steps}, batch {self.batch}, copies {self.jitter.copies}; expected at least 0, 1 and 0."
            )
        if not self.learning_rate > 0.0:
            raise InputError(f"learning_rate is {self.learning_rate}; expected more than 0, such as 0.003.")
        if self.threads < 1:
            raise InputError(f"threads is {self.threads}; expected at least 1.")
        if not 0.0 < self.noise_min <= self.noise_max:
            raise InputError(f"noise levels {self.noise_min} to {self.noise_max}; expected 0 < noise_min <= noise_max.")


def optimise(
    field: KinematicField,
    decoder: Decoder,
    data: Mapping[str, HandData],
    config: TrainConfig,
    generator: torch.Generator,
    *,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """Train the decoder in place; (steps,) losses.

    Args:
        folder: keeps a checkpoint every `CHECKPOINT_S` seconds while training; one of the same training that is there
            already is gone on from, with the same weights in the end. It is removed when training is done.
    Raises:
        DivergedError: the loss became NaN or infinite.
    """
    losses = torch.zeros(config.steps, dtype=torch.float64)
    optimiser = torch.optim.Adam(decoder.parameters(), lr=config.learning_rate)
    cells = cell_tensors(list(field.object_codecs.values()), dtype=torch.float32)
    state = None if folder is None else folder / STATE_FILE
    key = training_key(config, data)
    first = _restore(state, key, decoder, optimiser, generator, losses)
    point = _Point(done=first, drawn=generator.get_state())

    def keep() -> None:
        if state is not None and point.whole and 0 < point.done < config.steps:
            tensors = {"losses": losses[: point.done], "generator": point.drawn}
            save_training(state, decoder, optimiser, tensors=tensors, notes={"key": key})

    saved = time.monotonic()
    try:
        for step in range(first, config.steps):
            optimiser.param_groups[0]["lr"] = config.learning_rate * one_cycle(step / config.steps)
            losses[step] = _step(field, decoder, data, cells, config, generator, optimiser, point, step)
            point.done, point.drawn, point.whole = step + 1, generator.get_state(), True
            if time.monotonic() - saved > CHECKPOINT_S:
                keep()
                saved = time.monotonic()
            if progress is not None:
                progress(step + 1, config.steps, float(losses[step]))
    except KeyboardInterrupt:
        keep()
        raise
    if state is not None:
        state.unlink(missing_ok=True)
    return losses.numpy()


@dataclass(slots=True)
class _Point:
    """Where a training can be gone on from: steps done, random state then; not `whole` while weights are changing."""

    done: int
    drawn: Tensor
    whole: bool = True


def _step(
    field: KinematicField,
    decoder: Decoder,
    data: Mapping[str, HandData],
    cells: CellTensors,
    config: TrainConfig,
    generator: torch.Generator,
    optimiser: torch.optim.Optimizer,
    point: _Point,
    step: int,
) -> float:
    """One gradient step; its loss."""
    loss = batch_loss(field, decoder, data, cells, config, generator)
    value = float(loss.detach())
    if not math.isfinite(value):
        raise DivergedError(f"the loss of step {step} is {value}; lower the learning rate ({config.learning_rate}).")
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(decoder.parameters(), 1.0)
    point.whole = False
    optimiser.step()
    return value


def one_cycle(done: float) -> float:
    """Share of the peak learning rate when the share `done` of the steps is done: up in a line, down in a cosine."""
    if done < WARM_UP:
        return 0.04 + 0.96 * done / WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (done - WARM_UP) / (1.0 - WARM_UP)))


def training_key(config: TrainConfig, data: Mapping[str, HandData]) -> str:
    """sha256 (hex) of what a training is made from."""
    digest = hashlib.sha256(json.dumps([asdict(config), list(data)], sort_keys=True).encode())
    for own in data.values():
        for tensor in (own.codes, own.object_index, own.points_O):
            digest.update(tensor.contiguous().numpy().tobytes())
    return digest.hexdigest()


def _restore(
    state: Path | None,
    key: str,
    decoder: Decoder,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    losses: Tensor,
) -> int:
    """Steps already done by a checkpoint of the same training, put into the arguments; 0 without one."""
    if state is None or not state.is_file() or read_tensors(state)[1].get("key") != key:
        return 0
    kept = load_training(state, decoder, optimiser)
    generator.set_state(kept["generator"])
    losses[: len(kept["losses"])] = kept["losses"]
    return len(kept["losses"])


def add_noise(codes: Tensor, level: Tensor, *, joints: int, contact_noise: float, generator: torch.Generator) -> Tensor:
    """Codes (N, 128) off by about `level` (N,): palm moved and turned, posture and contact blocks shifted.

    The palm's rotation stays a rotation. Of the posture block only the columns in use, `joints`, are shifted.
    """

    def normal(columns: int) -> Tensor:
        return torch.randn(len(codes), columns, generator=generator, dtype=codes.dtype) * level[:, None]

    palm, posture = codes[:, CELLS : CELLS + PALM], codes[:, CELLS + PALM :]
    position = palm[:, :3] + normal(3)
    columns = palm[:, 3:].reshape(-1, 2, 3).transpose(1, 2)
    rotation = (exp_so3(normal(3)) @ columns).transpose(1, 2).reshape(-1, 6)
    shift = normal(posture.shape[1])
    shift[:, joints:] = 0.0
    contact = codes[:, :CELLS] + contact_noise * normal(CELLS)
    return torch.cat([contact, position, rotation, posture + shift], dim=-1)


def batch_loss(
    field: KinematicField,
    decoder: Decoder,
    data: Mapping[str, HandData],
    cells: CellTensors,
    config: TrainConfig,
    generator: torch.Generator,
) -> Tensor:
    """Mean point error over noise level of a random batch of every hand's grasps; the network sees all at once."""
    low, high = np.log(config.noise_min), np.log(config.noise_max)
    noisy, levels, chosen = [], [], []
    for hand, own in data.items():
        rows = torch.randint(len(own.codes), (config.batch,), generator=generator)
        level = torch.exp(low + (high - low) * torch.rand(config.batch, generator=generator))
        codec = field.hand_codecs[hand]
        joints = min(codec.num_joints, codec.basis.shape[1])
        noisy.append(
            add_noise(own.codes[rows], level, joints=joints, contact_noise=config.contact_noise, generator=generator)
        )
        levels.append(level)
        chosen.append(rows)
    objects = torch.cat([own.object_index[rows] for own, rows in zip(data.values(), chosen, strict=True)])
    whose = torch.arange(len(data)).repeat_interleave(config.batch)
    moved = corrected_blocks(decoder, torch.cat(noisy), cells[objects], torch.cat(levels), whose)
    errors = []
    for k, (hand, own) in enumerate(data.items()):
        part = slice(k * config.batch, (k + 1) * config.batch)
        errors.append(_point_errors(field, own, hand, moved[part], chosen[k]) / levels[k])
    return torch.cat(errors).mean()


def _point_errors(field: KinematicField, own: HandData, hand: str, blocks: Tensor, rows: Tensor) -> Tensor:
    """(B,) mean distance of the hand's points at decoded blocks (B, 32) to where they should be, metres."""
    objects = list(field.object_codecs.values())
    offsets = torch.as_tensor(np.stack([o.offset_O for o in objects]), dtype=blocks.dtype)[own.object_index[rows]]
    # Decoded relative to the objects' centres: one call for a batch over several objects.
    grasps = decode_blocks(blocks, field.hand_codecs[hand], objects[0])
    shift = offsets - torch.as_tensor(objects[0].offset_O, dtype=blocks.dtype)
    return point_distances(own.material.posed(grasps.X_OH, grasps.q) + shift[:, None], own.points_O[rows])
