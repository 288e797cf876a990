"""What a frame of a robot at work is painted from: the faces that are seen, what stands still, light on a table.

A frame has S sample planes, each a picture whose rays are shifted by part of a pixel.
"""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.report.light_kernels import _lit

_NEARER = np.float32(1.0003)  # of two surfaces half a millimetre apart the first is drawn: no pattern of both
NOTHING, TABLE_TOP = -1, -2  # in the face of a sample: backdrop, and the table's upper face


@njit(cache=True, error_model="numpy")
def fill_faces(points_C, faces, two_sided, camera, offsets, face, inverse):  # type: ignore[no-untyped-def]
    """Write the nearest faces into face (S, h, w) int32 where they are nearer than inverse (S, h, w), 1 / depth.

    Args:
        points_C: (V, 3) camera frame; faces: (F, 3); two_sided: (F,) faces whose back is drawn too.
        camera: fx, fy, cx, cy; offsets: (S, 2) shift of every plane's rays, pixels.
    """
    height, width = face.shape[1], face.shape[2]
    uvw = np.empty((len(points_C), 3))
    for i in range(len(points_C)):
        z = points_C[i, 2]
        w = 1.0 / z if z > 1e-3 else 0.0
        uvw[i, 0] = points_C[i, 0] * w * camera[0] + camera[2]
        uvw[i, 1] = points_C[i, 1] * w * camera[1] + camera[3]
        uvw[i, 2] = w
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if uvw[a, 2] == 0.0 or uvw[b, 2] == 0.0 or uvw[c, 2] == 0.0:
            continue
        ax, ay = uvw[a, 0], uvw[a, 1]
        bx, by, cx, cy = uvw[b, 0] - ax, uvw[b, 1] - ay, uvw[c, 0] - ax, uvw[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0.0 or (area > 0.0 and not two_sided[f]):  # clockwise in the picture (y down) is the back
            continue
        inv = 1.0 / area
        w0, wb, wc = uvw[a, 2], uvw[b, 2] - uvw[a, 2], uvw[c, 2] - uvw[a, 2]
        for s in range(len(offsets)):
            ox, oy = ax - offsets[s, 0], ay - offsets[s, 1]
            row0, row1 = (
                max(int(np.ceil(oy + min(0.0, by, cy))), 0),
                min(int(np.floor(oy + max(0.0, by, cy))), height - 1),
            )
            col0, col1 = (
                max(int(np.ceil(ox + min(0.0, bx, cx))), 0),
                min(int(np.floor(ox + max(0.0, bx, cx))), width - 1),
            )
            ds, dt = cy * inv, -by * inv
            for row in range(row0, row1 + 1):
                y = row - oy
                x = col0 - ox
                p, q = (x * cy - y * cx) * inv, (bx * y - by * x) * inv
                for col in range(col0, col1 + 1):
                    if p >= 0.0 and q >= 0.0 and p + q <= 1.0:
                        w = np.float32(w0 + p * wb + q * wc)
                        if w > inverse[s, row, col] * _NEARER:
                            inverse[s, row, col] = w
                            face[s, row, col] = f
                    p += ds
                    q += dt


@njit(cache=True, error_model="numpy")
def fill_backdrop(view, camera, offsets, table, floor, colours, out):  # type: ignore[no-untyped-def]
    """What stands still: the table's top and sides, the floor that fades away, the backdrop.

    Args:
        view: R_WC (3, 3), eye (3,) world.
        table: low (3,), high (3,) corners, sides (3,) light on faces across x, y, z.
        floor: height, centre (2,), light (G, G), side of its square.
        colours: (4, 3) linear: table, floor, backdrop at the horizon and overhead.
        out: face (S, h, w), inverse (S, h, w), still (h, w, 3) linear light of all but the table's top, spot (h, w, 2)
            mean place on the table's top.
    """
    R, eye = view
    low, high, sides = table
    floor_z, floor_at, floor_light, floor_side = floor
    face, inverse, still, spot = out
    samples = len(offsets)
    share = np.float32(1.0 / samples)
    d = np.empty(3)
    for row in range(face.shape[1]):
        for col in range(face.shape[2]):
            tops = 0
            for s in range(samples):
                x, y = (col + offsets[s, 0] - camera[2]) / camera[0], (row + offsets[s, 1] - camera[3]) / camera[1]
                for k in range(3):
                    d[k] = R[k, 0] * x + R[k, 1] * y + R[k, 2]
                enter, leave, axis = 1e-3, np.inf, -1
                for k in range(3):
                    if d[k] == 0.0:
                        if eye[k] < low[k] or eye[k] > high[k]:
                            leave = -1.0
                        continue
                    t0, t1 = (low[k] - eye[k]) / d[k], (high[k] - eye[k]) / d[k]
                    if min(t0, t1) > enter:
                        enter, axis = min(t0, t1), k
                    leave = min(leave, max(t0, t1))
                face[s, row, col] = NOTHING
                inverse[s, row, col] = 0.0
                if axis >= 0 and enter < leave:
                    inverse[s, row, col] = 1.0 / enter
                    if axis == 2 and d[2] < 0.0:
                        face[s, row, col] = TABLE_TOP
                        tops += 1
                        spot[row, col, 0] += eye[0] + enter * d[0]
                        spot[row, col, 1] += eye[1] + enter * d[1]
                    else:
                        for k in range(3):
                            still[row, col, k] += share * colours[0, k] * sides[axis]
                    continue
                _open_air(d, eye, floor_z, floor_at, floor_light, floor_side, colours, share, still[row, col])
            if tops:
                spot[row, col, 0] /= tops
                spot[row, col, 1] /= tops


@njit(cache=True, error_model="numpy", inline="always")
def _open_air(d, eye, floor_z, centre, light, side, colours, share, out):  # type: ignore[no-untyped-def]
    """Add the floor or the backdrop that a ray meets."""
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    rise = min(max(d[2] / length * 1.6 + 0.35, 0.0), 1.0)
    rise = rise * rise * (3.0 - 2.0 * rise)
    weight, bright = 0.0, 1.0
    if d[2] < 0.0:
        t = (floor_z - eye[2]) / d[2]
        x, y = eye[0] + t * d[0] - centre[0], eye[1] + t * d[1] - centre[1]
        away = np.sqrt(x * x + y * y)
        weight = 1.0 - min(max((away - 0.8) / 2.6, 0.0), 1.0)
        weight = weight * weight * (3.0 - 2.0 * weight)
        bright = value_at(light, x / side + 0.5, y / side + 0.5)
    for k in range(3):
        behind = colours[2, k] + rise * (colours[3, k] - colours[2, k])
        out[k] += share * (weight * colours[1, k] * bright + (1.0 - weight) * behind)


@njit(cache=True, error_model="numpy", inline="always")
def value_at(grid, u, v):  # type: ignore[no-untyped-def]
    """Bilinear value of a grid over the unit square, its border continued."""
    x = min(max(u * grid.shape[0] - 0.5, 0.0), grid.shape[0] - 1.001)
    y = min(max(v * grid.shape[1] - 0.5, 0.0), grid.shape[1] - 1.001)
    i, j = int(x), int(y)
    p, q = x - i, y - j
    return (1 - p) * ((1 - q) * grid[i, j] + q * grid[i, j + 1]) + p * (
        (1 - q) * grid[i + 1, j] + q * grid[i + 1, j + 1]
    )


@njit(cache=True, error_model="numpy", inline="always")
def even_sky(x, y, z, n, sky):  # type: ignore[no-untyped-def]
    """Light from the dome, scaled so that a free level surface gets 1; between the cells of the maps it is even."""
    directions, axes, depth, texel = sky
    count, size = directions.shape[0], depth.shape[1]
    inv, half = np.float32(1.0) / texel, np.float32(0.5 * depth.shape[1] - 0.5)
    one, ramp = np.float32(1.0), np.float32(0.4) * inv
    total = np.float32(0.0)
    for i in range(count):
        facing = n[0] * directions[i, 0] + n[1] * directions[i, 1] + n[2] * directions[i, 2]
        if facing <= 0.0:
            continue
        radiance = max(np.float32(0.55) + np.float32(0.45) * directions[i, 2], np.float32(0.0)) * facing
        u = (axes[i, 0, 0] * x + axes[i, 0, 1] * y + axes[i, 0, 2] * z) * inv + half
        v = (axes[i, 1, 0] * x + axes[i, 1, 1] * y + axes[i, 1, 2] * z) * inv + half
        cu, cv = int(u), int(v)
        if u < 0.0 or v < 0.0 or cu >= size - 1 or cv >= size - 1:
            total += radiance
            continue
        d = (axes[i, 2, 0] * x + axes[i, 2, 1] * y + axes[i, 2, 2] * z - texel * np.float32(2.0)) * ramp
        p, q = u - np.float32(cu), v - np.float32(cv)
        hidden = (one - q) * (
            (one - p) * min(max(d - depth[i, cv, cu] * ramp, np.float32(0.0)), one)
            + p * min(max(d - depth[i, cv, cu + 1] * ramp, np.float32(0.0)), one)
        ) + q * (
            (one - p) * min(max(d - depth[i, cv + 1, cu] * ramp, np.float32(0.0)), one)
            + p * min(max(d - depth[i, cv + 1, cu + 1] * ramp, np.float32(0.0)), one)
        )
        total += radiance * (one - hidden)
    return total * np.float32(2.86) / np.float32(count)


@njit(cache=True, error_model="numpy")
def light_plane(origin, step, sky, centre, out):  # type: ignore[no-untyped-def]
    """Share of the sky that each cell of a level plane sees, out (Gx, Gy).

    Args:
        origin: (3,) middle of cell 0, 0, world; step: (2,) metres between cells along x and y.
        sky: lights of the dome; centre: (3,) of their maps.
    """
    up = (np.float32(0.0), np.float32(0.0), np.float32(1.0))
    z = np.float32(origin[2] - centre[2] + 0.002)
    for i in range(out.shape[0]):
        x = np.float32(origin[0] + step[0] * i - centre[0])
        for j in range(out.shape[1]):
            y = np.float32(origin[1] + step[1] * j - centre[1])
            out[i, j] = even_sky(x, y, z, up, sky)


@njit(cache=True, error_model="numpy")
def lamp_on_plane(origin, step, key, centre, disc, spread, out):  # type: ignore[no-untyped-def]
    """Share of a round lamp that each cell of a level plane sees, out (Gx, Gy): sharp at contacts, soft far from them.

    Args:
        disc: (16, 36, 2) points in the unit disc; spread: radius of the lamp over its distance.
    """
    _, axes, depth, texel = key
    ax, size = axes[0], depth.shape[1]
    inv, half = np.float32(1.0) / texel, np.float32(0.5 * depth.shape[1])
    z = np.float32(origin[2] - centre[2])
    bias, search = np.float32(2.5) * texel, np.float32(0.03) * inv
    for i in range(out.shape[0]):
        x = np.float32(origin[0] + step[0] * i - centre[0])
        for j in range(out.shape[1]):
            y = np.float32(origin[1] + step[1] * j - centre[1])
            u = (ax[0, 0] * x + ax[0, 1] * y + ax[0, 2] * z) * inv + half
            v = (ax[1, 0] * x + ax[1, 1] * y + ax[1, 2] * z) * inv + half
            d = ax[2, 0] * x + ax[2, 1] * y + ax[2, 2] * z - bias
            pattern = (i * 7 + j * 13) % 16
            gap, hits = np.float32(0.0), 0
            for tap in range(0, 36, 3):
                cu, cv = int(u + search * disc[pattern, tap, 0]), int(v + search * disc[pattern, tap, 1])
                if 0 <= cu < size and 0 <= cv < size and depth[0, cv, cu] < d:
                    gap += d - depth[0, cv, cu]
                    hits += 1
            if hits == 0:
                out[i, j] = 1.0
                continue
            reach = max(spread * gap / hits, np.float32(0.003)) * inv
            lit = np.float32(0.0)
            for tap in range(0, 36, 2):
                lit += _lit(
                    x, y, z, ax, depth[0], inv, bias, inv, reach * disc[pattern, tap, 0], reach * disc[pattern, tap, 1]
                )
            out[i, j] = lit / np.float32(18.0)
