"""Close a hand on an object without ever passing through it (conservative advancement).

Every step moves each surface point by less than its distance to the object, so the closed hand is free of
penetration up to the spacing of its surface points. A link that touches stops the joints that
carry it; joints further out go on (the breakaway of underactuated fingers is this).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.grasps.contact import link_pose_in_object
from neuralgrasps.kinematics.forward_kernels import link_poses

CONTACT_M = 3.0e-4  # a link closer than this touches
MAX_STEPS = 80


@njit(cache=True, error_model="numpy")
def _bound(values, origin, inv_spacing, packed, X, link):
    """Lower bound of a link's distance to the object, from its bounding sphere."""
    c = packed.link_centre[link]
    x = X[0, 0] * c[0] + X[0, 1] * c[1] + X[0, 2] * c[2] + X[0, 3]
    y = X[1, 0] * c[0] + X[1, 1] * c[1] + X[1, 2] * c[2] + X[1, 3]
    z = X[2, 0] * c[0] + X[2, 1] * c[1] + X[2, 2] * c[2] + X[2, 3]
    return grid_distance(values, origin, inv_spacing, x, y, z) - packed.link_radius[link]


@njit(cache=True, error_model="numpy")
def _link_distance(values, origin, inv_spacing, packed, X, link):
    """Smallest signed distance of a link's surface points to the object."""
    best = 1.0e9
    for k in range(packed.link_point_start[link], packed.link_point_start[link + 1]):
        p = packed.point_L[k]
        x = X[0, 0] * p[0] + X[0, 1] * p[1] + X[0, 2] * p[2] + X[0, 3]
        y = X[1, 0] * p[0] + X[1, 1] * p[1] + X[1, 2] * p[2] + X[1, 3]
        z = X[2, 0] * p[0] + X[2, 1] * p[1] + X[2, 2] * p[2] + X[2, 3]
        best = min(best, grid_distance(values, origin, inv_spacing, x, y, z))
    return best


@njit(cache=True, error_model="numpy")
def hand_clearance(values, origin, inv_spacing, packed, X_OH, X_HL):
    """Smallest signed distance, metres, of the hand's surface points to the object."""
    X = np.empty((3, 4))
    best = 1.0e9
    for link in range(packed.link_radius.shape[0]):
        if packed.link_point_start[link] == packed.link_point_start[link + 1]:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        if _bound(values, origin, inv_spacing, packed, X, link) < best:
            best = min(best, _link_distance(values, origin, inv_spacing, packed, X, link))
    return best


@njit(cache=True, error_model="numpy")
def _speed_bound(packed, X_HL, link, rate, active):
    """Largest speed (m/s) that any point of a link can have while the active joints close."""
    c = packed.link_centre[link]
    centre0 = X_HL[link, 0, 0] * c[0] + X_HL[link, 0, 1] * c[1] + X_HL[link, 0, 2] * c[2] + X_HL[link, 0, 3]
    centre1 = X_HL[link, 1, 0] * c[0] + X_HL[link, 1, 1] * c[1] + X_HL[link, 1, 2] * c[2] + X_HL[link, 1, 3]
    centre2 = X_HL[link, 2, 0] * c[0] + X_HL[link, 2, 1] * c[1] + X_HL[link, 2, 2] * c[2] + X_HL[link, 2, 3]
    speed = 0.0
    i = link
    while i > 0:
        joint_rate = 0.0
        if packed.joint_types[i] != 0:
            for j in range(rate.shape[0]):
                if active[j]:
                    joint_rate += packed.coupling[i, j] * rate[j]
        if joint_rate != 0.0 and packed.joint_types[i] == 1:
            dx = centre0 - X_HL[i, 0, 3]
            dy = centre1 - X_HL[i, 1, 3]
            dz = centre2 - X_HL[i, 2, 3]
            speed += abs(joint_rate) * (math.sqrt(dx * dx + dy * dy + dz * dz) + packed.link_radius[link])
        elif joint_rate != 0.0:
            speed += abs(joint_rate)
        i = packed.parents[i]
    return speed


@njit(cache=True, error_model="numpy")
def _freeze(packed, link, rate, active):
    """Stop every closing joint that carries `link`."""
    i = link
    while i > 0:
        for j in range(rate.shape[0]):
            if packed.coupling[i, j] != 0.0 and rate[j] != 0.0:
                active[j] = False
        i = packed.parents[i]


