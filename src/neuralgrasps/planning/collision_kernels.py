"""Compiled collision checks. They take `CheckArrays` and `Work` and may be called from other kernels.

    config_is_free(check, q_arm, work) -> bool
    edge_is_free(check, q0, q1, work) -> bool

Parts against boxes and against each other: exact distance (`convex_gap`). Parts against grids: trees of spheres, and
for the hand where `exact_hand` says so its surface points. Far things are told by spheres around links and parts.
"""

from __future__ import annotations

import math

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.shape_kernels import box_sdf
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.kinematics.forward_kernels import link_poses
from neuralgrasps.planning.convex_kernels import convex_gap
from neuralgrasps.planning.grid_kernels import grid_lower_bound

_BOX = int(PartKind.BOX)
BOXES, TARGET, OTHERS, CLOUD = 0, 1, 2, 3  # columns of margins


@njit(cache=True, error_model="numpy")
def pose_bodies(robot, q_arm, work):  # type: ignore[no-untyped-def]
    """Poses of the bodies and centres of the links, in B, at planned joints (D,), into `work`."""
    link_poses(
        robot.parents, robot.joint_types, robot.X_parent_joint, robot.axes, robot.coupling, robot.offset, q_arm,
        work.X_BK,
    )  # fmt: skip
    for g in range(robot.link_body.shape[0]):
        c = robot.link_centre[g]
        x, y, z = moved_point(work.X_BK[robot.link_body[g]], c[0], c[1], c[2])
        work.link_centre[g, 0], work.link_centre[g, 1], work.link_centre[g, 2] = x, y, z


@njit(cache=True, error_model="numpy")
def config_is_free(check, q_arm, work):  # type: ignore[no-untyped-def]
    """Whether the robot at planned joints (D,) keeps its margins to everything; joint limits are not looked at."""
    robot = check.robot
    pose_bodies(robot, q_arm, work)
    for g in range(robot.link_body.shape[0] - 1, -1, -1):  # the hand first: it is what touches most
        if robot.link_meets_world[g]:
            row = 1 if robot.link_is_hand[g] else 0
            if not link_clears_boxes(check, g, check.margins[row, BOXES], work):
                return False
            exact = check.exact_hand and row == 1
            if not link_clears_grids(robot, g, check.target, check.margins[row, TARGET], exact, work):
                return False
            if not link_clears_grids(robot, g, check.others, check.margins[row, OTHERS], exact, work):
                return False
            if not link_clears_grids(robot, g, check.cloud, check.margins[row, CLOUD], exact, work):
                return False
    for k in range(robot.pair.shape[0]):
        if not links_are_apart(robot, robot.pair[k, 0], robot.pair[k, 1], robot.pair_margin[k], work):
            return False
    return carried_is_clear(check, work)


@njit(cache=True, error_model="numpy")
def configs_are_free(check, q_arm, work, out):  # type: ignore[no-untyped-def]
    """`config_is_free` of rows (N, D) into out (N,)."""
    for n in range(q_arm.shape[0]):
        out[n] = config_is_free(check, q_arm[n], work)


@njit(cache=True, error_model="numpy")
def edge_is_free(check, q0, q1, work):  # type: ignore[no-untyped-def]
    """Whether the straight joint motion from q0 to q1 (D,), ends included, is free at steps as `check` states.

    The ends first, then the middle, then the middles of the halves: a motion that is not free is found out early.
    """
    if not (config_is_free(check, q0, work) and config_is_free(check, q1, work)):
        return False
    steps = edge_steps(check, q0, q1, work)
    if steps <= 1:
        return True
    stride = 1
    while stride < steps:
        stride *= 2
    while stride > 1:
        half = stride // 2
        for k in range(half, steps, stride):
            share = k / steps
            for j in range(q0.shape[0]):
                work.q[j] = q0[j] + share * (q1[j] - q0[j])
            if not config_is_free(check, work.q, work):
                return False
        stride = half
    return True


