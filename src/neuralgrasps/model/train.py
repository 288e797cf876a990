"""Fit a `KinematicField` to a dataset: posture bases, codes of all grasps, and the correction network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.errors import unknown_name
from neuralgrasps.hands.hand import Hand
from neuralgrasps.model.codes import CodeBook, hand_codec, join_codes, object_codec
from neuralgrasps.model.decoder import Decoder
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.optimise import Progress, TrainConfig, optimise
from neuralgrasps.model.train_data import collect_data
from neuralgrasps.model.train_state import torch_threads
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_seed

__all__ = ["TrainConfig", "TrainResult", "encode_dataset", "train", "untrained_field"]


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
    folder: str | Path | None = None,
    progress: Progress | None = None,
) -> TrainResult:
    """Fit a field to the training grasps of a dataset. Test grasps are encoded but never trained on.

    Deterministic: the same dataset and config give the same weights, also when training was killed and called again
    with the same `folder`. Torch runs on `config.threads` threads meanwhile.

    Args:
        folder: where to keep a checkpoint meanwhile; none is kept when None.
    Raises:
        UnknownNameError: a hand or object of the dataset is not given.
        DivergedError: the loss became NaN or infinite.
    """
    config = config or TrainConfig()
    for kind, needed, given in (("hand", dataset.hands, hands), ("object", dataset.objects, objects)):
        for name in needed:
            if name not in given:
                raise unknown_name(kind, name, given)
    field = untrained_field(dataset, hands=hands, objects=objects)
    with torch_threads(config.threads):
        codebook = encode_dataset(field, dataset)
        generator = torch.Generator().manual_seed(child_seed(config.seed, "decoder"))
        data = collect_data(field, dataset, jitter=config.jitter, seed=config.seed, threads=config.threads)
        decoder = Decoder(tuple(data), config.decoder)
        decoder.initialise(generator)
        losses = optimise(
            field, decoder, data, config, generator, folder=None if folder is None else Path(folder), progress=progress
        )
    field.decoder = decoder.eval().requires_grad_(False)
    return TrainResult(field=field, codebook=codebook, losses=losses, config=config)


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
