"""Start poses for grasping: antipodal pairs for jaws, approach and preshape for other hands.

Random numbers are drawn in one call per batch, so a proposal is a function of (seed, batch) only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.sdf_grid import grid_distance, grid_distance_gradient
from neuralgrasps.hands.extent import hand_extent, lowest_height
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import blocks, thread_map
from neuralgrasps.synthesis.assess import advance_all
from neuralgrasps.synthesis.candidates import GraspProblem
from neuralgrasps.synthesis.jaw import jaw_aperture, jaw_postures, pad_middles, widest_grip
from neuralgrasps.synthesis.oppose import opposition, perpendicular, pose_on_pair, thumb_and_fingers
from neuralgrasps.synthesis.squeeze import pregrasp_joints
from neuralgrasps.synthesis.support import Support

START_GAP_M = 1.0e-3  # an open hand advances until it is this near
BACK_OFF_M = 0.012
MAX_SPAN_M = 0.15  # wider pairs are not looked for
OPPOSED_SHARE = 0.7
DRAWS = 4  # pairs drawn per proposal: many are too wide, and drawing costs a hundredth of closing
TIP_M = 0.004  # of the pads' length at their tips that nothing is planned to be held with
LIFT_M = 0.015  # that a hand may be drawn back, so that its fingertips do not meet the support
MORE_PAIRS = 4  # times as many are drawn beside a support, where most do not fit
STEEPEST_UP = 0.2  # sine of the slope at which a hand may come from below level, beside a support


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposals:
    """Start poses `X_OH` (N, 4, 4) and postures `q` (N, J) from which the hand closes."""

    X_OH: np.ndarray
    q: np.ndarray


def poses_from_palm(X_HP: np.ndarray, origin_O: np.ndarray, x_axis: np.ndarray, z_axis: np.ndarray) -> np.ndarray:
    """Hand poses (N, 4, 4) that put the palm frame (one or N) at `origin_O` with the given unit, perpendicular axes."""
    X_OP = np.zeros((len(origin_O), 4, 4))
    X_OP[:, :3, 0] = x_axis
    X_OP[:, :3, 1] = np.cross(z_axis, x_axis)
    X_OP[:, :3, 2] = z_axis
    X_OP[:, :3, 3] = origin_O
    X_OP[:, 3, 3] = 1.0
    return X_OP @ np.linalg.inv(X_HP)


@njit(cache=True, error_model="numpy")
def _trace_through(values, origin, inv_spacing, start, direction, max_width, out_exit, out_normal):  # type: ignore[no-untyped-def]
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
def _antipodal_pairs(values, origin, inv_spacing, points, directions, max_width, cos_cone, exits, keep):  # type: ignore[no-untyped-def]
    normal = np.empty(3)
    for i in range(points.shape[0]):
        found = _trace_through(values, origin, inv_spacing, points[i], directions[i], max_width, exits[i], normal)
        along = normal[0] * directions[i, 0] + normal[1] * directions[i, 1] + normal[2] * directions[i, 2]
        keep[i] = found and along >= cos_cone


def draw_pairs(
    obj: ObjectModel, count: int, friction: float, max_width: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface points (count, 3), where rays from them leave the object (count, 3), and which are antipodal (count,).

    Most rays lie somewhere in the inward friction cone, 30 % along the normal.
    """
    index = rng.integers(len(obj.points_O), size=count)
    tilt = math.atan(friction) * np.sqrt(rng.random(count)) * (rng.random(count) < 0.7)
    side = rng.random(count) * 2 * np.pi
    inward = -obj.normals_O[index]
    direction = np.cos(tilt)[:, None] * inward + np.sin(tilt)[:, None] * perpendicular(inward, side)
    start = np.ascontiguousarray(obj.points_O[index])
    exits, keep = np.zeros_like(start), np.zeros(count, np.bool_)
    sdf = obj.sdf
    _antipodal_pairs(
        sdf.values, sdf.origin, sdf.inv_spacing, start, np.ascontiguousarray(direction), max_width,
        math.cos(math.atan(friction)), exits, keep,
    )  # fmt: skip
    return start, exits, keep


