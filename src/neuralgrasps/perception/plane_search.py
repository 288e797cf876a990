"""Planes in a depth image, found and fitted in inverse depth.

A plane is w . p = 1 in the camera frame, so that along the ray d = (x, y, 1) of a pixel 1 / z = w . d: affine in the
pixel, and the noise of a triangulating depth camera, which grows with z squared, is the same everywhere. Blocks of
pixels are therefore averaged, and planes fitted by ordinary least squares, in 1 / z. A height above the plane of
z (1 / z - w . d) / |w| follows from the residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.frame import Frame
from neuralgrasps.seeds import child_rng

BAND_M, LEAST_BAND_M = 0.008, 0.003
"""Half width of the band around a plane, along the ray: at 1 m, growing with the square of the depth; and at least."""

_CELLS = 160  # blocks across the image
_HYPOTHESES, _SCORED = 96, 1500
_LEAST_OF_FIRST = 0.05
_FITTED = 30_000
_SMOOTH = 0.006  # 1/m, rms of a local fit
_ACROSS_COS = np.cos(np.deg2rad(30.0))


@dataclass(frozen=True, slots=True)
class Cells:
    """A depth image in blocks of `step` x `step` pixels.

    Attributes:
        inverse: (r, c) float64 mean 1 / z, 1/m; 0 where less than half of a block was measured or it holds a jump.
        ray: (r, c, 2) float64 mean x / z and y / z of its measured pixels.
        local: (r, c, 3) float64 w of the plane through the 5 x 5 blocks around; 0 where they do not lie on one.
        step: pixels.
    """

    inverse: np.ndarray
    ray: np.ndarray
    local: np.ndarray
    step: int


def image_cells(frame: Frame, farthest_m: float) -> Cells:
    """Blocks of the pixels nearer than `farthest_m`, about 160 across the image."""
    k = frame.intrinsics
    step = max(1, round(k.width / _CELLS))
    inverse, ray = _blocks(frame.depth, k.fx, k.fy, k.cx, k.cy, step, farthest_m)
    return Cells(inverse, ray, _local_planes(inverse, ray, _SMOOTH), step)


def search_planes(cells: Cells, *, count: int, least: int, seed: int) -> list[np.ndarray]:
    """Up to `count` planes w (3,), each on at least `least` blocks that no plane before it holds; most blocks first.

    Every hypothesis is the local plane of one block; the best of each round are refined by least squares. The search
    ends where a plane holds less than `_LEAST_OF_FIRST` of what the first one does.
    """
    rng = child_rng(seed, "planes")
    row, column = np.nonzero(cells.local[..., 2])
    data = np.concatenate([cells.ray[row, column], cells.inverse[row, column, None], cells.local[row, column]], axis=1)
    found: list[np.ndarray] = []
    while len(found) < count and len(data) >= least:
        tried = data[rng.choice(len(data), min(_HYPOTHESES, len(data)), replace=False), 3:]
        scored = data[rng.choice(len(data), _SCORED, replace=False)] if len(data) > _SCORED else data
        votes = _votes(scored, tried, BAND_M, LEAST_BAND_M, _ACROSS_COS)
        best = _refined(data, _refined(scored, tried[np.argsort(-votes, kind="stable")[:4]])[None])
        held = _held(data, best, BAND_M, LEAST_BAND_M, _ACROSS_COS)
        if held.sum() < least:
            break
        found.append(best)
        least = max(least, int(_LEAST_OF_FIRST * held.sum())) if len(found) == 1 else least
        data = data[~held]
    return found


def plane_of(w: np.ndarray) -> Plane:
    """The plane w . p = 1 with its normal towards the camera."""
    length = float(np.linalg.norm(w))
    return Plane(-w / length, 1.0 / length)


def cells_on(cells: Cells, plane: Plane) -> np.ndarray:
    """(r, c) bool: blocks in the band around a plane and turned like it."""
    w = -plane.normal / plane.offset_m
    return _cells_held(cells.inverse, cells.ray, cells.local, w, BAND_M, LEAST_BAND_M, _ACROSS_COS)


def cell_points(cells: Cells) -> np.ndarray:
    """(r, c, 3) float64 points of the blocks, camera frame, metres; NaN where not measured."""
    z = 1.0 / np.where(cells.inverse > 0, cells.inverse, np.nan)
    return np.concatenate([cells.ray * z[..., None], z[..., None]], axis=-1)


def fitted_plane(frame: Frame, plane: Plane, near: np.ndarray) -> Plane:
    """A plane refined on the pixels `near` (h, w) bool, of which at most `_FITTED` are used, evenly.

    Least squares in 1 / z, reweighted by Tukey's biweight at 4.7 times a robust standard deviation.
    """
    k = frame.intrinsics
    pixels = np.flatnonzero(near & (frame.depth > 0))
    pixels = pixels[:: -(-len(pixels) // _FITTED)]
    row, column = np.divmod(pixels, k.width)
    x, y = (column - k.cx) / k.fx, (row - k.cy) / k.fy
    inverse = 1.0 / frame.depth.ravel()[pixels]
    w = -plane.normal / plane.offset_m
    for _ in range(3):
        off = np.abs(inverse - (w[0] * x + w[1] * y + w[2]))
        w = _weighted_fit(x, y, inverse, w, max(4.685 * 1.4826 * float(np.median(off)), 1e-6))
    return plane_of(w)


def in_band(frame: Frame, plane: Plane) -> np.ndarray:
    """(h, w) bool: measured pixels whose depth is the plane's, within the band."""
    return _pixels_in_band(
        frame.depth, _camera_array(frame.intrinsics), plane.normal, plane.offset_m, BAND_M, LEAST_BAND_M
    )


