"""What becomes of decoded hands: closed, judged, squeezed, and tried in physics once each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np

from neuralgrasps.apply.novel_align import turn_flush
from neuralgrasps.apply.novel_close import best_variation, free_and_close
from neuralgrasps.apply.novel_codes import SampledCodes
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate, empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng
from neuralgrasps.sim.build import contact_friction
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.sim.validate import validate_grasps
from neuralgrasps.synthesis.candidates import (
    COLLIDES,
    FEW_CONTACTS,
    NO_FORCE_CLOSURE,
    VALID,
    Candidates,
    GraspProblem,
    make_problem,
)
from neuralgrasps.synthesis.close import START_OVERLAP_M
from neuralgrasps.synthesis.finish import finish_grasps
from neuralgrasps.synthesis.settle import settle
from neuralgrasps.synthesis.synthesise import SynthesisConfig

Kind = Literal["noise", "midpoint", "sample", "gaussian"]
# What became of a code, from first to last obstacle.
PENETRATING, NOT_CLOSED, NOT_FORCE_CLOSURE, NOT_HELD, HELD = range(5)
ENOUGH = 0.5  # share of the median epsilon of known grasps: a hand that closes to it is not varied
NOVEL_OUTCOMES = ("penetrating", "not closed", "no force closure", "not held", "held")


@dataclass(frozen=True, slots=True, kw_only=True)
class NovelConfig:
    """How codes are made and tried.

    Attributes:
        kind: "noise": a known code plus Gaussian noise; "midpoint": between a known code and a neighbour; "sample":
            from a kernel density over known codes; "gaussian": from one Gaussian over them.
        count: codes. spread: of the noise, in standard deviations of the known codes, component by component.
        share: of the way from a code to its neighbour.
        search: most variations of a decoded hand that are closed too, where it closes to less than `ENOUGH`; the one of
            largest epsilon goes into physics. 0: what is decoded is closed. One trial per code in any case.
        noise_level: told to the decoder; above 0 its trained network moves the code towards known grasps first.
        protocol: physics protocol that decides.
    Raises:
        InputError, UnknownNameError: a value that makes no sense.
    """

    kind: Kind = "noise"
    count: int = 20
    spread: float = 0.1
    share: float = 0.5
    search: int = 16
    noise_level: float = 0.0
    protocol: str = "dexgraspbench"

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise unknown_name("kind", self.kind, get_args(Kind))
        if self.count < 1:
            raise InputError(f"novel grasps: count is {self.count}; expected at least 1.")
        for name in ("spread", "search", "noise_level"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise InputError(f"novel grasps: {name} is {value}; expected 0 or more.")
        if not 0 <= self.share <= 1:
            raise InputError(f"novel grasps: share is {self.share}; expected 0 (the code) to 1 (its neighbour).")
        get_protocol(self.protocol)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedCodes:
    """Codes of one hand on one object, decoded.

    Attributes:
        codes: N codes; their `source` and `neighbour` are rows of the code book.
        X_OH: (N, 4, 4); q: (N, J) that they decode to.
        known_X_OH: (M, 4, 4); known_q: (M, J) of the known grasps they were made from.
        seed: of this hand and object.
    """

    codes: SampledCodes
    X_OH: np.ndarray
    q: np.ndarray
    known_X_OH: np.ndarray
    known_q: np.ndarray
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """What became of N decoded hands.

    Attributes:
        outcome: (N,) int8, one of `NOVEL_OUTCOMES`.
        grasps: those in force closure, with the verdict of the protocol, in order.
        place: (N,) int64, row of `grasps`, -1 for those that did not get there.
    """

    outcome: np.ndarray
    grasps: GraspSet
    place: np.ndarray


def try_decoded(
    hand: Hand,
    obj: ObjectModel,
    decoded: DecodedCodes,
    *,
    config: NovelConfig,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Trials:
    """Close, judge, settle and squeeze N decoded hands, and try each once in physics.

    A hand that does not reach force closure is turned flush with what it touches and closed once more.

    Args:
        threads: of the physics trials; the result does not depend on it.
        progress: called with (hands closed, N).
    """
    problem = novel_problem(hand, obj, config.protocol)
    count, enough = len(decoded.q), 0.0
    if config.search:
        known, _ = free_and_close(problem, decoded.known_X_OH, decoded.known_q)
        enough = ENOUGH * float(np.median(known.epsilon))
    outcome, place = np.empty(count, np.int8), np.full(count, -1, np.int64)
    finished: list[GraspSet] = []
    texts = {f"novel_{name}": str(value) for name, value in asdict(config).items()}
    finish = partial(finish_grasps, problem, protocol=config.protocol, seed=decoded.seed, config=texts)
    for i in range(count):
        best, overlap = best_variation(
            problem, decoded.X_OH[i], decoded.q[i], search=config.search, enough=enough,
            rng=child_rng(decoded.seed, "variations", i),
        )  # fmt: skip
        outcome[i], one = _finished(problem, best, overlap, finish)
        if outcome[i] in (NOT_CLOSED, NOT_FORCE_CLOSURE):
            X_OH = turn_flush(problem, best.X_OH[0], best.q[0])
            flush, left = free_and_close(problem, X_OH[None], best.q)
            again, one = _finished(problem, flush, float(left[0]), finish)
            outcome[i] = again if again == NOT_HELD else outcome[i]
        if len(one):
            place[i] = len(finished)
            finished.append(one)
        if progress is not None:
            progress(i + 1, count)
    if not finished:
        none = empty_grasps(hand.name, obj.name, num_joints=hand.num_dofs, seed=decoded.seed)
        return Trials(outcome=outcome, grasps=none.with_config(**texts), place=place)
    grasps = concatenate(finished)
    verdict = validate_grasps(hand, obj, grasps, config.protocol, threads=threads)
    outcome[place >= 0] = np.where(verdict.success, HELD, NOT_HELD)
    return Trials(outcome=outcome, grasps=grasps.with_verdict(config.protocol, verdict), place=place)


def novel_problem(hand: Hand, obj: ObjectModel, protocol: str) -> GraspProblem:
    """The pair as `synthesise` would see it: friction of the protocol, overlap and contacts by its defaults."""
    sliding, torsional, _ = contact_friction(obj, get_protocol(protocol))
    usual = SynthesisConfig()
    return make_problem(
        hand, obj, friction=sliding, torsion=torsional, contact_threshold_m=usual.contact_threshold_m,
        max_penetration_m=usual.max_penetration_m,
    )  # fmt: skip


def _finished(
    problem: GraspProblem, closed: Candidates, overlap_m: float, finish: Callable[[Candidates], GraspSet]
) -> tuple[int, GraspSet]:
    """What stopped one closed hand, or NOT_HELD when nothing did so far and its grasp; `overlap_m` before closing."""
    none = empty_grasps(problem.hand.name, problem.obj.name, num_joints=problem.hand.num_dofs)
    stopped = int(closed.outcome[0])
    if stopped in (VALID, NO_FORCE_CLOSURE, FEW_CONTACTS):  # settling may still bring another link into contact
        grasp = finish(closed)
        if len(grasp):
            return NOT_HELD, grasp
        settled, _ = settle(problem, closed)
        if settled.penetration_m[0] > problem.max_penetration_m:
            return PENETRATING, none
        return NOT_CLOSED if stopped == FEW_CONTACTS else NOT_FORCE_CLOSURE, none
    free = stopped == COLLIDES and overlap_m <= START_OVERLAP_M  # a jaw that ran into its limit
    return NOT_CLOSED if free else PENETRATING, none