@njit(cache=True, error_model="numpy")
def close_fingers(values, origin, inv_spacing, packed, X_OH, q, X_HL):
    """Close one hand in place: `q` (J,) and its link poses `X_HL` (L, 4, 4) end in contact.

    Returns False when the start already penetrates by more than 1 mm.
    """
    num_dofs = q.shape[0]
    rate = packed.closing_rate
    active = np.empty(num_dofs, np.bool_)
    for j in range(num_dofs):
        active[j] = rate[j] != 0.0
    X = np.empty((3, 4))
    tree = (packed.parents, packed.joint_types, packed.X_parent_joint, packed.axes, packed.coupling, packed.offset)
    link_poses(tree[0], tree[1], tree[2], tree[3], tree[4], tree[5], q, X_HL)
    if hand_clearance(values, origin, inv_spacing, packed, X_OH, X_HL) < -1.0e-3:
        return False
    for _ in range(MAX_STEPS):
        step = 1.0e9
        for j in range(num_dofs):
            if active[j]:
                room = (packed.upper[j] - q[j]) if rate[j] > 0.0 else (q[j] - packed.lower[j])
                if room < 1.0e-6:
                    active[j] = False
                else:
                    step = min(step, room / abs(rate[j]))
        for link in range(1, packed.link_radius.shape[0]):
            if packed.link_point_start[link] == packed.link_point_start[link + 1]:
                continue
            speed = _speed_bound(packed, X_HL, link, rate, active)
            if speed == 0.0:
                continue
            link_pose_in_object(X_OH, X_HL, link, X)
            distance = _bound(values, origin, inv_spacing, packed, X, link)
            if distance < step * speed + CONTACT_M:
                distance = _link_distance(values, origin, inv_spacing, packed, X, link)
                if distance < CONTACT_M:
                    _freeze(packed, link, rate, active)
                    continue
            step = min(step, (distance - 0.5 * CONTACT_M) / speed)
        moving = False
        for j in range(num_dofs):
            if active[j]:
                q[j] = min(max(q[j] + step * rate[j], packed.lower[j]), packed.upper[j])
                moving = True
        if not moving:
            break
        link_poses(tree[0], tree[1], tree[2], tree[3], tree[4], tree[5], q, X_HL)
    return True


@njit(cache=True, error_model="numpy")
def close_jaw(values, origin, inv_spacing, packed, side, axis_H, X_OH, q, X_HL):
    """Close a parallel jaw in place and centre it: `q` (1,), `X_OH` and `X_HL` change.

    `side` (L,) is +1 for links that close along `axis_H`, -1 for those that close against it, 0 for the palm.
    Both pads advance by their own distance at once: half of the sum closes the jaw, half of the
    difference shifts the hand. Returns True when both pads touch and nothing penetrates.
    """
    X = np.empty((3, 4))
    axis = np.empty(3)
    per_unit = 0.0
    for link in range(side.shape[0]):
        per_unit = max(per_unit, abs(packed.coupling[link, 0]))
    tree = (packed.parents, packed.joint_types, packed.X_parent_joint, packed.axes, packed.coupling, packed.offset)
    for _ in range(MAX_STEPS):
        link_poses(tree[0], tree[1], tree[2], tree[3], tree[4], tree[5], q, X_HL)
        plus, minus, palm = 1.0e9, 1.0e9, 1.0e9
        for link in range(side.shape[0]):
            if packed.link_point_start[link] == packed.link_point_start[link + 1]:
                continue
            link_pose_in_object(X_OH, X_HL, link, X)
            distance = _link_distance(values, origin, inv_spacing, packed, X, link)
            if side[link] > 0:
                plus = min(plus, distance)
            elif side[link] < 0:
                minus = min(minus, distance)
            else:
                palm = min(palm, distance)
        if plus < -1.0e-3 or minus < -1.0e-3 or palm < -1.0e-3:
            return False
        if plus < CONTACT_M and minus < CONTACT_M:
            return True
        plus = max(plus - 0.5 * CONTACT_M, 0.0)
        minus = max(minus - 0.5 * CONTACT_M, 0.0)
        room = (q[0] - packed.lower[0]) * per_unit
        shift = 0.5 * (plus - minus)
        free = max(palm - 1.0e-4, 0.0)
        shift = min(max(shift, -free), free)
        closing = min(min(plus - shift, minus + shift), room)
        if closing < 1.0e-6 and abs(shift) < 1.0e-6:
            return False
        q[0] -= closing / per_unit
        for k in range(3):
            axis[k] = X_OH[k, 0] * axis_H[0] + X_OH[k, 1] * axis_H[1] + X_OH[k, 2] * axis_H[2]
        for k in range(3):
            X_OH[k, 3] += shift * axis[k]
    return False
