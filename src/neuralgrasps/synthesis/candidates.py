"""From start poses to assessed grasps: close, find contacts, epsilon, penetration."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from neuralgrasps.errors import DeviceError
from neuralgrasps.grasps.probe_points import ProbePoints
from neuralgrasps.grasps.wrench_space import characteristic_length
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.assess import (
    COLLIDES,
    CONE_EDGES,
    CONTACTS_PER_LINK,
    FEW_CONTACTS,
    MEETS_SUPPORT,
    NO_FORCE_CLOSURE,
    OUTCOMES,
    PENETRATES,
    SELF_COLLIDES,
    VALID,
    Pair,
    close_and_assess_all,
    close_and_balance_all,
)
from neuralgrasps.synthesis.close import Closing
from neuralgrasps.synthesis.clusters import Clusters
from neuralgrasps.synthesis.prepared import prepare_hand, prepare_surface

if TYPE_CHECKING:
    from neuralgrasps.synthesis.device import GpuPair
    from neuralgrasps.synthesis.support import Support

__all__ = [
    "COLLIDES",
    "CONE_EDGES",
    "CONTACTS_PER_LINK",
    "FEW_CONTACTS",
    "MEETS_SUPPORT",
    "NO_FORCE_CLOSURE",
    "OUTCOMES",
    "PENETRATES",
    "SELF_COLLIDES",
    "VALID",
    "Candidates",
    "GraspProblem",
    "close_and_assess",
    "close_and_balance",
    "make_problem",
]

Device = Literal["cpu", "cuda"]
SPACING_M = 0.004  # of the hand's surface points; at 9 mm, round links overlap by 2 mm between the points


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """Closed hands around one object.

    Attributes:
        X_OH: (N, 4, 4); q: (N, J) after closing; q_start: (N, J) before it.
        epsilon: (N,) Ferrari-Canny quality, 0 unless the outcome is VALID.
        penetration_m: (N,) deepest overlap found, metres; 0 for candidates that failed before it was measured.
        outcome: (N,) int8, one of `OUTCOMES`.
    """

    X_OH: np.ndarray
    q: np.ndarray
    q_start: np.ndarray
    epsilon: np.ndarray
    penetration_m: np.ndarray
    outcome: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def take(self, index: np.ndarray) -> Candidates:
        """The candidates at `index` (mask or integers)."""
        return Candidates(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    @staticmethod
    def join(parts: list[Candidates]) -> Candidates:
        """All candidates of `parts`, in order."""
        return Candidates(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Candidates)})


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspProblem:
    """One hand and one object, packed for the compiled kernels; `support`: what the object lies on, if anything."""

    hand: Hand
    obj: ObjectModel
    packed: PackedHand
    probe: ProbePoints
    hand_probe: PackedHand
    clusters: Clusters
    closing: Closing
    length: float
    friction: float
    torsion: float
    contact_threshold_m: float
    max_penetration_m: float
    device: Device = "cpu"
    support: Support | None = None
    _gpu: dict[str, GpuPair] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def arrays(self) -> Pair:
        """What the compiled steps of `assess` read."""
        return Pair(
            *self.sdf_arrays,
            probe=self.probe,
            com=self.obj.com_O,
            packed=self.packed,
            clusters=self.clusters,
            closing=self.closing,
            is_jaw=self.hand.is_jaw,
            length=self.length,
            friction=self.friction,
            torsion=self.torsion,
            threshold=self.contact_threshold_m,
            max_penetration=self.max_penetration_m,
        )

    def on_gpu(self) -> GpuPair:
        """The pair in the GPU's memory, copied there once."""
        from neuralgrasps.synthesis.device import GpuPair  # noqa: PLC0415 - only those who ask for a GPU pay for it

        if not self._gpu:
            self._gpu["pair"] = GpuPair(self.arrays)
        return self._gpu["pair"]

    @property
    def sdf_arrays(self) -> tuple[np.ndarray, np.ndarray, float]:
        return self.obj.sdf.values, self.obj.sdf.origin, self.obj.sdf.inv_spacing


def make_problem(
    hand: Hand,
    obj: ObjectModel,
    *,
    spacing: float = SPACING_M,
    friction: float,
    torsion: float,
    contact_threshold_m: float,
    max_penetration_m: float,
    device: Device = "cpu",
    support: Support | None = None,
) -> GraspProblem:
    """Pack `hand` and `obj`.

    Args:
        hand, obj: the pair.
        spacing: of the hand's surface points, metres.
        friction: Coulomb coefficient; torsion: torsional friction, metres.
        contact_threshold_m, max_penetration_m: see `SynthesisConfig`.
        device: where hands are closed and judged, "cpu" or "cuda".
        support: what the object lies on; hands that meet it are no grasps.
    Raises:
        DeviceError: the device is not known or not there.
    """
    check_device(device)
    tools = prepare_hand(hand, spacing=spacing)
    return GraspProblem(
        hand=hand,
        obj=obj,
        packed=tools.packed,
        probe=prepare_surface(obj.mesh),
        hand_probe=tools.probe,
        clusters=tools.clusters,
        closing=tools.closing,
        length=characteristic_length(obj.points_O, obj.com_O),
        friction=friction,
        torsion=torsion,
        contact_threshold_m=contact_threshold_m,
        max_penetration_m=max_penetration_m,
        device=device,
        support=support,
    )


def check_device(device: str) -> None:
    """Raise `DeviceError` unless `device` is "cpu", or "cuda" and there is a GPU that numba can use."""
    if device not in get_args(Device):
        raise DeviceError(f"device is '{device}'; expected 'cpu' or 'cuda'.")
    if device == "cuda":
        from neuralgrasps.synthesis.device import require_gpu  # noqa: PLC0415 - only those who ask for it pay

        require_gpu()


def close_and_assess(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> Candidates:
    """Close every hand from its start (N poses and postures) and assess it, on `problem.device`."""
    found, epsilon = _judge(problem, X_OH, q, by_forces=False)
    return replace(found, epsilon=epsilon)


def close_and_balance(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> tuple[Candidates, np.ndarray]:
    """Close every hand from its start and judge it by its best squeeze instead of epsilon, on `problem.device`.

    Returns:
        the candidates, VALID where contact forces of 1 N in total leave at most `MAX_RESIDUAL` unbalanced and nothing
        overlaps, epsilon 0; and what they leave, (N,), inf with fewer than two touching links.
    """
    return _judge(problem, X_OH, q, by_forces=True)


def _judge(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray, *, by_forces: bool) -> tuple[Candidates, np.ndarray]:
    q_start = np.ascontiguousarray(q)
    if problem.device == "cuda":
        judged = problem.on_gpu().judge(X_OH, q_start, by_forces=by_forces)
        X_OH, closed, score, depth, outcome = (getattr(judged, f.name) for f in fields(judged))
    else:
        X_OH, closed, count = np.ascontiguousarray(X_OH).copy(), q_start.copy(), len(q_start)
        score, depth, outcome = np.zeros(count), np.zeros(count), np.zeros(count, np.int8)
        run = close_and_balance_all if by_forces else close_and_assess_all
        run(problem.arrays, q_start, X_OH, closed, score, depth, outcome)
    if problem.support is not None:
        valid = np.flatnonzero(outcome == VALID)
        low = valid[~problem.support.allows(problem.hand, X_OH[valid], closed[valid])]
        outcome[low], score[low] = MEETS_SUPPORT, np.inf if by_forces else 0.0
    zero = np.zeros(len(q_start))
    found = Candidates(X_OH=X_OH, q=closed, q_start=q_start, epsilon=zero, penetration_m=depth, outcome=outcome)
    return found, score
