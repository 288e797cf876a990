"""Settle closed hands on an object: open what overlaps it, and relax the fingers that do not touch.

Closing keeps a few hundred points of the hand out of the object. Between them, and where an edge of the object cuts
into a flat link, a little overlap is left. Here it is looked for both ways at fine points, and a link that overlaps is
opened, the palm drawn back, by about the depth, until less than a tolerance is left.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, rigid_inverse, rigid_product
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.grasps.contact import link_is_farther, link_pose_in_object
from neuralgrasps.grasps.penetration import depth_in_part, self_penetration
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.parallel import blocks, thread_map
from neuralgrasps.synthesis.candidates import Candidates, GraspProblem
from neuralgrasps.synthesis.close import speed_bound
from neuralgrasps.synthesis.clusters import link_distance, sphere_distance

TOLERANCE_M = 2.0e-4  # overlap that is left alone
_STEPS = 10
_OVERSHOOT = 1.2  # a link's own speed is below the bound that a step is computed from
_RELAXED = (0.45, 0.3, 0.6, 0.15, 0.0)  # shares of the way to the limits at which an idle finger may rest
_IDLE_GAP_M = 2.0e-3  # that it keeps from the object


@njit(cache=True, error_model="numpy")
def link_overlaps(values, origin, inv_spacing, fine, probe, X_OH, X_HL, depth):  # type: ignore[no-untyped-def]
    """Overlap of each link with the object into `depth` (L,), metres, >= 0.

    The link's points in the object's grid, and the object's points in the link's parts.
    """
    X_OL, X_LO, X_PO = np.empty((3, 4)), np.empty((3, 4)), np.empty((3, 4))
    for link in range(depth.shape[0]):
        depth[link] = 0.0
        start, end = fine.link_point_start[link], fine.link_point_start[link + 1]
        if start == end:
            continue
        link_pose_in_object(X_OH, X_HL, link, X_OL)
        if link_is_farther(values, origin, inv_spacing, fine, X_OL, link, 0.0):
            continue
        for k in range(start, end):
            p = fine.point_L[k]
            x, y, z = moved_point(X_OL, p[0], p[1], p[2])
            depth[link] = max(depth[link], -grid_distance(values, origin, inv_spacing, x, y, z))
    for part in range(len(fine.part_kind)):
        link = fine.part_link[part]
        link_pose_in_object(X_OH, X_HL, link, X_OL)
        m, radius = fine.part_centre[part], fine.part_radius[part]
        cx, cy, cz = moved_point(X_OL, m[0], m[1], m[2])
        rigid_inverse(X_OL, X_LO)
        rigid_product(fine.part_X_PL[part], X_LO, X_PO)
        for g in range(len(probe.radius)):
            x, y, z = probe.centre[g, 0], probe.centre[g, 1], probe.centre[g, 2]
            if (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 >= (radius + probe.radius[g]) ** 2:
                continue
            u, v, w = moved_point(X_PO, x, y, z)
            if depth_in_part(fine, part, u, v, w) + probe.radius[g] <= depth[link]:
                continue
            for i in range(probe.start[g], probe.start[g + 1]):
                u, v, w = moved_point(X_PO, probe.points[i, 0], probe.points[i, 1], probe.points[i, 2])
                depth[link] = max(depth[link], depth_in_part(fine, part, u, v, w))


@njit(cache=True, error_model="numpy")
def _carries(packed, link, active):  # type: ignore[no-untyped-def]
    """Mark the closing joints that move `link`."""
    active[:] = False
    i = link
    while i > 0:
        for j in range(active.shape[0]):
            if packed.coupling[i, j] != 0.0 and packed.closing_rate[j] != 0.0:
                active[j] = True
        i = packed.parents[i]


@njit(cache=True, error_model="numpy")
def _open_jaw(fine, closing, excess, X_OH, q):  # type: ignore[no-untyped-def]
    """Open a jaw by half of what its two sides overlap together, and shift it by half of the difference.

    So the pad that overlaps is cleared and the other one stays on the object. `excess` (L,) per link, metres.
    """
    minus = plus = 0.0
    for link in range(excess.shape[0]):
        if closing.side[link] < 0:
            minus = max(minus, excess[link])
        elif closing.side[link] > 0:
            plus = max(plus, excess[link])
    for j in range(q.shape[0]):
        q[j] = min(max(q[j] - 0.5 * (minus + plus) * closing.unit[j], fine.lower[j]), fine.upper[j])
    for k in range(3):
        for m in range(3):
            X_OH[k, 3] += 0.5 * (minus - plus) * X_OH[k, m] * closing.axis_H[m]


@njit(cache=True, error_model="numpy")
def _open_fingers(fine, X_HL, excess, active, back, q):  # type: ignore[no-untyped-def]
    """Open the joints that carry a link that overlaps by `excess` (L,), metres, as far as clears it at full speed."""
    back[:] = 0.0
    for link in range(excess.shape[0]):
        if excess[link] > 0.0:
            _carries(fine, link, active)
            speed = speed_bound(fine, X_HL, link, active)
            for j in range(q.shape[0]):
                if active[j] and speed > 0.0:
                    back[j] = max(back[j], _OVERSHOOT * excess[link] / speed)
    for j in range(q.shape[0]):
        q[j] = min(max(q[j] - back[j] * fine.closing_rate[j], fine.lower[j]), fine.upper[j])


@njit(cache=True, error_model="numpy")
def draw_apart(  # type: ignore[no-untyped-def]
    values, origin, inv_spacing, fine, probe, closing, is_jaw, approach_H, tolerance, X_OH, q, X_HL, depth
):
    """Open links and draw the hand back until no link overlaps by more than `tolerance`; returns the deepest left."""
    active, back, excess = np.empty(q.shape[0], np.bool_), np.empty(q.shape[0]), np.empty(depth.shape[0])
    for step in range(_STEPS + 1):
        pose_links(fine, q, X_HL)
        link_overlaps(values, origin, inv_spacing, fine, probe, X_OH, X_HL, depth)
        if depth.max() <= tolerance or step == _STEPS:
            break
        away = 0.0
        for link in range(depth.shape[0]):
            excess[link] = depth[link] - 0.5 * tolerance if depth[link] > tolerance else 0.0
            if closing.link_group[link] < 0:
                away = max(away, excess[link])
        for k in range(3):
            for m in range(3):
                X_OH[k, 3] -= _OVERSHOOT * away * X_OH[k, m] * approach_H[m]
        if is_jaw:
            _open_jaw(fine, closing, excess, X_OH, q)
        else:
            _open_fingers(fine, X_HL, excess, active, back, q)
    return depth.max()


@njit(cache=True, error_model="numpy")
def _group_is_nearer(values, origin, inv_spacing, packed, clusters, closing, group, X_OH, X_HL, distance, X):  # type: ignore[no-untyped-def]
    """Whether a link of the group comes nearer to the object than `distance`."""
    for link in range(packed.link_radius.shape[0]):
        if closing.link_group[link] != group or clusters.of_link[link] == clusters.of_link[link + 1]:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        near = sphere_distance(values, origin, inv_spacing, packed, X, link) < distance
        if near and link_distance(values, origin, inv_spacing, packed, clusters, X, link, distance) < distance:
            return True
    return False


@njit(cache=True, error_model="numpy")
def relax_idle(  # type: ignore[no-untyped-def]
    values, origin, inv_spacing, packed, clusters, closing, q_open, threshold, max_self_depth, X_OH, q, X_HL, idle
):
    """Half curl the fingers that touch nothing, where there is room; marks their joints in `idle` (J,)."""
    X, before = np.empty((3, 4)), np.empty(q.shape[0])
    for group in range(closing.groups):
        if _group_is_nearer(values, origin, inv_spacing, packed, clusters, closing, group, X_OH, X_HL, threshold, X):
            continue
        before[:] = q
        for j in range(q.shape[0]):
            idle[j] = idle[j] or closing.group[j] == group
        for share in _RELAXED:
            for j in range(q.shape[0]):
                if closing.group[j] == group:
                    end = packed.upper[j] if packed.closing_rate[j] > 0.0 else packed.lower[j]
                    q[j] = q_open[j] + share * (end - q_open[j])
            pose_links(packed, q, X_HL)
            if (
                not _group_is_nearer(
                    values, origin, inv_spacing, packed, clusters, closing, group, X_OH, X_HL, _IDLE_GAP_M, X
                )
                and self_penetration(packed, X_HL) <= max_self_depth
            ):
                break
        else:
            q[:] = before
            pose_links(packed, q, X_HL)


@njit(cache=True, error_model="numpy", nogil=True)
def _settle(  # type: ignore[no-untyped-def]
    values, origin, inv_spacing, packed, clusters, closing, fine, probe, is_jaw, approach_H, q_open, tolerance,
    threshold, max_self_depth, X_OH, q, idle, penetration,
):  # fmt: skip
    X_HL = np.zeros((packed.link_radius.shape[0], 4, 4))
    depth = np.empty(packed.link_radius.shape[0])
    for i in range(q.shape[0]):
        idle[i] = False
        left = draw_apart(
            values, origin, inv_spacing, fine, probe, closing, is_jaw, approach_H, tolerance, X_OH[i], q[i], X_HL, depth
        )
        if not is_jaw:
            relax_idle(
                values, origin, inv_spacing, packed, clusters, closing, q_open, threshold, max_self_depth,
                X_OH[i], q[i], X_HL, idle[i],
            )  # fmt: skip
        penetration[i] = max(left, self_penetration(packed, X_HL))


def settle(problem: GraspProblem, closed: Candidates, *, threads: int = 1) -> tuple[Candidates, np.ndarray]:
    """Candidates without the overlap that closing left, idle fingers half curled.

    Returns:
        The candidates, changed in `X_OH`, `q` and `penetration_m` (of the distance grid, both ways, and of the hand in
        itself; not below `TOLERANCE_M` for all of them), and which joints (N, J) belong to fingers that touch nothing.
    """
    X_OH, q = np.ascontiguousarray(closed.X_OH).copy(), np.ascontiguousarray(closed.q).copy()
    idle, penetration = np.zeros(q.shape, np.bool_), np.zeros(len(q))
    hand = problem.hand

    def run(rows: slice) -> None:
        _settle(
            *problem.sdf_arrays, problem.packed, problem.clusters, problem.closing, problem.hand_probe, problem.probe,
            hand.is_jaw, np.ascontiguousarray(hand.X_HP[:3, 2]), hand.q_open, TOLERANCE_M, problem.contact_threshold_m,
            problem.max_penetration_m, X_OH[rows], q[rows], idle[rows], penetration[rows],
        )  # fmt: skip

    thread_map(run, blocks(len(q), threads), threads=threads)
    return replace(closed, X_OH=X_OH, q=q, penetration_m=penetration), idle
