"""How near everything is to everything: clearances, and what to say of a posture that is not free."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.hands.parts import part_distances, sample_part
from neuralgrasps.planning.collision_arrays import CheckArrays, Grids, Work
from neuralgrasps.planning.collision_kernels import (
    BOXES,
    CLOUD,
    OTHERS,
    TARGET,
    box_distance,
    link_grid_gap,
    links_gap,
    part_box_gap,
    point_in_frame,
    pose_bodies,
)
from neuralgrasps.planning.collision_robot import robot_shape
from neuralgrasps.planning.grid_kernels import grid_lower_bound

if TYPE_CHECKING:
    from neuralgrasps.planning.collision import CollisionChecker

_SAMPLE_SPACING = 0.004  # of the points that measure how deep a part is
_WORDS = 3  # at most so many contacts are named


def world_gaps(arrays: CheckArrays, q_arm: np.ndarray, work: Work, cap_m: float) -> np.ndarray:
    """(G + 1, boxes + target + others + clouds) distances, metres, at most `cap_m`; the last row is what is carried.

    0 where a link overlaps a box; negative in grids and for what is carried. Links fixed to the base have `cap_m`.
    """
    count = len(arrays.box_half) + sum(len(g.radius) for g in (arrays.target, arrays.others, arrays.cloud))
    out = np.full((len(arrays.robot.link_body) + 1, count), cap_m)
    pose_bodies(arrays.robot, q_arm, work)
    _box_gaps(arrays, cap_m, work, out)
    column = len(arrays.box_half)
    for grids in (arrays.target, arrays.others, arrays.cloud):
        _grid_gaps(arrays, grids, cap_m, column, work, out)
        column += len(grids.radius)
    return out


@njit(cache=True, error_model="numpy")
def _box_gaps(check, cap, work, out):  # type: ignore[no-untyped-def]
    robot, carried = check.robot, check.carried
    for b in range(check.box_half.shape[0]):
        for g in range(robot.link_body.shape[0]):
            if robot.link_meets_world[g]:
                for part in range(robot.link_part_start[g], robot.link_part_start[g + 1]):
                    out[g, b] = min(out[g, b], part_box_gap(check, g, part, b, out[g, b], work))
        X = work.X_BK[carried.body]
        for k in range(carried.points.shape[0]):
            x, y, z = moved_point(X, carried.points[k, 0], carried.points[k, 1], carried.points[k, 2])
            out[-1, b] = min(out[-1, b], box_distance(check, b, x, y, z))


@njit(cache=True, error_model="numpy")
def _grid_gaps(check, grids, cap, column, work, out):  # type: ignore[no-untyped-def]
    robot, carried = check.robot, check.carried
    for a in range(grids.radius.shape[0]):
        for g in range(robot.link_body.shape[0]):
            if robot.link_meets_world[g]:
                exact = check.exact_hand and robot.link_is_hand[g]
                best = cap
                while True:  # each turn finds something nearer
                    d = link_grid_gap(robot, g, grids, a, grids.X_BA[a], best, exact, work)
                    if d >= best:
                        break
                    best = d
                out[g, column + a] = best
        X = work.X_BK[carried.body]
        for k in range(carried.points.shape[0]):
            x, y, z = point_in_frame(X, grids.X_BA[a], carried.points[k])
            out[-1, column + a] = min(out[-1, column + a], grid_lower_bound(grids, a, x, y, z, cap))


@njit(cache=True, error_model="numpy")
def grid_gap(grids, a, points_B):  # type: ignore[no-untyped-def]
    """Least distance of points (M, 3) in B to thing a, metres."""
    best = np.inf
    eye = np.eye(4)
    for k in range(points_B.shape[0]):
        x, y, z = point_in_frame(eye, grids.X_BA[a], points_B[k])
        best = min(best, grid_lower_bound(grids, a, x, y, z, best))
    return best


@njit(cache=True, error_model="numpy")
def box_gap(check, b, points_B):  # type: ignore[no-untyped-def]
    """Least signed distance of points (M, 3) in B to box b, metres."""
    best = np.inf
    for k in range(points_B.shape[0]):
        best = min(best, box_distance(check, b, points_B[k, 0], points_B[k, 1], points_B[k, 2]))
    return best


def start_limits(
    arrays: CheckArrays, grids: Grids | None, points_B: np.ndarray, *, margin: float, sink: float
) -> np.ndarray:
    """Least distances that a carried thing must keep: the margin, or what it has at its start less `sink`.

    To the boxes where `grids` is None, else to its things.
    """
    count = len(arrays.box_half) if grids is None else len(grids.radius)
    gaps = [box_gap(arrays, k, points_B) if grids is None else grid_gap(grids, k, points_B) for k in range(count)]
    return np.minimum(margin, np.array(gaps, float) - sink)


def describe(checker: CollisionChecker, q_arm: np.ndarray) -> str:
    """The worst contacts at q_arm (D,), in words."""
    arrays, found = checker.arrays, []
    gaps = world_gaps(arrays, q_arm, checker.work, 0.1)
    names, limits = _names(checker), _limits(arrays)
    for row, column in zip(*np.nonzero(gaps < limits), strict=True):
        depth = -gaps[row, column]
        if column < len(arrays.box_half) and row < len(arrays.robot.link_body) and depth >= 0.0:
            depth = _depth_in_box(checker, row, column)
        found.append(
            (limits[row, column] + depth, _sentence(names[0][row], names[1][column], -depth, limits[row, column]))
        )
    pose_bodies(arrays.robot, q_arm, checker.work)
    robot = arrays.robot
    for (g, h), margin in zip(robot.pair, robot.pair_margin, strict=True):
        gap = links_gap(robot, g, h, margin, checker.work)
        if gap < margin:
            depth = _depth_of_links(checker, g, h) if gap <= 0.0 else -gap
            found.append((margin + depth, _sentence(names[0][g], names[0][h], -depth, margin)))
    found.sort(key=lambda pair: -pair[0])
    return "; ".join(text for _, text in found[:_WORDS]) or "what is carried touches the arm"


def _sentence(link: str, thing: str, gap: float, need: float) -> str:
    if gap < 0.0:
        return f"{link} is {-1e3 * gap:.0f} mm deep in {thing}"
    return f"{link} is {1e3 * gap:.1f} mm from {thing}; expected at least {1e3 * need:.1f} mm"


def _names(checker: CollisionChecker) -> tuple[list[str], list[str]]:
    """Names of the rows and columns of `world_gaps`."""
    world = checker.world
    links = robot_shape(checker.manipulator).links
    rows = [checker.manipulator.tree.link_names[i] for i in links]
    rows.append(f"the carried {world.target.obj.name}" if world.target is not None else "what is carried")
    columns = [f"the {b.name}" for b in world.boxes]
    columns += [f"the target {world.target.obj.name}"] * len(checker.arrays.target.radius) if world.target else []
    columns += [f"the {p.obj.name}" for p in world.objects]
    return rows, columns + ["something seen but not known"] * len(checker.arrays.cloud.radius)


def _limits(arrays: CheckArrays) -> np.ndarray:
    """What each entry of `world_gaps` must be at least."""
    groups = ((BOXES, len(arrays.box_half)), (TARGET, len(arrays.target.radius)), (OTHERS, len(arrays.others.radius)))
    kinds = np.repeat([k for k, _ in groups] + [CLOUD], [n for _, n in groups] + [len(arrays.cloud.radius)])
    robot, carried = arrays.robot, arrays.carried
    rows = arrays.margins[robot.link_is_hand.astype(int)][:, kinds]
    rows[~robot.link_meets_world] = -np.inf
    last = np.full(len(kinds), -np.inf)
    if len(carried.points):
        last = np.concatenate(
            [carried.box_limit, np.zeros(len(arrays.target.radius)), carried.other_limit, carried.cloud_limit]
        )
    return np.concatenate([rows, last[None]])


def _link_points(checker: CollisionChecker, g: int) -> np.ndarray:
    """Surface points of a link in B, at the posture last posed."""
    shape, robot = robot_shape(checker.manipulator), checker.arrays.robot
    out = []
    for part in range(robot.link_part_start[g], robot.link_part_start[g + 1]):
        p = shape.parts[part]
        X = checker.work.X_BK[robot.link_body[g]] @ robot.part_X[part] @ np.linalg.inv(p.X_LP)
        out.append(sample_part(p, 1.0 / _SAMPLE_SPACING**2)[0] @ X[:3, :3].T + X[:3, 3])
    return np.concatenate(out)


def _depth_in_box(checker: CollisionChecker, g: int, b: int) -> float:
    return float(max(-box_gap(checker.arrays, b, _link_points(checker, g)), 0.0))


def _depth_of_links(checker: CollisionChecker, g: int, h: int) -> float:
    """How deep the surface points of either link are in the other, metres."""
    shape, robot, depth = robot_shape(checker.manipulator), checker.arrays.robot, 0.0
    for one, other in ((g, h), (h, g)):
        points = _link_points(checker, one)
        for part in range(robot.link_part_start[other], robot.link_part_start[other + 1]):
            p = shape.parts[part]
            X = checker.work.X_BK[robot.link_body[other]] @ robot.part_X[part] @ np.linalg.inv(p.X_LP)
            own = (points - X[:3, 3]) @ X[:3, :3]
            depth = max(depth, -float(part_distances(p, own).min()))
    return depth
