"""One view of one object, as the pose search takes it: thinned points, and an image of what was seen around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.observation_kernels import (
    collect_points,
    distance_outside,
    filled,
    free_sides,
    gate_points,
)
from neuralgrasps.perception.pose_model import PoseModel
from neuralgrasps.seeds import child_rng

MIN_POINTS = 20
_POINTS = 4000  # at most so many points are kept
_MASK_CELLS = 2500  # the image is thinned until the mask has about so many pixels


class Observation(NamedTuple):
    """Camera frame, metres.

    Attributes:
        points: (M, 3) measured points, in random order so that any first part is a fair sample.
        centroid: (3,) of the points.
        depth: (h, w) thinned z-depth around the mask, 0 = not measured.
        outside: (h, w) distance from the mask in pixels of `depth`, 0 inside.
        camera: (4,) fx, fy, cx, cy of the thinned image.
        image_box: (4,) first and last column and row of the whole image in pixels of `depth`.
        free: (4,) for the left, right, upper, lower side of the mask, the share of its border that nothing hides.
        table: (4,) plane normal and offset; zeros when there is no table.
    """

    points: np.ndarray
    centroid: np.ndarray
    depth: np.ndarray
    outside: np.ndarray
    camera: np.ndarray
    image_box: np.ndarray
    free: np.ndarray
    table: np.ndarray


def observe_points(points_C: np.ndarray, *, reach_m: float, table: Plane | None = None, seed: int = 0) -> Observation:
    """An observation without a depth image: (M, 3) points on the object's visible surface, camera frame, metres.

    They are seen as the image of a camera whose pixels are as wide as the points lie apart; where there is no point
    nothing was measured, so that what may lie there is a weak hint only.

    Raises:
        InputError: see `check_points`; or points that do not lie before the camera.
    """
    points = check_points(points_C)
    points = points[points.any(axis=1)]  # organised clouds mark what was not measured by zeros
    front = points[:, 2] > 1e-3
    if front.sum() < max(MIN_POINTS, 0.5 * len(points)):
        raise InputError(
            f"only {front.sum()} of {len(points)} points lie before the camera; expected the camera's frame: x right, "
            "y down, z forward, everything seen at z > 0."
        )
    points = points[front]
    points = _shuffled(points[np.lexsort(points.T)], seed)[:_POINTS]
    ratio = points[:, :2] / points[:, 2:]
    ratio_low, ratio_high = np.percentile(ratio, [1, 99], axis=0)
    extent = np.maximum(ratio_high - ratio_low, 1e-6)
    far_out = np.abs(ratio - 0.5 * (ratio_low + ratio_high)) > extent.max()  # strays would widen the image
    points = points[~far_out.any(axis=1)]
    u, v = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    spacing = 1.5 * max(float(np.sqrt(extent.prod() / len(points))), float(extent.max()) / 300.0)
    margin = int(min(reach_m / points[:, 2].min() / spacing, 150.0)) + 2
    left, top = u.min() - margin * spacing, v.min() - margin * spacing
    column, row = np.rint((u - left) / spacing).astype(int), np.rint((v - top) / spacing).astype(int)
    depth = np.zeros((row.max() + margin + 1, column.max() + margin + 1))
    far_first = np.argsort(-points[:, 2], kind="stable")
    depth[row[far_first], column[far_first]] = points[far_first, 2]
    mask = depth > 0.0
    camera = np.array([1.0 / spacing, 1.0 / spacing, -left / spacing, -top / spacing])
    box = np.array([0.0, depth.shape[1] - 1.0, 0.0, depth.shape[0] - 1.0])
    return Observation(
        points, points.mean(axis=0), depth, distance_outside(mask), camera, box, np.full(4, 0.5), _flat(table)
    )


def observe_depth(
    depth: np.ndarray,
    intrinsics: Intrinsics,
    mask: np.ndarray | None,
    *,
    points_C: np.ndarray | None = None,
    reach_m: float,
    table: Plane | None = None,
    seed: int = 0,
) -> Observation:
    """An observation of the masked pixels of a depth image and of what lies around them.

    Args:
        depth: (h, w) z-depth, metres; 0, inf or nan = nothing measured. mask: (h, w) bool, the object's pixels.
        points_C: (M, 3) the object's points, when there is no mask: the pixels that they fall on become the mask.
        reach_m: how far from the mask the image matters: the largest diameter of the objects that it may show.
    Raises:
        InputError: images of another size than the camera's; see `check_points`.
    """
    shape = (intrinsics.height, intrinsics.width)
    for name, image in (("depth", depth), ("mask", mask)):
        if image is not None and np.shape(image) != shape:
            raise InputError(f"{name} has shape {np.shape(image)}; the camera's images are {shape[0]} x {shape[1]}.")
    if mask is None:
        assert points_C is not None
        mask = _pixels_of(check_points(points_C), intrinsics)
    depth, mask = _checked_depth(depth), _checked_mask(mask)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        raise InputError("the mask is empty; expected the pixels of the object.")
    box = np.array([rows[0], rows[-1] + 1, columns[0], columns[-1] + 1])
    points = _mask_points(depth, mask, box, intrinsics)
    stride = max(1, round(float(np.sqrt(len(points) / _MASK_CELLS))))
    points = check_points(_shuffled(points, seed)[:_POINTS])
    cut = _window(box, intrinsics, reach_m / max(float(np.percentile(points[:1000, 2], 5)), 0.05), stride)
    z = np.asarray(depth[cut], np.float64)
    small_mask = np.ascontiguousarray(mask[cut])
    z = filled(np.where(np.isfinite(z) & (z > 0.0), z, 0.0), small_mask)
    top, left = cut[0].start, cut[1].start
    camera = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx - left, intrinsics.cy - top]) / stride
    image_box = np.array([-left, intrinsics.width - 1 - left, -top, intrinsics.height - 1 - top]) / stride
    free = np.zeros(4)
    free_sides(small_mask, z, image_box, free)
    return Observation(
        points, points.mean(axis=0), z, distance_outside(small_mask), camera, image_box, free, _flat(table)
    )


def observe_around(
    depth: np.ndarray,
    intrinsics: Intrinsics,
    model: PoseModel,
    X_CO: np.ndarray,
    *,
    gate_m: float,
    table: Plane | None = None,
    seed: int = 0,
) -> Observation:
    """An observation of the pixels that lie within `gate_m` of a model posed at X_CO (4, 4) and not on the table.

    Its points may be few or none.
    """
    depth = _checked_depth(depth)
    if depth.shape != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth has shape {depth.shape}; the camera's images are {intrinsics.height} x {intrinsics.width}."
        )
    k = intrinsics
    centre = X_CO[:3, :3] @ model.centre + X_CO[:3, 3]
    z = max(float(centre[2]), 0.05)
    reach = 1.2 * (model.radius + gate_m) / z
    stride = max(1, round(model.radius / z * float(np.sqrt(k.fx * k.fy)) * 1.5 / np.sqrt(_MASK_CELLS)))
    cuts = []
    for value, focal, middle, size in ((centre[1], k.fy, k.cy, k.height), (centre[0], k.fx, k.cx, k.width)):
        at = focal * value / z + middle
        first = int(np.clip(at - reach * focal, 0, size - 1))
        cuts.append(slice(first, int(np.clip(at + reach * focal + 1, first + 1, size)), stride))
    small = np.asarray(depth[cuts[0], cuts[1]], np.float64)
    small = np.where(np.isfinite(small) & (small > 0.0), small, 0.0)
    top, left = cuts[0].start, cuts[1].start
    camera = np.array([k.fx, k.fy, k.cx - left, k.cy - top]) / stride
    image_box = np.array([-left, k.width - 1 - left, -top, k.height - 1 - top]) / stride
    mask = np.zeros(small.shape, np.bool_)
    points = np.empty((small.size, 3))
    count = gate_points(model, small, camera, np.linalg.inv(X_CO), _flat(table), gate_m, mask, points)
    points = _shuffled(points[:count], seed)
    centroid = points.mean(axis=0) if count else centre
    return Observation(
        points, centroid, filled(small, mask), distance_outside(mask), camera, image_box, np.ones(4), _flat(table)
    )


def check_points(points_C: np.ndarray) -> np.ndarray:
    """The finite ones of points (M, 3), float64.

    Raises:
        InputError: fewer than 20 finite points, all behind the camera, or at a distance that says the unit is wrong.
    """
    check_shape("points_C", np.shape(points_C), (3,))
    points = np.asarray(points_C, np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < MIN_POINTS:
        raise InputError(f"{len(points)} finite points were observed; expected at least {MIN_POINTS} on the object.")
    spread = float(np.linalg.norm(np.percentile(points, 95, axis=0) - np.percentile(points, 5, axis=0)))
    if spread > 10.0:
        raise InputError(
            f"the points span {spread:.3g} m; expected metres. If they are in millimetres, divide them by 1000."
        )
    if spread < 1e-3:
        raise InputError(f"the points span {1e3 * spread:.3g} mm, no more than one spot; expected a visible surface.")
    return points


def _checked_depth(depth: np.ndarray) -> np.ndarray:
    """float32 or float64 metres.

    Raises:
        InputError: not numbers; whole numbers, which metres are not.
    """
    depth = np.asarray(depth)
    if depth.dtype.kind != "f":
        raise InputError(
            f"depth holds {depth.dtype}; expected metres as floating point. Divide the units of the file by their "
            "number per metre, or use read_frame."
        )
    return depth if depth.dtype in (np.float32, np.float64) else depth.astype(np.float64)


def _checked_mask(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool.

    Raises:
        InputError: not bool or whole numbers.
    """
    mask = np.asarray(mask)
    if mask.dtype.kind not in "biu":
        raise InputError(f"mask holds {mask.dtype}; expected bool, or whole numbers that are not 0 on the object.")
    return np.ascontiguousarray(mask != 0)


