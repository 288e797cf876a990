"""How an `MlpField` is trained: rates, draws, loss weights, and the presets `paper` and `paper-fast`.

`paper` is the schedule of Khargonkar et al. 2022, as far as paper and published code agree. What differs:

| | published code | preset `paper` |
|---|---|---|
| batch | 16 scenes x 16,384 points | the same |
| epoch | every scene once: about 15 steps for 250 | 20,000 points per scene, as in the paper: 19 steps |
| triplet margin | L1 distances of maps, divided by the largest, x 0.9 | the paper's: L2 distances of maps of P points |
| triplet loss | mean over triplets that violate it; anchor and positive swap | mean over all; no swap |
| SDF loss | 0.5 object + 0.5 hand, other weights alike | 1 + 1: triplet and prior weigh half as much beside it |
| predictions | clamped like the labels | not clamped: those beyond the clamp still learn |
| batch norm | running figures of training | taken anew with dropout off at the end |
| precision | float32 | bf16 products |
| unseen codes | 8,000 points a step, mean z^2 | `mlp_infer.PUBLISHED`: the same; 512 on processors |

A step of `paper` takes 8 GB and half a minute on one thread of a processor: it is meant for GPUs.

`paper-fast` is a schedule of our own with less than a tenth of the samples: all scenes in every step, one-cycle rates,
no dropout, wider start codes, points drawn far from both shapes too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from neuralgrasps.errors import InputError
from neuralgrasps.model.mlp_field import MlpConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpTrainConfig:
    """How the decoder and the codes of one object are trained. Lengths are in normalised units.

    Attributes:
        seed: of start weights and codes, draws, dropout and triplets.
        epochs: passes; in each, every scene is drawn from `points_per_scene` times.
        step_scenes: scenes of one step, 0 = all; step_points: points of each.
        far_share: part of them drawn among points far from both shapes; 0 in the published method, which sees so many
            samples that the 3 % there are enough. With fewer, stray surfaces appear there.
        clamp: distances are learned up to it.
        triplet_weight, triplets_per_anchor: of the triplet loss; every scene of a step is an anchor.
        prior_weight: of the mean norm of the codes, reached after `prior_epochs` epochs.
        net_rate, code_rate: Adam's rates.
        schedule: "halving" every `halve_epochs` epochs, or "one-cycle": up over 3 % of the steps, down as a cosine.
        code_std: standard deviation of the start codes.
        code_noise: standard deviation of noise on the codes that the decoder sees in training, so that it learns what
            lies between them; 0 in the published method.
        precision: of the products; "bf16" is as good here and several times as fast.
        threads: of torch on processors: sums come out the same only for the same number.
    """

    seed: int = 0
    epochs: int = 2_000
    points_per_scene: int = 20_000
    step_scenes: int = 16
    step_points: int = 16_384
    far_share: float = 0.0
    clamp: float = 0.05
    triplet_weight: float = 1.0
    triplets_per_anchor: int = 1
    prior_weight: float = 1e-4
    prior_epochs: int = 100
    net_rate: float = 5e-4
    code_rate: float = 1e-3
    schedule: Literal["halving", "one-cycle"] = "halving"
    halve_epochs: int = 500
    code_std: float = 0.01
    code_noise: float = 0.0
    precision: Literal["bf16", "fp32"] = "bf16"
    threads: int = 2
    decoder: MlpConfig = field(default_factory=MlpConfig)

    def __post_init__(self) -> None:
        whole = ("epochs", "points_per_scene", "step_points", "triplets_per_anchor", "halve_epochs", "threads")
        for name in whole:
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected at least 1.")
        if self.step_scenes < 0 or self.prior_epochs < 0:
            raise InputError(f"step_scenes {self.step_scenes}, prior_epochs {self.prior_epochs}; expected >= 0.")
        for name in ("clamp", "net_rate", "code_rate"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected more than 0.")
        for name in ("triplet_weight", "prior_weight", "code_std", "code_noise"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected 0 or more.")
        if not 0.0 <= self.far_share < 1.0:
            raise InputError(f"far_share is {self.far_share}; expected 0 <= far_share < 1.")
        if self.schedule not in ("halving", "one-cycle"):
            raise InputError(f"schedule is '{self.schedule}'; expected 'halving' or 'one-cycle'.")
        if self.precision not in ("bf16", "fp32"):
            raise InputError(f"precision is '{self.precision}'; expected 'bf16' or 'fp32'.")

    def scenes_of_step(self, scenes: int) -> int:
        """Scenes in one step, of `scenes` in all."""
        return min(self.step_scenes or scenes, scenes)

    def steps_per_epoch(self, scenes: int) -> int:
        """Steps in which every one of `scenes` is drawn from `points_per_scene` times, on average."""
        samples = scenes * self.points_per_scene
        return max(1, round(samples / (self.scenes_of_step(scenes) * self.step_points)))

    def samples(self, scenes: int) -> int:
        """Points that the whole schedule draws."""
        return self.epochs * self.steps_per_epoch(scenes) * self.scenes_of_step(scenes) * self.step_points

    def rate_factor(self, step: int, scenes: int) -> float:
        """What both rates are multiplied by at a step."""
        per_epoch = self.steps_per_epoch(scenes)
        if self.schedule == "halving":
            return float(0.5 ** (step // per_epoch // self.halve_epochs))
        total = self.epochs * per_epoch
        rise = max(1.0, 0.03 * total)
        if step < rise:
            return (step + 1) / (rise + 1)
        done = min((step - rise) / max(total - rise, 1.0), 1.0)  # past the end the cosine would climb again
        return 1e-3 + (1.0 - 1e-3) * 0.5 * (1.0 + math.cos(math.pi * done))

    def prior_factor(self, step: int, scenes: int) -> float:
        """Weight of the prior at a step: 1e-4 min(1, epoch / 100) as published."""
        epoch = step // self.steps_per_epoch(scenes)
        return self.prior_weight * (min(1.0, epoch / self.prior_epochs) if self.prior_epochs else 1.0)


PAPER = MlpTrainConfig()
PAPER_FAST = MlpTrainConfig(
    epochs=150,
    step_scenes=0,
    step_points=16,
    far_share=0.35,
    triplets_per_anchor=16,
    net_rate=2e-3,
    code_rate=3e-2,
    schedule="one-cycle",
    code_std=0.4,
    decoder=MlpConfig(dropout=0.0),
)
# For codes rather than shapes: noise on the codes halves the retrieval gap of unseen grasps (.066 to .036 after 1.5e7
# samples of one object, from signed distances alone); far draws, which keep stray surfaces away, widen it.
PAPER_FAST_CODES = replace(PAPER_FAST, far_share=0.0, code_noise=0.3)
PRESETS: Mapping[str, MlpTrainConfig] = {
    "paper": PAPER,
    "paper-fast": PAPER_FAST,
    "paper-fast-codes": PAPER_FAST_CODES,
}


def shortened(config: MlpTrainConfig, samples: float, scenes: int) -> MlpTrainConfig:
    """The same schedule squeezed into about so many samples of so many scenes; one that is shorter stays as it is."""
    whole = config.samples(scenes)
    if samples >= whole:
        return config
    epochs = max(1, math.ceil(samples / (scenes * config.points_per_scene)))
    at_least = math.ceil(config.scenes_of_step(scenes) * config.step_points / scenes)  # one step
    points = max(at_least, int(samples // (scenes * epochs)))
    share = epochs / config.epochs
    return replace(
        config,
        epochs=epochs,
        points_per_scene=min(points, config.points_per_scene),
        halve_epochs=max(1, round(config.halve_epochs * share)),
        prior_epochs=round(config.prior_epochs * share),
    )
