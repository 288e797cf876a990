"""Synthesise diverse grasps of one object by one hand, each proven in physics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict, concatenate
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng
from neuralgrasps.sim.build import contact_friction
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.sim.validate import validate_grasps
from neuralgrasps.synthesis.candidates import (
    OUTCOMES,
    VALID,
    Candidates,
    GraspProblem,
    close_and_assess,
    make_problem,
)
from neuralgrasps.synthesis.finish import finish_grasps
from neuralgrasps.synthesis.propose import Proposals, jaw_aperture, propose_dexterous, propose_jaw
from neuralgrasps.synthesis.refine import refine
from neuralgrasps.synthesis.select import diverse_order


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthesisConfig:
    """How grasps are made.

    Attributes:
        count: validated grasps wanted.
        batch: proposals per round; max_rounds: rounds before giving up.
        protocol: physics protocol that decides (see `sim.protocols`).
        friction: Coulomb coefficient for epsilon and the squeeze; torsion_m: torsional friction, metres. None takes the
            protocol's on this object; `grasps.config` records the values used.
        max_penetration_m: a grasp that overlaps the object by more at points of either surface 2 mm apart, or itself at
            points 4 mm apart, is dropped.
        contact_threshold_m: hand points nearer than this to the object are contacts.
        niches: diverse candidates that are refined in each round; generations, children: of the refinement.
        pad_depth_m: largest offset of the object's middle from the middle of a jaw's pads along the approach.
    """

    count: int = 60
    batch: int = 2048
    max_rounds: int = 12
    protocol: str = "dexgraspbench"
    friction: float | None = None
    torsion_m: float | None = None
    max_penetration_m: float = 1.0e-3
    contact_threshold_m: float = 2.5e-3
    niches: int = 120
    generations: int = 3
    children: int = 8
    pad_depth_m: float = 0.012

    def __post_init__(self) -> None:
        for name in ("count", "batch", "max_rounds", "niches", "children"):
            if getattr(self, name) < 1:
                raise InputError(f"synthesis: {name} is {getattr(self, name)}; expected at least 1.")
        for name in ("contact_threshold_m", "max_penetration_m", "generations", "torsion_m", "pad_depth_m"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise InputError(f"synthesis: {name} is {value}; expected 0 or more.")
        get_protocol(self.protocol)
        if self.friction is not None and not 0 < self.friction < 5:
            raise InputError(f"synthesis: friction is {self.friction}; expected a Coulomb coefficient in (0, 5).")


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthesisResult:
    """What `synthesise` made, and what it cost.

    Attributes:
        grasps: up to `count` validated grasps in farthest-point order (any prefix is diverse).
        converged: `count` was reached.
        proposals: start poses tried; outcomes: how many ended how (`OUTCOMES`), refinement not counted.
        tried: grasps that went into physics; validated: how many held.
        cpu_s: CPU-seconds per stage of this process.
        reason: why fewer than `count` were found; "" when converged.
        seed: the seed.
    """

    grasps: GraspSet
    converged: bool
    proposals: int
    outcomes: Mapping[str, int]
    tried: int
    validated: int
    cpu_s: Mapping[str, float]
    reason: str
    seed: int

    @property
    def physics_success(self) -> float:
        """Share of the grasps tried in physics that held; nan when none was tried."""
        return self.validated / self.tried if self.tried else float("nan")


@dataclass(slots=True)
class _Stopwatch:
    cpu_s: dict[str, float] = field(default_factory=dict)

    def add(self, stage: str, start: float) -> None:
        self.cpu_s[stage] = self.cpu_s.get(stage, 0.0) + time.process_time() - start


def synthesise(
    hand: Hand,
    obj: ObjectModel,
    *,
    config: SynthesisConfig | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> SynthesisResult:
    """Make `config.count` diverse grasps, every one held by the physics protocol.

    Rounds of: propose, close, assess, refine the diverse best, then try in physics in farthest-point order until
    the count is reached. The result depends on the hand, the object, the config and the seed only.

    Args:
        hand: any hand; obj: any object.
        config: see `SynthesisConfig`.
        seed: root of every random number.
        progress: called with (validated so far, wanted).
    Returns:
        A result; `converged` is False, with a reason, when fewer grasps were found.
    Source:
        Khargonkar et al. 2022 use GraspIt! simulated annealing and keep force-closure grasps; this differs throughout.
    """
    config, friction, torsion = _with_friction(config or SynthesisConfig(), obj)
    problem = make_problem(
        hand, obj, friction=friction, torsion=torsion,
        contact_threshold_m=config.contact_threshold_m, max_penetration_m=config.max_penetration_m,
    )  # fmt: skip
    provenance = {name: str(value) for name, value in asdict(config).items()}
    watch = _Stopwatch()
    kept: list[GraspSet] = []
    outcomes = np.zeros(len(OUTCOMES), np.int64)
    proposals = tried = held = 0
    for round_index in range(config.max_rounds):
        rng = child_rng(seed, hand.name, obj.content_hash, round_index)
        start = time.process_time()
        drawn = _propose(problem, config, rng)
        proposals += config.batch
        closed = close_and_assess(problem, drawn.X_OH, drawn.q)
        outcomes += np.bincount(closed.outcome, minlength=len(OUTCOMES))
        watch.add("propose and close", start)
        start = time.process_time()
        refined = _refine_diverse(problem, closed.take(closed.outcome == VALID), config, rng)
        watch.add("refine", start)
        start = time.process_time()
        grasps = finish_grasps(problem, refined, protocol=config.protocol, seed=seed, config=provenance)
        watch.add("check", start)
        start = time.process_time()
        good, used = _prove(hand, obj, grasps, config, wanted=config.count - held)
        watch.add("physics", start)
        tried, held = tried + used, held + len(good)
        kept.append(good)
        if progress is not None:
            progress(min(held, config.count), config.count)
        if held >= config.count or (round_index >= 2 and outcomes[VALID] == 0):
            break
    grasps = _in_diverse_order(hand, concatenate(kept))
    return SynthesisResult(
        grasps=grasps,
        converged=held >= config.count,
        proposals=proposals,
        outcomes=dict(zip(OUTCOMES, outcomes.tolist(), strict=True)),
        tried=tried,
        validated=held,
        cpu_s=watch.cpu_s,
        reason="" if held >= config.count else _reason(problem, outcomes, held, tried, config),
        seed=seed,
    )


def _with_friction(config: SynthesisConfig, obj: ObjectModel) -> tuple[SynthesisConfig, float, float]:
    """The settings with the protocol's friction and torsion on `obj` in place of None, and these two."""
    sliding, torsional, _ = contact_friction(obj, get_protocol(config.protocol))
    friction = sliding if config.friction is None else config.friction
    torsion = torsional if config.torsion_m is None else config.torsion_m
    return replace(config, friction=friction, torsion_m=torsion), friction, torsion


