"""Close a hand on an object without ever passing through it (conservative advancement).

Every step moves each surface point by less than its distance to the object, so the closed hand is free of
penetration up to the spacing of its surface points. A link that touches stops the joints that
carry it; joints further out go on (the breakaway of underactuated fingers is this). Where one joint moves several
fingers, the first that touches would stop them all; then the hand gives way, as the object would, until all touch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, turned_vector
from neuralgrasps.geometry.sdf_grid import grid_distance, grid_distance_gradient
from neuralgrasps.grasps.contact import link_pose_in_object
from neuralgrasps.hands.chains import moved_links
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.synthesis.clusters import (
    hand_clearance_using,
    link_distance_using,
    most_clusters,
    sphere_distance,
)

CONTACT_M = 3.0e-4  # a link closer than this touches
START_OVERLAP_M = 1.0e-3  # a hand that starts deeper in the object cannot close
MAX_STEPS = 160
MAX_SHIFTS = 60  # of a hand whose fingers move together
LARGEST_SHIFT_M = 3.0e-3  # at once
ALL_SHIFTS_M = 0.03
_LEAST_SHIFT_M = 5.0e-5
_NEAR_M = 1.0e-3  # of coupled fingers, those that are nearly there have a say too
_BALANCED = 0.2  # mean contact normal below which nothing is to be gained by giving way
_AGAINST = -0.1  # a link whose nearest normal points this far against the shift must have room for it


class Closing(NamedTuple):
    """How a hand closes.

    Attributes:
        group (J,), link_group (L,) int64: joints that move a common link share a group and close in step; groups
            (mostly fingers) do not affect each other's contacts and close one after the other. -1: not closing.
        groups: number of groups.
        side (L,) int8: of a jaw, +1 for links that close along `axis_H`, -1 against it, 0 for the palm.
        axis_H (3,): the closing line of a jaw.
        unit (J,): of a jaw, joint motion that advances the faster pad by 1 m.
        branch (L,) int64: finger of each link that closes on a joint it shares with another finger; -1 for all others.
    """

    group: np.ndarray
    link_group: np.ndarray
    groups: int
    side: np.ndarray
    axis_H: np.ndarray
    unit: np.ndarray
    branch: np.ndarray


def make_closing(hand: Hand) -> Closing:
    """Find which joints must close together, and for a jaw which links close along the palm's x axis."""
    moved = moved_links(hand.tree) & (hand.closing_rate != 0)
    group = np.where(hand.closing_rate != 0, np.arange(hand.num_dofs), -1)
    for row in moved:
        if row.any():
            group[np.isin(group, group[row])] = group[row].min()
    names = np.unique(group[group >= 0])
    group = np.where(group >= 0, np.searchsorted(names, group), -1)
    link_group = np.array([group[row].max() if row.any() else -1 for row in moved])
    side, unit = np.zeros(hand.tree.num_links, np.int8), np.zeros(hand.num_dofs)
    axis_H = np.ascontiguousarray(hand.X_HP[:3, 0])
    if hand.is_jaw:
        step = 1e-4 * hand.closing_rate / np.abs(hand.closing_rate).max()
        before, after = forward_numpy(hand.tree, np.stack([hand.q_open, hand.q_open + step]))
        advance = (after - before)[:, :3, 3] @ axis_H
        side = np.sign(np.round(advance, 9)).astype(np.int8)
        unit = step / max(float(np.abs(advance).max()), 1e-12)
    branch = _shared_branches(hand, moved, group, link_group)
    return Closing(group.astype(np.int64), link_group.astype(np.int64), len(names), side, axis_H, unit, branch)


def _shared_branches(hand: Hand, moved: np.ndarray, group: np.ndarray, link_group: np.ndarray) -> np.ndarray:
    """(L,) finger of the links in groups where a joint moves several fingers, else -1; `moved` (L, J) by joint."""
    finger = np.full(hand.tree.num_links, -1, np.int64)
    for index, one in enumerate(hand.fingers):
        finger[list(one.links)] = index
    driven = np.array([len(np.unique(finger[moved[:, j] & (finger >= 0)])) for j in range(hand.num_dofs)])
    return np.where(np.isin(link_group, group[(driven > 1) & (group >= 0)]), finger, -1)


