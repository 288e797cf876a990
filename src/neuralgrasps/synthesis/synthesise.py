"""Synthesise diverse grasps of one object by one hand, each proven in physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate, empty_grasps
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
    Device,
    GraspProblem,
    make_problem,
)
from neuralgrasps.synthesis.feasibility import why_short
from neuralgrasps.synthesis.finish import finish_grasps
from neuralgrasps.synthesis.propose import Proposals, propose_dexterous, propose_jaw
from neuralgrasps.synthesis.quotas import Kind, Quotas, Stopwatch
from neuralgrasps.synthesis.refine import assess_all, refine
from neuralgrasps.synthesis.select import diverse_order
from neuralgrasps.synthesis.strength import is_heavy, strengthen
from neuralgrasps.synthesis.support import Support

_LENGTHS = ("contact_threshold_m", "max_penetration_m", "torsion_m", "pad_depth_m")
_MORE_NICHES = 8  # besides those in proportion to the grasps wanted


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthesisConfig:
    """How grasps are made.

    Attributes:
        count: validated grasps wanted.
        batch: start poses drawn at once; a round draws up to `draws` batches, until it has `pool` valid candidates per
            grasp still wanted; max_rounds: rounds before giving up.
        protocol: physics protocol that decides (see `sim.protocols`).
        also: other protocols whose verdicts are stored with the grasps; they decide nothing.
        friction: Coulomb coefficient for epsilon and the squeeze; torsion_m: torsional friction, metres. None takes the
            protocol's on this object; `grasps.config` records the values used.
        max_penetration_m: a grasp that overlaps the object by more at points of either surface 2 mm apart, or itself at
            points 4 mm apart, is dropped.
        contact_threshold_m: hand points nearer than this to the object are contacts.
        power_share: share of power grasps (the palm or an inner phalanx touches) among the `count`; the others are
            precision grasps (only fingertips touch). None takes them as they come; parallel jaws always do.
        spare: diverse candidates that are refined per grasp still wanted; generations, children: of the refinement.
        pad_depth_m: largest offset of the object's middle from the middle of a jaw's pads along the approach.
        device: "cpu", or "cuda" to trace, close and judge hands on an NVIDIA GPU; figures differ in their last bits.
    """

    count: int = 60
    batch: int = 512
    draws: int = 4
    pool: float = 5.0
    max_rounds: int = 12
    protocol: str = "dexgraspbench"
    also: tuple[str, ...] = ()
    friction: float | None = None
    torsion_m: float | None = None
    max_penetration_m: float = 0.5e-3
    contact_threshold_m: float = 2.5e-3
    power_share: float | None = None
    spare: float = 1.15
    generations: int = 3
    children: int = 8
    pad_depth_m: float = 0.012
    device: Device = "cpu"

    def __post_init__(self) -> None:
        for name in ("count", "batch", "draws", "max_rounds", "children"):
            if getattr(self, name) < 1:
                raise InputError(f"synthesis: {name} is {getattr(self, name)}; expected at least 1.")
        for name in (*_LENGTHS, "pool", "spare", "generations"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise InputError(f"synthesis: {name} is {value}; expected 0 or more.")
        for name in (self.protocol, *self.also):
            get_protocol(name)
        if self.power_share is not None and not 0 <= self.power_share <= 1:
            raise InputError(f"synthesis: power_share is {self.power_share}; expected a share from 0 to 1, or None.")
        if self.friction is not None and not 0 < self.friction < 5:
            raise InputError(f"synthesis: friction is {self.friction}; expected a Coulomb coefficient in (0, 5).")


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthesisResult:
    """What `synthesise` made, and what it cost.

    Attributes:
        grasps: up to `count` validated grasps in farthest-point order (any prefix is diverse).
        converged: `count` was reached.
        proposals: start poses from which a hand was closed, refinement not counted; outcomes: how many ended how
            (`OUTCOMES`).
        tried: grasps that went into physics, best first of each diverse round; validated: how many held.
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


