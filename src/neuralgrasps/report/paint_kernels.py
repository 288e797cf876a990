"""The kernel that turns visible faces into finished pixels.

Light is worked out once per pixel and smooth surface, not once per sample: smooth edges at a quarter of the work.
"""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.report.light_kernels import _dot, _key_light, _unit
from neuralgrasps.report.scene_kernels import TABLE_TOP, even_sky, value_at

_SMOOTH = 0.94  # cosine between faces of one body that share one light in a pixel


@njit(cache=True, error_model="numpy")
def paint(frame, still, scene, view, top, sky, key, lights, tone, out):  # type: ignore[no-untyped-def]
    """Finished pixels, out (h, w, 3) uint8 sRGB.

    Args:
        frame: face (S, h, w), offsets (S, 2), camera (4,).
        still: light of what stands still (h, w, 3), place on the table's top (h, w, 2).
        scene: points_W (V, 3), faces (F, 3), normals_L (F, 3, 3) at corners, flat_L (F, 3) across faces, body (F,),
            R_WL (B, 3, 3), colour (F, 3), gloss (F,); float32.
        view: R_WC (3, 3), eye (3,), centre (3,) of the shadow maps; float32.
        top: linear colour (3,) of the table, corner (2,) and size (2,) of its top, sky (Gx, Gy) and lamp (Hx, Hy) that
            it sees.
        sky, key: lights of the dome and the lamp; lights: strength of sky, lamp and rim.
        tone: 8-bit levels of 4096 steps of linear light from 0 to 2.
    """
    # Arrays are taken out of their tuples once: within the loops that costs more than the light.
    face, offsets, camera = frame
    base, spot = still
    points, faces, normals, flat, body, R_WL, colours, gloss = scene
    R, eye, centre = view
    colour, low, size, sky_light, lamp_light = top
    samples = face.shape[0]
    share, one = np.float32(1.0 / samples), np.float32(1.0)
    owner = np.empty(samples, np.int64)  # a face of each lit surface of the pixel
    shown = np.empty((samples, 3), np.float32)  # and its colour
    for row in range(face.shape[1]):
        for col in range(face.shape[2]):
            red = green = blue = np.float32(0.0)
            groups = tops = free = 0
            for s in range(samples):
                f = face[s, row, col]
                if f < 0:
                    free += 1
                    tops += f == TABLE_TOP
                    continue
                own, link = groups, body[f]
                for k in range(groups):
                    o = owner[k]
                    alike = flat[o, 0] * flat[f, 0] + flat[o, 1] * flat[f, 1] + flat[o, 2] * flat[f, 2] > _SMOOTH
                    if o == f or (body[o] == link and alike):
                        own = k
                        break
                if own == groups:
                    x = (np.float32(col) + offsets[s, 0] - camera[2]) / camera[0]
                    y = (np.float32(row) + offsets[s, 1] - camera[3]) / camera[1]
                    d = (
                        R[0, 0] * x + R[0, 1] * y + R[0, 2],
                        R[1, 0] * x + R[1, 1] * y + R[1, 2],
                        R[2, 0] * x + R[2, 1] * y + R[2, 2],
                    )
                    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
                    a = (points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2])
                    b = (points[j, 0] - eye[0], points[j, 1] - eye[1], points[j, 2] - eye[2])
                    c = (points[k, 0] - eye[0], points[k, 1] - eye[1], points[k, 2] - eye[2])
                    b0, b1, b2 = _hit(a, b, c, d)
                    m0 = b0 * normals[f, 0, 0] + b1 * normals[f, 1, 0] + b2 * normals[f, 2, 0]
                    m1 = b0 * normals[f, 0, 1] + b1 * normals[f, 1, 1] + b2 * normals[f, 2, 1]
                    m2 = b0 * normals[f, 0, 2] + b1 * normals[f, 1, 2] + b2 * normals[f, 2, 2]
                    p = (
                        b0 * a[0] + b1 * b[0] + b2 * c[0],
                        b0 * a[1] + b1 * b[1] + b2 * c[1],
                        b0 * a[2] + b1 * b[2] + b2 * c[2],
                    )
                    view_ray = _unit(p, -one)
                    r00, r01, r02 = R_WL[link, 0, 0], R_WL[link, 0, 1], R_WL[link, 0, 2]
                    r10, r11, r12 = R_WL[link, 1, 0], R_WL[link, 1, 1], R_WL[link, 1, 2]
                    r20, r21, r22 = R_WL[link, 2, 0], R_WL[link, 2, 1], R_WL[link, 2, 2]
                    g0, g1, g2 = flat[f, 0], flat[f, 1], flat[f, 2]
                    g = (
                        r00 * g0 + r01 * g1 + r02 * g2,
                        r10 * g0 + r11 * g1 + r12 * g2,
                        r20 * g0 + r21 * g1 + r22 * g2,
                    )
                    side = one if _dot(g, view_ray) >= 0 else -one
                    g = (g[0] * side, g[1] * side, g[2] * side)
                    n = _unit(
                        (
                            r00 * m0 + r01 * m1 + r02 * m2,
                            r10 * m0 + r11 * m1 + r12 * m2,
                            r20 * m0 + r21 * m1 + r22 * m2,
                        ),
                        side,
                    )
                    q = (p[0] + eye[0] - centre[0], p[1] + eye[1] - centre[1], p[2] + eye[2] - centre[2])
                    pattern = (row * 7 + col * 13) % 16
                    diffuse, shine, glow = _surface_light(q, n, g, view_ray, gloss[f], pattern, sky, key, lights)
                    for k in range(3):
                        shown[groups, k] = colours[f, k] * diffuse + shine + glow * (one + colours[f, k])
                    owner[groups] = f
                    groups += 1
                red += shown[own, 0]
                green += shown[own, 1]
                blue += shown[own, 2]
            red, green, blue = red * share, green * share, blue * share
            if free:
                weight = np.float32(free) * share  # `base` holds the whole pixel's
                red += weight * base[row, col, 0]
                green += weight * base[row, col, 1]
                blue += weight * base[row, col, 2]
                if tops:
                    u, v = (spot[row, col, 0] - low[0]) / size[0], (spot[row, col, 1] - low[1]) / size[1]
                    bright = lights[0] * value_at(sky_light, u, v) + lights[1] * key[0][2] * value_at(lamp_light, u, v)
                    bright = (bright + np.float32(0.08)) * np.float32(tops) * share
                    red += colour[0] * bright
                    green += colour[1] * bright
                    blue += colour[2] * bright
            out[row, col, 0] = tone[min(int(red * np.float32(2047.5) + np.float32(0.5)), 4095)]
            out[row, col, 1] = tone[min(int(green * np.float32(2047.5) + np.float32(0.5)), 4095)]
            out[row, col, 2] = tone[min(int(blue * np.float32(2047.5) + np.float32(0.5)), 4095)]