class CloseScratch(NamedTuple):
    """What closing one hand overwrites: pose (3, 4), at_centre (`most_clusters`,) float64, active (J,) bool."""

    pose: np.ndarray
    at_centre: np.ndarray
    active: np.ndarray


@njit(cache=True, error_model="numpy")
def new_close_scratch(packed, clusters):  # type: ignore[no-untyped-def]
    """A `CloseScratch` for this hand."""
    return CloseScratch(np.empty((3, 4)), np.empty(most_clusters(clusters)), np.empty(packed.lower.shape[0], np.bool_))


@njit(cache=True, error_model="numpy")
def speed_bound(packed, X_HL, link, active):  # type: ignore[no-untyped-def]
    """Largest speed (m/s) that any point of a link can have while the active joints close.

    It also bounds the distance a point ends up from its start: turn the joints one by one, inner ones first, and none
    changes a point's distance to the axes of those that follow.
    """
    c = packed.link_centre
    x, y, z = moved_point(X_HL[link], c[link, 0], c[link, 1], c[link, 2])
    speed = 0.0
    i = link
    while i > 0:
        rate = 0.0
        if packed.joint_types[i] != 0:
            for j in range(active.shape[0]):
                if active[j]:
                    rate += packed.coupling[i, j] * packed.closing_rate[j]
        if rate != 0.0 and packed.joint_types[i] == 1:
            u, v, w = turned_vector(X_HL[i], packed.axes[i, 0], packed.axes[i, 1], packed.axes[i, 2])
            dx, dy, dz = x - X_HL[i, 0, 3], y - X_HL[i, 1, 3], z - X_HL[i, 2, 3]
            along = dx * u + dy * v + dz * w
            lever = math.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
            speed += abs(rate) * (lever + packed.link_radius[link])
        elif rate != 0.0:
            speed += abs(rate)
        i = packed.parents[i]
    return speed


@njit(cache=True, error_model="numpy")
def _freeze(packed, link, active):  # type: ignore[no-untyped-def]
    """Stop every closing joint that carries `link`."""
    i = link
    while i > 0:
        for j in range(active.shape[0]):
            if packed.coupling[i, j] != 0.0:
                active[j] = False
        i = packed.parents[i]


@njit(cache=True, error_model="numpy")
def _room(packed, q, active):  # type: ignore[no-untyped-def]
    """Time until the first active joint meets its limit; joints at their limit stop."""
    step = 1.0e9
    for j in range(q.shape[0]):
        if active[j]:
            rate = packed.closing_rate[j]
            room = (packed.upper[j] - q[j]) if rate > 0.0 else (q[j] - packed.lower[j])
            if room < 1.0e-6:
                active[j] = False
            else:
                step = min(step, room / abs(rate))
    return step


@njit(cache=True, error_model="numpy")
def _close_group(values, origin, inv_spacing, packed, clusters, closing, group, X_OH, q, X_HL, active, X, at_centre):  # type: ignore[no-untyped-def]
    for _ in range(MAX_STEPS):
        step = _room(packed, q, active)
        for link in range(1, packed.link_radius.shape[0]):
            if closing.link_group[link] != group or clusters.of_link[link] == clusters.of_link[link + 1]:
                continue
            speed = speed_bound(packed, X_HL, link, active)
            if speed == 0.0:
                continue
            link_pose_in_object(X_OH, X_HL, link, X)
            reach = step * speed + CONTACT_M
            distance = sphere_distance(values, origin, inv_spacing, packed, X, link)
            if distance < reach:
                distance = link_distance_using(values, origin, inv_spacing, packed, clusters, X, link, reach, at_centre)
                if distance < CONTACT_M:
                    _freeze(packed, link, active)
                    continue
            step = min(step, (distance - 0.5 * CONTACT_M) / speed)
        moving = False
        for j in range(q.shape[0]):
            if active[j]:
                q[j] = min(max(q[j] + step * packed.closing_rate[j], packed.lower[j]), packed.upper[j])
                moving = True
        if not moving:
            break
        pose_links(packed, q, X_HL)


