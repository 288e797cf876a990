"""6D pose of a known object from the points of one depth view, by its signed distance.

Thousands of rotations are scored at once, the best are polished by Levenberg-Marquardt on SE(3) with a robust loss,
and the rest is decided by free space: a model surface where the camera saw farther is evidence against a pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.pose_kernels import moved_point, turned_vector
from neuralgrasps.geometry.rotation import super_fibonacci_rotations
from neuralgrasps.geometry.sdf_grid import grid_distance, grid_distance_gradient
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseConfig:
    """Knobs of `estimate_pose`.

    Attributes:
        rotations: rotations of the coarse grid (2,000 lie about 20 degrees apart).
        coarse_points, middle_points, fine_points: observed points used per stage.
        keep: poses that survive the coarse stage; finalists: poses that are polished and compared.
        middle_steps, fine_steps: Levenberg-Marquardt steps per stage.
        clip_m: residuals count at most this much in a score.
        kernel_m: scale of the Geman-McClure loss at the start and the end of each polish.
        free_space_weight: weight of the free-space term; free_space_margin_m: what sensor noise may explain.
        accept_m: mean clipped residual below which the result says `converged`.
    """

    rotations: int = 2000
    coarse_points: int = 64
    middle_points: int = 160
    fine_points: int = 600
    keep: int = 128
    finalists: int = 32
    middle_steps: int = 8
    fine_steps: int = 12
    clip_m: float = 0.02
    kernel_m: tuple[float, float] = (0.010, 0.003)
    free_space_weight: float = 1.0
    free_space_margin_m: float = 0.004
    accept_m: float = 0.003


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseResult:
    """Where an object is.

    Attributes:
        X_CO: (4, 4) object frame in the camera frame, the best pose.
        score_m: mean clipped distance of the observed points to the surface plus the free-space penalty, metres.
        residual: median absolute distance of the observed points to the surface, metres.
        converged: `score_m` is below the acceptance threshold.
        alternatives_X_CO: (K, 4, 4) distinct poses, best first (the first is `X_CO`); alternatives_score_m: (K,).
        seed: seed of the point subsampling.
    """

    X_CO: np.ndarray
    score_m: float
    residual: float
    converged: bool
    alternatives_X_CO: np.ndarray
    alternatives_score_m: np.ndarray
    seed: int


def estimate_pose(
    obj: ObjectModel,
    points_C: np.ndarray,
    *,
    depth: np.ndarray | None = None,
    intrinsics: Intrinsics | None = None,
    config: PoseConfig | None = None,
    seed: int = 0,
) -> PoseResult:
    """Find the object's pose from points of its visible surface.

    Args:
        obj: the object.
        points_C: (M, 3) observed points on it, camera frame, metres; M >= 20.
        depth: (h, w) z-depth image, metres, for free space; 0, inf or nan = nothing measured.
        intrinsics: camera of `depth`; both or neither.
        config: knobs; seed: of the subsampling.
    Raises:
        InputError: fewer than 20 finite points, or a depth image without intrinsics or of another size.
    Source:
        The multi-start search replaces the 45-degree grid and single descent of Khargonkar et al. 2022, Eq. 1 of the
        supplement.
    """
    config = config or PoseConfig()
    check_shape("points_C", np.shape(points_C), (3,))
    points_C = np.asarray(points_C, np.float64).reshape(-1, 3)
    points_C = points_C[np.isfinite(points_C).all(axis=1)]
    if len(points_C) < 20:
        raise InputError(f"{len(points_C)} finite points were observed; expected at least 20 on the object.")
    if (depth is None) != (intrinsics is None):
        raise InputError("free space needs both `depth` and `intrinsics`; got only one of them.")
    if depth is not None and intrinsics is not None and np.shape(depth) != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth has shape {np.shape(depth)}; the camera's images are {intrinsics.height} x {intrinsics.width}."
        )
    rng = child_rng(seed, "pose")
    sdf = (obj.sdf.values, obj.sdf.origin, obj.sdf.inv_spacing)
    radius = float(np.linalg.norm(obj.points_O - obj.com_O, axis=1).max())
    sample = _subsample(points_C, config.coarse_points, rng)
    X_OC = _start_poses(obj, points_C, config.rotations)
    for _ in range(2):
        _slide(*sdf, sample, X_OC)
    score = _scores(*sdf, sample, X_OC, config.clip_m)
    X_OC = X_OC[_distinct(X_OC, score, points_C.mean(0), config.keep)]
    sample = _subsample(points_C, config.middle_points, rng)
    X_OC = _polish(sdf, sample, X_OC, config.middle_steps, config.kernel_m, radius)
    score = _scores(*sdf, sample, X_OC, config.clip_m)
    X_OC = X_OC[_distinct(X_OC, score, points_C.mean(0), config.finalists)]
    sample = _subsample(points_C, config.fine_points, rng)
    X_OC = _polish(sdf, sample, X_OC, config.fine_steps, config.kernel_m, radius)
    score = _scores(*sdf, sample, X_OC, config.clip_m)
    if depth is not None and intrinsics is not None:
        score = score + config.free_space_weight * free_space_violation(
            obj, np.linalg.inv(X_OC), depth, intrinsics, margin_m=config.free_space_margin_m, clip_m=config.clip_m
        )
    order = _distinct(X_OC, score, points_C.mean(0), config.finalists)
    best = X_OC[order[0]]
    residual = np.array([grid_distance(*sdf, *p) for p in sample @ best[:3, :3].T + best[:3, 3]])
    return PoseResult(
        X_CO=np.linalg.inv(best),
        score_m=float(score[order[0]]),
        residual=float(np.median(np.abs(residual))),
        converged=bool(score[order[0]] < config.accept_m),
        alternatives_X_CO=np.linalg.inv(X_OC[order]),
        alternatives_score_m=score[order],
        seed=seed,
    )


def free_space_violation(
    obj: ObjectModel,
    X_CO: np.ndarray,
    depth: np.ndarray,
    intrinsics: Intrinsics,
    *,
    margin_m: float = 0.004,
    clip_m: float = 0.02,
) -> np.ndarray:
    """How far, on average, a posed model sticks out of what the camera saw, metres.

    For every camera-facing surface point: measured depth minus its own, less `margin_m`, between 0 and `clip_m`. The
    nearest measurement among its pixel and the eight around it counts, for at the object's outline the pixel itself may
    see past it. Points behind the measured surface, outside the image or without a measurement count 0.

    Args:
        X_CO: (N, 4, 4) poses; depth: (h, w) z-depth, metres.
    Returns:
        (N,) float64.
    """
    out = np.zeros(len(X_CO))
    measured = np.asarray(depth, np.float64)
    measured = np.where(measured > 0.0, measured, np.inf)  # also drops nan
    nearest = np.where(np.isfinite(measured), ndimage.minimum_filter(measured, size=3, mode="nearest"), 0.0)
    _free_space(
        np.ascontiguousarray(obj.points_O), np.ascontiguousarray(obj.normals_O), np.ascontiguousarray(X_CO),
        nearest, intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy,
        margin_m, clip_m, out,
    )  # fmt: skip
    return out


def _subsample(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    if len(points) <= count:
        return np.ascontiguousarray(points)
    return np.ascontiguousarray(points[rng.choice(len(points), count, replace=False)])


def _start_poses(obj: ObjectModel, points_C: np.ndarray, count: int) -> np.ndarray:
    """X_OC (count, 4, 4): a grid of rotations, placed so that the *visible* surface's centroid meets the observed one.

    The visible surface of a view is approximated by the camera-facing points weighted by their foreshortening.
    """
    R = super_fibonacci_rotations(count).numpy()
    centroid_C = points_C.mean(axis=0)
    view_O = R @ (centroid_C / np.linalg.norm(centroid_C))
    weight = np.maximum(-(view_O @ obj.normals_O.T), 0.0)
    visible_O = weight @ obj.points_O / weight.sum(axis=1, keepdims=True)
    X_OC = np.tile(np.eye(4), (count, 1, 1))
    X_OC[:, :3, :3] = R
    X_OC[:, :3, 3] = visible_O - R @ centroid_C
    return X_OC


@njit(cache=True, error_model="numpy")
def _slide(values, origin, inv_spacing, points, X_OC):  # type: ignore[no-untyped-def]
    """One Gauss-Newton step on the translation of every pose, residuals beyond 5 cm ignored."""
    for n in range(X_OC.shape[0]):
        H = np.zeros((3, 3))
        b = np.zeros(3)
        for m in range(points.shape[0]):
            x, y, z = moved_point(X_OC[n], points[m, 0], points[m, 1], points[m, 2])
            d, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, x, y, z)
            if abs(d) > 0.05:
                continue
            g = (gx, gy, gz)
            for r in range(3):
                b[r] -= g[r] * d
                for c in range(3):
                    H[r, c] += g[r] * g[c]
        for r in range(3):
            H[r, r] += 1.0e-2 * points.shape[0]
        step = np.linalg.solve(H, b)
        for r in range(3):
            X_OC[n, r, 3] += step[r]


@njit(cache=True, error_model="numpy")
def _scores(values, origin, inv_spacing, points, X_OC, clip):  # type: ignore[no-untyped-def]
    """(N,) mean distance of the points to the surface, each clipped."""
    out = np.zeros(X_OC.shape[0])
    for n in range(X_OC.shape[0]):
        for m in range(points.shape[0]):
            x, y, z = moved_point(X_OC[n], points[m, 0], points[m, 1], points[m, 2])
            out[n] += min(abs(grid_distance(values, origin, inv_spacing, x, y, z)), clip)
        out[n] /= points.shape[0]
    return out


@njit(cache=True, error_model="numpy")
def _normal_equations(values, origin, inv_spacing, points, X_OC, centre_O, kernel, H, b, cost):  # type: ignore[no-untyped-def]
    """Weighted normal equations of every pose for a twist [v, w] about `centre_O` (N, 3); Geman-McClure loss."""
    J = np.empty(6)
    k2 = kernel * kernel
    for n in range(X_OC.shape[0]):
        H[n] = 0.0
        b[n] = 0.0
        cost[n] = 0.0
        for m in range(points.shape[0]):
            x, y, z = moved_point(X_OC[n], points[m, 0], points[m, 1], points[m, 2])
            d, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, x, y, z)
            cost[n] += k2 * d * d / (d * d + k2)
            weight = (k2 / (d * d + k2)) ** 2
            rx, ry, rz = x - centre_O[n, 0], y - centre_O[n, 1], z - centre_O[n, 2]
            J[0], J[1], J[2] = gx, gy, gz
            J[3], J[4], J[5] = ry * gz - rz * gy, rz * gx - rx * gz, rx * gy - ry * gx
            for r in range(6):
                b[n, r] -= weight * J[r] * d
                for c in range(r, 6):
                    H[n, r, c] += weight * J[r] * J[c]
        for r in range(6):
            for c in range(r):
                H[n, r, c] = H[n, c, r]


def _stepped(X_OC: np.ndarray, centre_O: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Poses moved by a twist [v, w] (N, 6) about `centre_O`, object frame."""
    angle = np.linalg.norm(twist[:, 3:], axis=1)
    R = axis_angle_matrix(np.where(angle[:, None] > 1e-12, twist[:, 3:], np.array([0.0, 0.0, 1.0])), angle)
    out = X_OC.copy()
    out[:, :3, :3] = R @ X_OC[:, :3, :3]
    out[:, :3, 3] = (R @ (X_OC[:, :3, 3] - centre_O)[..., None])[..., 0] + centre_O + twist[:, :3]
    return out


