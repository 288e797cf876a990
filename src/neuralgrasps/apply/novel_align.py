"""Turn a closed hand flush with what it touches: a flat pad that meets a face at an angle touches with an edge only.

In a squeeze the object would turn until the pads lie flat. Here the hand turns instead, by the small rotation that
makes the distances of each link's facing points to the object as equal as can be.
"""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, turned_vector
from neuralgrasps.geometry.sdf_grid import grid_distance_gradient
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.contact import link_pose_in_object
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.synthesis.candidates import GraspProblem

NEAR_M = 0.006  # points of the hand nearer than this count, on links that
TOUCH_M = 0.0015  # come as near as this
MOST_RAD = 0.3  # that a hand turns
_FACING = 0.7  # cosine between a point's normal and the way to the object
_STEPS = 4
_DOUBT_M, _USUAL_RAD = 5.0e-4, 0.1  # errors of the distances, and turns, that are as likely as each other


@njit(cache=True, error_model="numpy")
def _facing_points(values, origin, inv_spacing, packed, X_OH, X_HL, counts, points, normals, distance, links):  # type: ignore[no-untyped-def]
    """Points of the links that count (L,) that face the object nearby, into the last four arrays; how many."""
    X, count = np.empty((3, 4)), 0
    for link in range(packed.link_radius.shape[0]):
        start, end = packed.link_point_start[link], packed.link_point_start[link + 1]
        if start == end or not counts[link]:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        for k in range(start, end):
            p, n = packed.point_L[k], packed.point_normal_L[k]
            x, y, z = moved_point(X, p[0], p[1], p[2])
            d, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, x, y, z)
            if d > NEAR_M:
                continue
            norm = math.sqrt(gx * gx + gy * gy + gz * gz) + 1.0e-12
            gx, gy, gz = gx / norm, gy / norm, gz / norm
            u, v, w = turned_vector(X, n[0], n[1], n[2])
            if -(u * gx + v * gy + w * gz) < _FACING:
                continue
            points[count, 0], points[count, 1], points[count, 2] = x, y, z
            normals[count, 0], normals[count, 1], normals[count, 2] = gx, gy, gz
            distance[count], links[count] = d, link
            count += 1
    return count


def turn_flush(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The pose (4, 4) of a closed hand, `X_OH` (4, 4) and `q` (J,), turned flush with the object.

    Only the pads of a jaw count. The hand turns about the middle of the points that count, or, where that would take
    more than `MOST_RAD`, not at all. How far a link as a whole is from the object does not matter: closing takes care
    of that.
    """
    packed, X = problem.packed, np.ascontiguousarray(X_OH).copy()
    X_HL, room = np.zeros((len(packed.link_radius), 4, 4)), len(packed.point_L)
    pose_links(packed, np.ascontiguousarray(q), X_HL)
    points, normals = np.empty((room, 3)), np.empty((room, 3))
    distance, links = np.empty(room), np.empty(room, np.int64)
    counts = (problem.closing.side != 0) | (not problem.hand.is_jaw)
    for _ in range(_STEPS):
        count = _facing_points(*problem.sdf_arrays, packed, X, X_HL, counts, points, normals, distance, links)
        rows, centre = _tilts(points[:count], normals[:count], distance[:count], links[:count])
        A, d = rows[:, :3], rows[:, 3]
        turn = -np.linalg.solve(A.T @ A + (_DOUBT_M / _USUAL_RAD) ** 2 * np.eye(3), A.T @ d)
        angle = float(np.linalg.norm(turn))
        if angle < 1e-4:
            break
        R = axis_angle_matrix(turn, angle)
        X[:3, :3], X[:3, 3] = R @ X[:3, :3], R @ (X[:3, 3] - centre) + centre
    R = X[:3, :3] @ X_OH[:3, :3].T
    cosine = 0.5 * (np.trace(R) - 1.0)
    return X if cosine > math.cos(MOST_RAD) else np.array(X_OH)


def _tilts(
    points: np.ndarray, normals: np.ndarray, distance: np.ndarray, links: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Per point of a link that touches: how its distance changes per rad about each axis, and the distance, (M, 4).

    Both without the link's mean; and the middle (3,) of the points, about which the hand turns.
    """
    near = np.array([distance[links == link].min() < TOUCH_M for link in links], np.bool_)
    points, normals, distance, links = points[near], normals[near], distance[near], links[near]
    centre = points.mean(axis=0) if len(points) else np.zeros(3)
    rows = np.column_stack([np.cross(points - centre, normals), distance])
    for link in np.unique(links):
        rows[links == link] -= rows[links == link].mean(axis=0)
    return rows, centre