@njit(cache=True, error_model="numpy")
def edge_steps(check, q0, q1, work):  # type: ignore[no-untyped-def]
    """How many steps the edge from q0 to q1 (D,) is checked in.

    How far links move is measured over pieces of at most a quarter radian, as the way of their centres plus their
    radius times the angle they turn by, and a tenth more, since a link's way is longer than its chord.
    """
    robot = check.robot
    widest = 0.0
    for j in range(q0.shape[0]):
        widest = max(widest, abs(q1[j] - q0[j]))
    if widest == 0.0:
        return 1
    pieces = int(math.ceil(widest / 0.25))
    farthest = 0.0
    for piece in range(pieces + 1):
        for j in range(q0.shape[0]):
            work.q[j] = q0[j] + piece / pieces * (q1[j] - q0[j])
        work.before[:] = work.X_BK
        link_poses(
            robot.parents, robot.joint_types, robot.X_parent_joint, robot.axes, robot.coupling, robot.offset, work.q,
            work.X_BK,
        )  # fmt: skip
        if piece > 0:
            for g in range(robot.link_body.shape[0]):
                farthest = max(farthest, _link_way(robot, g, work))
    ways = 1.1 * pieces * farthest / check.max_step_m
    return max(1, int(math.ceil(max(ways, widest / check.max_step_rad))))


@njit(cache=True, error_model="numpy")
def _link_way(robot, g, work):  # type: ignore[no-untyped-def]
    """How far any point of a link moves at most, to first order, from `work.before` to `work.X_BK`."""
    body = robot.link_body[g]
    A, B, c = work.before[body], work.X_BK[body], robot.link_centre[g]
    ax, ay, az = moved_point(A, c[0], c[1], c[2])
    bx, by, bz = moved_point(B, c[0], c[1], c[2])
    trace = 0.0
    for i in range(3):
        trace += A[i, 0] * B[i, 0] + A[i, 1] * B[i, 1] + A[i, 2] * B[i, 2]
    angle = math.acos(min(max((trace - 1.0) / 2.0, -1.0), 1.0))
    return math.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) + robot.link_radius[g] * angle


@njit(cache=True, error_model="numpy")
def link_clears_boxes(check, g, margin, work):  # type: ignore[no-untyped-def]
    """Whether link g keeps `margin` to all boxes."""
    robot = check.robot
    x, y, z = work.link_centre[g, 0], work.link_centre[g, 1], work.link_centre[g, 2]
    for b in range(check.box_half.shape[0]):
        if box_distance(check, b, x, y, z) >= robot.link_radius[g] + margin:
            continue
        for part in range(robot.link_part_start[g], robot.link_part_start[g + 1]):
            c = robot.part_centre[part]
            px, py, pz = moved_point(work.X_BK[robot.link_body[g]], c[0], c[1], c[2])
            if box_distance(check, b, px, py, pz) >= robot.part_radius[part] + margin:
                continue
            if part_box_gap(check, g, part, b, margin, work) < margin:
                return False
    return True


