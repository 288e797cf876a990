"""Search around known grasps for hands that touch an object as asked: perturb, close again, keep the most alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from neuralgrasps.apply.transfer_descent import descend, map_problem
from neuralgrasps.apply.transfer_kernels import Target, map_differences, search_starts
from neuralgrasps.apply.transfer_pair import KnownMaps, TransferPair
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.synthesis.candidates import VALID

Allows = Callable[[np.ndarray, np.ndarray], np.ndarray]
KEEP = 10  # nearest hands that a search keeps apart from those it varies
_CHUNK = 64  # known grasps, by rank, that are asked at once whether they are allowed


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchConfig:
    """How far and how long to search.

    Attributes:
        seeds: hands that are varied at a time. generations, children: rounds, and variations of each seed in one.
        shift_m, turn_rad, curl: standard deviations of variations in the first round, curl in shares of the joints'
            ranges; each round's are `shrink` times the last one's.
        least_epsilon: closed hands below this quality are dropped.
    """

    starts: int = 6
    steps: int = 12
    seeds: int = 3
    generations: int = 3
    children: int = 20
    shift_m: float = 0.005
    turn_rad: float = 0.08
    curl: float = 0.04
    shrink: float = 0.6
    least_epsilon: float = 0.02


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
    """Closed hands: X_OH (N, 4, 4), q (N, J), difference (N,) at the sparse points, epsilon (N,), origin (N,) the start
    that each descends from."""

    X_OH: np.ndarray
    q: np.ndarray
    difference: np.ndarray
    epsilon: np.ndarray
    origin: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def take(self, index: np.ndarray) -> Found:
        """Those at `index`."""
        return Found(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def join_found(parts: list[Found]) -> Found:
    """All of them, in order."""
    return Found(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Found)})


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
    best = rough.argmin(axis=0) if versions > 1 else np.zeros(rough.shape[1], np.int64)
    rotations = pair.problem.obj.symmetry.rotations
    order = np.argsort(rough, axis=None, kind="stable")
    rows, turns, seen = [], [], set()
    for first in range(0, len(order), _CHUNK):
        if len(rows) >= count:
            break
        turns_here, rows_here = np.unravel_index(order[first : first + _CHUNK], rough.shape)
        fine = allows(rotations[turns_here] @ known.grasps.X_OH[rows_here], rows_here)
        for row, symmetry in zip(rows_here[fine], turns_here[fine], strict=True):
            if row not in seen and len(rows) < count:
                seen.add(row)
                rows.append(row)
                turns.append(symmetry)
    del best
    row, symmetry = np.array(rows, np.int64), np.array(turns, np.int64)
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
    allows: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rng: np.random.Generator,
) -> Found:
    """Closed hands in force closure, found by varying the starts X_OH (N, 4, 4), q (N, J); the most alike first.

    Args:
        allows: (N,) bool of closed hands X_OH, q. rng: the result depends on its state.
    """
    hand, coarse = pair.problem.hand, pair.coarse.packed
    problem = map_problem(hand, pair.problem.obj, coarse, sparse)
    X_near, q_near, cost = np.ascontiguousarray(X_OH).copy(), np.ascontiguousarray(q).copy(), np.empty(len(q))
    descend(coarse, problem, X_near, q_near, config.steps, cost)
    X_all, q_all, own = np.concatenate([X_near, X_OH]), np.concatenate([q_near, q]), np.arange(len(q))
    origin = np.concatenate([own, own])
    pool = _closed(pair, sparse, X_all, q_all, origin, np.inf, config, allows)
    pool = pool.take(np.argsort(pool.difference, kind="stable"))
    for generation in range(config.generations):
        best = pool.take(np.arange(min(config.seeds, len(pool))))
        if len(best) == 0:
            best = Found(X_OH=X_near, q=q_near, difference=cost, epsilon=cost, origin=own).take(
                np.argsort(cost, kind="stable")[: config.seeds]
            )
        X, joints = _varied(hand, best.X_OH, best.q, config, config.shrink**generation, rng)
        limit = np.inf if len(pool) < KEEP else float(pool.difference[KEEP - 1])
        parents = np.repeat(best.origin, config.children)
        pool = join_found([pool, _closed(pair, sparse, X, joints, parents, limit, config, allows)])
        pool = pool.take(np.argsort(pool.difference, kind="stable"))
    return pool


def _closed(
    pair: TransferPair,
    sparse: Target,
    X_OH: np.ndarray,
    q: np.ndarray,
    origin: np.ndarray,
    limit: float,
    config: SearchConfig,
    allows: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Found:
    """Those of the starts that close to an allowed grasp nearer than `limit`."""
    arrays = pair.searching.arrays
    X, joints, count = np.ascontiguousarray(X_OH).copy(), np.ascontiguousarray(q).copy(), len(q)
    difference, epsilon, outcome = np.empty(count), np.empty(count), np.empty(count, np.int8)
    search_starts(arrays, sparse, pair.hands, limit, config.least_epsilon, X, joints, difference, epsilon, outcome)
    good = np.flatnonzero(outcome == VALID)
    if len(good):
        good = good[allows(X[good], joints[good])]
    return Found(X_OH=X, q=joints, difference=difference, epsilon=epsilon, origin=origin).take(good)


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
