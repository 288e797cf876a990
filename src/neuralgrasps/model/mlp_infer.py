"""Codes of grasps that an `MlpField` was not trained on: maximum a posteriori over the code, from SDF samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.model.losses import clamped_l1
from neuralgrasps.model.mlp_data import ObjectScenes, SceneSamples
from neuralgrasps.model.mlp_field import MlpDecoder, MlpField
from neuralgrasps.model.mlp_loss import triplet_of_distances
from neuralgrasps.seeds import child_seed

NEAREST_POINTS = 128  # of a scene, to compare all known codes by
NEAR_SURFACE = 0.01  # samples this near the object's surface (normalised) stand for it


Progress = Callable[[int, int, float], None]
"""Called as progress(steps done, all steps, mean loss of the scenes)."""


_CHOICES = {
    "schedule": ("step", "cosine"),
    "prior": ("norm", "square"),
    "start": ("zero", "nearest", "mean"),
    "precision": ("bf16", "fp32"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpInferConfig:
    """How codes are inferred.

    Attributes:
        seed: of start codes and draws. steps: of Adam.
        points: of a scene in every step, drawn as in training.
        rate: of Adam; a tenth after half the steps ("step") or down as a cosine.
        prior_weight: of the codes' prior: "norm", their norm as in training, or "square", the mean of their squares.
        start: "zero": near 0 as published; "nearest": the known code that explains the samples best; "mean".
        start_std: of the start codes around it.
        triplet_weight, triplets: of the training's triplet loss with the scene as anchor, and how many of them in every
            step; in use when contact maps are given.
        precision: of the products.
    """

    seed: int = 0
    steps: int = 800
    points: int = 1_024
    rate: float = 5e-3
    schedule: Literal["step", "cosine"] = "step"
    prior: Literal["norm", "square"] = "norm"
    prior_weight: float = 1e-4
    start: Literal["zero", "nearest", "mean"] = "zero"
    start_std: float = 0.01
    precision: Literal["bf16", "fp32"] = "bf16"
    triplet_weight: float = 1.0
    triplets: int = 64

    def __post_init__(self) -> None:
        if self.steps < 0 or self.points < 1:
            raise InputError(f"steps {self.steps}, points {self.points}; expected >= 0 and >= 1.")
        if not self.rate > 0.0 or not self.prior_weight >= 0.0 or not self.start_std >= 0.0:
            raise InputError(
                f"rate {self.rate}, prior_weight {self.prior_weight}, start_std {self.start_std}; "
                "expected > 0, >= 0, >= 0."
            )
        if not self.triplet_weight >= 0.0 or self.triplets < 1:
            raise InputError(
                f"triplet_weight {self.triplet_weight}, triplets {self.triplets}; expected >= 0 and at least 1."
            )
        for name, known in _CHOICES.items():
            if getattr(self, name) not in known:
                raise InputError(f"{name} is '{getattr(self, name)}'; expected one of {', '.join(map(repr, known))}.")


PUBLISHED = MlpInferConfig(points=8_000, prior="square", prior_weight=2e-4)
"""The published inference: signed distances and prior alone, 800 steps from near 0, 8,000 points a step.

The prior weighs 1e-4 there, beside distances weighted 0.5 + 0.5; here they weigh 1 + 1, so it weighs 2e-4. Differs:
points are drawn with replacement, predictions are not clamped, products are in bf16.
"""
PUBLISHED_ON_CPU = replace(PUBLISHED, points=512)
"""The same with fewer points a step: 8,000 take a processor an hour for 25 scenes, 512 some minutes."""
PLACED = MlpInferConfig(steps=200, points=256, rate=0.05, schedule="cosine", start="nearest", triplet_weight=0.1)
"""Not published: from the known code that explains the samples best, for use with contact maps read off the samples.