def propose_jaw(
    hand: Hand,
    obj: ObjectModel,
    *,
    count: int,
    friction: float,
    pad_depth_m: float,
    rng: np.random.Generator,
    support: Support | None = None,
) -> Proposals:
    """Antipodal candidates: a surface point, a ray in its inward friction cone, the far side within its cone.

    At most `count` come back (pairs that fail the cone or the aperture are dropped).
    Roll about the closing axis is uniform; the object's middle lies within `pad_depth_m` of the pads' middle.
    Beside a `support`, `DRAWS` times as many are drawn, hands come level or from above, as deep as it lets them
    (`deepest_beside`), and those that meet it are dropped.
    """
    widest = jaw_aperture(hand) - 2.0e-3 if support is None else widest_grip(hand)
    draws = count if support is None else DRAWS * count
    start, exits, keep = draw_pairs(obj, draws, friction, widest, rng)
    roll = rng.random(draws) * 2 * np.pi
    share = rng.uniform(-1.0, 1.0, draws)
    start, exits, roll, share = (a[keep] for a in (start, exits, roll, share))
    depth = share * pad_depth_m
    width = np.linalg.norm(exits - start, axis=1)
    x_axis = (exits - start) / width[:, None]
    z_axis = perpendicular(x_axis, roll)
    if support is not None:
        z_axis *= np.where(z_axis @ support.plane.normal > 0.0, -1.0, 1.0)[:, None]
    X_HP_pad = np.repeat(hand.X_HP[None], len(start), axis=0)
    X_HP_pad[:, :3, 3] = pad_middles(hand, width)
    centre = 0.5 * (start + exits)
    if support is not None:
        at_middle = poses_from_palm(X_HP_pad, centre, x_axis, z_axis)
        depth, fits = depths_beside(hand, support, at_middle, width, share, pad_depth_m)
        chosen = np.flatnonzero(fits)[:count]
        centre, depth, x_axis, z_axis, X_HP_pad = (a[chosen] for a in (centre, depth, x_axis, z_axis, X_HP_pad))
    centre = centre + depth[:, None] * z_axis
    q = np.repeat(hand.q_open[None], len(centre), axis=0)
    return Proposals(X_OH=poses_from_palm(X_HP_pad, centre, x_axis, z_axis), q=q)