def _flat(table: Plane | None) -> np.ndarray:
    return np.zeros(4) if table is None else np.append(table.normal, table.offset_m).astype(np.float64)


def _shuffled(points: np.ndarray, seed: int) -> np.ndarray:
    order = child_rng(seed, "pose").permutation(len(points))
    return np.ascontiguousarray(points[order])


def _pixels_of(points: np.ndarray, k: Intrinsics) -> np.ndarray:
    mask = np.zeros((k.height, k.width), bool)
    front = points[points[:, 2] > 1e-6]
    column = np.rint(k.fx * front[:, 0] / front[:, 2] + k.cx).astype(int)
    row = np.rint(k.fy * front[:, 1] / front[:, 2] + k.cy).astype(int)
    inside = (row >= 0) & (row < k.height) & (column >= 0) & (column < k.width)
    if inside.sum() < MIN_POINTS:
        raise InputError(
            f"{inside.sum()} of {len(points)} points fall into the image; expected points in the frame of its camera."
        )
    mask[row[inside], column[inside]] = True
    return mask


def _mask_points(depth: np.ndarray, mask: np.ndarray, box: np.ndarray, k: Intrinsics) -> np.ndarray:
    """Points of the mask, without pixels whose neighbours lie at another depth: flying ones at the object's edge."""
    out = np.empty(((box[1] - box[0]) * (box[3] - box[2]), 3))
    for least in (4, 0):
        count = collect_points(depth, mask, box, k.fx, k.fy, k.cx, k.cy, least, out)
        if count >= MIN_POINTS:
            break
    return out[:count]


def _window(box: np.ndarray, k: Intrinsics, reach: float, stride: int) -> tuple[slice, slice]:
    """Rows and columns of the image that may show an object of `reach` times the focal length, and all of the mask."""
    cuts = []
    for low, high, focal, size in ((box[0], box[1], k.fy, k.height), (box[2], box[3], k.fx, k.width)):
        first = max(min(int(high - reach * focal), int(low) - 2), 0)
        last = min(max(int(low + reach * focal), int(high) + 2), size)
        cuts.append(slice(first, last, stride))
    return cuts[0], cuts[1]
