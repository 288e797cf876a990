"""How many grasps whose contact forces balance come per second, on a GPU or on one core."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng
from neuralgrasps.synthesis.candidates import VALID, Device, GraspProblem, close_and_balance, make_problem
from neuralgrasps.synthesis.propose import Proposals, propose_dexterous, propose_jaw
from neuralgrasps.synthesis.synthesise import SynthesisConfig

FRICTION = 0.6
TORSION_M = 0.005
_WARM = 64  # candidates that load or compile the kernels before anything is timed


@dataclass(frozen=True, slots=True, kw_only=True)
class GpuRate:
    """Figures of one hand, object and device.

    Attributes:
        candidates: hands that were closed and judged; qp_valid: those that end without overlap (see
            `SynthesisConfig.max_penetration_m`) and whose contact forces of 1 N in total leave at most 1 mN unbalanced.
        propose_s, judge_s: wall seconds for start poses, and for closing and judging, copies to and from the GPU
            included.
    """

    hand: str
    object: str
    device: str
    candidates: int
    qp_valid: int
    propose_s: float
    judge_s: float

    @property
    def judged_per_s(self) -> float:
        """QP-valid grasps per second of closing and judging."""
        return self.qp_valid / self.judge_s

    @property
    def per_s(self) -> float:
        """QP-valid grasps per second, start poses included."""
        return self.qp_valid / (self.judge_s + self.propose_s)


def gpu_rate(hand: Hand, obj: ObjectModel, *, device: Device, candidates: int = 65_536, seed: int = 0) -> GpuRate:
    """Time one hand and object; compiling is not counted.

    Args:
        hand, obj: the pair.
        device: "cuda", or "cpu" for one core.
        candidates: start poses drawn; a few of them may be dropped before they are judged. A GPU wants many.
        seed: root of the random numbers.
    Raises:
        DeviceError: there is no GPU that numba can use.
    """
    config = SynthesisConfig()
    problem = make_problem(
        hand,
        obj,
        friction=FRICTION,
        torsion=TORSION_M,
        contact_threshold_m=config.contact_threshold_m,
        max_penetration_m=config.max_penetration_m,
        device=device,
    )
    warm = _starts(problem, _WARM, config, child_rng(seed, "gpu rate, warm", hand.name, obj.name))
    close_and_balance(problem, warm.X_OH, warm.q)
    begin = time.perf_counter()
    drawn = _starts(problem, candidates, config, child_rng(seed, "gpu rate", hand.name, obj.name))
    middle = time.perf_counter()
    judged, _ = close_and_balance(problem, drawn.X_OH, drawn.q)
    end = time.perf_counter()
    return GpuRate(
        hand=hand.name,
        object=obj.name,
        device=device,
        candidates=len(judged),
        qp_valid=int((judged.outcome == VALID).sum()),
        propose_s=middle - begin,
        judge_s=end - middle,
    )


def _starts(problem: GraspProblem, count: int, config: SynthesisConfig, rng: np.random.Generator) -> Proposals:
    if problem.hand.is_jaw:
        return propose_jaw(
            problem.hand, problem.obj, count=count, friction=FRICTION, pad_depth_m=config.pad_depth_m, rng=rng
        )
    return propose_dexterous(problem, count=count, friction=FRICTION, rng=rng)
