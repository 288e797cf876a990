"""What the synthesis of one pair costs and how good its grasps are: one record of the benchmark."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from neuralgrasps.evaluate.grasps import measured_penetration
from neuralgrasps.evaluate.synthesis_shapes import ShapeKind, shape_kind
from neuralgrasps.grasps.diversity import Diversity, grasp_diversity
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.grasps.wrench_space import characteristic_length
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.sim.validate import verdict_parameters
from neuralgrasps.synthesis.synthesise import SynthesisConfig, SynthesisResult, synthesise

CORES = 4  # of the machine that rates are stated for
SPACING_M = 0.002  # of the points that overlap is measured at
HandKind = Literal["jaws", "dexterous"]
_WARM_UP = SynthesisConfig(count=1, batch=256, max_rounds=1)
_WARM_UP_OBJECT = "gelatin_box"
_STATED = ("mass_kg", "friction", "torsional_friction_m", "force_n", "min_joint_effort", "max_joint_effort")


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRun:
    """One call of `synthesise`.

    Attributes:
        result: what it made. wall_s, cpu_s: of the whole call, every stage and thread of this process.
    """

    result: SynthesisResult
    wall_s: float
    cpu_s: float


def warm_up(hand: Hand, *, threads: int = 1) -> None:
    """Make a few grasps of a box, so that compiled loops are loaded before something is timed."""
    synthesise(hand, load_object(_WARM_UP_OBJECT), config=_WARM_UP, threads=threads)


def run_pair(hand: Hand, obj: ObjectModel, config: SynthesisConfig, seed: int, threads: int = 1) -> PairRun:
    """Time one synthesis; the compiled loops are loaded before, once per process and kind of hand."""
    warm_kind(hand.is_jaw)
    return time_pair(hand, obj, config, seed, threads=threads)


def time_pair(hand: Hand, obj: ObjectModel, config: SynthesisConfig, seed: int, *, threads: int) -> PairRun:
    """Time one synthesis as it is."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = synthesise(hand, obj, config=config, seed=seed, threads=threads)
    return PairRun(result=result, wall_s=time.perf_counter() - wall, cpu_s=time.process_time() - cpu)


@functools.cache
def warm_kind(is_jaw: bool) -> None:
    """`warm_up` with a built-in jaw or dexterous hand, once per process."""
    warm_up(load_hand("fetch" if is_jaw else "barrett"))


@dataclass(frozen=True, slots=True, kw_only=True)
class PairMeasures:
    """One hand on one object: two runs and the quality of the grasps.

    Attributes:
        hand, object: names. hand_kind, shape: what the figures are told apart by.
        wanted: grasps asked for.
        run: the run beside others on worker processes. alone: the run of the whole process; None when it was left out.
        depth_m: (N,) overlap of each grasp, see `measured_penetration`.
        diversity: None with fewer than two grasps.
        parameters: of the physics, see `verdict_parameters`.
    """

    hand: str
    object: str
    hand_kind: HandKind
    shape: ShapeKind
    wanted: int
    run: PairRun
    depth_m: np.ndarray
    diversity: Diversity | None
    parameters: dict[str, float]
    alone: PairRun | None = None

    @property
    def grasps(self) -> GraspSet:
        return self.run.result.grasps

    @property
    def is_feasible(self) -> bool:
        """As many grasps as wanted."""
        return len(self.grasps) >= self.wanted

    def with_alone(self, alone: PairRun) -> PairMeasures:
        """The same, with the run of the whole process."""
        return replace(self, alone=alone)


def measure_pair(hand: Hand, obj: ObjectModel, run: PairRun, wanted: int, protocol: str) -> PairMeasures:
    """Overlap against the true mesh, variety, and what the physics assumed."""
    grasps = run.result.grasps
    length = characteristic_length(obj.points_O, obj.com_O)
    return PairMeasures(
        hand=hand.name,
        object=obj.name,
        hand_kind="jaws" if hand.is_jaw else "dexterous",
        shape=shape_kind(obj.name, obj.mesh),
        wanted=wanted,
        run=run,
        depth_m=measured_penetration(hand, obj, grasps, spacing=SPACING_M),
        diversity=grasp_diversity(hand, grasps.X_OH, grasps.q, length=length) if len(grasps) > 1 else None,
        parameters=verdict_parameters(hand, obj, protocol),
    )


