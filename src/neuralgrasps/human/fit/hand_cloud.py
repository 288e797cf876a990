"""The measured points of a hand: of its mask, near its joints, off the object and off the table; and their merging."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.human.skeleton import BONES, WRIST
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame

PALM = (0, 1, 5, 9, 13, 17)
"""Wrist and the first joint of every finger: they keep their distances when the fingers move."""

_BONES = np.array(BONES)
_FAR = 1e3  # metres: what is not there is so far away
_NO_OBJECT = (np.full((2, 2, 2), _FAR, np.float32), np.zeros(3), 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudConfig:
    """Which pixels count as the hand's.

    Attributes:
        reach_m: a point of the hand lies so near to a line between two of its joints.
        beyond_wrist_m: how far points may lie past the wrist, where the forearm begins.
        clear_m: points so near to the object's surface, or inside, may be the object's: left out.
        above_m: points lower over the table are left out.
        most: points kept per frame, spread evenly.
    """

    reach_m: float = 0.035
    beyond_wrist_m: float = 0.005
    clear_m: float = 0.004
    above_m: float = 0.008
    most: int = 500


def hand_cloud(
    frame: Frame,
    seen: SeenJoints,
    *,
    box: HandBox | None = None,
    obj: tuple[ObjectModel, np.ndarray] | None = None,
    table: Plane | None = None,
    config: CloudConfig | None = None,
) -> np.ndarray:
    """The points that a frame shows of a hand.

    Args:
        seen: the joints, camera frame, and the mask where there is one.
        box: pixels outside are left out; None for those that the joints reach.
        obj: what is held and where, X_CO (4, 4). table: what it stands on, camera frame, normal up.
    Returns:
        (M, 3) float64 camera frame, metres; M is 0 where nothing of the hand was measured.
    """
    config, k = config or CloudConfig(), frame.intrinsics
    known = np.isfinite(seen.points_C).all(axis=1)
    bones = seen.points_C[_BONES[known[_BONES].all(axis=1)]]
    if not len(bones):
        return np.zeros((0, 3))
    u0, v0, u1, v1 = _window(frame, bones, box, config.reach_m)
    if u0 >= u1 or v0 >= v1:
        return np.zeros((0, 3))
    mask = np.ones((1, 1), np.bool_) if seen.mask is None else np.ascontiguousarray(seen.mask)
    sdf = _NO_OBJECT if obj is None else (obj[0].sdf.values, obj[0].sdf.origin, obj[0].sdf.inv_spacing)
    X_OC = np.eye(4) if obj is None else np.linalg.inv(obj[1])
    plane = np.array([0.0, 0.0, 0.0, _FAR]) if table is None else np.append(table.normal, table.offset_m)
    step = max(1, int(np.sqrt((u1 - u0) * (v1 - v0) / (16.0 * config.most))))
    out = np.empty((((u1 - u0) // step + 1) * ((v1 - v0) // step + 1), 3))
    limits = np.array([config.reach_m, config.clear_m, config.above_m])
    count = _gather(
        frame.depth, mask, np.array([k.fx, k.fy, k.cx, k.cy]), np.array([u0, v0, u1, v1, step]), bones,
        _forearm(seen.points_C, config.beyond_wrist_m), limits, *sdf, X_OC, plane, out,
    )  # fmt: skip
    return _thinned(out[:count], config.most)


def merged_cloud(clouds: list[np.ndarray], *, cell_m: float = 0.003, least: int = 1, most: int = 1000) -> np.ndarray:
    """One cloud of several (M, 3) in the same frame: the means of the points in cells of `cell_m`.

    Args:
        least: cells with fewer points are left out, as flying pixels.
        most: points kept, spread evenly over the cells' order.
    """
    points = np.concatenate(clouds) if clouds else np.zeros((0, 3))
    if not len(points):
        return points
    cell, inverse, count = np.unique(np.floor(points / cell_m), axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(cell), 3))
    np.add.at(total, inverse.ravel(), points)
    return _thinned((total / count[:, None])[count >= least], most)


def _thinned(points: np.ndarray, most: int) -> np.ndarray:
    if len(points) <= most:
        return points.copy()
    return points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def _window(frame: Frame, bones: np.ndarray, box: HandBox | None, reach_m: float) -> tuple[int, int, int, int]:
    """First and past-the-last pixel that bones (B, 2, 3) reach, cut to the box and the image."""
    k = frame.intrinsics
    ends = bones.reshape(-1, 3)
    z = np.maximum(ends[:, 2], 0.05)
    u, v = k.fx * ends[:, 0] / z + k.cx, k.fy * ends[:, 1] / z + k.cy
    ru, rv = k.fx * reach_m / z, k.fy * reach_m / z
    low = [max((u - ru).min(), 0.0), max((v - rv).min(), 0.0)]
    high = [min((u + ru).max(), k.width - 1.0), min((v + rv).max(), k.height - 1.0)]
    if box is not None:
        low = [max(low[0], box.u_min), max(low[1], box.v_min)]
        high = [min(high[0], box.u_max), min(high[1], box.v_max)]
    return int(np.ceil(low[0])), int(np.ceil(low[1])), int(high[0]) + 1, int(high[1]) + 1


def _forearm(points_C: np.ndarray, beyond_m: float) -> np.ndarray:
    """(4,) a plane across the arm: positive heights lie past the wrist, on the forearm."""
    knuckles = points_C[list(PALM[2:])]
    knuckles = knuckles[np.isfinite(knuckles).all(axis=1)]
    if not len(knuckles) or not np.isfinite(points_C[WRIST]).all():
        return np.array([0.0, 0.0, 0.0, -_FAR])
    away = points_C[WRIST] - knuckles.mean(axis=0)
    normal = away / max(float(np.linalg.norm(away)), 1e-6)
    return np.append(normal, -normal @ points_C[WRIST] - beyond_m)


@njit(cache=True, error_model="numpy")
def _gather(depth, mask, camera, window, bones, forearm, limits, values, origin, inv_spacing, X_OC, plane, out):  # type: ignore[no-untyped-def]
    """Points of the window (u0, v0, u1, v1, step) that are the hand's, into `out`; their count."""
    count, masked = 0, mask.shape[0] > 1
    for v in range(window[1], window[3], window[4]):
        for u in range(window[0], window[2], window[4]):
            z = depth[v, u]
            if z <= 0.0 or (masked and not mask[v, u]):
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            if forearm[0] * x + forearm[1] * y + forearm[2] * z + forearm[3] > 0.0:
                continue
            if plane[0] * x + plane[1] * y + plane[2] * z + plane[3] < limits[2]:
                continue
            if not _near_bones(bones, limits[0], x, y, z):
                continue
            ox, oy, oz = moved_point(X_OC, x, y, z)
            if grid_distance(values, origin, inv_spacing, ox, oy, oz) < limits[1]:
                continue
            out[count, 0], out[count, 1], out[count, 2] = x, y, z
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _near_bones(bones, reach, x, y, z):  # type: ignore[no-untyped-def]
    for b in range(bones.shape[0]):
        ax, ay, az = bones[b, 0, 0], bones[b, 0, 1], bones[b, 0, 2]
        dx, dy, dz = bones[b, 1, 0] - ax, bones[b, 1, 1] - ay, bones[b, 1, 2] - az
        px, py, pz = x - ax, y - ay, z - az
        t = (px * dx + py * dy + pz * dz) / max(dx * dx + dy * dy + dz * dz, 1e-12)
        t = min(max(t, 0.0), 1.0)
        ex, ey, ez = px - t * dx, py - t * dy, pz - t * dz
        if ex * ex + ey * ey + ez * ez < reach * reach:
            return True
    return False
