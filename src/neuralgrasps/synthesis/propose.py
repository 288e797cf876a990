"""Start poses for grasping: antipodal pairs for jaws, approach and preshape for other hands.

Random numbers are drawn in one call per batch, so a proposal is a function of (seed, batch) only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from neuralgrasps.geometry.sdf_grid import grid_distance, grid_distance_gradient
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.candidates import GraspProblem
from neuralgrasps.synthesis.clusters import hand_clearance


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposals:
    """Start poses `X_OH` (N, 4, 4) and postures `q` (N, J) from which the hand closes."""

    X_OH: np.ndarray
    q: np.ndarray


def perpendicular(axes: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Unit vectors perpendicular to unit `axes` (N, 3), turned about them by `angle` (N,) rad."""
    helper = np.where(np.abs(axes[:, :1]) < 0.7, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    u = np.cross(axes, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axes, u)
    return np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v


def poses_from_palm(X_HP: np.ndarray, origin_O: np.ndarray, x_axis: np.ndarray, z_axis: np.ndarray) -> np.ndarray:
    """Hand poses (N, 4, 4) that put the palm frame at `origin_O` with the given axes (unit, perpendicular)."""
    X_OP = np.zeros((len(origin_O), 4, 4))
    X_OP[:, :3, 0] = x_axis
    X_OP[:, :3, 1] = np.cross(z_axis, x_axis)
    X_OP[:, :3, 2] = z_axis
    X_OP[:, :3, 3] = origin_O
    X_OP[:, 3, 3] = 1.0
    return X_OP @ np.linalg.inv(X_HP)


@njit(cache=True, error_model="numpy")
def _trace_through(values, origin, inv_spacing, start, direction, max_width, out_exit, out_normal):
    """Walk from a surface point through the object to the far side; False when wider than `max_width`."""
    travelled = 1.0e-3
    inside = False
    while travelled < max_width + 2.0e-3:
        x = start[0] + travelled * direction[0]
        y = start[1] + travelled * direction[1]
        z = start[2] + travelled * direction[2]
        d = grid_distance(values, origin, inv_spacing, x, y, z)
        if d < 0.0:
            inside = True
        elif inside or d > 2.0e-3:
            break
        travelled += max(abs(d), 2.0e-4)
    if not inside or travelled >= max_width:
        return False
    for k in range(3):
        out_exit[k] = start[k] + travelled * direction[k]
    _, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, out_exit[0], out_exit[1], out_exit[2])
    norm = math.sqrt(gx * gx + gy * gy + gz * gz) + 1e-12
    out_normal[0], out_normal[1], out_normal[2] = gx / norm, gy / norm, gz / norm
    return True


@njit(cache=True, error_model="numpy")
def _antipodal_pairs(values, origin, inv_spacing, points, directions, max_width, cos_cone, exits, keep):
    normal = np.empty(3)
    for i in range(points.shape[0]):
        found = _trace_through(values, origin, inv_spacing, points[i], directions[i], max_width, exits[i], normal)
        along = normal[0] * directions[i, 0] + normal[1] * directions[i, 1] + normal[2] * directions[i, 2]
        keep[i] = found and along >= cos_cone


def jaw_aperture(hand: Hand) -> float:
    """Largest object width, metres, that fits between the open pads of a parallel jaw."""
    travel = hand.tree.upper[0] - max(hand.tree.lower[0], 0.0)
    return float(travel * np.abs(hand.tree.coupling[:, 0]).sum())


