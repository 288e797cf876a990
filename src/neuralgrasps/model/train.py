"""Fit a `KinematicField` to a dataset: posture bases, codes of all grasps, and the correction network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.samples import contact_maps
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.geometry.rotation import exp_so3
from neuralgrasps.hands.hand import Hand
from neuralgrasps.model.codes import (
    CELLS,
    PALM,
    CodeBook,
    HandCodec,
    assemble_codes,
    contact_blocks,
    hand_codec,
    join_codes,
    object_codec,
)
from neuralgrasps.model.kinematic_field import Decoder, DecoderConfig, KinematicField, correction, decode_blocks
from neuralgrasps.model.losses import HandPoints, point_distances
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng, child_seed

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
        variants: jittered copies of each grasp, with contact maps of their own, beside the grasp itself.
        jitter_m, jitter_rad, jitter_joint: standard deviations of that jitter (joint: share of its range).
        threads: torch's threads while training, on any machine: sums come out the same only for the same number.
    """

    seed: int = 0
    steps: int = 500
    batch: int = 48
    learning_rate: float = 1.5e-3
    noise_min: float = 0.02
    noise_max: float = 0.5
    contact_noise: float = 0.2
    variants: int = 4
    jitter_m: float = 0.01
    jitter_rad: float = 0.1
    jitter_joint: float = 0.05
    threads: int = 2
    decoder: DecoderConfig = field(default_factory=DecoderConfig)

    def __post_init__(self) -> None:
        if self.steps < 0 or self.batch < 1 or self.variants < 0:
            raise InputError(f"steps {self.steps}, batch {self.batch}, variants {self.variants}; expected >= 0, 1, 0.")
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _HandData:
    """Training tensors of one hand: clean codes, object of each, and the clean hands' points (object frame)."""

    codes: Tensor
    object_of: Tensor
    points_O: Tensor
    material: HandPoints


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
        decoder = _new_decoder(dataset.hands, config.decoder, generator)
        data = {name: _hand_data(field, dataset, name, config) for name in dataset.hands}
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


def _new_decoder(hands: tuple[str, ...], config: DecoderConfig, generator: torch.Generator) -> Decoder:
    decoder = Decoder(hands, config)
    with torch.no_grad():
        for module in decoder.modules():
            if isinstance(module, torch.nn.Linear):
                bound = 1.0 / np.sqrt(module.in_features)
                module.weight.uniform_(-bound, bound, generator=generator)
                module.bias.zero_()
        for head in decoder.heads:
            *_, last = head.children()
            last.get_parameter("weight").mul_(0.05)  # start close to decoding what the code says
    return decoder


def _hand_data(field: KinematicField, dataset: GraspDataset, name: str, config: TrainConfig) -> _HandData:
    codes, object_of, X_all, q_all = [], [], [], []
    for hand, object_name in dataset.pairs:
        if hand != name:
            continue
        chosen = dataset.split(hand, object_name).train
        grasps = dataset.grasps(hand, object_name)[chosen]
        obj = field.object_codecs[object_name]
        known = contact_blocks(dataset.contact_maps(hand, object_name)[chosen], obj)
        rng = child_rng(config.seed, "jitter", hand, object_name)
        X, q = _jittered(np.array(grasps.X_OH), np.array(grasps.q), field.hand_codecs[hand], config, rng)
        maps = contact_maps(field.packed[hand], X, q, dataset.object(object_name).points_O, radius_m=obj.radius_m)
        X, q = np.concatenate([grasps.X_OH, X]), np.concatenate([grasps.q, q])
        near = np.concatenate([known, contact_blocks(maps, obj)])
        codes.append(assemble_codes(near, X, q, hand=field.hand_codecs[hand], obj=obj))
        object_of.append(np.full(len(X), dataset.objects.index(object_name)))
        X_all.append(X)
        q_all.append(q)
    material = HandPoints(field.hands[name], field.packed[name])
    points_O = material.posed(
        torch.as_tensor(np.concatenate(X_all), dtype=torch.float32),
        torch.as_tensor(np.concatenate(q_all), dtype=torch.float32),
    )
    return _HandData(
        codes=torch.as_tensor(np.concatenate(codes)),
        object_of=torch.as_tensor(np.concatenate(object_of)),
        points_O=points_O,
        material=material,
    )


def _jittered(
    X_OH: np.ndarray, q: np.ndarray, codec: HandCodec, config: TrainConfig, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`variants` perturbed copies of each grasp: the palm is moved and turned about itself, joints stay in limits."""
    X = np.repeat(X_OH, config.variants, axis=0)
    q = np.repeat(q, config.variants, axis=0)
    X_OP = X @ codec.X_HP
    turn = exp_so3(torch.as_tensor(rng.normal(scale=config.jitter_rad, size=(len(X), 3)))).numpy()
    X_OP[:, :3, :3] = X_OP[:, :3, :3] @ turn
    X_OP[:, :3, 3] += rng.normal(scale=config.jitter_m, size=(len(X), 3))
    span = codec.upper - codec.lower
    q = np.clip(q + rng.normal(scale=config.jitter_joint, size=q.shape) * span, codec.lower, codec.upper)
    return X_OP @ np.linalg.inv(codec.X_HP), q


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
    data: Mapping[str, _HandData],
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
    for step in range(config.steps):
        loss = torch.stack([_hand_loss(field, decoder, d, config, generator) for d in data.values()]).mean()
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(decoder.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        losses[step] = float(loss.detach())
        if progress is not None:
            progress(step + 1, config.steps, losses[step])
    return losses


def _hand_loss(
    field: KinematicField, decoder: Decoder, data: _HandData, config: TrainConfig, generator: torch.Generator
) -> Tensor:
    """Mean point error over noise level of a random batch of one hand's grasps."""
    hand = data.material.hand.name
    codec = field.hand_codecs[hand]
    chosen = torch.randint(len(data.codes), (config.batch,), generator=generator)
    low, high = np.log(config.noise_min), np.log(config.noise_max)
    level = torch.exp(low + (high - low) * torch.rand(config.batch, generator=generator))
    joints = min(codec.num_joints, codec.basis.shape[1])
    noisy = add_noise(data.codes[chosen], level, joints=joints, contact_noise=config.contact_noise, generator=generator)
    objects = list(field.object_codecs.values())
    descriptors = torch.as_tensor(np.stack([o.descriptor for o in objects]), dtype=noisy.dtype)
    offsets = torch.as_tensor(np.stack([o.offset_O for o in objects]), dtype=noisy.dtype)
    place = data.object_of[chosen]
    blocks = noisy[:, CELLS:] + correction(decoder, noisy, descriptors[place], level, hand)
    # Decode relative to the objects' centres: one call for a batch over several objects.
    grasps = decode_blocks(blocks, codec, objects[0])
    moved = data.material.posed(grasps.X_OH, grasps.q) + (offsets[place] - offsets[0])[:, None]
    return (point_distances(moved, data.points_O[chosen]) / level).mean()
