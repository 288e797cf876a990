"""Fit a `KinematicField` to a dataset: posture bases, codes of all grasps, and the correction network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.geometry.rotation import exp_so3
from neuralgrasps.hands.hand import Hand
from neuralgrasps.model.codes import (
    CELLS,
    PALM,
    CodeBook,
    hand_codec,
    join_codes,
    object_codec,
)
from neuralgrasps.model.decoder import CellTensors, Decoder, DecoderConfig, cell_tensors, corrected_blocks
from neuralgrasps.model.kinematic_field import KinematicField, decode_blocks
from neuralgrasps.model.losses import point_distances
from neuralgrasps.model.train_data import HandData, Jitter, collect_data
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_seed

Progress = Callable[[int, int, float], None]
"""Called as progress(steps done, all steps, latest loss)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """How the correction network is trained.

    Attributes:
        seed: of the start weights, the jitter, the batches and the noise.
        steps: gradient steps; each sees `batch` grasps of every hand.
        learning_rate: peak of the one-cycle schedule (Adam).
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
        if self.threads < 1:
            raise InputError(f"threads is {self.threads}; expected at least 1.")
        if not 0.0 < self.noise_min <= self.noise_max:
            raise InputError(f"noise levels {self.noise_min} to {self.noise_max}; expected 0 < noise_min <= noise_max.")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainResult:
    """A fitted field.

    Attributes:
        field: decodes codes; codebook: codes of all train and test grasps (test ones marked).
        losses: (steps,) mean hand point error over noise level, metres per code unit: 0.1 means that a code off by
            0.1 decodes to a hand 1 cm from the true one.
    """

    field: KinematicField
    codebook: CodeBook
    losses: np.ndarray
    config: TrainConfig


def train(
    dataset: GraspDataset,
    *,
    hands: Mapping[str, Hand],
    objects: Mapping[str, ObjectModel],
    config: TrainConfig | None = None,
    progress: Progress | None = None,
) -> TrainResult:
    """Fit a field to the training grasps of a dataset. Test grasps are encoded but never trained on.

    Deterministic: the same dataset and config give the same weights. Torch runs on `config.threads` threads meanwhile.

    Raises:
        UnknownNameError: a hand or object of the dataset is not given.
    """
    config = config or TrainConfig()
    for kind, needed, given in (("hand", dataset.hands, hands), ("object", dataset.objects, objects)):
        for name in needed:
            if name not in given:
                raise unknown_name(kind, name, given)
    field = untrained_field(dataset, hands=hands, objects=objects)
    with _torch_threads(config.threads):
        codebook = encode_dataset(field, dataset)
        generator = torch.Generator().manual_seed(child_seed(config.seed, "decoder"))
        data = collect_data(field, dataset, jitter=config.jitter, seed=config.seed, threads=config.threads)
        decoder = Decoder(tuple(data), config.decoder)
        decoder.initialise(generator)
        losses = _optimise(field, decoder, data, config, generator, progress)
    field.decoder = decoder.eval().requires_grad_(False)
    return TrainResult(field=field, codebook=codebook, losses=losses, config=config)


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def untrained_field(
    dataset: GraspDataset, *, hands: Mapping[str, Hand], objects: Mapping[str, ObjectModel]
) -> KinematicField:
    """The closed-form field of a dataset: posture bases from the training grasps, no correction network."""
    hand_codecs = {}
    for name in dataset.hands:
        pairs = [(h, o) for h, o in dataset.pairs if h == name]
        postures = np.concatenate([dataset.grasps(h, o).q[dataset.split(h, o).train] for h, o in pairs])
        hand_codecs[name] = hand_codec(hands[name], postures)
    object_codecs = {}
    for name in dataset.objects:
        stored = dataset.object(name)
        object_codecs[name] = object_codec(
            name,
            stored.points_O,
            offset_O=stored.normalisation.offset_O,
            radius_m=dataset.contact_radius_m(name),
        )
    return KinematicField(
        hands={name: hands[name] for name in dataset.hands},
        objects={name: objects[name] for name in dataset.objects},
        hand_codecs=hand_codecs,
        object_codecs=object_codecs,
    )


def encode_dataset(field: KinematicField, dataset: GraspDataset) -> CodeBook:
    """Codes of all train and test grasps of a dataset; spare grasps are left out."""
    books = []
    for hand, object_name in dataset.pairs:
        grasps, split = dataset.grasps(hand, object_name), dataset.split(hand, object_name)
        chosen = np.sort(np.concatenate([split.train, split.test]))
        maps = dataset.contact_maps(hand, object_name)[chosen]
        some = grasps[chosen]
        book = field.encode_with_maps(maps, some.X_OH, some.q, hand=hand, object_name=object_name)
        books.append(
            CodeBook(
                values=book.values,
                hands=book.hands,
                objects=book.objects,
                hand_index=book.hand_index,
                object_index=book.object_index,
                grasp_index=chosen.astype(np.int32),
                contact_maps=book.contact_maps,
                is_test=np.isin(chosen, split.test),
            )
        )
    return join_codes(books)


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


def _optimise(
    field: KinematicField,
    decoder: Decoder,
    data: Mapping[str, HandData],
    config: TrainConfig,
    generator: torch.Generator,
    progress: Progress | None,
) -> np.ndarray:
    losses = np.zeros(config.steps)
    if config.steps == 0:
        return losses
    optimiser = torch.optim.Adam(decoder.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=config.learning_rate, total_steps=config.steps, pct_start=0.1
    )
    cells = cell_tensors(list(field.object_codecs.values()), dtype=torch.float32)
    for step in range(config.steps):
        loss = _loss(field, decoder, data, cells, config, generator)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(decoder.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        losses[step] = float(loss.detach())
        if progress is not None:
            progress(step + 1, config.steps, losses[step])
    return losses


def _loss(
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
