"""Carry a grasp over to another hand: the executable grasps that touch the object most alike.

Known grasps that touch it alike are looked for first, in every orientation that the object cannot tell apart
(retrieval). The best of them are then moved down the difference of the contact maps, closed, varied, and moved and
closed again (generation). Candidates are tried in physics in the order of their likeness, as many as it takes. With
`TransferConfig.robust` one that slips easily is chosen as if it were less alike. The answer is listed by likeness.

The number: `similarity` is 1 - d / scale, d the mean absolute difference of two contact maps over the object's contact
points (weighted, for drawn contacts), and scale the largest d from the query to a known grasp or between two known
grasps, weighted alike: 1 for equal maps, 0 for the farthest there are. It is the published measure of retrieval
(Khargonkar et al. 2022, Sec. 5: a matrix of distances divided by its largest), for one query.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.apply.transfer_config import Constraint, Method, TransferConfig
from neuralgrasps.apply.transfer_kernels import Sturdy, weakness
from neuralgrasps.apply.transfer_order import Candidate, Order
from neuralgrasps.apply.transfer_pair import known_maps, target_of, transfer_pair, widest
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.apply.transfer_reasons import why_here, why_short, why_unlike
from neuralgrasps.apply.transfer_search import Ranked, SearchConfig, rank_known, search
from neuralgrasps.apply.transfer_verdicts import verdict_of
from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate, empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.grasp_cache import pair_fingerprint, remembered
from neuralgrasps.seeds import child_rng
from neuralgrasps.sim.validate import check_pair, not_let_fall
from neuralgrasps.synthesis.support import Support
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

__all__ = [
    "Constraint", "Method", "SearchConfig", "TransferConfig", "TransferResult", "made_grasps", "transfer",
]  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferResult:
    """Grasps of one hand that touch an object like the query, chosen by `similarity` less `weak`, listed by similarity.

    Attributes:
        grasps: N of them, each held by the protocol; `grasps.verdicts` has the trial.
        similarity: (N,) see the module; map_difference: (N,) the mean absolute difference it is of.
        weak: (N,) similarity that each counts as less alike by for slipping easily, 0 unless `TransferConfig.robust`.
        origin: N times "retrieved" or "generated". source: (N,) place in the known set that each is or comes from, -1:
            the query's palm.
        reasons: why each is there, in words.
        oracle: similarity of the known grasp most alike, turned by the object's symmetry; oracle_plain: without; nan
            where none is known. scale: difference that has similarity 0.
        tried: grasps tried in physics.
        reason: in sentences, why there are fewer than wanted, or none, or why they touch otherwise than asked; "" when
            all is well.
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
    weak: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __repr__(self) -> str:
        best = f", similarity {self.similarity[0]:.2f}" if len(self.grasps) else ""
        return f"TransferResult({len(self.grasps)} grasps by {self.grasps.hand} on {self.grasps.object}{best})"


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

    The result depends on the arguments only. What is kept of a pair between calls serves one thread at a time.

    Args:
        query: see `transfer_query`.
        hand: any hand, `obj`: the query's object; neither need be of a training.
        known: grasps of the hand on the object; those that every protocol tried lets fall are left out; verdicts
            of other masses, frictions or protocols do not count. None: some are made on the spot, once, and kept.
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
    return _Transfer(query, hand, obj, known, config, (support, constraints), seed).run()


def made_grasps(
    hand: Hand, obj: ObjectModel, config: TransferConfig, *, support: Support | None, seed: int
) -> GraspSet:
    """Grasps synthesised on the spot, or kept from the last time; `config["shortfall"]` says why they are few."""
    settings = SynthesisConfig(count=config.synthesise, max_rounds=6)

    def make() -> GraspSet:
        made = synthesise(hand, obj, config=settings, seed=seed, support=support)
        return made.grasps.with_config(shortfall=made.reason)

    return remembered(("transfer", pair_fingerprint(hand, obj), settings, seed, support), make)