@njit(cache=True, error_model="numpy")
def box_distance(check, b, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance from (x, y, z), in B, to a box."""
    X, half = check.box_X[b], check.box_half[b]
    dx, dy, dz = x - X[0, 3], y - X[1, 3], z - X[2, 3]
    return box_sdf(
        X[0, 0] * dx + X[1, 0] * dy + X[2, 0] * dz,
        X[0, 1] * dx + X[1, 1] * dy + X[2, 1] * dz,
        X[0, 2] * dx + X[1, 2] * dy + X[2, 2] * dz,
        half[0], half[1], half[2],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _pose_part(robot, g, part, work, out):  # type: ignore[no-untyped-def]
    """X of a part of link g in B into the upper rows of out (4, 4)."""
    A, P = work.X_BK[robot.link_body[g]], robot.part_X[part]
    for r in range(3):
        for c in range(4):
            out[r, c] = A[r, 0] * P[0, c] + A[r, 1] * P[1, c] + A[r, 2] * P[2, c]
        out[r, 3] += A[r, 3]


@njit(cache=True, error_model="numpy")
def part_box_gap(check, g, part, b, need, work):  # type: ignore[no-untyped-def]
    """`convex_gap` of a part of link g and a box."""
    robot = check.robot
    _pose_part(robot, g, part, work, work.X_a)
    work.start[0] = work.X_a[0, 3] - check.box_X[b, 0, 3]
    work.start[1] = work.X_a[1, 3] - check.box_X[b, 1, 3]
    work.start[2] = work.X_a[2, 3] - check.box_X[b, 2, 3]
    corners = robot.vertices[robot.vertex_start[part] : robot.vertex_start[part + 1]]
    return convex_gap(
        robot.part_kind[part], robot.part_size[part], corners, work.X_a, _BOX, check.box_half[b], corners,
        check.box_X[b], work.start, need, work.simplex,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def parts_gap(robot, g, a, h, b, need, work):  # type: ignore[no-untyped-def]
    """`convex_gap` of part a of link g and part b of link h."""
    _pose_part(robot, g, a, work, work.X_a)
    _pose_part(robot, h, b, work, work.X_b)
    for i in range(3):
        work.start[i] = work.X_a[i, 3] - work.X_b[i, 3]
    return convex_gap(
        robot.part_kind[a], robot.part_size[a], robot.vertices[robot.vertex_start[a] : robot.vertex_start[a + 1]],
        work.X_a, robot.part_kind[b], robot.part_size[b],
        robot.vertices[robot.vertex_start[b] : robot.vertex_start[b + 1]], work.X_b, work.start, need, work.simplex,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def links_are_apart(robot, g, h, margin, work):  # type: ignore[no-untyped-def]
    """Whether two links keep `margin` to each other."""
    return links_gap(robot, g, h, margin, work) >= margin


@njit(cache=True, error_model="numpy")
def links_gap(robot, g, h, need, work):  # type: ignore[no-untyped-def]
    """Distance of two links where it is less than `need`, else something >= need; 0 where they overlap."""
    c, d = work.link_centre[g], work.link_centre[h]
    reach = robot.link_radius[g] + robot.link_radius[h] + need
    if (c[0] - d[0]) ** 2 + (c[1] - d[1]) ** 2 + (c[2] - d[2]) ** 2 >= reach * reach:
        return need
    X_g, X_h = work.X_BK[robot.link_body[g]], work.X_BK[robot.link_body[h]]
    best = need
    for a in range(robot.link_part_start[g], robot.link_part_start[g + 1]):
        c = robot.part_centre[a]
        ax, ay, az = moved_point(X_g, c[0], c[1], c[2])
        reach = robot.part_radius[a] + robot.link_radius[h] + best
        if (ax - d[0]) ** 2 + (ay - d[1]) ** 2 + (az - d[2]) ** 2 >= reach * reach:
            continue
        for b in range(robot.link_part_start[h], robot.link_part_start[h + 1]):
            e = robot.part_centre[b]
            bx, by, bz = moved_point(X_h, e[0], e[1], e[2])
            reach = robot.part_radius[a] + robot.part_radius[b] + best
            if (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2 < reach * reach:
                best = min(best, parts_gap(robot, g, a, h, b, best, work))
                if best <= 0.0:
                    return 0.0
    return best


@njit(cache=True, error_model="numpy")
def link_clears_grids(robot, g, grids, margin, exact, work):  # type: ignore[no-untyped-def]
    """Whether link g keeps `margin` to all things of `grids`; exact: by its points, not by its spheres."""
    for a in range(grids.radius.shape[0]):
        c = work.link_centre[g]
        reach = robot.link_radius[g] + grids.radius[a] + margin
        dx, dy, dz = c[0] - grids.centre[a, 0], c[1] - grids.centre[a, 1], c[2] - grids.centre[a, 2]
        if dx * dx + dy * dy + dz * dz < reach * reach:
            if link_grid_gap(robot, g, grids, a, grids.X_BA[a], margin, exact, work) < margin:
                return False
    return True


@njit(cache=True, error_model="numpy")
def link_grid_gap(robot, g, grids, a, X_BA, need, exact, work):  # type: ignore[no-untyped-def]
    """A distance of link g and thing a at X_BA that is < need where the spheres (exact: the points) are nearer.

    It is then the first found, not the least; else it is `need`.
    """
    X = work.X_BK[robot.link_body[g]]
    for part in range(robot.link_part_start[g], robot.link_part_start[g + 1]):
        i, end = robot.node_start[part], robot.node_start[part + 1]
        while i < end:
            x, y, z = point_in_frame(X, X_BA, robot.node_centre[i])
            d = grid_lower_bound(grids, a, x, y, z, robot.node_radius[i] + need) - robot.node_radius[i]
            if d >= need:
                i = robot.node_skip[i]
                continue
            if robot.node_skip[i] == i + 1:
                if not exact:
                    return d
                for k in range(robot.point_start[i], robot.point_start[i + 1]):
                    x, y, z = point_in_frame(X, X_BA, robot.points[k])
                    d = grid_lower_bound(grids, a, x, y, z, need)
                    if d < need:
                        return d
            i += 1
    return need


@njit(cache=True, error_model="numpy")
def point_in_frame(X_BK, X_BA, p):  # type: ignore[no-untyped-def]
    """A point p of a body in the frame of a thing."""
    x, y, z = moved_point(X_BK, p[0], p[1], p[2])
    dx, dy, dz = x - X_BA[0, 3], y - X_BA[1, 3], z - X_BA[2, 3]
    return (
        X_BA[0, 0] * dx + X_BA[1, 0] * dy + X_BA[2, 0] * dz,
        X_BA[0, 1] * dx + X_BA[1, 1] * dy + X_BA[2, 1] * dz,
        X_BA[0, 2] * dx + X_BA[1, 2] * dy + X_BA[2, 2] * dz,
    )


@njit(cache=True, error_model="numpy")
def carried_is_clear(check, work):  # type: ignore[no-untyped-def]
    """Whether what the hand holds keeps its limits to boxes, other objects and the cloud, and the margin to the arm."""
    carried = check.carried
    if carried.points.shape[0] == 0:
        return True
    X, c = work.X_BK[carried.body], carried.centre
    x, y, z = moved_point(X, c[0], c[1], c[2])
    for b in range(check.box_half.shape[0]):
        if box_distance(check, b, x, y, z) < carried.radius + carried.box_limit[b]:
            for k in range(carried.points.shape[0]):
                p = carried.points[k]
                px, py, pz = moved_point(X, p[0], p[1], p[2])
                if box_distance(check, b, px, py, pz) < carried.box_limit[b]:
                    return False
    if not _points_clear_grids(carried, X, check.others, carried.other_limit):
        return False
    if not _points_clear_grids(carried, X, check.cloud, carried.cloud_limit):
        return False
    return _links_clear_carried(check, X, work)


@njit(cache=True, error_model="numpy")
def _points_clear_grids(carried, X, grids, limits):  # type: ignore[no-untyped-def]
    x, y, z = moved_point(X, carried.centre[0], carried.centre[1], carried.centre[2])
    for a in range(grids.radius.shape[0]):
        reach = carried.radius + grids.radius[a] + limits[a]
        dx, dy, dz = x - grids.centre[a, 0], y - grids.centre[a, 1], z - grids.centre[a, 2]
        if reach > 0.0 and dx * dx + dy * dy + dz * dz < reach * reach:
            for k in range(carried.points.shape[0]):
                px, py, pz = point_in_frame(X, grids.X_BA[a], carried.points[k])
                if grid_lower_bound(grids, a, px, py, pz, limits[a]) < limits[a]:
                    return False
    return True


@njit(cache=True, error_model="numpy")
def _links_clear_carried(check, X, work):  # type: ignore[no-untyped-def]
    """Whether the arm's spheres keep the arm's margin for the target to what the hand holds."""
    robot, carried = check.robot, check.carried
    G = carried.grid.X_BA[0]
    for r in range(3):
        for c in range(4):
            work.X_a[r, c] = X[r, 0] * G[0, c] + X[r, 1] * G[1, c] + X[r, 2] * G[2, c]
        work.X_a[r, 3] += X[r, 3]
    x, y, z = moved_point(X, carried.centre[0], carried.centre[1], carried.centre[2])
    margin = check.margins[0, TARGET]
    for g in range(robot.link_body.shape[0]):
        if carried.meets_link[g]:
            c = work.link_centre[g]
            reach = robot.link_radius[g] + carried.radius + margin
            if (c[0] - x) ** 2 + (c[1] - y) ** 2 + (c[2] - z) ** 2 < reach * reach:
                if link_grid_gap(robot, g, carried.grid, 0, work.X_a, margin, False, work) < margin:
                    return False
    return True