def _polish(
    sdf: tuple[np.ndarray, np.ndarray, float],
    points: np.ndarray,
    X_OC: np.ndarray,
    steps: int,
    kernel_m: tuple[float, float],
    radius: float,
) -> np.ndarray:
    """Levenberg-Marquardt on every pose at once, one damping each; the loss narrows from kernel_m[0] to kernel_m[1]."""
    count = len(X_OC)
    damping = np.full(count, 1.0e-2)
    H, b, cost = np.empty((count, 6, 6)), np.empty((count, 6)), np.empty(count)
    trial_H, trial_b, trial_cost = np.empty_like(H), np.empty_like(b), np.empty_like(cost)
    scale = np.array([1.0, 1.0, 1.0, radius, radius, radius])
    centre_C = points.mean(axis=0)
    for step in range(steps):
        kernel = kernel_m[0] * (kernel_m[1] / kernel_m[0]) ** (step / max(steps - 1, 1))
        centre_O = X_OC[:, :3, :3] @ centre_C + X_OC[:, :3, 3]
        _normal_equations(*sdf, points, X_OC, centre_O, kernel, H, b, cost)
        A = H / (scale[:, None] * scale) + damping[:, None, None] * len(points) * np.eye(6)
        twist = np.linalg.solve(A, (b / scale)[..., None])[..., 0] / scale
        length = np.linalg.norm(twist[:, :3], axis=1, keepdims=True)
        angle = np.linalg.norm(twist[:, 3:], axis=1, keepdims=True)
        twist *= np.minimum(1.0, np.minimum(0.05 / np.maximum(length, 1e-12), 0.5 / np.maximum(angle, 1e-12)))
        trial = _stepped(X_OC, centre_O, twist)
        _normal_equations(*sdf, points, trial, centre_O, kernel, trial_H, trial_b, trial_cost)
        better = trial_cost < cost
        X_OC = np.where(better[:, None, None], trial, X_OC)
        damping = np.clip(np.where(better, damping * 0.3, damping * 5.0), 1e-7, 1e3)
    return X_OC


