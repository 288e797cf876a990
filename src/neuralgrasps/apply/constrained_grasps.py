"""Grasps made for constraints: where few of the known ones meet them, new ones are aimed at what may be touched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.transfer_verdicts import verdict_of
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate
from neuralgrasps.hands.fingerprint import fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.grasp_cache import pair_fingerprint, remembered
from neuralgrasps.sim.validate import not_let_fall
from neuralgrasps.synthesis.support import Support
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

ENOUGH = 10  # known grasps that meet the constraints: with fewer, some are made
_FEWEST_POINTS = 16  # of the object's surface, to aim at
_MADE, _ROUNDS = 60, 3


def with_constrained(
    constraints: GraspConstraints,
    hand: Hand,
    known: GraspSet,
    *,
    protocol: str,
    enough: int = ENOUGH,
    support: Support | None = None,
    seed: int = 0,
) -> GraspSet:
    """The known grasps and, where fewer than `enough` meet the constraints, new ones that do.

    New ones start from the surface that may be touched only; they take seconds once, and are kept.

    Args:
        known: grasps of the hand on the constraints' object. protocol: physics trial that the new ones held.
        support: the table as it was seen; None: that of the constraints, if they say which side is up.
    """
    support = support or constraints.support
    meets = _met(constraints, support, hand, known)
    aimed = aimed_object(constraints)
    if int(meets.sum()) >= enough or aimed is None:
        return known
    settings = SynthesisConfig(count=_MADE, max_rounds=_ROUNDS, protocol=protocol)
    made = remembered(
        ("constrained", pair_fingerprint(hand, aimed), settings, seed, support),
        lambda: synthesise(hand, aimed, config=settings, seed=seed, support=support).grasps,
    )
    return with_more(hand, constraints.obj, known, made[_met(constraints, support, hand, made)], protocol=protocol)


def with_more(hand: Hand, obj: ObjectModel, known: GraspSet, made: GraspSet, *, protocol: str) -> GraspSet:
    """Known grasps and newly made ones as one set; with the verdicts of the protocol where both sets have them."""
    if not len(made):
        return known
    if not len(known):
        return made
    both = [_judged_by(hand, obj, one, protocol) for one in (known, made)]
    agreed = all(protocol in one.verdicts for one in both)
    return concatenate([one if agreed else replace(one, verdicts={}) for one in both])


def _met(constraints: GraspConstraints, support: Support | None, hand: Hand, grasps: GraspSet) -> np.ndarray:
    """(N,) bool: grasps that meet the constraints and clear the table."""
    met = constraints.allows(hand, grasps.X_OH, grasps.q, grasps.q_pregrasp)
    if support is not None:
        left = np.flatnonzero(met)
        met[left] = support.allows(hand, grasps.X_OH[left], grasps.q[left], grasps.q_pregrasp[left])
    return met


def aimed_object(constraints: GraspConstraints) -> ObjectModel | None:
    """The object with only those of its surface points that may be touched; None where these are few."""
    obj = constraints.obj
    free, only = constraints.marked(obj.points_O)
    kept = only if constraints.only_region else ~free
    if kept.sum() < _FEWEST_POINTS:
        return None
    points_O, normals_O = obj.points_O[kept], obj.normals_O[kept]
    return replace(obj, points_O=points_O, normals_O=normals_O, content_hash=fingerprint((obj.content_hash, points_O)))


def _judged_by(hand: Hand, obj: ObjectModel, grasps: GraspSet, protocol: str) -> GraspSet:
    """The grasps that may hold, with the verdict of one protocol if they have it with the numbers of today."""
    grasps = not_let_fall(hand, obj, grasps)
    return replace(grasps, verdicts=verdict_of(hand, obj, grasps, protocol), protocol=protocol)
