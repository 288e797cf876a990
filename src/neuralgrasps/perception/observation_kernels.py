"""Compiled parts of an observation: loops over the pixels of a mask and of what lies around it."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sdf_grid import grid_distance


@njit(cache=True, error_model="numpy")
def collect_points(depth, mask, box, fx, fy, cx, cy, least, out):  # type: ignore[no-untyped-def]
    """Mean points of the 3 x 3 neighbourhoods of the mask's pixels, where at least so many continue the surface.

    Returns their number.
    """
    height, width = depth.shape
    count = 0
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            z = depth[i, j]
            if not (mask[i, j] and z > 0.0 and np.isfinite(z)):
                continue
            slack = 4.0 * z / fx + 0.004 * z * z + 0.001
            near = 0
            x, y, total = 0.0, 0.0, 0.0
            for a in range(max(i - 1, 0), min(i + 2, height)):
                for b in range(max(j - 1, 0), min(j + 2, width)):
                    if mask[a, b] and abs(depth[a, b] - z) < slack:
                        near += 1
                        x += (b - cx) / fx * depth[a, b]
                        y += (a - cy) / fy * depth[a, b]
                        total += depth[a, b]
            if near >= least:
                near = max(near, 1)
                out[count, 0], out[count, 1], out[count, 2] = x / near, y / near, total / near
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def gate_points(model, depth, camera, X_OC, table, gate, mask, points):  # type: ignore[no-untyped-def]
    """Pixels near the posed model and above the table: into `mask` and `points`; their number."""
    count = 0
    has_table = table[0] != 0.0 or table[1] != 0.0 or table[2] != 0.0
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            z = depth[i, j]
            if z <= 0.0:
                continue
            x, y = (j - camera[2]) / camera[0] * z, (i - camera[3]) / camera[1] * z
            if has_table and table[0] * x + table[1] * y + table[2] * z + table[3] < 0.004 + 0.003 * z * z:
                continue
            a, b, c = moved_point(X_OC, x, y, z)
            if abs(grid_distance(model.values, model.origin, model.inv_spacing, a, b, c)) > gate:
                continue
            mask[i, j] = True
            points[count, 0], points[count, 1], points[count, 2] = x, y, z
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def distance_outside(mask):  # type: ignore[no-untyped-def]
    """(h, w) Euclidean distance to the nearest pixel of the mask, pixels; exact, by lower envelopes of parabolas."""
    height, width = mask.shape
    far = float(height * height + width * width)
    square = np.empty((height, width))
    for j in range(width):
        last = -1.0e9
        for i in range(height):
            if mask[i, j]:
                last = i
            square[i, j] = min((i - last) ** 2, far)
        last = 1.0e9
        for i in range(height - 1, -1, -1):
            if mask[i, j]:
                last = i
            square[i, j] = min(square[i, j], (last - i) ** 2)
    out = np.empty((height, width))
    place = np.empty(width, np.int64)
    edge = np.empty(width + 1)
    for i in range(height):
        count = 0
        place[0] = 0
        edge[0], edge[1] = -1.0e18, 1.0e18
        for j in range(1, width):
            while True:
                k = place[count]
                cross = ((square[i, j] + j * j) - (square[i, k] + k * k)) / (2.0 * (j - k))
                if cross > edge[count]:
                    break
                count -= 1
            count += 1
            place[count] = j
            edge[count], edge[count + 1] = cross, 1.0e18
        count = 0
        for j in range(width):
            while edge[count + 1] < j:
                count += 1
            out[i, j] = np.sqrt((j - place[count]) ** 2 + square[i, place[count]])
    return out


@njit(cache=True, error_model="numpy")
def filled(depth, mask):  # type: ignore[no-untyped-def]
    """The image with holes outside the mask closed by the nearest surface within two pixels.

    Sensors lose pixels at edges and on surfaces seen at a flat angle: what is lost next to a thing in front is its.
    """
    height, width = depth.shape
    out = depth.copy()
    for i in range(height):
        for j in range(width):
            if depth[i, j] > 0.0 or mask[i, j]:
                continue
            least = 0.0
            for a in range(max(i - 2, 0), min(i + 3, height)):
                for b in range(max(j - 2, 0), min(j + 3, width)):
                    z = depth[a, b]
                    if z > 0.0 and (least == 0.0 or z < least):
                        least = z
            out[i, j] = least
    return out


@njit(cache=True, error_model="numpy")
def free_sides(mask, depth, box, free):  # type: ignore[no-untyped-def]
    """Share of the mask's left, right, upper and lower border beyond which the camera saw farther."""
    height, width = mask.shape
    for side in range(4):
        step_i = -1 if side == 2 else (1 if side == 3 else 0)
        step_j = -1 if side == 0 else (1 if side == 1 else 0)
        hidden, total = 0, 0
        for i in range(height):
            for j in range(width):
                if not mask[i, j] or depth[i, j] <= 0.0:
                    continue
                # two pixels on: the first may be a mixed one
                a, b = i + 2 * step_i, j + 2 * step_j
                if b < box[0] or b > box[1] or a < box[2] or a > box[3]:
                    hidden, total = hidden + 1, total + 1
                    continue
                if a < 0 or b < 0 or a >= height or b >= width or mask[a, b]:
                    continue
                total += 1
                if 0.0 < depth[a, b] < depth[i, j] - 0.008:  # nearer: it hides something
                    hidden += 1
        free[side] = 1.0 - hidden / total if total > 0 else 1.0
