"""How near everything is to everything: clearances, and what to say of a posture that is not free."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.parts import part_distances, sample_part
from neuralgrasps.planning.collision_arrays import (
    BODY,
    CLOUD,
    END_PART,
    FIRST_PART,
    FRAME,
    IS_HAND,
    MEETS_WORLD,
    POSE,
    TARGET,
    CheckArrays,
    Work,
)
from neuralgrasps.planning.collision_kernels import (
    box_distance,
    link_box_gap,
    link_grid_gap,
    links_gap,
    points_grid_gap,
    values_of,
)
from neuralgrasps.planning.collision_poses import pose_robot
from neuralgrasps.planning.collision_robot import robot_shape

if TYPE_CHECKING:
    from neuralgrasps.planning.collision import CollisionChecker

_SAMPLE_SPACING = 0.004  # of the points that measure how deep a part is
_WORDS = 3  # at most so many contacts are named


def world_gaps(arrays: CheckArrays, q_arm: np.ndarray, work: Work, cap_m: float) -> np.ndarray:
    """(G + 1, Nb + A) distances, metres, at most `cap_m`, of links to boxes and things; last row: what is carried.

    0 where a link overlaps a box; negative in grids and for what is carried. Links fixed to the base have `cap_m`, as
    has what is not looked at.
    """
    boxes = len(arrays.parts) - arrays.num_parts
    out = np.full((len(arrays.links) + 1, boxes + int(arrays.kinds[-1])), cap_m)
    pose_robot(arrays, q_arm, work)
    _link_gaps(arrays, work, out)
    if len(arrays.carried_points):
        out[-1] = np.minimum(points_gaps(arrays, arrays.carried_points, work.X_BK[arrays.carried_body]), cap_m)
    return out


@njit(cache=True, error_model="numpy")
def _link_gaps(check, work, out):  # type: ignore[no-untyped-def]
    boxes = check.parts.shape[0] - check.num_parts
    for g in range(check.links.shape[0]):
        if check.link_info[g, MEETS_WORLD] == 0:
            continue
        for b in range(boxes):
            out[g, b] = link_box_gap(
                check.link_info, check.parts, check.part_info, check.vertices, g, check.num_parts + b, out[g, b],
                False, work.X_BK, work.poses, work.made, work.simplex,
            )  # fmt: skip
        exact = check.exact_hand and check.link_info[g, IS_HAND] == 1
        for kind in range(TARGET, CLOUD + 1):
            for a in range(check.kinds[kind], check.kinds[kind + 1]):
                while True:  # each turn finds something nearer
                    gap = link_grid_gap(
                        check.link_info, check.part_info, check.nodes, check.node_info, check.points, check.grids,
                        check.grid_info, values_of(check, kind), g, a, check.grids, FRAME, out[g, boxes + a], exact,
                        work.X_BK,
                    )  # fmt: skip
                    if gap >= out[g, boxes + a]:
                        break
                    out[g, boxes + a] = gap


@njit(cache=True, error_model="numpy")
def points_gaps(check, points, X):  # type: ignore[no-untyped-def]
    """(Nb + A,) least signed distances of points (C, 3) moved by X (4, 4) to all boxes and things, metres.

    To the target it is infinite where it is no obstacle.
    """
    boxes = check.parts.shape[0] - check.num_parts
    out = np.full(boxes + check.kinds[-1], np.inf)
    for b in range(boxes):
        for p in range(points.shape[0]):
            x, y, z = moved_point(X, points[p, 0], points[p, 1], points[p, 2])
            out[b] = min(out[b], box_distance(check.parts, check.num_parts + b, x, y, z))
    for kind in range(TARGET, CLOUD + 1):
        for a in range(check.kinds[kind], check.kinds[kind + 1]):
            out[boxes + a] = points_grid_gap(check, values_of(check, kind), points, X, a, np.inf)
    return out


def describe(checker: CollisionChecker, q_arm: np.ndarray) -> str:
    """The worst contacts at q_arm (D,), in words."""
    arrays, work, found = checker.arrays, checker.work, []
    gaps, limits = world_gaps(arrays, q_arm, work, 0.1), _limits(arrays)
    rows, columns = _names(checker)
    boxes = len(arrays.parts) - arrays.num_parts
    for row, column in zip(*np.nonzero(gaps < limits), strict=True):
        gap = gaps[row, column]
        if column < boxes and row < len(arrays.links) and gap <= 0.0:
            gap = -_depth_in_box(checker, row, arrays.num_parts + column)
        found.append((gap - limits[row, column], _sentence(rows[row], columns[column], gap, limits[row, column])))
    for (g, h), margin in zip(arrays.pairs, arrays.pair_margins, strict=True):
        gap = links_gap(
            arrays.links, arrays.link_info, arrays.parts, arrays.part_info, arrays.vertices, g, h, margin, work.X_BK,
            work.centres, work.poses, work.made, work.simplex,
        )  # fmt: skip
        if gap < margin:
            gap = gap if gap > 0.0 else -_depth_of_links(checker, g, h)
            found.append((gap - margin, _sentence(rows[g], rows[h], gap, margin)))
    found.sort(key=lambda pair: pair[0])
    return "; ".join(text for _, text in found[:_WORDS]) or f"{rows[-1]} is too near to the arm"


def _sentence(link: str, thing: str, gap: float, need: float) -> str:
    if gap < 0.0:
        return f"{link} is {-1e3 * gap:.0f} mm deep in {thing}"
    return f"{link} is {1e3 * gap:.1f} mm from {thing}; expected at least {1e3 * need:.1f} mm"


def _names(checker: CollisionChecker) -> tuple[list[str], list[str]]:
    """Names of the rows and columns of `world_gaps`."""
    world = checker.world
    rows = [checker.manipulator.tree.link_names[i] for i in robot_shape(checker.manipulator).links]
    rows.append("what is carried" if world.target is None else f"the carried {world.target.obj.name}")
    columns = [f"the {b.name}" for b in world.boxes]
    columns += [] if world.target is None else [f"the target {world.target.obj.name}"]
    columns += [f"the {p.obj.name}" for p in world.objects]
    return rows, columns + ["something that was seen but is not known"] * (len(world.cloud_B) > 0)


def _limits(arrays: CheckArrays) -> np.ndarray:
    """What each entry of `world_gaps` must be at least."""
    boxes, kinds = len(arrays.parts) - arrays.num_parts, arrays.kinds
    kind = np.zeros(boxes + kinds[-1], np.int64)
    kind[boxes:] = np.searchsorted(kinds[2:], np.arange(kinds[-1]), side="right") + 1
    rows = arrays.margins[arrays.link_info[:, IS_HAND]][:, kind]
    rows[arrays.link_info[:, MEETS_WORLD] == 0] = -np.inf
    last = arrays.carried_limits if len(arrays.carried_points) else np.full(len(kind), -np.inf)
    return np.concatenate([rows, last[None]])


def _link_parts(checker: CollisionChecker, g: int) -> list[tuple[ConvexPart, np.ndarray]]:
    """The parts of a link, and its pose in B at the posture last posed."""
    shape, arrays = robot_shape(checker.manipulator), checker.arrays
    out = []
    for i in range(*arrays.link_info[g, FIRST_PART : END_PART + 1]):
        X_KP = np.eye(4)
        X_KP[:3] = arrays.parts[i, POSE:].reshape(3, 4)
        X_BL = checker.work.X_BK[arrays.link_info[g, BODY]] @ X_KP @ inverse_np(shape.parts[i].X_LP)
        out.append((shape.parts[i], X_BL))
    return out


def _link_points(checker: CollisionChecker, g: int) -> np.ndarray:
    """Surface points (M, 3) of a link in B, at the posture last posed."""
    parts = _link_parts(checker, g)
    return np.concatenate([sample_part(p, 1.0 / _SAMPLE_SPACING**2)[0] @ X[:3, :3].T + X[:3, 3] for p, X in parts])


def _depth_in_box(checker: CollisionChecker, g: int, row: int) -> float:
    return max(-min(box_distance(checker.arrays.parts, row, *p) for p in _link_points(checker, g)), 0.0)


def _depth_of_links(checker: CollisionChecker, g: int, h: int) -> float:
    """How deep the surface points of either link are in the other, metres."""
    depth = 0.0
    for one, other in ((g, h), (h, g)):
        points = _link_points(checker, one)
        for part, X in _link_parts(checker, other):
            depth = max(depth, -float(part_distances(part, (points - X[:3, 3]) @ X[:3, :3]).min()))
    return depth
