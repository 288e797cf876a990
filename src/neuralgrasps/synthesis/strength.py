"""Grasps that lift heavy things off a table: how strong closed hands are, and a local search for strong ones.

Epsilon, by which grasps are refined elsewhere, knows neither the weight nor the motors: of the grasps of a full bottle
that it chooses for a hand with motors of 0.7 N m, one in a hundred lifts it.
"""

from __future__ import annotations

import numpy as np

from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.grasps.lift_capacity import joints_of, lift_grip, lift_weights
from neuralgrasps.grasps.wrench_space import characteristic_length
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
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
_MOST_GENERATIONS, _CHILDREN = 40, 6
_MOSTLY = 0.75  # share of the grasps that lift the object: then the search ends
_SELECT_EVERY = 4  # generations after which the weaker half makes room for copies of the stronger one
_COPIES = 3  # grasps returned, at most, per candidate to begin with
_CROWD = 1.5  # grasps that are searched from, per grasp wanted
_SHRINK, _LEAST_SCALE = 0.95, 0.15  # of the perturbations
_SHARES = tuple(round(1.0 - 0.1 * k, 1) for k in range(9))  # of friction, tried for the squeeze
_SQUEEZE_WEIGHTS = 1.2  # weights that a squeeze is made for


def lift_strengths(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray, *, threads: int = 1) -> np.ndarray:
    """(N,) how many times its object's weight each closed hand can lift off the support, at most `ENOUGH`.

    Args:
        problem: with a support, which says where up is. X_OH: (N, 4, 4); q: (N, J) closed.
    """
    assert problem.support is not None
    hand, obj, up, out = problem.hand, problem.obj, problem.support.plane.normal, np.zeros(len(q))

    def run(rows: slice) -> None:
        X_HL = forward_fast(hand.tree, q[rows])
        contacts = contacts_of(problem, X_OH[rows], X_HL)
        out[rows] = _strengths(hand, obj, X_OH[rows], X_HL, contacts, up, problem.length)

    thread_map(run, blocks(len(q), threads), threads=threads)
    return out


def grasp_strengths(hand: Hand, obj: ObjectModel, grasps: GraspSet, up_O: np.ndarray) -> np.ndarray:
    """(N,) the same of finished grasps, by their own contacts; up_O: (3,) unit, against gravity.

    Those without contacts were not measured, and count as strong.
    """
    length = characteristic_length(obj.points_O, obj.com_O)
    contacts = (grasps.contact_points_O, grasps.contact_normals_O, grasps.contact_links)
    strengths = _strengths(hand, obj, grasps.X_OH, forward_fast(hand.tree, grasps.q), contacts, up_O, length)
    return np.where(grasps.num_contacts > 0, strengths, ENOUGH)


def _strengths(
    hand: Hand,
    obj: ObjectModel,
    X_OH: np.ndarray,
    X_HL: np.ndarray,
    contacts: tuple[np.ndarray, np.ndarray, np.ndarray],
    up_O: np.ndarray,
    length: float,
) -> np.ndarray:
    sliding, torsional, _ = contact_friction(obj, PROTOCOLS["shake"])
    weight, out = obj.mass_kg * GRAVITY, np.zeros(len(X_OH))
    points, normals, links = (np.array(a) for a in contacts)  # of a set they are read-only, another type to compile for
    lift_weights(
        joints_of(hand.tree), X_HL, np.array(X_OH), points, normals, links, obj.com_O, np.array(up_O), ENOUGH * weight,
        hand.tree.effort, FRICTION_SHARE * sliding, FRICTION_SHARE * torsional, length, out,
    )  # fmt: skip
    return out / weight


def few_lift(strengths: np.ndarray) -> bool:
    """Whether so few of some grasps, by their strengths (N,), lift the object that it is heavy for the hand."""
    return len(strengths) > 0 and bool((strengths >= 1.0).mean() < LIGHT_SHARE)


def is_heavy(problem: GraspProblem, valid: Candidates) -> bool:
    """Whether there is a support, and few of these grasps can lift the object off it."""
    if problem.support is None:
        return False
    some = valid.take(np.arange(min(len(valid), _LOOKED_AT)))
    return few_lift(lift_strengths(problem, some.X_OH, some.q))


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
        valid: candidates to begin with, at least one. niches: grasps wanted; fewer come back from very few candidates.
    """
    size = round(_CROWD * niches)
    strength = lift_strengths(problem, valid.X_OH, valid.q, threads=threads)
    best, strength = strongest_diverse(problem, valid, strength, size)
    for generation in range(_MOST_GENERATIONS):
        if generation % _SELECT_EVERY == 0 and generation > 0:
            if (strength >= 1.0).mean() >= _MOSTLY:
                break
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
    best, strength = strongest_diverse(problem, best, strength, min(niches, _COPIES * len(valid)))
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
    obj, up, joints = problem.obj, np.array(problem.support.plane.normal), joints_of(problem.hand.tree)
    sliding, torsional, _ = contact_friction(obj, PROTOCOLS["shake"])
    most, chosen = _SQUEEZE_WEIGHTS * obj.mass_kg * GRAVITY, None
    for share in _SHARES:
        grip = lift_grip(
            joints, X_HL, X_OH, points, normals, links, obj.com_O, up, most, problem.hand.tree.effort,
            share * sliding, share * torsional, problem.length,
        )  # fmt: skip
        if chosen is not None and grip.weight < 0.999 * most:
            break
        chosen = grip.torques
    assert chosen is not None
    return np.asarray(chosen)