def _distinct(X_OC: np.ndarray, score: np.ndarray, centre_C: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most `count` best poses that differ by 12 degrees or 15 mm from every better one."""
    order = np.argsort(score, kind="stable")
    R = X_OC[order, :3, :3]
    centre_O = R @ centre_C + X_OC[order, :3, 3]
    kept = np.zeros(count, np.int64)
    return order[kept[: _suppress(R, centre_O, np.cos(np.deg2rad(12.0)), 0.015, kept)]]


@njit(cache=True, error_model="numpy")
def _suppress(R, centre, cos_angle, distance, kept):  # type: ignore[no-untyped-def]
    found = 0
    for i in range(R.shape[0]):
        fresh = True
        for k in range(found):
            j = kept[k]
            trace = 0.0
            gap = 0.0
            for r in range(3):
                gap += (centre[i, r] - centre[j, r]) ** 2
                for c in range(3):
                    trace += R[i, r, c] * R[j, r, c]
            if 0.5 * (trace - 1.0) > cos_angle and gap < distance * distance:
                fresh = False
                break
        if fresh:
            kept[found] = i
            found += 1
            if found == kept.shape[0]:
                break
    return found


@njit(cache=True, error_model="numpy")
def _free_space(points, normals, X_CO, depth, fx, fy, cx, cy, margin, clip, out):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for n in range(X_CO.shape[0]):
        total = 0.0
        facing = 0
        for m in range(points.shape[0]):
            x, y, z = moved_point(X_CO[n], points[m, 0], points[m, 1], points[m, 2])
            nx, ny, nz = turned_vector(X_CO[n], normals[m, 0], normals[m, 1], normals[m, 2])
            if z <= 1.0e-3 or nx * x + ny * y + nz * z >= 0.0:
                continue
            facing += 1
            column = int(np.round(fx * x / z + cx))
            row = int(np.round(fy * y / z + cy))
            if row < 0 or column < 0 or row >= height or column >= width:
                continue
            measured = depth[row, column]
            if measured == 0.0:
                continue
            total += min(max(measured - z - margin, 0.0), clip)
        out[n] = total / max(facing, 1)
