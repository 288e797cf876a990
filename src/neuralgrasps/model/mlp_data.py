"""SDF samples of one object's scenes on the training device, and the published balanced draw from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.samples import Normalisation, SdfSamples
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.hands.packed import PackedHand

FAR = 0.01  # farther from both shapes than this (normalised) no sample lies that was drawn around a surface


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSamples:
    """Query points and distances of S scenes, in normalised units, ordered so that a draw is index arithmetic.

    Attributes:
        rows: (S, M, 5) float32 x, y, z, distance to the object and to the hand, not clamped. Of each scene first
            points outside both shapes, farthest first, then those outside one and inside the other, then the others.
        positive: (S,) points outside at least one shape, the first ones; inside: (S,) those inside or on at
            least one, the last ones; far: (S,) those farther than `FAR` outside both, the very first; int64.
    """

    rows: Tensor
    positive: Tensor
    inside: Tensor
    far: Tensor

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def device(self) -> torch.device:
        return self.rows.device

    def to(self, device: torch.device | str) -> SceneSamples:
        """The same samples on a device."""
        return SceneSamples(
            rows=self.rows.to(device),
            positive=self.positive.to(device),
            inside=self.inside.to(device),
            far=self.far.to(device),
        )

    def draw(
        self, scenes: Tensor, count: int, generator: torch.Generator, *, far_share: float = 0.0, shared: bool = False
    ) -> Tensor:
        """(n, count) int64 points of each of `scenes` (n,): half positive to either shape, half non-positive.

        With replacement. Where a scene has no point of one kind, all its points are of the other, and both halves are
        drawn from them.

        Args:
            far_share: part of the points that is drawn from the far ones instead, the last of each row.
            shared: all scenes use the same random numbers; what is drawn from one does not depend on the others.

        Source:
            Khargonkar et al. 2022, published training code.
        """
        uniform = torch.rand(1 if shared else len(scenes), count, generator=generator, device=self.device)
        points = self.rows.shape[1]
        balanced = count - round(far_share * count)
        half = (balanced + 1) // 2
        outer, inner, far = (
            torch.where(length > 0, length, points)[:, None]
            for length in (self.positive[scenes], self.inside[scenes], self.far[scenes])
        )

        def among(length: Tensor, numbers: Tensor) -> Tensor:
            return torch.minimum((numbers * length).long(), length - 1)

        first = among(outer, uniform[:, :half])
        last = points - inner + among(inner, uniform[:, half:balanced])
        return torch.cat([first, last, among(far, uniform[:, balanced:])], dim=1)

    def gather(self, scenes: Tensor, places: Tensor) -> Tensor:
        """(n, K, 5) rows at `places` (n, K) of `scenes` (n,)."""
        flat = scenes[:, None] * self.rows.shape[1] + places
        return self.rows.flatten(0, 1)[flat.flatten()].reshape(*places.shape, 5)


def scene_samples(parts: list[SdfSamples], normalisation: Normalisation) -> SceneSamples:
    """Samples of all parts in order, normalised and sorted by kind; on the processor.

    Raises:
        InputError: no samples; ShapeError: parts of different numbers of points per scene.
    """
    parts = [part for part in parts if len(part)]
    if not parts:
        raise InputError("no SDF samples given; expected at least one scene.")
    sizes = {part.points_O.shape[1] for part in parts}
    if len(sizes) > 1:
        raise ShapeError(f"scenes have {sorted(sizes)} SDF samples; expected one number.")
    rows = np.empty((sum(len(part) for part in parts), sizes.pop(), 5), np.float32)
    positive, inside, far = np.empty((3, len(rows)), np.int64)
    k = 0
    for part in parts:
        for i in range(len(part)):
            sdf = np.stack([part.sdf_object[i], part.sdf_hand[i]])
            out, clear = sdf > 0, sdf.min(axis=0) / normalisation.scale_m
            order = np.lexsort((-clear, 2 - out.sum(axis=0)))
            rows[k, :, :3] = normalisation.to_unit(part.points_O[i].astype(np.float64))[order]
            rows[k, :, 3] = part.sdf_object[i][order] / normalisation.scale_m
            rows[k, :, 4] = part.sdf_hand[i][order] / normalisation.scale_m
            positive[k], inside[k] = out.any(axis=0).sum(), (~out).any(axis=0).sum()
            far[k] = (clear > FAR).sum()
            k += 1
    return SceneSamples(
        rows=torch.from_numpy(rows),
        positive=torch.from_numpy(positive),
        inside=torch.from_numpy(inside),
        far=torch.from_numpy(far),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectScenes:
    """One object's scenes of one part of a dataset, by hand, then grasp.

    Attributes:
        object_name: the object; normalisation: its frame.
        samples: of S scenes.
        contact_maps: (S, P) float32.
        contact_decay: length of their closeness, normalised units.
        hands: names; hand_index: (S,) int32 into them; grasp_index: (S,) int32 in the pair's grasp set.
    """

    object_name: str
    normalisation: Normalisation
    samples: SceneSamples
    contact_maps: np.ndarray
    contact_decay: float
    hands: tuple[str, ...]
    hand_index: np.ndarray
    grasp_index: np.ndarray

    def __len__(self) -> int:
        return len(self.samples)


def object_scenes(
    dataset: GraspDataset,
    object_name: str,
    *,
    part: str = "train",
    packed: Mapping[str, PackedHand] | None = None,
) -> ObjectScenes:
    """Read the "train", "test" or "spare" scenes of an object, all hands, from a dataset.

    Args:
        packed: by hand; needed when the dataset does not store its samples.
    Raises:
        UnknownNameError: the object is not in the dataset; InputError: it has no scenes in that part.
    """
    stored = dataset.object(object_name)
    hands = tuple(hand for hand, name in dataset.pairs if name == object_name)
    samples, maps, hand_index, grasp_index = [], [], [], []
    for k, hand in enumerate(hands):
        chosen = dataset.split(hand, object_name).part(part)
        if not len(chosen):
            continue
        samples.append(dataset.samples(hand, object_name, chosen, packed=(packed or {}).get(hand)))
        maps.append(dataset.contact_maps(hand, object_name)[chosen])
        hand_index.append(np.full(len(chosen), k, np.int32))
        grasp_index.append(chosen.astype(np.int32))
    if not samples:
        raise InputError(f"object '{object_name}' has no {part} grasps in this dataset; choose another part or object.")
    return ObjectScenes(
        object_name=object_name,
        normalisation=stored.normalisation,
        samples=scene_samples(samples, stored.normalisation),
        contact_maps=np.concatenate(maps),
        contact_decay=dataset.manifest.config.contact_decay,
        hands=hands,
        hand_index=np.concatenate(hand_index),
        grasp_index=np.concatenate(grasp_index),
    )
