"""Closing and judging one candidate: the compiled steps that CPU loops and GPU threads share.

Nothing here allocates, except where the name says `new_`: every array a step overwrites is handed in, so the same
functions compile for the CPU and, called from the kernels in `gpu_kernels`, for a GPU.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.contact import ContactScratch, find_contacts_using, most_points
from neuralgrasps.grasps.epsilon import epsilon_scratch, epsilon_with, epsilon_within
from neuralgrasps.grasps.force_qp import WEIGHT, edge_forces_using, net_wrench, new_force_scratch
from neuralgrasps.grasps.penetration import (
    PoseScratch,
    new_poses,
    object_points_in_hand_using,
    self_penetration_using,
)
from neuralgrasps.grasps.polar import PolarScratch
from neuralgrasps.grasps.probe_points import ProbePoints
from neuralgrasps.grasps.wrench_space import fill_grasp_wrenches
from neuralgrasps.hands.packed import PackedHand, pose_links
from neuralgrasps.synthesis.close import (
    CloseScratch,
    Closing,
    close_fingers_using,
    close_jaw_using,
    new_close_scratch,
)
from neuralgrasps.synthesis.clusters import Clusters, hand_clearance_using

CONE_EDGES = 8
CONTACTS_PER_LINK = 3
MAX_ADVANCES = 60  # steps of an approach
MAX_RESIDUAL = 1.0e-3  # N of net wrench per N of squeeze: what balanced contact forces may leave
# Outcome of one candidate, from first to last obstacle.
COLLIDES, FEW_CONTACTS, NO_FORCE_CLOSURE, PENETRATES, SELF_COLLIDES, VALID, MEETS_SUPPORT = range(7)
OUTCOMES = ("collides", "few contacts", "no force closure", "penetrates", "self-collides", "valid", "meets the table")


class Pair(NamedTuple):
    """What the steps read about one hand and one object.

    Attributes:
        values, origin, inv_spacing: the object's `SdfGrid`; probe: its surface points; com: (3,) centre of mass, O.
        packed, clusters, closing: the hand; is_jaw: whether it closes and centres itself as a parallel jaw.
        length, friction, torsion, threshold, max_penetration: see `GraspProblem`.
    """

    values: np.ndarray
    origin: np.ndarray
    inv_spacing: float
    probe: ProbePoints
    com: np.ndarray
    packed: PackedHand
    clusters: Clusters
    closing: Closing
    is_jaw: bool
    length: float
    friction: float
    torsion: float
    threshold: float
    max_penetration: float


class Cone(NamedTuple):
    """What wrenches depend on besides contacts: the attributes of `Pair` of the same names."""

    com: np.ndarray
    length: float
    friction: float
    torsion: float


class ContactList(NamedTuple):
    """Contacts of one candidate: points, normals (R, 3) float64, links (R,) int32, wrenches (R * 10, 6) float64."""

    points: np.ndarray
    normals: np.ndarray
    links: np.ndarray
    wrenches: np.ndarray


class Scratch(NamedTuple):
    """What one candidate's steps overwrite: X_HL (L, 4, 4) link poses, busy (J + 1,) bool, and the steps' own."""

    X_HL: np.ndarray
    busy: np.ndarray
    close: CloseScratch
    contact: ContactScratch
    found: ContactList
    quality: PolarScratch
    poses: PoseScratch


@njit(cache=True, error_model="numpy")
def most_contacts(packed):  # type: ignore[no-untyped-def]
    """Most contacts of one candidate."""
    return packed.link_radius.shape[0] * CONTACTS_PER_LINK


@njit(cache=True, error_model="numpy")
def new_scratch(pair):  # type: ignore[no-untyped-def]
    """A `Scratch` for this pair."""
    packed = pair.packed
    links, most, rows = packed.link_radius.shape[0], most_points(packed), most_contacts(packed)
    return Scratch(
        np.zeros((links, 4, 4)),
        np.empty(packed.lower.shape[0] + 1, np.bool_),
        new_close_scratch(packed, pair.clusters),
        ContactScratch(np.empty((most, 3)), np.empty((most, 3)), np.empty(most), np.empty((3, 4))),
        ContactList(
            np.empty((rows, 3)), np.empty((rows, 3)), np.empty(rows, np.int32), np.empty((rows * (CONE_EDGES + 2), 6))
        ),
        epsilon_scratch(rows * (CONE_EDGES + 2)),
        new_poses(),
    )


@njit(cache=True, error_model="numpy")
def advance_hand(pair, X_OH, X_HL, approach, contact_m, farthest, touching, moved, scratch):  # type: ignore[no-untyped-def]
    """Travel, metres, of an open hand along `approach` (3,) until it is nearer than `contact_m` to the object.

    A hand that comes to `farthest` free of contact stops there, or, where it was to touch, gets -1, as do hands that
    are in contact from the start. `moved` (3, 4) and `scratch`, a `CloseScratch`, are overwritten.
    """
    travel = distance = 0.0
    for r in range(3):
        for c in range(4):
            moved[r, c] = X_OH[r, c]
    for _ in range(MAX_ADVANCES):
        distance = hand_clearance_using(
            pair.values, pair.origin, pair.inv_spacing, pair.packed, pair.clusters, moved, X_HL,
            scratch.pose, scratch.at_centre,
        )  # fmt: skip
        if distance < contact_m or travel >= farthest:
            break
        travel = min(travel + distance - 0.5 * contact_m, farthest)
        for k in range(3):
            moved[k, 3] = X_OH[k, 3] + travel * approach[k]
    touches = distance < contact_m and travel > 0.0
    return travel if touches or (not touching and travel >= farthest) else -1.0


@njit(cache=True, error_model="numpy")
def close_hand(pair, X_OH, q, X_HL, scratch):  # type: ignore[no-untyped-def]
    """Close one hand in place (`close_jaw` or `close_fingers`); `scratch` is a `CloseScratch`. False: it collides."""
    if pair.is_jaw:
        return close_jaw_using(
            pair.values, pair.origin, pair.inv_spacing, pair.packed, pair.clusters, pair.closing, X_OH, q, X_HL, scratch
        )
    return close_fingers_using(
        pair.values, pair.origin, pair.inv_spacing, pair.packed, pair.clusters, pair.closing, X_OH, q, X_HL, scratch
    )


@njit(cache=True, error_model="numpy")
def touch(pair, X_OH, X_HL, scratch, points, normals, links):  # type: ignore[no-untyped-def]
    """Contacts of a closed hand into the last three arrays; how many, 0 when fewer than two links touch."""
    count = find_contacts_using(
        pair.values, pair.origin, pair.inv_spacing, pair.packed, X_OH, X_HL, pair.threshold, CONTACTS_PER_LINK,
        points, normals, links, scratch,
    )  # fmt: skip
    touching = 0
    for c in range(count):
        if c == 0 or links[c] != links[c - 1]:
            touching += 1
    return count if touching > 1 else 0


@njit(cache=True, error_model="numpy")
def fill_wrenches(cone, points, normals, count, wrenches):  # type: ignore[no-untyped-def]
    """The wrenches of the first `count` contacts; how many. `cone` is a `Pair` or a `Cone`."""
    return fill_grasp_wrenches(
        points, normals, count, cone.com, cone.friction, CONE_EDGES, cone.torsion, cone.length, wrenches
    )


@njit(cache=True, error_model="numpy")
def grasp_epsilon(cone, points, normals, count, wrenches, scratch):  # type: ignore[no-untyped-def]
    """Ferrari-Canny quality of the first `count` contacts, 0 without force closure."""
    return epsilon_with(wrenches, fill_wrenches(cone, points, normals, count, wrenches), scratch)


@njit(cache=True, error_model="numpy")
def grasp_epsilon_within(cone, points, normals, count, wrenches, scratch):  # type: ignore[no-untyped-def]
    """`grasp_epsilon`, or -1 where `scratch`, a `PolarScratch`, is too small: for GPUs, which cannot allocate more."""
    return epsilon_within(wrenches, fill_wrenches(cone, points, normals, count, wrenches), scratch)


@njit(cache=True, error_model="numpy")
def grasp_residual(cone, points, normals, count, wrenches, scratch):  # type: ignore[no-untyped-def]
    """What the best squeeze of 1 N in total leaves unbalanced (`force_qp`); `scratch` is a `ForceScratch`."""
    rows = fill_wrenches(cone, points, normals, count, wrenches)
    edge_forces_using(wrenches, rows, WEIGHT, scratch)
    return net_wrench(wrenches, rows, scratch.f)


@njit(cache=True, error_model="numpy")
def _open_idle(packed, closing, contact_links, count, q_start, q, X_HL, busy):  # type: ignore[no-untyped-def]
    """Open the fingers that touch nothing to where they started, so that they are out of the others' way.

    Returns whether any joint moved; `q` and `X_HL` change.
    """
    for group in range(closing.groups):
        busy[group] = False
    for c in range(count):
        group = closing.link_group[contact_links[c]]
        if group >= 0:
            busy[group] = True
    moved = False
    for j in range(q.shape[0]):
        if closing.group[j] >= 0 and not busy[closing.group[j]] and q[j] != q_start[j]:
            q[j] = q_start[j]
            moved = True
    if moved:
        pose_links(packed, q, X_HL)
    return moved


@njit(cache=True, error_model="numpy")
def check_overlap(pair, X_OH, q_start, q, X_HL, count, links, busy, close, poses):  # type: ignore[no-untyped-def]
    """(outcome, deepest overlap in metres); opens idle fingers (`q`, `X_HL`) when the hand meets itself."""
    own_depth = self_penetration_using(pair.packed, X_HL, poses)
    if own_depth > pair.max_penetration and _open_idle(pair.packed, pair.closing, links, count, q_start, q, X_HL, busy):
        own_depth = self_penetration_using(pair.packed, X_HL, poses)
    clearance = hand_clearance_using(
        pair.values, pair.origin, pair.inv_spacing, pair.packed, pair.clusters, X_OH, X_HL, close.pose, close.at_centre
    )
    depth = max(-clearance, object_points_in_hand_using(pair.probe, pair.packed, X_OH, X_HL, poses))
    if depth > pair.max_penetration:
        return PENETRATES, depth
    deepest = max(depth, 0.0, own_depth)
    if own_depth > pair.max_penetration:
        return SELF_COLLIDES, deepest
    return VALID, deepest


@njit(cache=True, error_model="numpy")
def assess(pair, X_OH, q_start, q, scratch):  # type: ignore[no-untyped-def]
    """(outcome, epsilon, overlap) of a hand that has closed; `scratch.X_HL` holds its link poses."""
    points, normals, links, wrenches = scratch.found
    count = touch(pair, X_OH, scratch.X_HL, scratch.contact, points, normals, links)
    if count == 0:
        return FEW_CONTACTS, 0.0, 0.0
    quality = grasp_epsilon(pair, points, normals, count, wrenches, scratch.quality)
    if quality <= 0.0:
        return NO_FORCE_CLOSURE, 0.0, 0.0
    outcome, depth = check_overlap(
        pair, X_OH, q_start, q, scratch.X_HL, count, links, scratch.busy, scratch.close, scratch.poses
    )
    return outcome, quality if outcome == VALID else 0.0, depth


@njit(cache=True, error_model="numpy")
def balance(pair, X_OH, q_start, q, scratch, force):  # type: ignore[no-untyped-def]
    """(outcome, residual, overlap) of a hand that has closed, judged by its best squeeze instead of epsilon.

    Over `MAX_RESIDUAL` the outcome is NO_FORCE_CLOSURE; the residual is inf with fewer than two touching links.
    """
    points, normals, links, wrenches = scratch.found
    count = touch(pair, X_OH, scratch.X_HL, scratch.contact, points, normals, links)
    if count == 0:
        return FEW_CONTACTS, np.inf, 0.0
    residual = grasp_residual(pair, points, normals, count, wrenches, force)
    if residual > MAX_RESIDUAL:
        return NO_FORCE_CLOSURE, residual, 0.0
    outcome, depth = check_overlap(
        pair, X_OH, q_start, q, scratch.X_HL, count, links, scratch.busy, scratch.close, scratch.poses
    )
    return outcome, residual, depth


@njit(cache=True, error_model="numpy", nogil=True)
def close_and_assess_all(pair, q_start, X_OH, q, quality, penetration, outcome):  # type: ignore[no-untyped-def]
    """`close_hand` and `assess` for N candidates on the CPU; `X_OH`, `q` and the last three (N,) arrays change."""
    scratch = new_scratch(pair)
    for i in range(q.shape[0]):
        if close_hand(pair, X_OH[i], q[i], scratch.X_HL, scratch.close):
            outcome[i], quality[i], penetration[i] = assess(pair, X_OH[i], q_start[i], q[i], scratch)
        else:
            outcome[i], quality[i], penetration[i] = COLLIDES, 0.0, 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def close_and_balance_all(pair, q_start, X_OH, q, residual, penetration, outcome):  # type: ignore[no-untyped-def]
    """`close_hand` and `balance` for N candidates on the CPU; `X_OH`, `q` and the last three (N,) arrays change."""
    scratch = new_scratch(pair)
    force = new_force_scratch(scratch.found.wrenches.shape[0])
    for i in range(q.shape[0]):
        if close_hand(pair, X_OH[i], q[i], scratch.X_HL, scratch.close):
            outcome[i], residual[i], penetration[i] = balance(pair, X_OH[i], q_start[i], q[i], scratch, force)
        else:
            outcome[i], residual[i], penetration[i] = COLLIDES, np.inf, 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def epsilon_all(pair, points, normals, contacts, todo):  # type: ignore[no-untyped-def]
    """`grasp_epsilon` (N,) of the candidates `todo` (M,), 0 for others; points, normals (N, R, 3), contacts (N,)."""
    quality, rows = np.zeros(contacts.shape[0]), points.shape[1] * (CONE_EDGES + 2)
    wrenches, scratch = np.empty((rows, 6)), epsilon_scratch(rows)
    for m in range(todo.shape[0]):
        i = todo[m]
        quality[i] = grasp_epsilon(pair, points[i], normals[i], contacts[i], wrenches, scratch)
    return quality


@njit(cache=True, error_model="numpy", nogil=True)
def advance_all(pair, X_OH, q, approach, contact_m, farthest, touching, travel):  # type: ignore[no-untyped-def]
    """`advance_hand` for N open hands on the CPU: X_OH (N, 4, 4), q (N, J), approach (N, 3) into travel (N,)."""
    X_HL, moved = np.empty((pair.packed.link_radius.shape[0], 4, 4)), np.empty((3, 4))
    scratch = new_close_scratch(pair.packed, pair.clusters)
    for i in range(q.shape[0]):
        pose_links(pair.packed, q[i], X_HL)
        travel[i] = advance_hand(pair, X_OH[i], X_HL, approach[i], contact_m, farthest, touching, moved, scratch)
