"""Compiled steps of the search for a contact map: open, draw back, close, compare, and only then judge.

A start whose closed hand is no nearer to the asked contact map than what is known already is dropped before its force
closure is looked at. Nothing here draws random numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.apply.transfer_nearest import Nearest, nearest_parts, new_nearest, points_in_hand
from neuralgrasps.compiled import njit
from neuralgrasps.grasps.epsilon import epsilon_scratch
from neuralgrasps.grasps.force_qp import new_force_scratch
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.posed_parts import part_poses_H
from neuralgrasps.synthesis.assess import (
    COLLIDES,
    CONE_EDGES,
    FEW_CONTACTS,
    NO_FORCE_CLOSURE,
    VALID,
    Cone,
    check_overlap,
    close_hand,
    grasp_epsilon,
    grasp_residual,
    most_contacts,
    new_scratch,
    touch,
)
from neuralgrasps.synthesis.clusters import hand_clearance_using
from neuralgrasps.synthesis.settle import relax_idle

FAR = 7  # outcome besides those of `assess`: enough hands with nearer contact maps are known
_OPENINGS = (0.0, 1.0, 2.0, 4.0, 8.0)  # steps that a hand which overlaps the object is opened by
_BACKS = 6
_MOST_BACK_M = 0.03
_GAP_M = 5.0e-4
_WEAKEST = 2.0  # shares of `Sturdy.give` that a hand counts at most as
_CURLED = 1.2  # a hand this much worse may still come below the limit when its idle fingers open


class Target(NamedTuple):
    """The contact map that is asked for: points (M, 3), closeness and weight (M,), weights of mean 1; 1 / radius."""

    points: np.ndarray
    closeness: np.ndarray
    weight: np.ndarray
    inv_radius: float


class Sturdy(NamedTuple):
    """What a grasp must be worth where it slips more easily.

    Attributes:
        cone: friction to judge by. usual: `margin` of known grasps there, above 0. give: difference of contact maps
            that a margin of 0 counts as.
        least_epsilon: quality with the usual friction that is no grasp yet.
    """

    cone: Cone
    usual: float
    give: float
    least_epsilon: float


class Hands(NamedTuple):
    """How a hand opens and rests: step (J,) one step of opening, approach_H (3,), q_open (J,)."""

    step: np.ndarray
    approach_H: np.ndarray
    q_open: np.ndarray


class MapWork(NamedTuple):
    """What comparing maps overwrites: X_HL (L, 4, 4), X_PH (Np, 3, 4), and the points."""

    X_HL: np.ndarray
    X_PH: np.ndarray
    nearest: Nearest


@njit(cache=True, error_model="numpy")
def new_map(packed, target):  # type: ignore[no-untyped-def]
    """Room to compare maps of one hand at a target's points."""
    parts = packed.part_link.shape[0]
    return MapWork(
        np.empty((packed.parents.shape[0], 4, 4)), np.empty((parts, 3, 4)), new_nearest(target.points.shape[0])
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def map_difference(packed, target, X_OH, q, work):  # type: ignore[no-untyped-def]
    """Weighted mean |difference| of a posed hand's contact map and the target; `work` is a `MapWork`."""
    pose_links(packed, q, work.X_HL)
    centres_H = np.empty((packed.part_link.shape[0], 3))  # nobody asks for them here
    part_poses_H(packed, work.X_HL, work.X_PH, centres_H)
    points_in_hand(X_OH, target.points, work.nearest.points_A)
    nearest_parts(packed, work.X_PH, work.nearest)
    total, distance = 0.0, work.nearest.distance
    for i in range(distance.shape[0]):
        closeness = math.exp(-max(distance[i], 0.0) * target.inv_radius)
        total += target.weight[i] * abs(closeness - target.closeness[i])
    return total / distance.shape[0]


@njit(cache=True, error_model="numpy", nogil=True)
def map_differences(packed, target, X_OH, q):  # type: ignore[no-untyped-def]
    """`map_difference` (N,) of hands X_OH (N, 4, 4), q (N, J)."""
    out, work = np.empty(q.shape[0]), new_map(packed, target)
    for i in range(q.shape[0]):
        out[i] = map_difference(packed, target, X_OH[i], q[i], work)
    return out


@njit(cache=True, error_model="numpy")
def _clearance(pair, X_OH, X_HL, scratch):  # type: ignore[no-untyped-def]
    return hand_clearance_using(
        pair.values, pair.origin, pair.inv_spacing, pair.packed, pair.clusters, X_OH, X_HL,
        scratch.close.pose, scratch.close.at_centre,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _make_room(pair, hands, X_OH, q, X_HL, scratch):  # type: ignore[no-untyped-def]
    """Open the hand, and then draw it back, until it does not overlap the object; False where that is not enough."""
    joints = q.shape[0]
    start = q.copy()
    clearance = 0.0
    for steps in _OPENINGS:
        for j in range(joints):
            q[j] = min(max(start[j] - steps * hands.step[j], pair.packed.lower[j]), pair.packed.upper[j])
        pose_links(pair.packed, q, X_HL)
        clearance = _clearance(pair, X_OH, X_HL, scratch)
        if clearance >= 0.0:
            return True
    gone = 0.0
    for _ in range(_BACKS):
        back = -clearance + _GAP_M
        gone += back
        if gone > _MOST_BACK_M:
            return False
        for k in range(3):
            for m in range(3):
                X_OH[k, 3] -= back * X_OH[k, m] * hands.approach_H[m]
        clearance = _clearance(pair, X_OH, X_HL, scratch)
        if clearance >= 0.0:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _insert(ascending, value):  # type: ignore[no-untyped-def]
    """Put a value in its place; the largest falls out."""
    k = ascending.shape[0]
    while k > 0 and value < ascending[k - 1]:
        if k < ascending.shape[0]:
            ascending[k] = ascending[k - 1]
        k -= 1
    if k < ascending.shape[0]:
        ascending[k] = value


@njit(cache=True, error_model="numpy")
def margin(cone, points, normals, count, wrenches, quality, force):  # type: ignore[no-untyped-def]
    """Epsilon of contacts; where it is 0, minus what the best squeeze of 1 N in total leaves unbalanced."""
    epsilon = grasp_epsilon(cone, points, normals, count, wrenches, quality)
    return epsilon if epsilon > 0.0 else -grasp_residual(cone, points, normals, count, wrenches, force)


@njit(cache=True, error_model="numpy")
def margins(cone, points, normals, links):  # type: ignore[no-untyped-def]
    """`margin` (N,) of grasps by their contacts (N, C, 3), (N, C, 3) and links (N, C), -1 for none."""
    out = np.empty(links.shape[0])
    wrenches = np.empty((max(links.shape[1], 1) * (CONE_EDGES + 2), 6))
    quality, force = epsilon_scratch(wrenches.shape[0]), new_force_scratch(wrenches.shape[0])
    for i in range(links.shape[0]):
        count = 0
        while count < links.shape[1] and links[i, count] >= 0:
            count += 1
        out[i] = margin(cone, points[i], normals[i], count, wrenches, quality, force) if count else -1.0
    return out


@njit(cache=True, error_model="numpy")
def weakness(sturdy, margin):  # type: ignore[no-untyped-def]
    """Difference of contact maps that a margin below the usual one counts as."""
    return sturdy.give * min(max(1.0 - margin / sturdy.usual, 0.0), _WEAKEST)


@njit(cache=True, error_model="numpy")
def _close(pair, hands, X_OH, q, q_start, scratch):  # type: ignore[no-untyped-def]
    """Open, draw back and close one hand in place; its number of contacts, 0: too few, -1: it collides."""
    if not _make_room(pair, hands, X_OH, q, scratch.X_HL, scratch):
        return -1
    q_start[:] = q
    if not close_hand(pair, X_OH, q, scratch.X_HL, scratch.close):
        return -1
    points, normals, links, _ = scratch.found
    return touch(pair, X_OH, scratch.X_HL, scratch.contact, points, normals, links)


@njit(cache=True, error_model="numpy")
def _relax(pair, hands, X_OH, q, idle, scratch):  # type: ignore[no-untyped-def]
    """Half curl the fingers that touch nothing; whether there are any."""
    idle[:] = False
    relax_idle(
        pair.values, pair.origin, pair.inv_spacing, pair.packed, pair.clusters, pair.closing, hands.q_open,
        pair.threshold, pair.max_penetration, X_OH, q, scratch.X_HL, idle,
    )  # fmt: skip
    return idle.any()


@njit(cache=True, error_model="numpy", nogil=True)
def search_starts(pair, target, hands, sturdy, nearest, running, X_OH, q, difference, weak, outcome):  # type: ignore[no-untyped-def]
    """Close N hands from their starts, compare their contact maps, and judge those that may be of the nearest.

    `nearest` (K,) are difference and weakness of the K best valid hands so far, ascending, inf where there are fewer;
    what is no nearer than the last of them is not judged. `running`: keep it up to date, where no one else has a say in
    what is valid.
    `X_OH` (N, 4, 4) and `q` (N, J) become the closed hands'. `difference` (N,): of the contact maps, inf for hands that
    could not close; `weak` (N,): `weakness` of those that are valid; `outcome` (N,): of `assess`, or FAR.
    """
    scratch, force = new_scratch(pair), new_force_scratch(most_contacts(pair.packed) * (CONE_EDGES + 2))
    maps, q_start, idle = new_map(pair.packed, target), np.empty(q.shape[1]), np.empty(q.shape[1], np.bool_)
    points, normals, links, wrenches = scratch.found
    last = nearest.shape[0] - 1
    for i in range(q.shape[0]):
        difference[i], weak[i] = np.inf, 0.0
        count = _close(pair, hands, X_OH[i], q[i], q_start, scratch)
        if count <= 0:
            outcome[i] = FEW_CONTACTS if count == 0 else COLLIDES
            continue
        difference[i] = map_difference(pair.packed, target, X_OH[i], q[i], maps)
        outcome[i] = FAR
        if difference[i] >= nearest[last] * (1.0 if pair.is_jaw else _CURLED):
            continue
        if grasp_epsilon(pair, points, normals, count, wrenches, scratch.quality) <= sturdy.least_epsilon:
            outcome[i] = NO_FORCE_CLOSURE
            continue
        if not pair.is_jaw and _relax(pair, hands, X_OH[i], q[i], idle, scratch):
            difference[i] = map_difference(pair.packed, target, X_OH[i], q[i], maps)
        if difference[i] >= nearest[last]:
            continue
        outcome[i], _ = check_overlap(
            pair, X_OH[i], q_start, q[i], scratch.X_HL, count, links, scratch.busy, scratch.close, scratch.poses
        )
        if outcome[i] == VALID:
            if sturdy.give > 0.0:
                held = margin(sturdy.cone, points, normals, count, wrenches, scratch.quality, force)
                weak[i] = weakness(sturdy, held)
            if running:
                _insert(nearest, difference[i] + weak[i])
