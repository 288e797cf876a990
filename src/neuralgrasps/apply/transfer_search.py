"""Search around known grasps for hands that touch an object as asked: perturb, close again, keep the most alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from neuralgrasps.apply.transfer_descent import descend, map_problem
from neuralgrasps.apply.transfer_kernels import Sturdy, Target, map_differences, search_starts
from neuralgrasps.apply.transfer_pair import KnownMaps, TransferPair
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.synthesis.candidates import VALID

Allows = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (N,) bool of X_OH (N, 4, 4) and what else is named
_CHUNK = 64  # known grasps, by rank, that are asked at once whether they are allowed


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchConfig:
    """How far and how long to search.

    Attributes:
        starts: known grasps that the search begins at; each is moved in `steps` steps down the difference of the maps,
            then closed.
        generations: rounds of varying the best `seeds` hands so far, `children` times each; variations are moved in
            `child_steps` steps, and the `closed` nearest of them closed (more where more are wanted; all where there
            are rules).
        shift_m, turn_rad, curl: standard deviations of variations in the first round, curl in shares of the joints'
            ranges; each round's are `shrink` times the last one's.
        least_epsilon: closed hands below this quality are dropped.
    """

    starts: int = 8
    steps: int = 12
    generations: int = 2
    seeds: int = 2
    children: int = 8
    child_steps: int = 6
    closed: int = 8
    shift_m: float = 0.012
    turn_rad: float = 0.2
    curl: float = 0.04
    shrink: float = 0.6
    least_epsilon: float = 0.02

    def __post_init__(self) -> None:
        for name in ("starts", "steps", "seeds", "children", "closed"):
            if getattr(self, name) < 1:
                raise InputError(f"transfer search: {name} is {getattr(self, name)}; expected at least 1.")
        for name in ("generations", "child_steps", "shift_m", "turn_rad", "curl", "shrink", "least_epsilon"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"transfer search: {name} is {getattr(self, name)}; expected 0 or more.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ranked:
    """Known grasps in the orientations that the object cannot tell apart, those that touch as asked first.

    Attributes:
        row: (K,) place in the known set; symmetry: (K,) which rotation; X_OH: (K, 4, 4) moved by it; q: (K, J).
        difference: (K,) weighted mean |difference| of the contact maps, exact, at all points.
    """

    row: np.ndarray
    symmetry: np.ndarray
    X_OH: np.ndarray
    q: np.ndarray
    difference: np.ndarray

    def take(self, index: np.ndarray) -> Ranked:
        """Those at `index`."""
        return Ranked(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """Closed hands, those first whose difference and weakness are least together.

    Attributes:
        X_OH: (N, 4, 4); q: (N, J). difference: (N,) of contact maps at the sparse points; weak: (N,) what it counts as
            that they hold worse than usual, see `transfer_kernels.weakness`. origin: (N,) start that each comes from.
    """

    X_OH: np.ndarray
    q: np.ndarray
    difference: np.ndarray
    weak: np.ndarray
    origin: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def take(self, index: np.ndarray) -> Found:
        """Those at `index`."""
        return Found(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def _in_order(parts: list[Found]) -> Found:
    """All of them, the best first."""
    found = Found(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Found)})
    return found.take(np.argsort(found.difference + found.weak, kind="stable"))


def rank_known(
    pair: TransferPair,
    query: TransferQuery,
    target: Target,
    known: KnownMaps,
    *,
    count: int,
    turn: bool,
    allows: Allows,
) -> Ranked:
    """The `count` known grasps most like the query that are allowed, each in its best orientation only.

    Maps at some points by table decide which come near; the exact maps of the turned hands decide the order.

    Args:
        turn: use the object's symmetry. allows: (N,) bool of X_OH (N, 4, 4) and rows (N,) of the known set.
    """
    versions = len(pair.turned) if turn else 1
    asked = query.contact_map[pair.turned[:versions]].astype(np.float32)
    weight = query.weight[pair.turned[:versions]]
    weight = (weight / weight.mean(axis=1, keepdims=True)).astype(np.float32)
    have = known.maps[:, pair.sparse]
    rough = np.stack([(np.abs(have - a) * w).mean(axis=1) for a, w in zip(asked, weight, strict=True)])  # (S, N)
    rotations = pair.problem.obj.symmetry.rotations
    order = np.argsort(rough, axis=None, kind="stable")
    taken: dict[int, int] = {}  # row: symmetry
    for first in range(0, len(order), _CHUNK):
        if len(taken) >= count:
            break
        turns, rows = np.unravel_index(order[first : first + _CHUNK], rough.shape)
        fine = allows(rotations[turns] @ known.grasps.X_OH[rows], rows)
        for row, symmetry in zip(rows[fine], turns[fine], strict=True):
            if len(taken) < count:
                taken.setdefault(int(row), int(symmetry))
    row, symmetry = np.array(list(taken), np.int64), np.array(list(taken.values()), np.int64)
    X_OH = np.ascontiguousarray(rotations[symmetry] @ known.grasps.X_OH[row])
    q = np.ascontiguousarray(known.grasps.q[row])
    exact = map_differences(pair.problem.packed, target, X_OH, q)
    order = np.argsort(exact, kind="stable")
    return Ranked(row=row, symmetry=symmetry, X_OH=X_OH, q=q, difference=exact).take(order)


def search(
    pair: TransferPair,
    sparse: Target,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    config: SearchConfig,
    sturdy: Sturdy,
    allows: Allows | None,
    keep: int,
    rng: np.random.Generator,
) -> Found:
    """Closed hands in force closure, found from the starts X_OH (N, 4, 4), q (N, J), N >= 1; the best first.

    Args:
        sturdy: what counts as weak. allows: (N,) bool of closed hands X_OH, q; None: all are.
        keep: how many of the best are worth having, about. rng: the result depends on its state.
    """
    hand, probes = pair.problem.hand, pair.probes
    problem = map_problem(hand, pair.problem.obj, sparse)
    X_near, q_near, cost = np.ascontiguousarray(X_OH).copy(), np.ascontiguousarray(q).copy(), np.empty(len(q))
    descend(probes, problem, X_near, q_near, config.steps, cost)
    order = np.argsort(cost, kind="stable")
    X_all, q_all, origin = np.concatenate([X_near[order], X_OH]), np.concatenate([q_near[order], q]), np.arange(len(q))
    pool = _closed(pair, sparse, X_all, q_all, np.append(order, origin), np.full(keep, np.inf), sturdy, allows)
    if len(pool) == 0:
        near = Found(X_OH=X_near, q=q_near, difference=cost, weak=np.zeros(len(q)), origin=origin).take(order)
    for generation in range(config.generations):
        best = (pool if len(pool) else near).take(np.arange(min(config.seeds, len(pool) or len(near))))
        X, joints = _varied(hand, best.X_OH, best.q, config, config.shrink**generation, rng)
        X, joints, cost = np.ascontiguousarray(X), np.ascontiguousarray(joints), np.empty(len(joints))
        descend(probes, problem, X, joints, config.child_steps, cost)
        most = max(config.closed, keep) if allows is None else len(cost)
        order = np.argsort(cost, kind="stable")[:most]
        nearest = np.full(keep, np.inf)
        nearest[: len(pool)] = (pool.difference + pool.weak)[:keep]
        parents = np.repeat(best.origin, config.children)[order]
        pool = _in_order([pool, _closed(pair, sparse, X[order], joints[order], parents, nearest, sturdy, allows)])
    return pool


def _closed(
    pair: TransferPair,
    sparse: Target,
    X_OH: np.ndarray,
    q: np.ndarray,
    origin: np.ndarray,
    nearest: np.ndarray,
    sturdy: Sturdy,
    allows: Allows | None,
) -> Found:
    """Those of the starts that close to an allowed grasp, and may be among the best; `nearest`: see `search_starts`."""
    arrays = pair.searching.arrays
    X, joints, count = np.ascontiguousarray(X_OH).copy(), np.ascontiguousarray(q).copy(), len(q)
    difference, weak, outcome = np.empty(count), np.empty(count), np.empty(count, np.int8)
    search_starts(arrays, sparse, pair.hands, sturdy, nearest, allows is None, X, joints, difference, weak, outcome)
    good = np.flatnonzero(outcome == VALID)
    if len(good) and allows is not None:
        good = good[allows(X[good], joints[good])]
    return _in_order([Found(X_OH=X, q=joints, difference=difference, weak=weak, origin=origin).take(good)])


def _varied(
    hand: Hand, X_OH: np.ndarray, q: np.ndarray, config: SearchConfig, scale: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`children` variations of each hand, turned about its palm; those of one hand are neighbours."""
    count = len(q) * config.children
    turn = rng.standard_normal((count, 3)) * (config.turn_rad * scale)
    shift = rng.standard_normal((count, 3)) * (config.shift_m * scale)
    X = np.repeat(X_OH, config.children, axis=0)
    palm = X @ hand.X_HP[:, 3]
    X[:, :3, :3] = axis_angle_matrix(turn, np.linalg.norm(turn, axis=1)) @ X[:, :3, :3]
    X[:, :3, 3] += palm[:, :3] - (X @ hand.X_HP[:, 3])[:, :3] + shift
    span = hand.tree.upper - hand.tree.lower
    joints = np.repeat(q, config.children, axis=0) + rng.standard_normal((count, q.shape[1])) * (
        config.curl * scale * span
    )
    return X, np.clip(joints, hand.tree.lower, hand.tree.upper)
