"""Compiled collision checks. They take `CheckArrays` and `Work` and may be called from other kernels.

    config_is_free(check, q_arm, work) -> bool
    edge_is_free(check, q0, q1, work) -> bool
    path_is_free(check, q, work) -> bool

Parts against boxes and against each other: exact distance (`convex_gap`). Parts against grids: trees of spheres, and
for the hand where `exact_hand` says so its surface points. Far things are told by spheres around links and parts.
"""

from __future__ import annotations

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.shape_kernels import box_sdf
from neuralgrasps.planning.collision_arrays import (
    BODY,
    BOXES,
    CLOUD,
    END_NODE,
    END_PART,
    FIRST_NODE,
    FIRST_PART,
    FRAME,
    IS_HAND,
    MEETS_CARRIED,
    MEETS_WORLD,
    MIDDLE,
    OTHERS,
    POSE,
    RADIUS,
    SIZE,
    TARGET,
    plain_kernel,
)
from neuralgrasps.planning.collision_poses import edge_steps, moved_by, pose_robot
from neuralgrasps.planning.convex_kernels import convex_gap, point_gap
from neuralgrasps.planning.grid_kernels import grid_lower_bound


@njit(cache=True, error_model="numpy")
def config_is_free(check, q_arm, work):  # type: ignore[no-untyped-def]
    """Whether the robot at planned joints (D,) keeps its margins to everything; joint limits are not looked at."""
    pose_robot(check, q_arm, work)
    if not _clears_boxes(
        check.links, check.link_info, check.parts, check.part_info, check.vertices, check.num_parts, check.margins,
        work.X_BK, work.centres, work.poses, work.made, work.simplex,
    ):  # fmt: skip
        return False
    for kind in range(TARGET, CLOUD + 1):
        if check.kinds[kind] < check.kinds[kind + 1] and not _clears_grids(
            check.links, check.link_info, check.part_info, check.nodes, check.node_info, check.points, check.grids,
            check.grid_info, values_of(check, kind), check.kinds, kind, check.margins, check.exact_hand, work.X_BK,
            work.centres,
        ):  # fmt: skip
            return False
    if not _clears_itself(
        check.pairs, check.pair_margins, check.links, check.link_info, check.parts, check.part_info, check.vertices,
        work.X_BK, work.centres, work.poses, work.made, work.simplex,
    ):  # fmt: skip
        return False
    return check.carried_points.shape[0] == 0 or _carried_is_clear(check, work)


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
    stride = 1
    while stride < steps:
        stride *= 2
    while stride > 1:
        for k in range(stride // 2, steps, stride):
            for j in range(q0.shape[0]):
                work.q[j] = q0[j] + k / steps * (q1[j] - q0[j])
            if not config_is_free(check, work.q, work):
                return False
        stride //= 2
    return True


@njit(cache=True, error_model="numpy")
def path_is_free(check, q, work):  # type: ignore[no-untyped-def]
    """Whether all edges between waypoints (T, D) are free; of a single waypoint, whether it is."""
    if q.shape[0] == 1:
        return config_is_free(check, q[0], work)
    free = True
    for i in range(q.shape[0] - 1):
        free = free and edge_is_free(check, q[i], q[i + 1], work)
    return free


@plain_kernel
def _into_frame(table, i, c, x, y, z):  # type: ignore[no-untyped-def]
    """(x, y, z) in the frame whose pose is in row i of a table, from column c on."""
    dx, dy, dz = x - table[i, c + 3], y - table[i, c + 7], z - table[i, c + 11]
    return (
        table[i, c] * dx + table[i, c + 4] * dy + table[i, c + 8] * dz,
        table[i, c + 1] * dx + table[i, c + 5] * dy + table[i, c + 9] * dz,
        table[i, c + 2] * dx + table[i, c + 6] * dy + table[i, c + 10] * dz,
    )


@plain_kernel
def box_distance(parts, b, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance from (x, y, z), in B, to the box in row b of `parts`."""
    u, v, w = _into_frame(parts, b, POSE, x, y, z)
    return box_sdf(u, v, w, parts[b, SIZE], parts[b, SIZE + 1], parts[b, SIZE + 2])


@plain_kernel
def pose_part(parts, part, X_BK, k, poses, made):  # type: ignore[no-untyped-def]
    """The pose in B of a part of body k into its row of `poses`, unless this check has made it before."""
    now = made[made.shape[0] - 1]
    if made[part] == now:
        return
    made[part] = now
    for r in range(3):
        for c in range(4):
            poses[part, 4 * r + c] = (
                X_BK[k, r, 0] * parts[part, POSE + c]
                + X_BK[k, r, 1] * parts[part, POSE + 4 + c]
                + X_BK[k, r, 2] * parts[part, POSE + 8 + c]
            )
        poses[part, 4 * r + 3] += X_BK[k, r, 3]


@plain_kernel
def _clears_boxes(  # type: ignore[no-untyped-def]
    links, link_info, parts, part_info, vertices, num_parts, margins, X_BK, centres, poses, made, simplex
):
    """Whether all links keep their margins to all boxes. The hand first: it is what touches most."""
    for g in range(links.shape[0] - 1, -1, -1):
        if link_info[g, MEETS_WORLD] == 0:
            continue
        margin = margins[link_info[g, IS_HAND], BOXES]
        for b in range(num_parts, parts.shape[0]):
            if box_distance(parts, b, centres[g, 0], centres[g, 1], centres[g, 2]) < links[g, 3] + margin:
                gap = link_box_gap(
                    link_info, parts, part_info, vertices, g, b, margin, True, X_BK, poses, made, simplex
                )
                if gap < margin:
                    return False
    return True


@plain_kernel
def link_box_gap(link_info, parts, part_info, vertices, g, b, need, any_will_do, X_BK, poses, made, simplex):  # type: ignore[no-untyped-def]
    """Distance of link g and the box in row b of `parts` where it is less than `need`, else `need`.

    any_will_do: a distance less than `need` is enough, it need not be the least.
    """
    k = link_info[g, BODY]
    best = need
    for part in range(link_info[g, FIRST_PART], link_info[g, END_PART]):
        x, y, z = moved_by(X_BK, k, parts[part, 0], parts[part, 1], parts[part, 2])
        if box_distance(parts, b, x, y, z) < parts[part, 3] + best:
            pose_part(parts, part, X_BK, k, poses, made)
            best = min(best, convex_gap(parts, part_info, vertices, poses, part, b, best, simplex))
            if best <= 0.0 or (any_will_do and best < need):
                return best
    return best


@plain_kernel
def _clears_itself(  # type: ignore[no-untyped-def]
    pairs, pair_margins, links, link_info, parts, part_info, vertices, X_BK, centres, poses, made, simplex
):
    """Whether all pairs of links keep their margins."""
    for p in range(pairs.shape[0]):
        g, h = pairs[p, 0], pairs[p, 1]
        reach = links[g, 3] + links[h, 3] + pair_margins[p]
        dx, dy, dz = centres[g, 0] - centres[h, 0], centres[g, 1] - centres[h, 1], centres[g, 2] - centres[h, 2]
        if dx * dx + dy * dy + dz * dz < reach * reach:
            gap = links_gap(
                links, link_info, parts, part_info, vertices, g, h, pair_margins[p], X_BK, centres, poses, made,
                simplex,
            )  # fmt: skip
            if gap < pair_margins[p]:
                return False
    return True


@plain_kernel
def links_gap(links, link_info, parts, part_info, vertices, g, h, need, X_BK, centres, poses, made, simplex):  # type: ignore[no-untyped-def]
    """Distance of links g and h where it is less than `need`, else `need`; 0 where they overlap."""
    i, j = link_info[g, BODY], link_info[h, BODY]
    best = need
    for a in range(link_info[g, FIRST_PART], link_info[g, END_PART]):
        ax, ay, az = moved_by(X_BK, i, parts[a, 0], parts[a, 1], parts[a, 2])
        dx, dy, dz = ax - centres[h, 0], ay - centres[h, 1], az - centres[h, 2]
        reach = parts[a, 3] + links[h, 3] + best
        if dx * dx + dy * dy + dz * dz >= reach * reach:
            continue
        pose_part(parts, a, X_BK, i, poses, made)
        if point_gap(parts, part_info, poses, a, centres[h, 0], centres[h, 1], centres[h, 2]) >= links[h, 3] + best:
            continue
        for b in range(link_info[h, FIRST_PART], link_info[h, END_PART]):
            bx, by, bz = moved_by(X_BK, j, parts[b, 0], parts[b, 1], parts[b, 2])
            reach = parts[a, 3] + parts[b, 3] + best
            if (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2 >= reach * reach:
                continue
            if point_gap(parts, part_info, poses, a, bx, by, bz) >= parts[b, 3] + best:
                continue
            pose_part(parts, b, X_BK, j, poses, made)
            if point_gap(parts, part_info, poses, b, ax, ay, az) < parts[a, 3] + best:
                best = min(best, convex_gap(parts, part_info, vertices, poses, a, b, best, simplex))
                if best <= 0.0:
                    return 0.0
    return best


@plain_kernel
def _clears_grids(  # type: ignore[no-untyped-def]
    links, link_info, part_info, nodes, node_info, points, grids, grid_info, values, kinds, kind, margins, exact_hand,
    X_BK, centres,
):  # fmt: skip
    """Whether all links keep their margins to all things of one kind."""
    for g in range(links.shape[0] - 1, -1, -1):
        if link_info[g, MEETS_WORLD] == 0:
            continue
        is_hand = link_info[g, IS_HAND]
        margin = margins[is_hand, kind]
        for a in range(kinds[kind], kinds[kind + 1]):
            reach = links[g, 3] + grids[a, RADIUS] + margin
            dx, dy = centres[g, 0] - grids[a, MIDDLE], centres[g, 1] - grids[a, MIDDLE + 1]
            dz = centres[g, 2] - grids[a, MIDDLE + 2]
            if dx * dx + dy * dy + dz * dz < reach * reach:
                gap = link_grid_gap(
                    link_info, part_info, nodes, node_info, points, grids, grid_info, values, g, a, grids, FRAME,
                    margin, exact_hand and is_hand == 1, X_BK,
                )  # fmt: skip
                if gap < margin:
                    return False
    return True


@plain_kernel
def link_grid_gap(  # type: ignore[no-untyped-def]
    link_info, part_info, nodes, node_info, points, grids, grid_info, values, g, a, frames, column, need, exact, X_BK
):
    """A distance of link g and thing a that is < need where the spheres (exact: the points) are nearer.

    It is then the first found, not the least; else it is `need`. The thing's frame in B is in row a of `frames`, from
    `column` on.
    """
    k = link_info[g, BODY]
    for part in range(link_info[g, FIRST_PART], link_info[g, END_PART]):
        i, end = part_info[part, FIRST_NODE], part_info[part, END_NODE]
        while i < end:
            x, y, z = moved_by(X_BK, k, nodes[i, 0], nodes[i, 1], nodes[i, 2])
            x, y, z = _into_frame(frames, a, column, x, y, z)
            d = grid_lower_bound(grids, grid_info, values, a, x, y, z, nodes[i, 3] + need) - nodes[i, 3]
            if d >= need:
                i = node_info[i, 0]
                continue
            if node_info[i, 0] == i + 1:  # a leaf
                if not exact:
                    return d
                for p in range(node_info[i, 1], node_info[i + 1, 1]):
                    x, y, z = moved_by(X_BK, k, points[p, 0], points[p, 1], points[p, 2])
                    x, y, z = _into_frame(frames, a, column, x, y, z)
                    d = grid_lower_bound(grids, grid_info, values, a, x, y, z, need)
                    if d < need:
                        return d
            i += 1
    return need


@njit(cache=True, error_model="numpy")
def values_of(check, kind):  # type: ignore[no-untyped-def]
    """Values of the grids of one kind of thing."""
    if kind == TARGET:
        return check.target_values
    return check.other_values if kind == OTHERS else check.cloud_values


@njit(cache=True, error_model="numpy")
def _carried_is_clear(check, work):  # type: ignore[no-untyped-def]
    """Whether what the hand holds keeps its limits to boxes, other objects and the cloud, and the margin to the arm."""
    X, held = work.X_BK[check.carried_body], check.grids.shape[0] - 1
    grids, points, limits = check.grids, check.carried_points, check.carried_limits
    boxes = check.parts.shape[0] - check.num_parts
    x, y, z = moved_point(X, grids[held, MIDDLE], grids[held, MIDDLE + 1], grids[held, MIDDLE + 2])
    for b in range(boxes):
        row = check.num_parts + b
        if box_distance(check.parts, row, x, y, z) < grids[held, RADIUS] + limits[b]:
            for p in range(points.shape[0]):
                px, py, pz = moved_point(X, points[p, 0], points[p, 1], points[p, 2])
                if box_distance(check.parts, row, px, py, pz) < limits[b]:
                    return False
    for kind in range(OTHERS, CLOUD + 1):
        for a in range(check.kinds[kind], check.kinds[kind + 1]):
            limit = limits[boxes + a]
            reach = grids[held, RADIUS] + grids[a, RADIUS] + max(limit, 0.0)
            dx, dy, dz = x - grids[a, MIDDLE], y - grids[a, MIDDLE + 1], z - grids[a, MIDDLE + 2]
            if dx * dx + dy * dy + dz * dz >= reach * reach:
                continue
            if points_grid_gap(check, values_of(check, kind), points, X, a, limit) < limit:
                return False
    return _arm_clears_carried(check, work, x, y, z)


@njit(cache=True, error_model="numpy")
def points_grid_gap(check, values, points, X, a, need):  # type: ignore[no-untyped-def]
    """Least distance of points (C, 3) moved by X to thing a where it is less than `need`, else `need`."""
    best = need
    for p in range(points.shape[0]):
        x, y, z = moved_point(X, points[p, 0], points[p, 1], points[p, 2])
        x, y, z = _into_frame(check.grids, a, FRAME, x, y, z)
        best = min(best, grid_lower_bound(check.grids, check.grid_info, values, a, x, y, z, best))
    return best


@njit(cache=True, error_model="numpy")
def _arm_clears_carried(check, work, x, y, z):  # type: ignore[no-untyped-def]
    """Whether the arm's spheres keep the arm's margin for the target to what the hand holds; (x, y, z) its middle."""
    held, margin = check.grids.shape[0] - 1, check.margins[0, TARGET]
    X, frames = work.X_BK[check.carried_body], work.frame.reshape(1, 12)
    for r in range(3):
        for c in range(4):
            value = X[r, 3] if c == 3 else 0.0
            for j in range(3):
                value += X[r, j] * check.grids[held, FRAME + 4 * j + c]
            frames[0, 4 * r + c] = value
    for g in range(check.links.shape[0]):
        if check.link_info[g, MEETS_CARRIED] == 1:
            reach = check.links[g, 3] + check.grids[held, RADIUS] + margin
            dx, dy, dz = x - work.centres[g, 0], y - work.centres[g, 1], z - work.centres[g, 2]
            if dx * dx + dy * dy + dz * dz < reach * reach:
                gap = link_grid_gap(
                    check.link_info, check.part_info, check.nodes, check.node_info, check.points, check.grids[held:],
                    check.grid_info[held:], check.other_values, g, 0, frames, 0, margin, False, work.X_BK,
                )  # fmt: skip
                if gap < margin:
                    return False
    return True