def propose_jaw(
    hand: Hand, obj: ObjectModel, *, count: int, friction: float, pad_depth_m: float, rng: np.random.Generator
) -> Proposals:
    """Antipodal candidates: a surface point, a ray in its inward friction cone, the far side within its cone.

    At most `count` come back (pairs that fail the cone or the aperture are dropped).
    Roll about the closing axis is uniform; the object's middle lies within `pad_depth_m` of the pads' middle.
    """
    index = rng.integers(len(obj.points_O), size=count)
    tilt = math.atan(friction) * np.sqrt(rng.random(count)) * (rng.random(count) < 0.7)
    side, roll = rng.random(count) * 2 * np.pi, rng.random(count) * 2 * np.pi
    depth = rng.uniform(-1.0, 1.0, count) * pad_depth_m
    inward = -obj.normals_O[index]
    direction = np.cos(tilt)[:, None] * inward + np.sin(tilt)[:, None] * perpendicular(inward, side)
    start = np.ascontiguousarray(obj.points_O[index])
    exits, keep = np.zeros_like(start), np.zeros(count, np.bool_)
    sdf = obj.sdf
    _antipodal_pairs(
        sdf.values, sdf.origin, sdf.inv_spacing, start, np.ascontiguousarray(direction),
        jaw_aperture(hand) - 2.0e-3, math.cos(math.atan(friction)), exits, keep,
    )  # fmt: skip
    start, exits, direction, roll, depth = (a[keep] for a in (start, exits, direction, roll, depth))
    x_axis = direction
    z_axis = perpendicular(x_axis, roll)
    X_HP_pad = hand.X_HP.copy()
    X_HP_pad[:3, 3] = hand.jaw_pad_H
    centre = 0.5 * (start + exits) + depth[:, None] * z_axis
    q = np.repeat(hand.q_open[None], len(centre), axis=0)
    return Proposals(X_OH=poses_from_palm(X_HP_pad, centre, x_axis, z_axis), q=q)


def draw_preshapes(hand: Hand, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, J) postures between the preshape limits; grouped joints share a number, plus 10 % of their own."""
    shared = np.empty((count, hand.num_dofs))
    for group in hand.preshape_groups:
        shared[:, list(group)] = rng.random((count, 1))
    own = rng.random((count, hand.num_dofs))
    u = np.clip(shared + 0.2 * (own - 0.5), 0.0, 1.0)
    return hand.preshape_lower + u * (hand.preshape_upper - hand.preshape_lower)


@njit(cache=True, error_model="numpy")
def _advance_to_contact(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, approach, contact_m, max_travel, travel):
    """Sphere-trace every open hand along its approach; `travel[i]` < 0 when it passes by the object."""
    for i in range(X_OH.shape[0]):
        gone = 0.0
        X = X_OH[i].copy()
        for _ in range(60):
            d = hand_clearance(values, origin, inv_spacing, packed, clusters, X, X_HL[i])
            if d < contact_m or gone > max_travel:
                break
            gone += d - 0.5 * contact_m
            for k in range(3):
                X[k, 3] = X_OH[i, k, 3] + gone * approach[i, k]
        travel[i] = gone if d < contact_m and gone > 0.0 else -1.0


def propose_dexterous(problem: GraspProblem, *, count: int, rng: np.random.Generator) -> Proposals:
    """Approach a random surface point along its normal (sd 0.35), random roll and preshape, up to first contact.

    70 % of the hands then back off by |N(0, 12 mm)|; the rest stay with the palm or a finger touching.
    """
    hand, obj = problem.hand, problem.obj
    index = rng.integers(len(obj.points_O), size=count)
    approach = -obj.normals_O[index] + 0.35 * rng.standard_normal((count, 3))
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    roll = rng.random(count) * 2 * np.pi
    back = np.abs(rng.normal(0.0, 0.012, count)) * (rng.random(count) < 0.7)
    q = draw_preshapes(hand, count, rng)
    reach = float(np.linalg.norm(obj.points_O - obj.points_O.mean(0), axis=1).max() * 2 + 0.3)
    start = obj.points_O[index] - reach * approach
    X_OH = poses_from_palm(hand.X_HP, start, perpendicular(approach, roll), approach)
    travel = np.empty(count)
    sdf = obj.sdf
    _advance_to_contact(
        sdf.values, sdf.origin, sdf.inv_spacing, problem.packed, problem.clusters, X_OH, forward_fast(hand.tree, q),
        approach, 1.0e-3, reach + 0.05, travel,
    )  # fmt: skip
    hit = travel > 0.0
    X_OH[:, :3, 3] += (travel - back)[:, None] * approach
    return Proposals(X_OH=X_OH[hit], q=q[hit])