def synthesise(
    hand: Hand,
    obj: ObjectModel,
    *,
    config: SynthesisConfig | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
    support: Support | None = None,
) -> SynthesisResult:
    """Make `config.count` diverse grasps, every one held by the physics protocol.

    Rounds of: propose, close, assess, refine the diverse best, settle, then try in physics in farthest-point order
    until the count is reached. The result depends on the hand, the object, the config and the seed only.

    Args:
        hand: any hand; obj: any object.
        config: see `SynthesisConfig`.
        seed: root of every random number.
        threads: threads of this process; the result does not depend on it.
        progress: called with (validated so far, wanted).
        support: what the object lies on: closed hands, the same a little more open, and their straight way back keep
            clear of it, and jaws close on no more than 97 % of their aperture. The physics trial stays the same. Of an
            object that is heavy for the hand (see `strength`), strong grasps are searched for in place of those with a
            large epsilon, and their squeeze is for lifting it.
    Returns:
        A result; `converged` is False, with a reason, when fewer grasps were found.
    Source:
        Khargonkar et al. 2022 use GraspIt! simulated annealing and keep force-closure grasps; this differs throughout.
    """
    config, friction, torsion = _with_friction(config or SynthesisConfig(), obj)
    watch = Stopwatch()
    with watch.stage("prepare"):
        problem = make_problem(
            hand, obj, friction=friction, torsion=torsion,
            contact_threshold_m=config.contact_threshold_m, max_penetration_m=config.max_penetration_m,
            device=config.device, support=support,
        )  # fmt: skip
    quotas = Quotas(hand, config.count, config.power_share)
    outcomes = np.zeros(len(OUTCOMES), np.int64)
    proposals = 0
    for round_index in range(config.max_rounds):
        rng = child_rng(seed, hand.name, obj.content_hash, round_index)
        enough = math.ceil(config.pool * (config.count - quotas.held))
        closed = _draw(problem, config, rng, watch, enough=enough, threads=threads)
        everything = Candidates.join(closed)
        proposals += len(everything)
        outcomes += np.bincount(everything.outcome, minlength=len(OUTCOMES))
        valid = everything.take(everything.outcome == VALID)
        heavy = is_heavy(problem, valid)
        search = _strengthen_diverse if heavy else _refine_diverse
        for kind, pool in quotas.pools(problem, valid).items():
            with watch.stage("refine"):
                refined = search(problem, pool, config, rng, wanted=quotas.missing(kind), threads=threads)
            _prove(problem, refined, kind, quotas, config, watch, seed=seed, threads=threads, lift=heavy)
            if progress is not None:
                progress(quotas.held, config.count)
        if quotas.complete or (round_index >= 2 and outcomes[VALID] == 0):
            break
    grasps = empty_grasps(hand.name, obj.name, num_joints=hand.num_dofs, seed=seed)
    if quotas.held:
        grasps = _in_diverse_order(hand, concatenate(quotas.kept))
        with watch.stage("other protocols"):
            for name in config.also:
                verdict = validate_grasps(hand, obj, grasps, name, threads=threads)
                grasps = grasps.with_verdict(name, verdict, decides=False)
    return SynthesisResult(
        grasps=grasps,
        converged=quotas.complete,
        proposals=proposals,
        outcomes=dict(zip(OUTCOMES, outcomes.tolist(), strict=True)),
        tried=quotas.tried,
        validated=quotas.held,
        cpu_s=watch.cpu_s,
        reason="" if quotas.complete else _reason(problem, outcomes, quotas, config),
        seed=seed,
    )


def _with_friction(config: SynthesisConfig, obj: ObjectModel) -> tuple[SynthesisConfig, float, float]:
    """The settings with the protocol's friction and torsion on `obj` in place of None, and these two."""
    sliding, torsional, _ = contact_friction(obj, get_protocol(config.protocol))
    friction = sliding if config.friction is None else config.friction
    torsion = torsional if config.torsion_m is None else config.torsion_m
    return replace(config, friction=friction, torsion_m=torsion), friction, torsion


def _draw(
    problem: GraspProblem,
    config: SynthesisConfig,
    rng: np.random.Generator,
    watch: Stopwatch,
    *,
    enough: int,
    threads: int,
) -> list[Candidates]:
    """Batches of closed and assessed hands, until `enough` are valid or `config.draws` are made."""
    closed: list[Candidates] = []
    valid = 0
    while len(closed) < config.draws and valid < enough:
        with watch.stage("propose"):
            drawn = _propose(problem, config, rng, threads)
        with watch.stage("close"):
            closed.append(assess_all(problem, drawn.X_OH, drawn.q, threads=threads))
        valid += int((closed[-1].outcome == VALID).sum())
    return closed