@njit(cache=True, error_model="numpy")
def _nearest_normal(values, origin, inv_spacing, packed, X, link):  # type: ignore[no-untyped-def]
    """Distance of a link's nearest point to the object, and the object's outward normal there."""
    best, x, y, z = 1.0e9, 0.0, 0.0, 0.0
    for k in range(packed.link_point_start[link], packed.link_point_start[link + 1]):
        px, py, pz = moved_point(X, packed.point_L[k, 0], packed.point_L[k, 1], packed.point_L[k, 2])
        d = grid_distance(values, origin, inv_spacing, px, py, pz)
        if d < best:
            best, x, y, z = d, px, py, pz
    _, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, x, y, z)
    norm = math.sqrt(gx * gx + gy * gy + gz * gz) + 1.0e-12
    return best, gx / norm, gy / norm, gz / norm


@njit(cache=True, error_model="numpy")
def _touches(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, link, X, at_centre):  # type: ignore[no-untyped-def]
    """Whether a link is within `_NEAR_M` of the object; leaves its pose in `X`."""
    if clusters.of_link[link] == clusters.of_link[link + 1]:
        return False
    link_pose_in_object(X_OH, X_HL, link, X)
    if sphere_distance(values, origin, inv_spacing, packed, X, link) >= _NEAR_M:
        return False
    d = link_distance_using(values, origin, inv_spacing, packed, clusters, X, link, _NEAR_M, at_centre)
    return d < _NEAR_M


@njit(cache=True, error_model="numpy")
def _give_way(values, origin, inv_spacing, packed, clusters, closing, group, X_OH, X_HL, X, at_centre):  # type: ignore[no-untyped-def]
    """Shift a hand away from what its coupled fingers touch, by no more than the rest of it has room for.

    Returns the shift in metres; 0 when all fingers of the group touch, or the contacts balance or block each other.
    """
    links = packed.link_radius.shape[0]
    nx = ny = nz = 0.0
    touching, free = 0, False
    for link in range(links):
        if closing.link_group[link] != group:
            continue
        first = closing.branch[link] >= 0  # the innermost link of its branch that touches speaks for the branch
        branch_touches = False
        for other in range(links):
            same = closing.link_group[other] == group and closing.branch[other] == closing.branch[link]
            if same and _touches(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, other, X, at_centre):
                branch_touches = True
                first = first and other >= link
        free = free or (closing.branch[link] >= 0 and not branch_touches)
        if first and _touches(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, link, X, at_centre):
            _, gx, gy, gz = _nearest_normal(values, origin, inv_spacing, packed, X, link)
            nx, ny, nz, touching = nx + gx, ny + gy, nz + gz, touching + 1
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    if touching == 0 or not free or norm < _BALANCED * touching:
        return 0.0
    nx, ny, nz = nx / norm, ny / norm, nz / norm
    shift = LARGEST_SHIFT_M
    for link in range(links):
        if clusters.of_link[link] == clusters.of_link[link + 1]:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        if sphere_distance(values, origin, inv_spacing, packed, X, link) >= shift + CONTACT_M:
            continue
        d, gx, gy, gz = _nearest_normal(values, origin, inv_spacing, packed, X, link)
        if gx * nx + gy * ny + gz * nz < _AGAINST:  # it comes nearer, by no more than the shift
            shift = min(shift, 0.5 * d)  # half: closing takes up the rest from the other side
    if shift < _LEAST_SHIFT_M:
        return 0.0
    X_OH[0, 3] += shift * nx
    X_OH[1, 3] += shift * ny
    X_OH[2, 3] += shift * nz
    return shift


@njit(cache=True, error_model="numpy")
def close_fingers(values, origin, inv_spacing, packed, clusters, closing, X_OH, q, X_HL):  # type: ignore[no-untyped-def]
    """Close one hand in place: `q` (J,) and its link poses `X_HL` (L, 4, 4) end in contact.

    `X_OH` changes where fingers share a joint: the hand gives way until they all touch.

    Returns False when the start already penetrates by more than `START_OVERLAP_M`.
    """
    scratch = new_close_scratch(packed, clusters)
    return close_fingers_using(values, origin, inv_spacing, packed, clusters, closing, X_OH, q, X_HL, scratch)


