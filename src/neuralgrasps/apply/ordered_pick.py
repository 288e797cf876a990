"""A pick with grasps in a given order, as transfer gives them: the first that clears the table and has a plan."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from neuralgrasps.apply.demonstrate_rules import table_support
from neuralgrasps.apply.pick_up import PickUpConfig, Planner, proof_of_lift, within_limits
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.copies import moved_grasps, roll_twins
from neuralgrasps.planning.ik import ik_solver
from neuralgrasps.planning.pick import PickResult, plan_pick
from neuralgrasps.planning.reach import beyond_reach
from neuralgrasps.planning.resting_plane import nearest_resting_plane
from neuralgrasps.planning.world import PlanningWorld

_ORDER_WEIGHT = 1.0e3  # of a place in the order: nothing else that ranks grasps comes near it
_FRICTIONS = (0.75, 1.0)  # shares of the object's friction that a grasp must lift it with: with a margin, if one can


def ordered_planner(grasps: GraspSet) -> Planner:
    """A `Planner` that walks down `grasps`, best first; see `place_of` for what `PickPlan.index` then means.

    Each is tried as it is and, by a parallel jaw, turned by half a turn. When none leads to a plan, the same grasps
    carried over by the object's symmetry follow, in the same order: the object cannot tell them apart. Only when that
    leads to none either may grasps follow that lift the object with no friction to spare.
    """
    return partial(_plan, grasps)


def place_of(plan_index: int, count: int) -> int:
    """Place in the order (0 = first) of the grasp that a plan of `ordered_planner` uses, of `count` grasps given."""
    return plan_index % count


def _plan(
    grasps: GraspSet,
    manipulator: Manipulator,
    world: PlanningWorld,
    table_B: Plane,
    q_arm: np.ndarray,
    config: PickUpConfig,
    seed: int,
) -> tuple[PickResult | None, str, float]:
    """As `plan_in`: the result, why there is no plan, and the CPU-seconds of proofs."""
    target, hand = world.target, manipulator.hand
    assert target is not None
    if len(grasps) == 0:
        return None, "no grasp was transferred.", 0.0
    beyond_m = beyond_reach(ik_solver(manipulator).reach, hand, target.obj, target.X_BO)
    if beyond_m > 0:
        return None, f"'{target.obj.name}' is out of reach, by {1e3 * beyond_m:.0f} mm at least.", 0.0
    plane_O = table_B.moved(np.linalg.inv(target.X_BO))
    q_arm, cpu = within_limits(manipulator, q_arm), time.thread_time()
    motions = target.obj.symmetry.rotations
    tiers = [_copies(hand, grasps, motions[:1]), _copies(hand, grasps, motions[1:])]
    support = table_support(plane_O)
    tried: PickResult | None = None
    planned = 0.0
    for friction in _frictions(target.obj, plane_O):
        proof = None if friction is None else proof_of_lift(manipulator, world, plane_O, friction, config)
        for tier, (copies, index) in enumerate(tiers):
            clear = support.allows(hand, copies.X_OH, copies.q, copies.q_pregrasp) if len(copies) else np.zeros(0, bool)
            if not clear.any():
                continue
            kept, place = copies[np.flatnonzero(clear)], index[clear]
            result = plan_pick(
                manipulator, kept, world, q_arm, preference=1.0 - place / len(grasps),
                config=replace(config.plan, preference_weight=_ORDER_WEIGHT), proof=proof, seed=seed,
            )  # fmt: skip
            planned, tried = planned + result.cpu_s, result
            if proof is not None:
                proof.keep()
            if result.plan is not None:
                own = int(place[result.plan.index]) + tier * len(grasps)
                result = replace(result, plan=replace(result.plan, index=own), cpu_s=planned)
                return result, "", time.thread_time() - cpu - planned
            if result.blocked:
                return replace(result, cpu_s=planned), result.reason, time.thread_time() - cpu - planned
    made = time.thread_time() - cpu - planned
    if tried is None:
        return None, f"none of the {len(grasps)} transferred grasps clears the table.", made
    return replace(tried, cpu_s=planned), tried.reason, made


def _copies(hand: Hand, grasps: GraspSet, motions: np.ndarray | Sequence[np.ndarray]) -> tuple[GraspSet, np.ndarray]:
    """Grasps moved by each motion, with their twins, and each one's place in the order."""
    sets, places = list[GraspSet](), list[np.ndarray]()
    for X in motions:
        moved = moved_grasps(grasps, X)
        for some in (moved, roll_twins(hand, moved)):
            if len(some):
                sets.append(some)
                places.append(np.arange(len(some)))
    if not sets:
        return grasps[:0], np.zeros(0, int)
    return concatenate(sets), np.concatenate(places)


def _frictions(obj: ObjectModel, plane_O: Plane) -> tuple[float | None, ...]:
    """No proof for a pose that the object does not rest in: nothing would stay as it is before the hand comes."""
    return (None,) if nearest_resting_plane(obj, plane_O) is None else _FRICTIONS
