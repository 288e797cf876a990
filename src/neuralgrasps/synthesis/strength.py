"""Grasps that lift heavy things off a table: how strong closed hands are, and a local search for strong ones.

Epsilon, by which grasps are refined elsewhere, knows neither the weight nor the motors: of the grasps of a full bottle
that it chooses for a hand with motors of 0.7 N m, one in a hundred lifts it.
"""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.lift_capacity import lift_grip
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.parallel import blocks, thread_map
from neuralgrasps.sim.build import contact_friction
from neuralgrasps.sim.protocols import PROTOCOLS
from neuralgrasps.synthesis.candidates import VALID, Candidates, GraspProblem
from neuralgrasps.synthesis.contacts import contacts_of
from neuralgrasps.synthesis.refine import assess_all, perturb
from neuralgrasps.synthesis.select import diverse_order

GRAVITY = 9.81
FRICTION_SHARE = 0.6  # of the object's friction, with which strength is measured: the rest is for what is not known
ENOUGH = 1.5  # weights of the object that a hand should lift with that; stronger is not better
LIGHT_SHARE = 0.4  # of a hand's grasps that lift an object: then it is light, and needs no search for strength
_LOOKED_AT = 128  # grasps that decide about that
_GENERATIONS, _CHILDREN = 18, 6
_SELECT_EVERY = 3  # generations after which the weaker half makes room for copies of the stronger one
_CROWD = 1.5  # grasps that are searched from, per grasp wanted
_SHRINK, _LEAST_SCALE = 0.9, 0.25  # of the perturbations
_SHARES = tuple(round(1.0 - 0.1 * k, 1) for k in range(9))  # of friction, tried for the squeeze
_SQUEEZE_WEIGHTS = 1.2  # weights that a squeeze is made for


@njit(cache=True, error_model="numpy", nogil=True)
def _lift_all(  # type: ignore[no-untyped-def]
    packed, X_HL, X_OH, points, normals, links, com, up, most, friction, torsion, length, out
):
    for i in range(X_OH.shape[0]):
        count = 0
        while count < links.shape[1] and links[i, count] >= 0:
            count += 1
        out[i] = 0.0
        if count > 0:
            out[i] = lift_grip(
                packed, X_HL[i], X_OH[i], points[i, :count], normals[i, :count], links[i, :count], com, up, most,
                packed.effort, friction, torsion, length,
            ).weight  # fmt: skip


def lift_strengths(
    problem: GraspProblem,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    friction_share: float = FRICTION_SHARE,
    threads: int = 1,
) -> np.ndarray:
    """(N,) how many times its object's weight each closed hand can lift off the support, at most `ENOUGH`.

    Args:
        problem: with a support, which says where up is. X_OH: (N, 4, 4); q: (N, J) closed.
        friction_share: of the object's own friction that may be used.
    """
    assert problem.support is not None
    obj, up = problem.obj, np.ascontiguousarray(problem.support.plane.normal)
    sliding, torsional, _ = contact_friction(obj, PROTOCOLS["shake"])
    weight, out = obj.mass_kg * GRAVITY, np.zeros(len(q))

    def run(rows: slice) -> None:
        X_HL = forward_fast(problem.hand.tree, q[rows])
        _lift_all(
            problem.packed, X_HL, np.ascontiguousarray(X_OH[rows]), *contacts_of(problem, X_OH[rows], X_HL), obj.com_O,
            up, ENOUGH * weight, friction_share * sliding, friction_share * torsional, problem.length, out[rows],
        )  # fmt: skip

    thread_map(run, blocks(len(q), threads), threads=threads)
    return out / weight


def is_heavy(problem: GraspProblem, valid: Candidates) -> bool:
    """Whether there is a support, and few of these grasps can lift the object off it."""
    if problem.support is None or len(valid) == 0:
        return False
    some = valid.take(np.arange(min(len(valid), _LOOKED_AT)))
    return bool((lift_strengths(problem, some.X_OH, some.q) >= 1.0).mean() < LIGHT_SHARE)


def strongest_diverse(
    problem: GraspProblem, candidates: Candidates, strength: np.ndarray, count: int
) -> tuple[Candidates, np.ndarray]:
    """Up to `count` candidates, strong and unlike each other, and their strengths (count,)."""
    order = diverse_order(
        problem.hand, candidates.X_OH, candidates.q, start=int(strength.argmax()), count=count,
        quality=(strength + 0.01) ** 4,
    )  # fmt: skip
    return candidates.take(order), strength[order]


def strengthen(
    problem: GraspProblem,
    valid: Candidates,
    *,
    niches: int,
    rng: np.random.Generator,
    threads: int = 1,
) -> Candidates:
    """Strong and diverse grasps by local search: perturb, close again, keep the stronger; the strongest first.

    Args:
        valid: candidates to begin with, at least one. niches: grasps that are improved, and returned.
    """
    size = round(_CROWD * niches)
    strength = lift_strengths(problem, valid.X_OH, valid.q, threads=threads)
    best, strength = strongest_diverse(problem, valid, strength, size)
    for generation in range(_GENERATIONS):
        if generation % _SELECT_EVERY == 0 and generation > 0:
            half, reached = strongest_diverse(problem, best, strength, min(len(best), (size + 1) // 2))
            again = np.arange(size) % len(half)
            best, strength = half.take(again), reached[again]
        scale = max(_SHRINK**generation, _LEAST_SCALE)
        X_OH, q = perturb(problem.hand, best, scale=scale, children=_CHILDREN, rng=rng)
        tried = assess_all(problem, X_OH, q, threads=threads)
        found, good = np.zeros(len(q)), np.flatnonzero(tried.outcome == VALID)
        found[good] = lift_strengths(problem, tried.X_OH[good], tried.q[good], threads=threads)
        winner = found.reshape(len(best), _CHILDREN).argmax(axis=1) + np.arange(len(best)) * _CHILDREN
        better = found[winner] > strength
        index = np.where(better, len(best) + winner, np.arange(len(best)))
        best, strength = Candidates.join([best, tried]).take(index), np.maximum(strength, found[winner])
    best, strength = strongest_diverse(problem, best, strength, niches)
    return best.take(np.argsort(-strength, kind="stable"))


def lift_torques(
    problem: GraspProblem,
    X_OH: np.ndarray,
    X_HL: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    links: np.ndarray,
) -> np.ndarray:
    """(J,) joint torques, N m or N, that lift the object off the support with as little friction as it takes.

    Where even all its friction is not enough, those that lift the most.

    Args:
        X_OH: (4, 4); X_HL: (L, 4, 4); points, normals (C, 3), links (C,): contacts in O, without padding; C >= 1.
    """
    assert problem.support is not None
    obj, up = problem.obj, np.ascontiguousarray(problem.support.plane.normal)
    sliding, torsional, _ = contact_friction(obj, PROTOCOLS["shake"])
    most, chosen = _SQUEEZE_WEIGHTS * obj.mass_kg * GRAVITY, None
    for share in _SHARES:
        grip = lift_grip(
            problem.packed, X_HL, X_OH, points, normals, links, obj.com_O, up, most, problem.packed.effort,
            share * sliding, share * torsional, problem.length,
        )  # fmt: skip
        if chosen is not None and grip.weight < 0.999 * most:
            break
        chosen = grip.torques
    assert chosen is not None
    return np.asarray(chosen)