def depths_beside(
    hand: Hand, support: Support, X_OH: np.ndarray, width: np.ndarray, share: np.ndarray, pad_depth_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """How deep jaws that come from above or level may go, drawn by `share` (N,) in [-1, 1], and which (N,) fit at all.

    Of the depths within `pad_depth_m` of the pads' middle, those that the support allows; where they are few, the
    pads hold the object nearer to their tips, up to `TIP_M` of them.

    Args:
        X_OH: (N, 4, 4) jaws at depth 0. width: (N,) of what they are to close on.
    """
    q = jaw_postures(hand, width)
    opened = pregrasp_joints(hand, q)
    height = np.minimum(*(lowest_height(hand, X_OH, posture, support.plane) for posture in (q, opened)))
    steep = np.maximum(support.steepness(hand, X_OH), 0.0)
    room = height - support.clearance_m
    most = np.where(room >= 0.0, np.inf, -np.inf)
    np.divide(room, steep, out=most, where=steep > 1e-6)
    fingers = [link for finger in hand.fingers for link in finger.links]
    approach_H = np.repeat(hand.X_HP[None, :3, 2], len(q), axis=0)
    tips = hand_extent(hand, q, approach_H, links=fingers) - pad_middles(hand, width) @ hand.X_HP[:3, 2]
    shallowest = TIP_M - tips
    high = np.minimum(most, pad_depth_m)
    low = np.maximum(shallowest, np.minimum(-pad_depth_m, high - TIP_M))
    fits = high > shallowest
    with np.errstate(invalid="ignore"):
        return np.where(fits, low + 0.5 * (share + 1.0) * (high - low), 0.0), fits


def draw_preshapes(hand: Hand, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, J) postures between the preshape limits; grouped joints share a number, plus 10 % of their own."""
    shared = np.empty((count, hand.num_dofs))
    for group in hand.preshape_groups:
        shared[:, list(group)] = rng.random((count, 1))
    own = rng.random((count, hand.num_dofs))
    u = np.clip(shared + 0.2 * (own - 0.5), 0.0, 1.0)
    return hand.preshape_lower + u * (hand.preshape_upper - hand.preshape_lower)


def _reach(hand: Hand, obj: ObjectModel) -> float:
    """From where a hand's base clears the object in any direction, metres."""
    low, high = obj.mesh.bounds
    X_HL = forward_fast(hand.tree, hand.q_open)
    size = np.linalg.norm(X_HL[:, :3, 3] - hand.X_HP[:3, 3], axis=1).max()
    return float(np.linalg.norm(high - low) + size + 0.15)


def _advance(
    problem: GraspProblem,
    X_OH: np.ndarray,
    q: np.ndarray,
    approach: np.ndarray,
    reach: float,
    *,
    touching: bool,
    threads: int,
) -> np.ndarray:
    """Travel (N,) of hands that start at `X_OH`, -1 where it ends as it should not; see `advance_hand`."""
    if problem.device == "cuda":
        return problem.on_gpu().advance(X_OH, q, approach, contact_m=START_GAP_M, farthest=reach, touching=touching)
    pair, travel, approach = problem.arrays, np.empty(len(q)), np.ascontiguousarray(approach)

    def run(rows: slice) -> None:
        advance_all(pair, X_OH[rows], q[rows], approach[rows], START_GAP_M, reach, touching, travel[rows])

    thread_map(run, blocks(len(q), threads), threads=threads)
    return travel


def _chosen(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray, hit: np.ndarray) -> Proposals:
    """The open hands that `hit` (N,) marks; beside a support, those whose palm is clear of it."""
    if problem.support is not None:
        hit = hit & problem.support.clears_open(problem.hand, X_OH, q)
    return Proposals(X_OH=X_OH[hit], q=q[hit])


def propose_approach(problem: GraspProblem, *, count: int, rng: np.random.Generator, threads: int = 1) -> Proposals:
    """Approach a random surface point along its normal (sd 0.35), random roll and preshape, up to first contact.

    70 % of the hands then back off by |N(0, 12 mm)|; the rest stay with the palm or a finger touching.
    """
    hand, obj = problem.hand, problem.obj
    draws = count if problem.support is None else DRAWS * count
    index = rng.integers(len(obj.points_O), size=draws)
    approach = -obj.normals_O[index] + 0.35 * rng.standard_normal((draws, 3))
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    roll = rng.random(draws) * 2 * np.pi
    back = np.abs(rng.normal(0.0, BACK_OFF_M, draws)) * (rng.random(draws) < 0.7)
    q = draw_preshapes(hand, draws, rng)
    if problem.support is not None:
        chosen = np.flatnonzero(approach @ problem.support.plane.normal < STEEPEST_UP)[:count]
        index, approach, roll = index[chosen], approach[chosen], roll[chosen]
        back, q = back[chosen], q[chosen]
    reach = _reach(hand, obj)
    X_OH = poses_from_palm(hand.X_HP, obj.points_O[index] - reach * approach, perpendicular(approach, roll), approach)
    travel = _advance(problem, X_OH, q, approach, reach + 0.05, touching=True, threads=threads)
    X_OH[:, :3, 3] += (travel - back)[:, None] * approach
    return _chosen(problem, X_OH, q, travel > 0.0)


def lifted_off(hand: Hand, support: Support, X_OH: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hands (N, 4, 4) drawn back along their approach until they clear the support at joints q (N, J).

    By up to `LIFT_M`, so that fingertips hold higher up, what they were to hold in the middle; and which (N,) then do.
    """
    steep = support.steepness(hand, X_OH)
    short = np.maximum(support.clearance_m - lowest_height(hand, X_OH, q, support.plane), 0.0)
    lift = np.where(short > 0.0, np.inf, 0.0)
    np.divide(short, steep, out=lift, where=(short > 0.0) & (steep > 0.0))
    fits = (lift <= LIFT_M) & (steep > -STEEPEST_UP)
    X_OH = X_OH.copy()
    X_OH[:, :3, 3] -= np.where(fits, lift, 0.0)[:, None] * (X_OH[:, :3, :3] @ hand.X_HP[:3, 2])
    return X_OH, fits


def propose_opposed(
    problem: GraspProblem, *, count: int, friction: float, rng: np.random.Generator, threads: int = 1
) -> Proposals:
    """Thumb and fingers on the two sides of an antipodal pair, reached along the palm's normal up to first contact.

    Pairs that fail the friction cone, and those that do not fit between the tips of their preshape, are dropped;
    `DRAWS` are made per proposal, and fewer than `count` may come back. The hand needs a thumb.
    """
    hand = problem.hand
    found = thumb_and_fingers(hand)
    assert found is not None
    more = 1 if problem.support is None else MORE_PAIRS
    draws = more * DRAWS * count
    start, exits, keep = draw_pairs(problem.obj, draws, friction, MAX_SPAN_M, rng)
    roll = rng.random(draws) * 2 * np.pi
    back = np.abs(rng.normal(0.0, BACK_OFF_M, draws)) * (rng.random(draws) < 0.3)
    share = rng.dirichlet(np.ones(len(found[1])), draws)
    q = draw_preshapes(hand, draws, rng)
    kept = np.flatnonzero(keep)[: 2 * more * count]
    start, exits, roll, back, share, q = (a[kept] for a in (start, exits, roll, back, share, q))
    thumb_H, fingers_H, met, q_met = opposition(hand, problem.packed, q, share, np.linalg.norm(exits - start, axis=1))
    X_OH = pose_on_pair(thumb_H, fingers_H, start, exits, roll)
    if problem.support is not None:
        from_below = problem.support.steepness(hand, X_OH) < 0.0
        X_OH = pose_on_pair(thumb_H, fingers_H, start, exits, roll + np.pi * from_below)
        X_OH, fits = lifted_off(hand, problem.support, X_OH, q_met)
        met &= fits
    chosen = np.flatnonzero(met)[:count]
    X_OH, q, back = X_OH[chosen], q[chosen], back[chosen]
    approach = X_OH[:, :3, :3] @ hand.X_HP[:3, 2]
    reach = _reach(hand, problem.obj)
    X_OH[:, :3, 3] -= reach * approach
    travel = _advance(problem, X_OH, q, approach, reach, touching=False, threads=threads)
    X_OH[:, :3, 3] += (travel - back)[:, None] * approach
    return _chosen(problem, X_OH, q, travel > 0.0)


def propose_dexterous(
    problem: GraspProblem, *, count: int, friction: float, rng: np.random.Generator, threads: int = 1
) -> Proposals:
    """`propose_opposed` for most of `count` where the hand has a thumb, `propose_approach` for the rest."""
    opposed = round(OPPOSED_SHARE * count) if thumb_and_fingers(problem.hand) else 0
    plain = propose_approach(problem, count=count - opposed, rng=rng, threads=threads)
    if opposed == 0:
        return plain
    paired = propose_opposed(problem, count=opposed, friction=friction, rng=rng, threads=threads)
    return Proposals(X_OH=np.concatenate([plain.X_OH, paired.X_OH]), q=np.concatenate([plain.q, paired.q]))
