"""Candidates of a transfer by difference and weakness, each finished and tried only when its turn comes."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.apply.transfer_config import TransferConfig
from neuralgrasps.apply.transfer_kernels import Sturdy, Target, map_differences, margins, weakness
from neuralgrasps.apply.transfer_pair import TransferPair
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.sim.grasp_trial import silent_engine
from neuralgrasps.sim.validate import verdict_parameters
from neuralgrasps.synthesis.candidates import VALID, Candidates
from neuralgrasps.synthesis.finish import finish_grasps
from neuralgrasps.synthesis.select import grasp_features
from neuralgrasps.synthesis.settle import settle

_ROUGH = 0.97  # differences at some points only, before settling, are about so sure: finish before ruling out
_FOR_OTHERS = 0.75  # of the trials may go to sources that have given little; the rest is for the most alike
_SAME_M = 0.004  # grasps that differ by less are one
AllowsGrasps = Callable[[np.ndarray, np.ndarray, np.ndarray | None], np.ndarray]


@dataclass(slots=True)
class Candidate:
    """A closed hand on its way to be a proven grasp.

    Attributes:
        origin: "retrieved" or "generated". source: place in the known set, -1: the query's palm. symmetry: by which
            rotation of the object it was turned, 0: none.
        X_OH: (4, 4); q: (J,) closed. difference: of its contact map from the query's. weak: what it counts as that it
            holds worse than usual, in the same unit; of the closed hand until there is a grasp, then of that.
        settled: difference is that of the settled hand; X_OH and q stay those before it, from which the grasp is
            finished. grasp: once it is finished. proven: it held.
    """

    origin: str
    source: int
    symmetry: int
    X_OH: np.ndarray
    q: np.ndarray
    difference: float
    weak: float = 0.0
    settled: bool = False
    grasp: GraspSet | None = None
    proven: bool = False


class Order:
    """A queue of candidates, those first whose difference and weakness are least together.

    Attributes:
        sturdy: what counts as weak, and the least epsilon of grasps that are new. tried: trials so far.
        failed: candidates that did not hold, in the order of their trials.
    """

    def __init__(
        self,
        pair: TransferPair,
        target: Target,
        config: TransferConfig,
        allows: AllowsGrasps,
        *,
        sturdy: Sturdy,
        seed: int,
    ) -> None:
        self.sturdy = sturdy
        self._pair, self._target, self._config, self._allows, self._seed = pair, target, config, allows, seed
        self._queue: list[tuple[float, int]] = []
        self._items: list[Candidate] = []
        self._taken: list[np.ndarray] = []
        self.tried = 0
        self.failed: list[Candidate] = []

    def add(self, candidate: Candidate) -> None:
        """Queue a candidate."""
        self._items.append(candidate)
        self._queue_again(len(self._items) - 1)

    def _queue_again(self, index: int) -> None:
        item = self._items[index]
        rough = 1.0 if item.grasp is not None or item.settled else _ROUGH
        heapq.heappush(self._queue, (rough * item.difference + item.weak, index))

    def best(self, count: int) -> list[Candidate]:
        """Up to `count` that hold, apart from each other, and few from one source.

        They are chosen by difference and weakness together, and listed by difference: the most alike first.

        What is nearer to others than wanted, or of a source that has given enough, fills up the answer when there is
        nothing else, or most trials are used up; twice as many from a source then, and half as far apart.
        """
        chosen: list[Candidate] = []
        spare: list[tuple[float, int]] = []
        given, config = Counter[int](), self._config
        most, apart_m = config.per_source or count, config.apart_m
        least_m, reserve = min(apart_m, _SAME_M), _FOR_OTHERS * config.trials
        while len(chosen) < count and (self._queue or spare):
            if not self._queue or self.tried >= reserve:
                self._queue, spare = sorted(self._queue + spare), []
                most, apart_m = 2 * most, max(apart_m / 2, least_m)
                reserve = np.inf
            key, index = heapq.heappop(self._queue)
            item = self._items[index]
            apart = self._apart(item)
            if given[item.source] >= most or least_m <= apart < apart_m:
                spare.append((key, index))
                continue
            if apart < least_m:
                continue
            if item.grasp is None:  # it keeps its place only if its finished self is as near
                if self._finish(item) if item.settled else self._settle(item):
                    self._queue_again(index)
            elif item.proven or self._prove(item):
                chosen.append(item)
                given[item.source] += 1
                self._taken.append(self._features(item))
        return sorted(chosen, key=lambda item: item.difference)

    def _features(self, item: Candidate) -> np.ndarray:
        X_OH, q = (item.X_OH[None], item.q[None]) if item.grasp is None else (item.grasp.X_OH, item.grasp.q)
        return grasp_features(self._pair.problem.hand, X_OH, q)[0]

    def _apart(self, item: Candidate) -> float:
        """How far it is from the nearest that was chosen, metres of `grasp_features`."""
        own = self._features(item)
        return min((float(np.linalg.norm(own - other)) for other in self._taken), default=np.inf)

    def _settle(self, item: Candidate) -> bool:
        """Settle a closed hand and compare its exact contact map; False where it overlaps too deeply."""
        problem = self._pair.problem
        settled, _ = settle(problem, _closed(item))
        if settled.penetration_m[0] > problem.max_penetration_m:
            return False
        item.difference = float(map_differences(problem.packed, self._target, settled.X_OH, settled.q)[0])
        item.settled = True
        return True

    def _finish(self, item: Candidate) -> bool:
        """Make a grasp of a closed hand that settles; False where it is none after all."""
        config = self._config
        grasp = finish_grasps(self._pair.problem, _closed(item), protocol=config.protocol, seed=self._seed, config={})
        least = self.sturdy.least_epsilon if item.origin == "generated" else 0.0
        if len(grasp) == 0 or float(grasp.epsilon[0]) < least:
            return False
        if not self._allows(grasp.X_OH, grasp.q, grasp.q_pregrasp)[0]:
            return False
        item.grasp = grasp
        if self.sturdy.give > 0.0:
            contacts = grasp.contact_points_O, grasp.contact_normals_O, grasp.contact_links
            item.weak = float(weakness(self.sturdy, margins(self.sturdy.cone, *contacts)[0]))
        return True

    def _prove(self, item: Candidate) -> bool:
        """Whether a finished grasp holds in physics; False, untried, when there were enough trials."""
        grasp, problem, protocol = item.grasp, self._pair.problem, self._config.protocol
        if grasp is None or self.tried >= self._config.trials:
            return False
        self.tried += 1
        with silent_engine():
            outcome = self._pair.trial.run(grasp.X_OH[0], grasp.q_pregrasp[0], grasp.q[0], grasp.q_squeeze[0])
        verdict = Verdict(
            success=np.array([outcome.success]),
            displacement_m=np.array([outcome.displacement_m]),
            rotation_rad=np.array([outcome.rotation_rad]),
            parameters=verdict_parameters(problem.hand, problem.obj, protocol),
        )
        item.grasp, item.proven = replace(grasp.with_verdict(protocol, verdict), config={}), outcome.success
        if not outcome.success:
            self.failed.append(item)
        return outcome.success


def _closed(item: Candidate) -> Candidates:
    X_OH, q = item.X_OH[None], item.q[None]
    return Candidates(
        X_OH=X_OH, q=q, q_start=q, epsilon=np.zeros(1), penetration_m=np.zeros(1), outcome=np.full(1, VALID, np.int8)
    )