def _propose(problem: GraspProblem, config: SynthesisConfig, rng: np.random.Generator) -> Proposals:
    if problem.hand.is_jaw:
        return propose_jaw(
            problem.hand, problem.obj, count=config.batch, friction=problem.friction,
            pad_depth_m=config.pad_depth_m, rng=rng,
        )  # fmt: skip
    return propose_dexterous(problem, count=config.batch, friction=problem.friction, rng=rng)


def _refine_diverse(
    problem: GraspProblem, valid: Candidates, config: SynthesisConfig, rng: np.random.Generator
) -> Candidates:
    """The better half by epsilon, thinned to `niches` diverse ones, each improved by local search, best first."""
    if len(valid) == 0:
        return valid
    best = valid.take(np.argsort(-valid.epsilon, kind="stable")[: max(config.niches, (len(valid) + 1) // 2)])
    niches = best.take(diverse_order(problem.hand, best.X_OH, best.q, start=0, count=config.niches))
    refined = refine(problem, niches, generations=config.generations, children=config.children, rng=rng)
    return refined.take(diverse_order(problem.hand, refined.X_OH, refined.q, start=int(refined.epsilon.argmax())))


def _prove(
    hand: Hand, obj: ObjectModel, grasps: GraspSet, config: SynthesisConfig, *, wanted: int
) -> tuple[GraspSet, int]:
    """The grasps that hold, tried in order until `wanted` do; and how many were tried."""
    if len(grasps) == 0:
        return grasps, 0
    verdict: Verdict = validate_grasps(hand, obj, grasps, config.protocol, stop_after=wanted)
    used = len(verdict)
    judged = grasps[:used].with_verdict(config.protocol, verdict)
    return judged[judged.validated], used


def _in_diverse_order(hand: Hand, grasps: GraspSet) -> GraspSet:
    if len(grasps) < 2:
        return grasps
    return grasps[diverse_order(hand, grasps.X_OH, grasps.q, start=int(grasps.epsilon.argmax()))]


def _reason(problem: GraspProblem, outcomes: np.ndarray, held: int, tried: int, config: SynthesisConfig) -> str:
    """One plain sentence on why fewer grasps than wanted were found."""
    total = int(outcomes.sum())
    size = " x ".join(f"{s * 1e3:.0f}" for s in np.sort(problem.obj.mesh.extents))
    if total == 0 and problem.hand.is_jaw:
        return (
            f"no two opposite surface points fit the aperture of {jaw_aperture(problem.hand) * 1e3:.0f} mm within "
            f"friction {problem.friction:g}; the object measures {size} mm"
        )
    if total == 0:
        return f"no open hand comes near the object, which measures {size} mm"
    if outcomes[VALID] == 0:
        worst = int(outcomes[:VALID].argmax())
        return f"none of {total} closed hands is a valid grasp; most fail because: {OUTCOMES[worst]}"
    return (
        f"{held} of {tried} grasps held '{config.protocol}'; {config.count} were wanted in {config.max_rounds} rounds"
    )
