"""How well a posed model explains a depth image: rays cast against its signed distances.

A pixel of the mask should show the model's surface where it was measured. A model surface before what was measured
outside the mask is evidence against the pose; one behind it is hidden and says nothing.
"""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.perception.pose_kernels import UNMEASURED

# columns of the evidence of a pose
COST, EXPLAINED, FREE, CONFIRMED, COVERED, IN_MASK = range(6)
EVIDENCE = 6
_HIT_M = 6.0e-4


@njit(cache=True, error_model="numpy")
def ray_evidence(model, scene, X_CO, stride, tolerance, clip, margin, out):  # type: ignore[no-untyped-def]
    """Evidence (N, 6) of poses X_CO (N, 4, 4) from every `stride`-th pixel.

    Columns: cost per pixel of the mask (0 = all explained; a pixel that is not costs 1, one in free space up to 1);
    share of the mask within `tolerance`; free-space pixels per pixel of the mask; predicted pixels confirmed by a
    measurement in the mask, per predicted pixel that is not hidden; of all pixels that the model covers, the share
    that is in the mask; number of mask pixels looked at.
    """
    inverse, box = np.empty((3, 4)), np.empty(4)
    for n in range(X_CO.shape[0]):
        _invert(X_CO[n], inverse)
        _seen_box(model, scene.camera, X_CO[n], box)
        cost, explained, free, confirmed, visible, covered, in_mask = 0.0, 0, 0.0, 0, 0, 0, 0
        for i in range(0, scene.depth.shape[0], stride):
            ry = (i - scene.camera[3]) / scene.camera[1]
            for j in range(0, scene.depth.shape[1], stride):
                inside = scene.outside[i, j] == 0.0
                met = box[0] <= j <= box[1] and box[2] <= i <= box[3]
                z = scene.depth[i, j]
                if (inside and z <= 0.0) or not (inside or met):
                    continue
                rx = (j - scene.camera[2]) / scene.camera[0]
                if inside:
                    in_mask += 1
                    d = abs(_measured(model, inverse, rx, ry, z))
                    if met and d < clip:
                        # a surface far before the measured one is as wrong as any: the ray may start behind it
                        hit, _ = _cast(model, inverse, rx, ry, z - 2.5 * clip, z + 0.03)
                        if hit > 0.0:
                            covered, visible = covered + 1, visible + 1
                            d = max(d, min(0.5 * abs(hit - z), clip))
                            confirmed += d < tolerance
                    cost += 0.5 * d * d / (d * d + tolerance * tolerance) + 0.5 * min(d / clip, 1.0)
                    explained += d < tolerance
                    continue
                limit = z - margin * (0.5 + z * z) if z > 0.0 else 1.0e3
                hit, hidden = _cast(model, inverse, rx, ry, 1.0e-3, limit)
                if hidden:
                    covered += 1
                if hit > 0.0:
                    covered, visible = covered + 1, visible + 1
                    off = max((scene.outside[i, j] - 1.0) * hit / scene.camera[0], 0.0)
                    share = 1.0 if z > 0.0 else UNMEASURED
                    cost += share * (off * off / (off * off + tolerance * tolerance))
                    free += share * min(off / tolerance, 1.0)
        total = max(in_mask, 1)
        out[n, COST], out[n, EXPLAINED], out[n, FREE] = cost / total, explained / total, free / total
        out[n, CONFIRMED] = confirmed / max(visible, 1)
        out[n, COVERED] = in_mask / max(covered, 1)
        out[n, IN_MASK] = in_mask


@njit(cache=True, error_model="numpy")
def _seen_box(model, camera, X, out):  # type: ignore[no-untyped-def]
    """out (4,): first and last column and row of the pixels that the posed object's bounds project to."""
    out[0], out[1], out[2], out[3] = 1.0e9, -1.0e9, 1.0e9, -1.0e9
    for corner in range(8):
        x, y, z = moved_point(
            X, model.bounds[corner & 1, 0], model.bounds[(corner >> 1) & 1, 1], model.bounds[corner >> 2, 2]
        )
        if z < 1.0e-3:  # partly behind the camera: anywhere
            out[0], out[1], out[2], out[3] = -1.0e9, 1.0e9, -1.0e9, 1.0e9
            return
        u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
        out[0], out[1] = min(out[0], u), max(out[1], u)
        out[2], out[3] = min(out[2], v), max(out[3], v)


@njit(cache=True, inline="always", error_model="numpy")
def _invert(X, out):  # type: ignore[no-untyped-def]
    for r in range(3):
        for c in range(3):
            out[r, c] = X[c, r]
        out[r, 3] = -(X[0, r] * X[0, 3] + X[1, r] * X[1, 3] + X[2, r] * X[2, 3])


@njit(cache=True, inline="always", error_model="numpy")
def _measured(model, inverse, rx, ry, z):  # type: ignore[no-untyped-def]
    x, y = rx * z, ry * z
    return grid_distance(
        model.values, model.origin, model.inv_spacing,
        inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * z + inverse[0, 3],
        inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * z + inverse[1, 3],
        inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2] * z + inverse[2, 3],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _cast(model, inverse, rx, ry, start, limit):  # type: ignore[no-untyped-def]
    """(depth of the first surface from depth `start` to `limit`, 0 for none; whether the limit stopped the ray).

    The ray is (rx, ry, 1) times the depth; the second answer is true when it could meet the object behind the limit.
    """
    entry, leave = start, 1.0e9
    d = (
        inverse[0, 0] * rx + inverse[0, 1] * ry + inverse[0, 2],
        inverse[1, 0] * rx + inverse[1, 1] * ry + inverse[1, 2],
        inverse[2, 0] * rx + inverse[2, 1] * ry + inverse[2, 2],
    )
    for k in range(3):
        o = inverse[k, 3]
        if abs(d[k]) < 1.0e-12:
            if o < model.bounds[0, k] or o > model.bounds[1, k]:
                return 0.0, False
            continue
        a, b = (model.bounds[0, k] - o) / d[k], (model.bounds[1, k] - o) / d[k]
        entry, leave = max(entry, min(a, b)), min(leave, max(a, b))
    if entry >= leave:
        return 0.0, False
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    z = entry
    stop = min(leave, limit)
    for _ in range(48):
        if z > stop:
            return 0.0, leave > limit
        s = grid_distance(
            model.values, model.origin, model.inv_spacing,
            d[0] * z + inverse[0, 3], d[1] * z + inverse[1, 3], d[2] * z + inverse[2, 3],
        )  # fmt: skip
        if s < _HIT_M:
            return z + s / length, False
        z += max(s, 5.0e-4) / length
    return 0.0, False
