"""What a transfer can be told, and what a user may ask of hands."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol, get_args

import numpy as np

from neuralgrasps.apply.transfer_search import SearchConfig
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.hands.hand import Hand
from neuralgrasps.sim.protocols import get_protocol

Method = Literal["both", "retrieve", "generate"]


class Constraint(Protocol):
    """What hands a user allows."""

    def allows(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None) -> np.ndarray:
        """(N,) bool of hands X_OH (N, 4, 4) in the object frame, closed with joints q (N, J)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferConfig:
    """How a grasp is carried over.

    Attributes:
        method: "retrieve": known grasps only; "generate": new ones only; "both".
        count: grasps wanted. trials: most grasps that are tried in physics.
        protocol: physics protocol that decides; by default the one whose forces end once nothing moves: a third of the
            time of the whole trial, which agrees with it (see BENCHMARKS.md, "Transfer").
        use_symmetry: also take known grasps as the object's symmetry turns them.
        apart_m: grasps of one answer differ by so much (`grasp_features`) while there are others; by 4 mm always,
            unless `apart_m` is less.
        per_source: most grasps of one answer that come from the same known grasp (or the query's palm) while others
            are left; None or 0: no limit.
        search: how new grasps are looked for; sturdy: those whose epsilon is below this share of the known grasps'
            median are dropped: they would hold less often than known ones where friction or weight are not as told.
        robust: similarity that is given up for a grasp that would hold at half the friction as well as known ones
            usually do, rather than only just (`transfer_kernels.weakness`); not where known grasps are only retrieved.
            By default nothing: on stand-ins (5 hands, 210 grasps of other hands, count 1), 0.08 cost 0.009 similarity,
            and 0.914 held at half the friction for 0.910. Jaws alone (168 others) gained 0.036 for 0.013.
        synthesise: grasps that are made on the spot where none are known.
        scale: difference of contact maps that has similarity 0; None: the largest from the query to a known grasp, or
            between two known grasps.
        alike: below this similarity the answer says why the hand cannot do better.
    """

    method: Method = "both"
    count: int = 5
    trials: int = 24
    protocol: str = "dexgraspbench-quick"
    use_symmetry: bool = True
    apart_m: float = 0.004
    per_source: int | None = 3
    search: SearchConfig = field(default_factory=SearchConfig)
    sturdy: float = 0.4
    robust: float = 0.0
    synthesise: int = 40
    scale: float | None = None
    alike: float = 0.5

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise unknown_name("method", self.method, get_args(Method))
        for name in ("count", "trials", "synthesise"):
            if getattr(self, name) < 1:
                raise InputError(f"transfer: {name} is {getattr(self, name)}; expected at least 1.")
        if self.scale is not None and not self.scale > 0:
            raise InputError(
                f"transfer: scale is {self.scale}; expected a difference of contact maps above 0, or None."
            )
        if not 0 <= self.sturdy < np.inf:
            raise InputError(f"transfer: sturdy is {self.sturdy}; expected a share of 0 or more.")
        if not 0 <= self.robust < np.inf:
            raise InputError(f"transfer: robust is {self.robust}; expected a similarity of 0 or more.")
        if not 0 <= self.apart_m < np.inf:
            raise InputError(f"transfer: apart_m is {self.apart_m}; expected 0 or more, metres.")
        if self.per_source is not None and self.per_source < 0:
            raise InputError(f"transfer: per_source is {self.per_source}; expected 0 or more, or None.")
        get_protocol(self.protocol)
