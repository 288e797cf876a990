"""Poses in which an object can lie on a table."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.mesh import convex_hull
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix


def resting_poses(points_O: np.ndarray, com_O: np.ndarray, *, min_share: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Stable poses on the plane z = 0.

    A face of the convex hull carries the object when the centre of mass projects inside it. Faces that are
    almost coplanar (5 degrees) count as one, represented by the largest.

    Args:
        points_O: (M, 3) vertices or surface points, metres. com_O: (3,) centre of mass.
        min_share: smaller shares are dropped, but never the largest: a ball rests on any of its many facets.
    Returns:
        X_WO (K, 4, 4), the lowest point at z = 0 and the centre of mass above the origin, and (K,) the share of
        the sphere of directions whose push down ends on that face (solid angle seen from the centre of mass), largest
        first, normalised to 1.
    """
    vertices, faces = convex_hull(points_O)
    a, b, c = (vertices[faces[:, k]] - com_O for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    solid = area > 1e-9 * area.max()  # a sliver has no direction
    a, b, c, area, normals = (v[solid] for v in (a, b, c, area, normals))
    normals = normals / area[:, None]
    height = (a * normals).sum(1)
    stable = _projects_inside(np.stack([a, b, c], axis=1), normals * height[:, None], normals)
    share = _solid_angles(a, b, c)
    poses, weights, used = [], [], np.zeros(len(area), bool)
    for face in np.argsort(-area, kind="stable"):
        if used[face]:
            continue
        same = (normals @ normals[face] > np.cos(np.deg2rad(5.0))) & ~used
        used |= same
        if not stable[same].any():
            continue
        X_WO = np.eye(4)
        X_WO[:3, :3] = _turn_down(normals[face])
        X_WO[:3, 3] = -X_WO[:3, :3] @ com_O
        X_WO[2, 3] = -float((vertices @ X_WO[2, :3]).min())
        poses.append(X_WO)
        weights.append(float(share[same].sum()))
    weight = np.array(weights) / max(sum(weights), 1e-12)
    order = [i for i in np.argsort(-weight, kind="stable") if weight[i] >= min(min_share, weight.max())]
    kept = weight[order]
    return np.array(poses)[order], kept / kept.sum()


def _turn_down(normal: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns a unit vector to (0, 0, -1)."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return np.eye(3) if normal[2] < 0 else np.diag([1.0, -1.0, -1.0])
    return axis_angle_matrix(axis / sine, np.arctan2(sine, -normal[2]))


def _projects_inside(triangles: np.ndarray, point: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(F,) whether `point` (F, 3), in the plane of each triangle, lies in it (1e-9 m tolerance)."""
    inside = np.ones(len(triangles), bool)
    for k in range(3):
        start, end = triangles[:, k], triangles[:, (k + 1) % 3]
        inside &= (np.cross(end - start, point - start) * normals).sum(1) >= -1e-9
    return inside


def _solid_angles(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(F,) solid angles of triangles seen from the origin (Van Oosterom and Strackee 1983)."""
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.abs((a * np.cross(b, c)).sum(1))
    below = la * lb * lc + (a * b).sum(1) * lc + (a * c).sum(1) * lb + (b * c).sum(1) * la
    return 2.0 * np.arctan2(triple, below)
