"""Where the robot's bodies are at planned joints, and how finely a motion must be looked at (compiled)."""

from __future__ import annotations

import math

from neuralgrasps.compiled import njit
from neuralgrasps.kinematics.forward_kernels import link_poses
from neuralgrasps.planning.collision_arrays import BODY, plain_kernel


@njit(cache=True, error_model="numpy")
def edge_steps(check, q0, q1, work):  # type: ignore[no-untyped-def]
    """How many steps the edge from q0 to q1 (D,) is checked in.

    How far links move is measured over pieces of at most a quarter radian, as the way of their centres plus their
    radius times the angle they turn by, and a tenth more, since a link's way is longer than its chord.
    """
    widest = 0.0
    for j in range(q0.shape[0]):
        widest = max(widest, abs(q1[j] - q0[j]))
    pieces = max(math.ceil(widest / 0.25), 1)
    farthest = 0.0
    for piece in range(pieces + 1):
        for j in range(q0.shape[0]):
            work.q[j] = q0[j] + piece / pieces * (q1[j] - q0[j])
        work.before[:] = work.X_BK
        link_poses(
            check.parents, check.joint_types, check.X_parent_joint, check.axes, check.coupling, check.offset, work.q,
            work.X_BK,
        )  # fmt: skip
        if piece > 0:
            farthest = max(farthest, longest_way(check.links, check.link_info, work.before, work.X_BK))
    ways = 1.1 * pieces * farthest / check.max_step_m
    return max(1, math.ceil(max(ways, widest / check.max_step_rad)))


@plain_kernel
def longest_way(links, link_info, before, after):  # type: ignore[no-untyped-def]
    """How far any point of a link moves at most, to first order, between two poses of the bodies (K, 4, 4)."""
    longest = 0.0
    for g in range(links.shape[0]):
        k = link_info[g, BODY]
        ax, ay, az = moved_by(before, k, links[g, 0], links[g, 1], links[g, 2])
        bx, by, bz = moved_by(after, k, links[g, 0], links[g, 1], links[g, 2])
        trace = 0.0
        for i in range(3):
            for j in range(3):
                trace += before[k, i, j] * after[k, i, j]
        angle = math.acos(min(max((trace - 1.0) / 2.0, -1.0), 1.0))
        way = math.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) + links[g, 3] * angle
        longest = max(longest, way)
    return longest


@plain_kernel
def pose_robot(check, q_arm, work):  # type: ignore[no-untyped-def]
    """Poses of the bodies and centres of the links, in B, at planned joints (D,), into `work`."""
    link_poses(
        check.parents, check.joint_types, check.X_parent_joint, check.axes, check.coupling, check.offset, q_arm,
        work.X_BK,
    )  # fmt: skip
    links, link_info, centres, X_BK = check.links, check.link_info, work.centres, work.X_BK
    for g in range(links.shape[0]):
        centres[g, 0], centres[g, 1], centres[g, 2] = moved_by(
            X_BK, link_info[g, BODY], links[g, 0], links[g, 1], links[g, 2]
        )
    work.made[check.num_parts] += 1


@plain_kernel
def moved_by(X, k, x, y, z):  # type: ignore[no-untyped-def]
    """X[k] @ (x, y, z) for poses X (K, 4, 4)."""
    return (
        X[k, 0, 0] * x + X[k, 0, 1] * y + X[k, 0, 2] * z + X[k, 0, 3],
        X[k, 1, 0] * x + X[k, 1, 1] * y + X[k, 1, 2] * z + X[k, 1, 3],
        X[k, 2, 0] * x + X[k, 2, 1] * y + X[k, 2, 2] * z + X[k, 2, 3],
    )