Those maps are read off exact distances and would retrieve as well without any network. The weight was chosen on spare
grasps, which neither training nor the tables use.
"""


def published_inference(device: torch.device | str) -> MlpInferConfig:
    """`PUBLISHED`, with the number of points that the device can do in minutes."""
    return PUBLISHED if torch.device(device).type == "cuda" else PUBLISHED_ON_CPU


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpInferResult:
    """Codes (N, D) float32 and the (N,) float32 SDF loss of each, object plus hand, normalised units."""

    codes: np.ndarray
    losses: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactTerm:
    """Contact maps (N, P) of the scenes, as far as they are known, and true ones (K, P) of the known codes."""

    maps: np.ndarray
    known_maps: np.ndarray


def maps_from_samples(samples: SceneSamples, points_unit: np.ndarray, *, decay: float) -> np.ndarray:
    """Contact maps (N, P) float32 read off SDF samples: closeness of the hand at the nearest sample of the surface.

    Args:
        points_unit: (P, 3) the object's contact points, normalised units.
        decay: length of the closeness, normalised units; the dataset's `contact_decay`.
    """
    maps = np.empty((len(samples), len(points_unit)), np.float32)
    for i, rows in enumerate(samples.rows.cpu().numpy()):
        order = np.argsort(np.abs(rows[:, 3]), kind="stable")
        near = rows[order[: max(int((np.abs(rows[:, 3]) < NEAR_SURFACE).sum()), 1)]]
        nearest = KDTree(near[:, :3]).query(points_unit)[1]
        maps[i] = np.exp(-np.maximum(near[nearest, 4], 0.0) / decay)
    return maps


def infer_codes(
    field: MlpField,
    samples: SceneSamples,
    *,
    known: np.ndarray | None = None,
    contact: ContactTerm | None = None,
    config: MlpInferConfig | None = None,
    progress: Progress | None = None,
) -> MlpInferResult:
    """Codes of N scenes from their SDF samples; all scenes at once, weights fixed, dropout off.

    A scene's result does not depend on the others. `samples` is on the field's device or is copied there.

    Args:
        known: (K, D) codes of training scenes; needed by `contact`, and by `start` "nearest" and "mean".
        contact: adds the loss that placed the known codes, so that distances to them follow the contact maps. Without
            it the loss is the published one: SDF and prior.
    Raises:
        InputError: `known` is missing; ShapeError: it does not fit the field.

    Source:
        Khargonkar et al. 2022, Sec. 4 (and DeepSDF, Park et al. 2019). `PUBLISHED` says what differs.
    """
    config = config or MlpInferConfig()
    size = field.decoder.config.code_size
    if known is not None and (known.ndim != 2 or known.shape[1] != size):
        raise ShapeError(f"known codes have shape {known.shape}; expected (K, {size}).")
    if known is None and (config.start != "zero" or contact is not None):
        what = "contact maps" if contact is not None else f"start '{config.start}'"
        raise InputError(f"{what} cannot be used without known codes; give the codes of the training scenes.")
    if contact is not None and (contact.maps.shape[0], contact.known_maps.shape[0]) != (len(samples), len(known)):  # type: ignore[arg-type]
        got = f"maps {contact.maps.shape}, known_maps {contact.known_maps.shape}"
        raise ShapeError(f"{got}; expected one row per scene ({len(samples)}) and per known code.")
    samples = samples.to(field.device)
    pull = _Pull(contact, known, config, field.device) if contact is not None and known is not None else None
    with _products_in(field.decoder.eval(), config.precision):
        start = _start_codes(field, samples, known, config)
        codes = _descend(field, samples, start, pull, config, progress)
        with torch.no_grad():
            losses = _scene_losses(field, samples, codes, config)
    return MlpInferResult(codes=codes.cpu().numpy(), losses=losses.cpu().numpy())


@contextmanager
def _products_in(decoder: MlpDecoder, precision: str) -> Iterator[None]:
    """Inside, the decoder takes its fast path or not; afterwards it is as before."""
    before, decoder.fast = decoder.fast, precision == "bf16"
    try:
        yield
    finally:
        decoder.fast = before


def _descend(
    field: MlpField,
    samples: SceneSamples,
    start: Tensor,
    pull: _Pull | None,
    config: MlpInferConfig,
    progress: Progress | None,
) -> Tensor:
    """Adam from the start codes (N, D)."""
    codes = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([codes], lr=config.rate)
    for step in range(config.steps):
        optimiser.param_groups[0]["lr"] = config.rate * _factor(step, config)
        rows = _drawn(samples, config.points, config.seed, step)
        out = _decoded(field.decoder, rows[..., :3], codes, config)
        # sums over scenes: every scene is a problem of its own
        loss = 2.0 * len(rows) * clamped_l1(out, rows[..., 3:], clamp=field.clamp)
        loss = loss + config.prior_weight * _priors(codes, config).sum()
        if pull is not None:
            loss = loss + config.triplet_weight * pull.loss(codes, step)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if progress is not None:
            progress(step + 1, config.steps, float(loss.detach()) / len(rows))
    return codes.detach()


def _priors(codes: Tensor, config: MlpInferConfig) -> Tensor:
    return codes.norm(dim=-1) if config.prior == "norm" else codes.square().mean(dim=-1)


class _Pull:
    """The triplet loss of codes to be found against known ones."""

    def __init__(self, contact: ContactTerm, known: np.ndarray, config: MlpInferConfig, device: torch.device) -> None:
        self.known = torch.as_tensor(known, dtype=torch.float32, device=device)
        maps, known_maps = (torch.as_tensor(m, device=device) for m in (contact.maps, contact.known_maps))
        self.distances = torch.cdist(maps, known_maps, compute_mode="donot_use_mm_for_euclid_dist")
        self.config = config

    def loss(self, codes: Tensor, step: int) -> Tensor:
        """Sum over scenes of the mean over triplets; all scenes use the same pairs of known codes."""
        config, count = self.config, len(self.known)
        generator = torch.Generator(device=codes.device).manual_seed(child_seed(config.seed, "triplets", step))
        first, second = torch.randint(count, (2, config.triplets), generator=generator, device=codes.device)
        scene = torch.arange(len(codes), device=codes.device).repeat_interleave(config.triplets)
        first, second = first.repeat(len(codes)) + len(codes), second.repeat(len(codes)) + len(codes)
        every = torch.cat([codes, self.known])
        maps = self.distances[scene, first - len(codes)], self.distances[scene, second - len(codes)]
        return len(codes) * triplet_of_distances(every, scene, first, second, *maps)


def _factor(step: int, config: MlpInferConfig) -> float:
    if config.schedule == "step":
        return 1.0 if 2 * step < config.steps else 0.1
    return 0.5 * (1.0 + float(np.cos(np.pi * step / config.steps)))


def _drawn(samples: SceneSamples, points: int, seed: int, step: int) -> Tensor:
    generator = torch.Generator(device=samples.device).manual_seed(child_seed(seed, "infer", step))
    scenes = torch.arange(len(samples), device=samples.device)
    # the same places of every list in all scenes, so that a scene's draw does not depend on the others
    places = samples.draw(scenes, points, generator, shared=True)
    return samples.gather(scenes, places)


def _decoded(decoder: MlpDecoder, points: Tensor, codes: Tensor, config: MlpInferConfig) -> Tensor:
    with torch.autocast(codes.device.type, dtype=torch.bfloat16, enabled=config.precision == "bf16"):
        return decoder(points, codes)


def _start_codes(field: MlpField, samples: SceneSamples, known: np.ndarray | None, config: MlpInferConfig) -> Tensor:
    size, device = field.decoder.config.code_size, field.device
    generator = torch.Generator().manual_seed(child_seed(config.seed, "start"))
    noise = config.start_std * torch.randn(1, size, generator=generator).to(device)
    if known is None or config.start == "zero":
        return noise.repeat(len(samples), 1)
    table = torch.as_tensor(known, dtype=torch.float32, device=device)
    if config.start == "mean":
        return table.mean(dim=0) + noise.repeat(len(samples), 1)
    return table[nearest_known(field, samples, table, config)] + noise


def nearest_known(field: MlpField, samples: SceneSamples, known: Tensor, config: MlpInferConfig) -> Tensor:
    """(N,) int64: of the codes `known` (K, D), the one whose decoded distances fit the samples of each scene best."""
    rows = _drawn(samples, min(config.points, NEAREST_POINTS), config.seed, -1)
    target = rows[..., 3:].clamp(-field.clamp, field.clamp)
    best = []
    with torch.no_grad():
        for scene in range(len(rows)):
            points = rows[scene, :, :3].expand(len(known), -1, -1)
            error = (_decoded(field.decoder, points, known, config) - target[scene]).abs().mean(dim=(1, 2))
            best.append(int(error.argmin()))
    return torch.tensor(best, device=known.device)


def _scene_losses(field: MlpField, samples: SceneSamples, codes: Tensor, config: MlpInferConfig) -> Tensor:
    rows = _drawn(samples, config.points, config.seed, config.steps)
    out = _decoded(field.decoder, rows[..., :3], codes, config)
    return 2.0 * (out - rows[..., 3:].clamp(-field.clamp, field.clamp)).abs().mean(dim=(1, 2))


def infer_scenes(
    field: MlpField,
    scenes: ObjectScenes,
    *,
    known: ObjectScenes,
    known_codes: np.ndarray,
    contact_points_O: np.ndarray | None = None,
    config: MlpInferConfig | None = None,
    progress: Progress | None = None,
) -> MlpInferResult:
    """Codes of unseen scenes from their SDF samples.

    Args:
        known, known_codes: the training scenes and their codes (K, D).
        contact_points_O: (P, 3) the object's contact points, metres; given, the contact maps that the samples show
            place the codes too. Without them the loss is the published one.
    """
    term = None
    if contact_points_O is not None:
        points_unit = field.normalisation.to_unit(contact_points_O)
        maps = maps_from_samples(scenes.samples, points_unit, decay=scenes.contact_decay)
        term = ContactTerm(maps=maps, known_maps=known.contact_maps)
    return infer_codes(field, scenes.samples, known=known_codes, contact=term, config=config, progress=progress)
