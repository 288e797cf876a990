"""Book-keeping of one synthesis: how many grasps of each kind are still wanted, and where the time went."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.synthesis.candidates import Candidates, GraspProblem
from neuralgrasps.synthesis.finish import kinds_of

Kind = Literal["any", "power", "precision"]


@dataclass(slots=True)
class Stopwatch:
    """CPU-seconds of this process per stage, all threads together."""

    cpu_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what runs inside as `name`."""
        start = time.process_time()
        try:
            yield
        finally:
            self.cpu_s[name] = self.cpu_s.get(name, 0.0) + time.process_time() - start


class Quotas:
    """Grasps wanted and found, in total or by kind.

    Attributes:
        kept: sets of validated grasps; tried: grasps that went into physics.
        other_kind: finished grasps that were not of the kind they were refined for.
        by_kind: precision and power grasps are wanted in a share.
    """

    def __init__(self, hand: Hand, count: int, power_share: float | None) -> None:
        self.kept: list[GraspSet] = []
        self.tried = self.other_kind = 0
        self._hand = hand
        self._missing: dict[Kind, int] = {"any": count}
        if power_share is not None and not hand.is_jaw:
            power = round(power_share * count)
            self._missing = {"power": power, "precision": count - power}
        self.by_kind = "any" not in self._missing

    @property
    def held(self) -> int:
        """Grasps found."""
        return sum(len(grasps) for grasps in self.kept)

    @property
    def complete(self) -> bool:
        """Nothing is missing."""
        return not any(self._missing.values())

    def missing(self, kind: Kind) -> int:
        """Grasps of this kind still wanted."""
        return self._missing[kind]

    def add(self, kind: Kind, grasps: GraspSet, *, tried: int) -> None:
        """Keep validated `grasps` of a kind."""
        self.kept.append(grasps)
        self.tried += tried
        self._missing[kind] -= len(grasps)

    def of_kind(self, grasps: GraspSet, kind: Kind) -> np.ndarray:
        """(N,) bool, which grasps are of this kind."""
        if kind == "any":
            return np.ones(len(grasps), bool)
        return grasps.precision == (kind == "precision")

    def pools(self, problem: GraspProblem, valid: Candidates) -> dict[Kind, Candidates]:
        """Candidates by kind, for the kinds that are missing."""
        if not self.by_kind or len(valid) == 0:
            return dict.fromkeys((kind for kind, missing in self._missing.items() if missing), valid)
        precision = kinds_of(problem, valid.X_OH, forward_fast(self._hand.tree, valid.q)).precision
        masks: dict[Kind, np.ndarray] = {"power": ~precision, "precision": precision}
        return {kind: valid.take(masks[kind]) for kind, missing in self._missing.items() if missing}

    def __str__(self) -> str:
        """What is missing, in words."""
        short = [f"{n} {'' if kind == 'any' else kind + ' '}grasps" for kind, n in self._missing.items() if n]
        return " and ".join(short)