def _propose(problem: GraspProblem, config: SynthesisConfig, rng: np.random.Generator, threads: int) -> Proposals:
    if problem.hand.is_jaw:
        return propose_jaw(
            problem.hand, problem.obj, count=config.batch, friction=problem.friction,
            pad_depth_m=config.pad_depth_m, rng=rng, support=problem.support,
        )  # fmt: skip
    return propose_dexterous(problem, count=config.batch, friction=problem.friction, rng=rng, threads=threads)


def _refine_diverse(
    problem: GraspProblem,
    valid: Candidates,
    config: SynthesisConfig,
    rng: np.random.Generator,
    *,
    wanted: int,
    threads: int,
) -> Candidates:
    """The better half by epsilon, thinned to diverse ones, each improved by local search, in diverse order."""
    if len(valid) == 0:
        return valid
    niches = round(config.spare * wanted) + _MORE_NICHES
    best = valid.take(np.argsort(-valid.epsilon, kind="stable")[: max(niches, (len(valid) + 1) // 2)])
    chosen = best.take(diverse_order(problem.hand, best.X_OH, best.q, start=0, count=niches, quality=best.epsilon))
    refined = refine(
        problem, chosen, generations=config.generations, children=config.children, rng=rng, threads=threads
    )
    return refined.take(diverse_order(problem.hand, refined.X_OH, refined.q, start=int(refined.epsilon.argmax())))


def _strengthen_diverse(
    problem: GraspProblem,
    valid: Candidates,
    config: SynthesisConfig,
    rng: np.random.Generator,
    *,
    wanted: int,
    threads: int,
) -> Candidates:
    """The strong and diverse ones, improved by a local search for strength, the strongest first."""
    if len(valid) == 0:
        return valid
    return strengthen(
        problem, valid, niches=round(config.spare * wanted) + _MORE_NICHES, rng=rng, threads=threads,
    )  # fmt: skip


def _prove(
    problem: GraspProblem,
    refined: Candidates,
    kind: Kind,
    quotas: Quotas,
    config: SynthesisConfig,
    watch: Stopwatch,
    *,
    seed: int,
    threads: int,
    lift: bool,
) -> None:
    """Finish candidates and try them in physics, in order, until none of this kind is missing."""
    texts = ((name, "" if value is None else value) for name, value in asdict(config).items())
    provenance = {name: ", ".join(value) if isinstance(value, tuple) else str(value) for name, value in texts}
    if problem.support is not None:
        provenance["support"] = str(problem.support)
    done = 0
    while done < len(refined) and quotas.missing(kind):
        rows = np.arange(done, min(done + quotas.missing(kind) + _MORE_NICHES, len(refined)))
        done += len(rows)
        with watch.stage("settle and check"):
            grasps = finish_grasps(
                problem, refined.take(rows), protocol=config.protocol, seed=seed, config=provenance, threads=threads,
                lift=lift,
            )  # fmt: skip
            if problem.support is not None:
                grasps = grasps[problem.support.allows(problem.hand, grasps.X_OH, grasps.q, grasps.q_pregrasp)]
            chosen = quotas.of_kind(grasps, kind)
            quotas.other_kind += int((~chosen).sum())
            grasps = grasps[chosen]
        if len(grasps) == 0:
            continue
        with watch.stage("physics"):
            verdict = validate_grasps(
                problem.hand, problem.obj, grasps, config.protocol, stop_after=quotas.missing(kind), threads=threads
            )
        judged = grasps[: len(verdict)].with_verdict(config.protocol, verdict)
        quotas.add(kind, judged[judged.validated], tried=len(verdict))


def _in_diverse_order(hand: Hand, grasps: GraspSet) -> GraspSet:
    if len(grasps) < 2:
        return grasps
    return grasps[diverse_order(hand, grasps.X_OH, grasps.q, start=int(grasps.epsilon.argmax()))]


def _reason(problem: GraspProblem, outcomes: np.ndarray, quotas: Quotas, config: SynthesisConfig) -> str:
    """Why fewer grasps than wanted were found."""
    shortfall = why_short(
        problem,
        outcomes=dict(zip(OUTCOMES, outcomes.tolist(), strict=True)),
        tried=quotas.tried,
        held=quotas.held,
        missing=str(quotas),
        other_kind=quotas.other_kind,
        by_kind=quotas.by_kind,
        rounds=config.max_rounds,
        protocol=config.protocol,
    )
    return str(shortfall)
