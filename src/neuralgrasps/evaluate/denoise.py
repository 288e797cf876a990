"""What the trained correction is worth: noisy codes of unseen grasps, decoded as they are and with the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.losses import HandPoints, point_distances
from neuralgrasps.model.optimise import TrainConfig, add_noise
from neuralgrasps.seeds import child_seed


@dataclass(frozen=True, slots=True, kw_only=True)
class DenoiseScore:
    """Mean distance of matching surface points between the decoded and the true hand, millimetres.

    Attributes:
        level: noise of the codes, in code units (0.1 = 1 cm, 0.1 rad, 5 % of a joint's range).
        closed_form_mm: decoded as the noisy code says; network_mm: decoded with `noise_level=level`.
        grasps: held-out grasps, each with several draws of noise.
    """

    level: float
    closed_form_mm: float
    network_mm: float
    grasps: int


def correction_gain(
    field: KinematicField,
    dataset: GraspDataset,
    *,
    levels: Sequence[float] = (0.1, 0.2, 0.3),
    seed: int = 0,
    hand: str | None = None,
    object_name: str | None = None,
    draws: int = 4,
    contact_noise: float | None = None,
) -> tuple[DenoiseScore, ...]:
    """Decode codes of test grasps made noisy as in training, without and with the correction network.

    The same draws of noise serve all levels, and a pair's draws do not depend on the other pairs.

    Args:
        field: fitted to `dataset`'s training grasps.
        hand, object_name: only these; all when None. draws: noisy codes per grasp.
        contact_noise: noise of the contact block per unit of level; as in training by default.
    Returns:
        One score per level, averaged over grasps and draws.
    Raises:
        UnknownNameError: the hand or object is not in the dataset. InputError: no test grasps, or a bad level.
    """
    if draws < 1 or not all(level > 0 for level in levels):
        raise InputError(f"draws {draws}, levels {tuple(levels)}; expected at least 1 draw and levels above 0.")
    for kind, name, known in (("hand", hand, dataset.hands), ("object", object_name, dataset.objects)):
        if name is not None and name not in known:
            raise unknown_name(kind, name, known)
    pairs = [p for p in dataset.pairs if hand in (None, p[0]) and object_name in (None, p[1])]
    share = TrainConfig().contact_noise if contact_noise is None else contact_noise
    errors = [_pair_errors(field, dataset, pair, levels, seed, draws, share) for pair in pairs]
    total = np.concatenate(errors, axis=1) if errors else np.zeros((len(levels), 0, 2))
    if not total.shape[1]:
        raise InputError("the dataset holds no test grasps of this hand and object; make more grasps.")
    means = 1000.0 * total.mean(axis=1)
    return tuple(
        DenoiseScore(level=level, closed_form_mm=float(m[0]), network_mm=float(m[1]), grasps=total.shape[1] // draws)
        for level, m in zip(levels, means, strict=True)
    )


def _pair_errors(
    field: KinematicField,
    dataset: GraspDataset,
    pair: tuple[str, str],
    levels: Sequence[float],
    seed: int,
    draws: int,
    contact_noise: float,
) -> np.ndarray:
    """(levels, draws * test grasps, 2) point errors in metres, closed form and network."""
    hand, object_name = pair
    test = dataset.split(hand, object_name).test
    if not len(test):
        return np.zeros((len(levels), 0, 2))
    grasps = dataset.grasps(hand, object_name)[test]
    maps = dataset.contact_maps(hand, object_name)[test]
    book = field.encode_with_maps(maps, grasps.X_OH, grasps.q, hand=hand, object_name=object_name)
    clean = torch.as_tensor(book.values).repeat(draws, 1)
    material = HandPoints(field.hand(hand), field.packed[hand])
    X_OH, q = (torch.as_tensor(np.array(a), dtype=torch.float32).repeat(draws, *[1] * (a.ndim - 1)) for a in
               (grasps.X_OH, grasps.q))  # fmt: skip
    true_O = material.posed(X_OH, q)
    codec = field.hand_codecs[hand]
    joints = min(codec.num_joints, codec.basis.shape[1])
    out = np.empty((len(levels), len(clean), 2))
    with torch.no_grad():
        for i, level in enumerate(levels):
            generator = torch.Generator().manual_seed(child_seed(seed, "denoise", hand, object_name))
            noise = torch.full((len(clean),), float(level))
            noisy = add_noise(clean, noise, joints=joints, contact_noise=contact_noise, generator=generator)
            for k, told in enumerate((0.0, float(level))):
                decoded = field.decode(noisy, hand=hand, object_name=object_name, noise_level=told)
                out[i, :, k] = point_distances(material.posed(decoded.X_OH, decoded.q), true_O).numpy()
    return out