@njit(cache=True, error_model="numpy", inline="always")
def _hit(a, b, c, d):  # type: ignore[no-untyped-def]
    """Barycentric weights at which the ray d from the eye meets the face a, b, c (relative to the eye)."""
    p = (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0])
    q = (c[1] * a[2] - c[2] * a[1], c[2] * a[0] - c[0] * a[2], c[0] * a[1] - c[1] * a[0])
    r = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    u, v, w = _dot(p, d), _dot(q, d), _dot(r, d)
    total = u + v + w
    inv = np.float32(1.0) / total if total != 0.0 else np.float32(0.0)
    return u * inv, v * inv, w * inv


@njit(cache=True, error_model="numpy")
def _surface_light(p, n, g, view, gloss, pattern, sky, key, lights):  # type: ignore[no-untyped-def]
    """Diffuse light, highlight and rim light at p (relative to the maps' centre), as in still pictures."""
    lift = sky[3] * np.float32(0.8)
    x, y, z = p[0] + g[0] * lift, p[1] + g[1] * lift, p[2] + g[2] * lift
    diffuse = lights[0] * even_sky(x, y, z, n, sky)
    facing, shine = _dot(n, key[0]), np.float32(0.0)
    if facing > 0.0:
        lift = key[3] * (np.float32(4.5) - np.float32(3.0) * facing)  # more where light grazes
        x, y, z = p[0] + g[0] * lift, p[1] + g[1] * lift, p[2] + g[2] * lift
        seen = np.float32(0.0)
        for sample in range(0, 9, 2):
            seen += np.float32(0.2) * _key_light(x, y, z, sample, pattern, key)
        half = _unit((key[0][0] + view[0], key[0][1] + view[1], key[0][2] + view[2]), np.float32(1.0))
        shine = lights[1] * seen * gloss * max(_dot(n, half), np.float32(0.0)) ** 38 * facing
        diffuse += lights[1] * seen * facing
    grazing = (np.float32(1.0) - max(_dot(n, view), np.float32(0.0))) ** 4
    rim = lights[2] * grazing * (np.float32(0.35) + np.float32(0.65) * max(n[2], np.float32(0.0)))
    return diffuse + np.float32(0.08), shine, rim * np.float32(0.3)
