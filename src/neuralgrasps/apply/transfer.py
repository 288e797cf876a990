"""Carry a grasp over to another hand: the executable grasps that touch the object most alike.

Known grasps that touch it alike are looked for first, in every orientation that the object cannot tell apart
(retrieval); then around the best of them for hands that touch it still more alike (generation). Candidates are tried in
physics in the order of their likeness, as many as it takes, so that what comes first is the best that holds.

The number: `similarity` is 1 - d / scale, d the mean absolute difference of two contact maps over the object's contact
points (weighted, for drawn contacts), and scale the largest d from the query to a known grasp or between two known
grasps: 1 for equal maps, 0 for the farthest there are. This is the published measure of retrieval (Khargonkar et al.
2022, Sec. 5), with the matrix of distances that one query has.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, get_args

import numpy as np

from neuralgrasps.apply.transfer_kernels import map_differences
from neuralgrasps.apply.transfer_pair import TransferPair, known_maps, target_of, transfer_pair
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.apply.transfer_search import Found, Ranked, SearchConfig, rank_known, search
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict, concatenate, empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.grasp_cache import pair_fingerprint, remembered
from neuralgrasps.seeds import child_rng
from neuralgrasps.sim.grasp_trial import silent_engine
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.sim.validate import check_pair, verdict_parameters
from neuralgrasps.synthesis.candidates import VALID, Candidates
from neuralgrasps.synthesis.finish import finish_grasps
from neuralgrasps.synthesis.select import grasp_features
from neuralgrasps.synthesis.support import Support
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

Method = Literal["both", "retrieve", "generate"]


class Constraint(Protocol):
    """What hands a user allows."""

    def allows(
        self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None
    ) -> np.ndarray: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferConfig:
    """How a grasp is carried over.

    Attributes:
        method: "retrieve": known grasps only; "generate": new ones only; "both".
        count: grasps wanted. trials: most grasps that are tried in physics.
        protocol: physics protocol that decides.
        use_symmetry: also take known grasps as the object's symmetry turns them.
        apart_m: grasps of one answer differ at least by so much (`grasp_features`).
        search: how new grasps are looked for.
        synthesise: grasps that are made on the spot where none are known.
        scale: difference of contact maps that has similarity 0; None: see above.
    """

    method: Method = "both"
    count: int = 5
    trials: int = 24
    protocol: str = "dexgraspbench"
    use_symmetry: bool = True
    apart_m: float = 0.004
    search: SearchConfig = field(default_factory=SearchConfig)
    synthesise: int = 40
    scale: float | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise unknown_name("method", self.method, get_args(Method))
        for name in ("count", "trials", "synthesise"):
            if getattr(self, name) < 1:
                raise InputError(f"transfer: {name} is {getattr(self, name)}; expected at least 1.")
        get_protocol(self.protocol)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferResult:
    """Grasps of one hand that touch an object like the query, those most alike first.

    Attributes:
        grasps: N of them, each held by the protocol; `grasps.verdicts` has the trial.
        similarity: (N,) see the module; map_difference: (N,) the mean absolute difference it is of.
        origin: N times "retrieved" or "generated". source: (N,) place in the known set that each is or comes from.
        reasons: why each is there, in words.
        oracle: similarity of the known grasp most alike, turned by the object's symmetry; oracle_plain: without; nan
            where none is known. scale: difference that has similarity 0.
        tried: grasps tried in physics.
        reason: why there are fewer than wanted, or none, or why they touch otherwise; "" when all is well.
        nearest: where nothing holds, the candidate most alike (0 or 1 grasps); nearest_similarity: its, or nan.
    """

    grasps: GraspSet
    similarity: np.ndarray
    map_difference: np.ndarray
    origin: tuple[str, ...]
    source: np.ndarray
    reasons: tuple[str, ...]
    oracle: float
    oracle_plain: float
    scale: float
    tried: int
    reason: str
    nearest: GraspSet
    nearest_similarity: float

    def __repr__(self) -> str:
        best = f", similarity {self.similarity[0]:.2f}" if len(self.grasps) else ""
        return f"TransferResult({len(self.grasps)} grasps by {self.grasps.hand} on {self.grasps.object}{best})"


@dataclass(slots=True)
class _Candidate:
    """A grasp on its way: rough (difference at some points), finished, proven."""

    origin: str
    source: int
    symmetry: int
    X_OH: np.ndarray
    q: np.ndarray
    epsilon: float
    grasp: GraspSet | None = None
    proven: bool = False


def transfer(
    query: TransferQuery,
    hand: Hand,
    obj: ObjectModel,
    *,
    known: GraspSet | None = None,
    config: TransferConfig | None = None,
    support: Support | None = None,
    constraints: Constraint | None = None,
    seed: int = 0,
) -> TransferResult:
    """Grasps of `hand` that touch `obj` like the query, the most alike first, each tried in physics.

    The result depends on the arguments only.

    Args:
        query: see `transfer_query`.
        hand: any hand, `obj`: the query's object; neither need be of a training.
        known: grasps of the hand on the object, with verdicts; None: some are made on the spot, once, and kept.
        support: what the object lies on; hands that meet it are no grasps.
        constraints: what else is asked of the hands.
        seed: of the search, and of grasps made on the spot.
    Raises:
        InputError: query or known grasps of another hand or object.
    """
    config = config or TransferConfig()
    if query.object != obj.name or len(query.points_O) != len(obj.points_O):
        raise InputError(f"the query is of object '{query.object}', the object is '{obj.name}'; expected the same.")
    if known is None:
        known = made_grasps(hand, obj, config, support=support, seed=seed)
    check_pair(hand, obj, known)
    return _Transfer(query, hand, obj, known, config, support, constraints, seed).run()


def made_grasps(
    hand: Hand, obj: ObjectModel, config: TransferConfig, *, support: Support | None, seed: int
) -> GraspSet:
    """Grasps synthesised on the spot, or kept from the last time."""
    settings = SynthesisConfig(count=config.synthesise, max_rounds=6)

    def make() -> GraspSet:
        made = synthesise(hand, obj, config=settings, seed=seed, support=support)
        return made.grasps.with_config(shortfall=made.reason)

    return remembered(("transfer", pair_fingerprint(hand, obj), settings, seed, support), make)


class _Transfer:
    """One transfer: what it reads, and candidates in order."""

    def __init__(
        self,
        query: TransferQuery,
        hand: Hand,
        obj: ObjectModel,
        known: GraspSet,
        config: TransferConfig,
        support: Support | None,
        constraints: Constraint | None,
        seed: int,
    ) -> None:
        self.query, self.hand, self.obj, self.config = query, hand, obj, config
        self.support, self.constraints, self.seed = support, constraints, seed
        self.pair: TransferPair = transfer_pair(hand, obj, config.protocol)
        self.known = known_maps(self.pair, _held(known), query.radius_m)
        self.full, self.sparse = target_of(query), target_of(query, self.pair.sparse)
        self.tried, self.heap, self.items = 0, [], []
        self.failed: list[tuple[float, _Candidate]] = []

    def allows(self, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None) -> np.ndarray:
        fine = np.ones(len(q), bool)
        for rule in (self.support, self.constraints):
            if rule is not None and len(q):
                fine &= rule.allows(self.hand, X_OH, q, q_pregrasp)
        return fine

    def run(self) -> TransferResult:
        config, ranked, scale = self.config, None, self.config.scale
        oracle = plain = np.nan
        if len(self.known.grasps):
            ranked = self._ranked(turn=config.use_symmetry)
            weighted = np.abs(self.known.maps - self.query.contact_map) @ self.query.weight / len(self.query.weight)
            if scale is None:
                scale = max(self.known.widest, float(weighted.max()), 1e-6)
            plain_ranked = self._ranked(turn=False, count=1)
            plain = 1.0 - plain_ranked.difference[0] / scale if len(plain_ranked.row) else np.nan
            oracle = 1.0 - ranked.difference[0] / scale if len(ranked.row) else np.nan
        scale = 1.0 if scale is None else scale
        if ranked is not None and config.method != "generate":
            self._add_known(ranked)
        if config.method != "retrieve":
            self._add_generated(ranked)
        chosen = self._best()
        return self._result(chosen, scale, oracle, plain)

    def _ranked(self, *, turn: bool, count: int = 0) -> Ranked:
        grasps = self.known.grasps
        config = self.config

        def allows(X_OH: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return self.allows(X_OH, grasps.q[rows], grasps.q_pregrasp[rows])

        wanted = count or max(config.count, 2 * config.search.starts)
        return rank_known(
            self.pair, self.query, self.full, self.known, count=wanted, turn=turn and len(self.pair.turned) > 1,
            allows=allows,
        )  # fmt: skip

    def _push(self, key: float, stage: int, item: _Candidate) -> None:
        heapq.heappush(self.heap, (key, stage, len(self.items)))
        self.items.append(item)

    def _add_known(self, ranked: Ranked) -> None:
        """Those that stay as they are count as proven; turned ones are closed and tried again."""
        grasps = self.known.grasps
        protocol = self.config.protocol
        for i, row in enumerate(ranked.row):
            item = _Candidate("retrieved", int(row), int(ranked.symmetry[i]), ranked.X_OH[i], ranked.q[i], 0.0)
            if ranked.symmetry[i] == 0:
                one = grasps[int(row)]
                item.grasp = replace(one, verdicts={k: v for k, v in one.verdicts.items() if k == protocol}, config={})
                item.proven = protocol in one.verdicts and bool(one.verdicts[protocol].success[0])
            self._push(float(ranked.difference[i]), 2 if item.proven else 0, item)

    def _add_generated(self, ranked: Ranked | None) -> None:
        X, q, rows, turns = self._starts(ranked)
        if len(q) == 0:
            return
        rng = child_rng(self.seed, "transfer", self.hand.name, self.obj.content_hash)
        found = search(self.pair, self.sparse, X, q, config=self.config.search, allows=self.allows, rng=rng)
        for i in self._apart(found):
            start = int(found.origin[i])
            item = _Candidate(
                "generated", int(rows[start]), int(turns[start]), found.X_OH[i], found.q[i], float(found.epsilon[i])
            )
            self._push(float(found.difference[i]), 0, item)

    def _starts(self, ranked: Ranked | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        seeds = self.config.search.starts
        X, q = np.zeros((0, 4, 4)), np.zeros((0, self.hand.num_dofs))
        rows = turns = np.zeros(0, np.int64)
        if ranked is not None:
            X, q, rows, turns = ranked.X_OH[:seeds], ranked.q[:seeds], ranked.row[:seeds], ranked.symmetry[:seeds]
        if self.query.X_OP is not None:
            own = self.query.X_OP @ np.linalg.inv(self.hand.X_HP)
            X = np.concatenate([X, own[None]])
            q = np.concatenate([q, q[:1] if len(q) else self.hand.q_open[None]])
            rows, turns = np.append(rows, -1), np.append(turns, 0)
        return X, q, rows, turns

    def _apart(self, found: Found) -> list[int]:
        """Candidates, most alike first, that differ from those before by enough; as many as could be tried."""
        features = grasp_features(self.hand, found.X_OH, found.q)
        chosen: list[int] = []
        for i in range(len(found)):
            near = np.linalg.norm(features[chosen] - features[i], axis=1) if chosen else np.zeros(0)
            if not (near < self.config.apart_m).any():
                chosen.append(i)
            if len(chosen) >= self.config.trials:
                break
        return chosen

    def _best(self) -> list[tuple[float, _Candidate]]:
        """Best first: what is rough is finished, what is finished is tried, and what held is taken."""
        chosen: list[tuple[float, _Candidate]] = []
        while self.heap and len(chosen) < self.config.count:
            key, _, index = heapq.heappop(self.heap)
            item = self.items[index]
            if item.proven:
                chosen.append((key, item))
            elif item.grasp is None:
                difference = self._finish(item)
                if difference is not None:
                    heapq.heappush(self.heap, (difference, 1, index))
            elif self.tried < self.config.trials:
                if self._prove(item):
                    chosen.append((key, item))
                else:
                    self.failed.append((key, item))
        return chosen

    def _finish(self, item: _Candidate) -> float | None:
        """Settle a closed hand; the exact difference of its contact map, None where it is no grasp after all."""
        X, q = item.X_OH[None], item.q[None]
        closed = Candidates(
            X_OH=X, q=q, q_start=q, epsilon=np.array([item.epsilon]), penetration_m=np.zeros(1),
            outcome=np.full(1, VALID, np.int8),
        )  # fmt: skip
        grasp = finish_grasps(self.pair.problem, closed, protocol=self.config.protocol, seed=self.seed, config={})
        if len(grasp) == 0 or not self.allows(grasp.X_OH, grasp.q, grasp.q_pregrasp)[0]:
            return None
        item.grasp = grasp
        return float(map_differences(self.pair.problem.packed, self.full, grasp.X_OH, grasp.q)[0])

    def _prove(self, item: _Candidate) -> bool:
        self.tried += 1
        grasp = item.grasp
        assert grasp is not None
        with silent_engine():
            out = self.pair.trial.run(grasp.X_OH[0], grasp.q_pregrasp[0], grasp.q[0], grasp.q_squeeze[0])
        verdict = Verdict(
            success=np.array([out.success]),
            displacement_m=np.array([out.displacement_m]),
            rotation_rad=np.array([out.rotation_rad]),
            parameters=verdict_parameters(self.hand, self.obj, self.config.protocol),
        )
        item.grasp, item.proven = grasp.with_verdict(self.config.protocol, verdict), out.success
        return out.success

    def _result(
        self, chosen: list[tuple[float, _Candidate]], scale: float, oracle: float, plain: float
    ) -> TransferResult:
        none = empty_grasps(self.hand.name, self.obj.name, num_joints=self.hand.num_dofs, seed=self.seed)
        sets = [c.grasp for _, c in chosen if c.grasp is not None]
        difference = np.array([key for key, _ in chosen])
        similarity = 1.0 - difference / scale
        nearest, near = none, np.nan
        if not chosen and self.failed:
            near = 1.0 - self.failed[0][0] / scale
            nearest = self.failed[0][1].grasp or none
        return TransferResult(
            grasps=concatenate(sets) if sets else none,
            similarity=similarity,
            map_difference=difference,
            origin=tuple(c.origin for _, c in chosen),
            source=np.array([c.source for _, c in chosen], np.int64),
            reasons=tuple(self._why(i, c, similarity[i], oracle) for i, (_, c) in enumerate(chosen)),
            oracle=float(oracle),
            oracle_plain=float(plain),
            scale=float(scale),
            tried=self.tried,
            reason="" if len(chosen) >= self.config.count else f"{len(chosen)} of {self.config.count} grasps found",
            nearest=nearest,
            nearest_similarity=float(near),
        )

    def _why(self, place: int, item: _Candidate, similarity: float, oracle: float) -> str:
        rank = "closest contacts" if place == 0 else f"contacts, place {place + 1}"
        turned = " turned by the object's symmetry" if item.symmetry else ""
        known = "the query's palm" if item.source < 0 else f"known grasp {item.source}{turned}"
        what = f"generated from {known}" if item.origin == "generated" else known
        beside = "" if np.isnan(oracle) else f" against {oracle:.2f} of the best known"
        return f"{rank}, {what}; similarity {similarity:.2f}{beside}; held in {self.config.protocol}"


def _held(known: GraspSet) -> GraspSet:
    """The known grasps that some protocol says hold; all where none was tried."""
    if not known.verdicts or len(known) == 0:
        return known
    return known[np.any([v.success for v in known.verdicts.values()], axis=0)]