def pair_record(pair: PairMeasures) -> dict[str, Any]:
    """Numbers of one pair, units in the names; nan for what could not be measured.

    Rates of candidates are per CPU-second of proposing and closing; rates of validated grasps per CPU-second or minute
    of the whole call, so of every stage.
    """
    result, run = pair.run.result, pair.run
    grasps, count = pair.grasps, len(pair.grasps)
    start_cpu_s = sum(s for stage, s in result.cpu_s.items() if "propose" in stage or "close" in stage)
    return {
        "hand": pair.hand,
        "object": pair.object,
        "hand_kind": pair.hand_kind,
        "shape": pair.shape,
        "wanted": pair.wanted,
        "validated": count,
        "feasible": pair.is_feasible,
        "reason": result.reason,
        "candidates": result.proposals,
        "valid_candidates": result.outcomes["valid"],
        "candidates_per_cpu_s": _ratio(result.proposals, start_cpu_s),
        "valid_per_cpu_s": _ratio(result.outcomes["valid"], start_cpu_s),
        "validated_per_cpu_s": _ratio(count, run.cpu_s),
        "validated_per_wall_min": _ratio(60.0 * count, run.wall_s),
        "validated_per_min_4c": _ratio(60.0 * CORES * count, run.cpu_s),
        "tried_in_physics": result.tried,
        "held_in_physics": result.validated,
        "success_before_filter": _ratio(result.validated, result.tried),
        **_quality(pair),
        "precision_share": float(grasps.precision.mean()) if count else float("nan"),
        "palm_contact_share": float(grasps.palm_contact.mean()) if count else float("nan"),
        "fingers_touching_mean": float(grasps.finger_count.mean()) if count else float("nan"),
        "wall_s": run.wall_s,
        "cpu_s": run.cpu_s,
        "stage_cpu_s": {**result.cpu_s, "other": run.cpu_s - sum(result.cpu_s.values())},
        "outcomes": dict(result.outcomes),
        **_alone(pair),
        **{name: pair.parameters[name] for name in _STATED},
    }


def _quality(pair: PairMeasures) -> dict[str, float]:
    epsilon, depth_mm, varied = pair.grasps.epsilon, 1e3 * pair.depth_m, pair.diversity
    return {
        "penetration_p50_mm": percentile(depth_mm, 50),
        "penetration_p95_mm": percentile(depth_mm, 95),
        "penetration_max_mm": percentile(depth_mm, 100),
        "epsilon_median": percentile(epsilon, 50),
        "epsilon_p5": percentile(epsilon, 5),
        "approach_coverage_30deg_share": varied.approach_coverage if varied else float("nan"),
        "nearest_approach_deg": float(np.rad2deg(varied.nearest_approach_rad)) if varied else float("nan"),
        "nearest_rotation_deg": float(np.rad2deg(varied.nearest_rotation_rad)) if varied else float("nan"),
        "joint_entropy_bits": varied.entropy_bits if varied else float("nan"),
    }


def _alone(pair: PairMeasures) -> dict[str, Any]:
    if pair.alone is None:
        return {}
    mine, other = pair.grasps, pair.alone.result.grasps
    same = np.array_equal(mine.X_OH, other.X_OH) and np.array_equal(mine.q, other.q)
    return {"alone_wall_s": pair.alone.wall_s, "alone_cpu_s": pair.alone.cpu_s, "alone_same_grasps": bool(same)}


def percentile(values: np.ndarray, share: float) -> float:
    """A percentile; nan of nothing."""
    return float(np.percentile(values, share)) if len(values) else float("nan")


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else float("nan")