class _Transfer:
    """One transfer: what it reads, and its steps."""

    def __init__(
        self,
        query: TransferQuery,
        hand: Hand,
        obj: ObjectModel,
        known: GraspSet,
        config: TransferConfig,
        rules: Sequence[Constraint | Support | None],
        seed: int,
    ) -> None:
        self.query, self.hand, self.obj, self.config, self.seed = query, hand, obj, config, seed
        self.rules = [rule for rule in rules if rule is not None]
        self.pair = transfer_pair(hand, obj, config.protocol)
        self.grasps = not_let_fall(hand, obj, known)
        self.known = known_maps(self.pair, self.grasps, query.radius_m)
        self.full, self.sparse = target_of(query), target_of(query, self.pair.sparse)
        usual = float(np.median(self.grasps.epsilon)) if len(self.grasps) else 0.0
        least = max(config.search.least_epsilon, config.sturdy * usual)
        margin = float(np.median(self.known.margins)) if len(self.grasps) else 0.0
        self.scale = self._scale()
        judged = margin > 0.0 and config.method != "retrieve"
        give = config.robust * self.scale if judged else 0.0
        self.sturdy = Sturdy(self.pair.slippery, max(margin, 1e-6), give, least)
        self.order = Order(self.pair, self.full, config, self._allows, sturdy=self.sturdy, seed=seed)

    def run(self) -> TransferResult:
        config = self.config
        wanted = config.search.starts
        if config.method != "generate":  # some will be too near to others, or fall
            wanted = max(wanted, config.trials, 2 * config.count)
        turn = config.use_symmetry and len(self.pair.turned) > 1
        ranked = self._ranked(wanted, turn=turn)
        plain = self._ranked(1, turn=False) if turn else ranked
        if config.method != "generate":
            self._add_known(ranked)
        if config.method != "retrieve":
            self._add_generated(ranked)
        return self._result(self.order.best(config.count), self.scale, ranked, plain)

    def _allows(self, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None) -> np.ndarray:
        fine = np.ones(len(q), bool)
        for rule in self.rules:
            fine[fine] = rule.allows(
                self.hand, X_OH[fine], q[fine], None if q_pregrasp is None else q_pregrasp[fine]
            )  # fmt: skip
        return fine

    def _scale(self) -> float:
        """The difference that has similarity 0."""
        if self.config.scale is not None:
            return self.config.scale
        if not len(self.grasps):
            return 1.0
        weight = self.query.weight / self.query.weight.sum()
        own = np.abs(self.known.maps - self.query.contact_map) @ weight
        even = float(np.ptp(weight)) == 0.0
        return max(self.known.widest if even else widest(self.known.maps, weight), float(own.max()), 1e-6)

    def _ranked(self, count: int, *, turn: bool, free: bool = False) -> Ranked:
        """Known grasps most like the query; `free`: whether they are allowed does not matter."""
        grasps = self.grasps

        def allows(X_OH: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return np.ones(len(rows), bool) if free else self._allows(X_OH, grasps.q[rows], grasps.q_pregrasp[rows])

        return rank_known(self.pair, self.query, self.full, self.known, count=count, turn=turn, allows=allows)

    def _add_known(self, ranked: Ranked) -> None:
        """Those that stay as they are need no trial where they have had the same; turned ones are closed and tried."""
        protocol = self.config.protocol
        verdicts = verdict_of(self.hand, self.obj, self.grasps, protocol)
        known = replace(self.grasps, verdicts=verdicts, protocol=protocol, config={})
        for i, row in enumerate(ranked.row):
            weak = float(weakness(self.sturdy, self.known.margins[row]))
            item = Candidate(
                "retrieved", int(row), int(ranked.symmetry[i]), ranked.X_OH[i], ranked.q[i],
                float(ranked.difference[i]), weak,
            )  # fmt: skip
            if item.symmetry == 0:
                item.grasp = known[int(row)]
                item.proven = bool(item.grasp.validated[0])
            self.order.add(item)

    def _add_generated(self, ranked: Ranked) -> None:
        rows, turns, X_OH, q = self._starts(ranked)
        if len(q) == 0:
            return
        rng = child_rng(self.seed, "transfer", self.hand.name, self.obj.content_hash)
        keep = 4 if self.config.count == 1 else max(4 * self.config.count, 20)  # some will be too near to others
        found = search(
            self.pair, self.sparse, X_OH, q, config=self.config.search, sturdy=self.sturdy,
            allows=self._allows if self.rules else None, keep=keep, rng=rng,
        )  # fmt: skip
        for i in range(min(len(found), keep * 4)):
            start = int(found.origin[i])
            self.order.add(
                Candidate(
                    "generated", int(rows[start]), int(turns[start]), found.X_OH[i], found.q[i],
                    float(found.difference[i]), float(found.weak[i]),
                )
            )  # fmt: skip

    def _starts(self, ranked: Ranked) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where the search begins: known grasps (allowed ones first), and the palm where the query's is."""
        count = self.config.search.starts
        chosen = ranked.take(np.arange(min(count, len(ranked.row))))
        rows, turns, X_OH, q = chosen.row, chosen.symmetry, chosen.X_OH, chosen.q
        if len(rows) < count and self.rules:
            more = self._ranked(count - len(rows), turn=self.config.use_symmetry, free=True)
            rows, turns = np.append(rows, more.row), np.append(turns, more.symmetry)
            X_OH, q = np.concatenate([X_OH, more.X_OH]), np.concatenate([q, more.q])
        if self.query.X_OP is not None:
            palm = self.query.X_OP @ np.linalg.inv(self.hand.X_HP)
            X_OH = np.concatenate([X_OH, palm[None]])
            q = np.concatenate([q, q[:1] if len(q) else self.hand.q_open[None]])
            rows, turns = np.append(rows, -1), np.append(turns, 0)
        return rows, turns, X_OH, q

    def _result(self, chosen: list[Candidate], scale: float, ranked: Ranked, plain: Ranked) -> TransferResult:
        none = empty_grasps(self.hand.name, self.obj.name, num_joints=self.hand.num_dofs, seed=self.seed)
        difference = np.array([c.difference for c in chosen], np.float64)
        similarity = 1.0 - difference / scale
        oracle, oracle_plain = (
            float(1.0 - r.difference[0] / scale) if len(r.row) else float("nan") for r in (ranked, plain)
        )
        nearest = min(self.order.failed, key=lambda c: c.difference) if self.order.failed and not chosen else None
        return TransferResult(
            grasps=concatenate([c.grasp for c in chosen if c.grasp is not None]) if chosen else none,
            similarity=similarity,
            map_difference=difference,
            origin=tuple(c.origin for c in chosen),
            source=np.array([c.source for c in chosen], np.int64),
            reasons=tuple(
                why_here(int((similarity > s).sum()), c, s, oracle, self.config.protocol)
                for c, s in zip(chosen, similarity, strict=True)
            ),
            oracle=oracle,
            oracle_plain=oracle_plain,
            scale=scale,
            tried=self.order.tried,
            reason=self._reason(chosen, similarity, ranked),
            nearest=none if nearest is None or nearest.grasp is None else nearest.grasp,
            nearest_similarity=float("nan") if nearest is None else 1.0 - nearest.difference / scale,
            weak=np.array([c.weak for c in chosen], np.float64) / scale,
        )

    def _reason(self, chosen: list[Candidate], similarity: np.ndarray, ranked: Ranked) -> str:
        """Why the answer is not all that was asked for, in sentences."""
        config, said = self.config, []
        if not chosen or similarity.max() < config.alike:
            said.append(why_unlike(self.query, self.pair.problem, float(similarity.max()) if chosen else None))
        if len(chosen) < config.count:
            short = why_short(
                config, found=len(chosen), tried=self.order.tried, known=self.grasps, allowed=len(ranked.row),
                ruled=bool(self.rules),
            )  # fmt: skip
            said.append(short)
        return " ".join(f"{text[0].upper()}{text[1:]}." for text in said)