@njit(cache=True, error_model="numpy")
def close_fingers_using(values, origin, inv_spacing, packed, clusters, closing, X_OH, q, X_HL, scratch):  # type: ignore[no-untyped-def]
    """`close_fingers` without allocating, for CPU and GPU."""
    X, at_centre, active = scratch.pose, scratch.at_centre, scratch.active
    pose_links(packed, q, X_HL)
    clearance = hand_clearance_using(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, X, at_centre)
    if clearance < -START_OVERLAP_M:
        return False
    for group in range(closing.groups):
        shared = False
        for link in range(closing.branch.shape[0]):
            shared = shared or (closing.link_group[link] == group and closing.branch[link] >= 0)
        gone = 0.0
        for turn in range(MAX_SHIFTS + 1):
            for j in range(q.shape[0]):
                active[j] = closing.group[j] == group
            _close_group(
                values, origin, inv_spacing, packed, clusters, closing, group, X_OH, q, X_HL, active, X, at_centre
            )
            if not shared or gone > ALL_SHIFTS_M or turn == MAX_SHIFTS:
                break
            shift = _give_way(values, origin, inv_spacing, packed, clusters, closing, group, X_OH, X_HL, X, at_centre)
            if shift == 0.0:
                break
            gone += shift
    return True


@njit(cache=True, error_model="numpy")
def close_jaw(values, origin, inv_spacing, packed, clusters, closing, X_OH, q, X_HL):  # type: ignore[no-untyped-def]
    """Close a parallel jaw in place and centre it: `q` (J,), `X_OH` and `X_HL` change.

    Both pads advance by their own distance at once: half of the sum closes the jaw, half of the
    difference shifts the hand. Returns True when both pads touch and nothing penetrates.
    """
    scratch = new_close_scratch(packed, clusters)
    return close_jaw_using(values, origin, inv_spacing, packed, clusters, closing, X_OH, q, X_HL, scratch)


@njit(cache=True, error_model="numpy")
def close_jaw_using(values, origin, inv_spacing, packed, clusters, closing, X_OH, q, X_HL, scratch):  # type: ignore[no-untyped-def]
    """`close_jaw` without allocating, for CPU and GPU."""
    X, at_centre = scratch.pose, scratch.at_centre
    for _ in range(MAX_STEPS):
        pose_links(packed, q, X_HL)
        against = palm = along = 1.0e9  # distances of the links that close against the axis, not at all, and along it
        for link in range(closing.side.shape[0]):
            if clusters.of_link[link] == clusters.of_link[link + 1]:
                continue
            link_pose_in_object(X_OH, X_HL, link, X)
            side = closing.side[link]
            nearest = against if side < 0 else (along if side > 0 else palm)
            if sphere_distance(values, origin, inv_spacing, packed, X, link) < nearest:
                nearest = link_distance_using(
                    values, origin, inv_spacing, packed, clusters, X, link, nearest, at_centre
                )
                if side < 0:
                    against = nearest
                elif side > 0:
                    along = nearest
                else:
                    palm = nearest
        if min(against, palm, along) < -START_OVERLAP_M:
            return False
        if against < CONTACT_M and along < CONTACT_M:
            return True
        minus, plus = max(against - 0.5 * CONTACT_M, 0.0), max(along - 0.5 * CONTACT_M, 0.0)
        room = 1.0e9
        for j in range(q.shape[0]):
            if closing.unit[j] != 0.0:
                end = packed.upper[j] if closing.unit[j] > 0.0 else packed.lower[j]
                room = min(room, max((end - q[j]) / closing.unit[j], 0.0))
        free = max(palm - 1.0e-4, 0.0)  # how far the palm may shift
        shift = min(max(0.5 * (plus - minus), -free), free)
        advance = min(plus - shift, minus + shift, room)
        if advance < 1.0e-6 and abs(shift) < 1.0e-6:
            return False
        for j in range(q.shape[0]):
            q[j] += advance * closing.unit[j]
        for k in range(3):
            for m in range(3):
                X_OH[k, 3] += shift * X_OH[k, m] * closing.axis_H[m]
    return False