def _camera_array(k: Intrinsics) -> np.ndarray:
    return np.array([k.fx, k.fy, k.cx, k.cy])


def _refined(data: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The best of some planes (n, 3) after least squares on what each holds."""
    best, most = w[0], -1
    for one in w:
        moved = one
        for widening in (1.5, 1.0, 1.0):
            held = _held(data, moved, widening * BAND_M, widening * LEAST_BAND_M, _ACROSS_COS)
            if held.sum() < 3:
                break
            x, y, inverse = data[held, 0], data[held, 1], data[held, 2]
            moved = _weighted_fit(x, y, inverse, moved, np.inf)
        count = int(_held(data, moved, BAND_M, LEAST_BAND_M, _ACROSS_COS).sum())
        if count > most:
            best, most = moved, count
    return best


@njit(cache=True, error_model="numpy")
def _blocks(depth, fx, fy, cx, cy, step, farthest):  # type: ignore[no-untyped-def]
    rows, columns = depth.shape[0] // step, depth.shape[1] // step
    inverse, ray = np.zeros((rows, columns)), np.zeros((rows, columns, 2))
    for r in range(rows):
        for c in range(columns):
            n, total, x, y, low, high = 0, 0.0, 0.0, 0.0, np.inf, 0.0
            for i in range(r * step, (r + 1) * step):
                for j in range(c * step, (c + 1) * step):
                    z = depth[i, j]
                    if 0.0 < z < farthest:
                        n += 1
                        total += 1.0 / z
                        x += (j - cx) / fx
                        y += (i - cy) / fy
                        low, high = min(low, z), max(high, z)
            # a surface 84 degrees slanted changes by ten times the width of a pixel from one to the next
            if 2 * n >= step * step and high - low <= 0.01 * low * low + 10.0 * step * low / fx:
                inverse[r, c] = total / n
                ray[r, c, 0], ray[r, c, 1] = x / n, y / n
    return inverse, ray


@njit(cache=True, error_model="numpy")
def _solved(a, b):  # type: ignore[no-untyped-def]
    """The solution of three equations with the symmetric a (3, 3), and whether there is one."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    c11 = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    c12 = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    c22 = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    out = np.zeros(3)
    if not abs(determinant) > 1e-12 * max(a[0, 0], 1e-30) * max(a[1, 1], 1e-30) * max(a[2, 2], 1e-30):
        return out, False
    out[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / determinant
    out[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / determinant
    out[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / determinant
    return out, True


@njit(cache=True, error_model="numpy")
def _local_planes(inverse, ray, smooth):  # type: ignore[no-untyped-def]
    """Planes through 5 x 5 blocks of which at least 15 are measured; coordinates centred for the numbers' sake."""
    rows, columns = inverse.shape
    out = np.zeros((rows, columns, 3))
    a, b = np.zeros((3, 3)), np.zeros(3)
    for r in range(2, rows - 2):
        for c in range(2, columns - 2):
            if inverse[r, c] == 0.0:
                continue
            a[:], b[:] = 0.0, 0.0
            square = 0.0
            x0, y0, q0 = ray[r, c, 0], ray[r, c, 1], inverse[r, c]
            for i in range(r - 2, r + 3):
                for j in range(c - 2, c + 3):
                    if inverse[i, j] > 0.0:
                        x, y, q = ray[i, j, 0] - x0, ray[i, j, 1] - y0, inverse[i, j] - q0
                        a[0, 0] += x * x
                        a[0, 1] += x * y
                        a[0, 2] += x
                        a[1, 1] += y * y
                        a[1, 2] += y
                        a[2, 2] += 1.0
                        b[0] += x * q
                        b[1] += y * q
                        b[2] += q
                        square += q * q
            if a[2, 2] < 15.0:
                continue
            w, ok = _solved(a, b)
            rest = (square - w[0] * b[0] - w[1] * b[1] - w[2] * b[2]) / a[2, 2]
            if ok and rest < smooth * smooth:
                out[r, c, 0], out[r, c, 1] = w[0], w[1]
                out[r, c, 2] = w[2] + q0 - w[0] * x0 - w[1] * y0
    return out


@njit(cache=True, error_model="numpy")
def _holds(x, y, q, u0, u1, u2, w0, w1, w2, band, least_band, across_cos):  # type: ignore[no-untyped-def]
    """Whether a block lies on plane w within the band and is turned like it: the band in 1 / z is max(b, l / z^2)."""
    if abs(q - (w0 * x + w1 * y + w2)) > max(band, least_band * q * q):
        return False
    dot = u0 * w0 + u1 * w1 + u2 * w2
    square = (u0 * u0 + u1 * u1 + u2 * u2) * (w0 * w0 + w1 * w1 + w2 * w2)
    return dot > 0.0 and dot * dot > across_cos * across_cos * square


@njit(cache=True, error_model="numpy")
def _votes(data, planes, band, least_band, across_cos):  # type: ignore[no-untyped-def]
    out = np.zeros(len(planes), np.int64)
    for k in range(len(planes)):
        w0, w1, w2 = planes[k]
        for i in range(len(data)):
            x, y, q, u0, u1, u2 = data[i]
            out[k] += _holds(x, y, q, u0, u1, u2, w0, w1, w2, band, least_band, across_cos)
    return out


@njit(cache=True, error_model="numpy")
def _held(data, plane, band, least_band, across_cos):  # type: ignore[no-untyped-def]
    out = np.zeros(len(data), np.bool_)
    w0, w1, w2 = plane
    for i in range(len(data)):
        x, y, q, u0, u1, u2 = data[i]
        out[i] = _holds(x, y, q, u0, u1, u2, w0, w1, w2, band, least_band, across_cos)
    return out


@njit(cache=True, error_model="numpy")
def _cells_held(inverse, ray, local, plane, band, least_band, across_cos):  # type: ignore[no-untyped-def]
    out = np.zeros(inverse.shape, np.bool_)
    w0, w1, w2 = plane
    for r in range(inverse.shape[0]):
        for c in range(inverse.shape[1]):
            x, y, q = ray[r, c, 0], ray[r, c, 1], inverse[r, c]
            u0, u1, u2 = local[r, c]
            out[r, c] = q > 0.0 and _holds(x, y, q, u0, u1, u2, w0, w1, w2, band, least_band, across_cos)
    return out


@njit(cache=True, error_model="numpy")
def _weighted_fit(x, y, q, w, cut):  # type: ignore[no-untyped-def]
    """Least squares of q = w . (x, y, 1) with Tukey weights of the residuals of the w given; centred."""
    x0, y0 = x.mean(), y.mean()
    q0 = w[0] * x0 + w[1] * y0 + w[2]
    a, b = np.zeros((3, 3)), np.zeros(3)
    for i in range(len(x)):
        off = (q[i] - (w[0] * x[i] + w[1] * y[i] + w[2])) / cut
        weight = (1.0 - off * off) ** 2 if off * off < 1.0 else 0.0
        dx, dy, dq = x[i] - x0, y[i] - y0, q[i] - q0
        a[0, 0] += weight * dx * dx
        a[0, 1] += weight * dx * dy
        a[0, 2] += weight * dx
        a[1, 1] += weight * dy * dy
        a[1, 2] += weight * dy
        a[2, 2] += weight
        b[0] += weight * dx * dq
        b[1] += weight * dy * dq
        b[2] += weight * dq
    v, ok = _solved(a, b)
    if not ok:
        return w.copy()
    v[2] += q0 - v[0] * x0 - v[1] * y0
    return v


@njit(cache=True, error_model="numpy")
def _pixels_in_band(depth, camera, normal, offset, band, least_band):  # type: ignore[no-untyped-def]
    out = np.zeros(depth.shape, np.bool_)
    fx, fy, cx, cy = camera
    for i in range(depth.shape[0]):
        across = normal[1] * (i - cy) / fy + normal[2]
        for j in range(depth.shape[1]):
            z = depth[i, j]
            if z > 0.0:
                along = normal[0] * (j - cx) / fx + across  # the ray meets the plane at depth -offset / along
                out[i, j] = abs(along * z + offset) < max(band * z * z, least_band) * abs(along)
    return out
