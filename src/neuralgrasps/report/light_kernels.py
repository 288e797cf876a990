"""The light reaching a surface point: dome, lamp and rim, in scalar kernels; vectors are tuples, kept in registers."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit


def _disc_points() -> np.ndarray:
    """(16, 36, 2) float32: a disc of 36 points on a golden-angle spiral, turned sixteen ways; one turn per pixel."""
    index = np.arange(36)
    angle = 2.399963 * index + np.arange(16)[:, None] * (np.pi / 8)
    return (np.sqrt((index + 0.5) / 36)[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)).astype(np.float32)


_DISC = _disc_points()


@njit(cache=True, error_model="numpy", inline="always")
def _lit(x, y, z, axes, depth, inv_texel, bias, ramp, du, dv):  # type: ignore[no-untyped-def]
    """1 when nothing stands between the point (relative to the maps' centre) and the light, 0 in its shadow."""
    size = depth.shape[0]
    half = 0.5 * size
    u = int(np.floor((axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z) * inv_texel + half + du))
    v = int(np.floor((axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z) * inv_texel + half + dv))
    if u < 0 or v < 0 or u >= size or v >= size:
        return np.float32(1.0)
    d = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    # A ramp instead of a step: the cells of the map do not show on slanted surfaces.
    return min(max(np.float32(1.0) - (d - bias - depth[v, u]) * ramp, np.float32(0.0)), np.float32(1.0))


@njit(cache=True, error_model="numpy", inline="always")
def _sky_light(x, y, z, n, sample, pattern, sky):  # type: ignore[no-untyped-def]
    """Light from this sample's share of the dome, scaled so that a free horizontal surface gets 1."""
    directions, axes, depth, texel = sky
    count = directions.shape[0]
    inv_texel = np.float32(1.0) / texel
    # Neighbouring pixels ask the maps more than a cell apart, so that no single light draws a sharp shadow.
    du, dv = _DISC[pattern, 4 * sample + 3, 0] * np.float32(1.4), _DISC[pattern, 4 * sample + 3, 1] * np.float32(1.4)
    total = np.float32(0.0)
    for i in range(sample, count, 9):
        lx, ly, lz = directions[i, 0], directions[i, 1], directions[i, 2]
        facing = n[0] * lx + n[1] * ly + n[2] * lz
        if facing > 0.0:
            radiance = np.float32(0.55) + np.float32(0.45) * lz
            if radiance > 0:
                lit = _lit(
                    x, y, z, axes[i], depth[i], inv_texel, texel * np.float32(2.0), inv_texel * np.float32(0.4), du, dv
                )
                total += radiance * facing * lit
    return total * np.float32(9.0 * 2.86) / np.float32(count)


@njit(cache=True, error_model="numpy", inline="always")
def _key_light(x, y, z, sample, pattern, key):  # type: ignore[no-untyped-def]
    """Visibility of the lamp, 0..1, over a disc of about 7 mm: a soft shadow."""
    _, axes, depth, texel = key
    inv_texel = np.float32(1.0) / texel
    spread = np.float32(0.007) * inv_texel
    total = np.float32(0.0)
    for tap in range(4 * sample, 4 * sample + 4):
        du, dv = spread * _DISC[pattern, tap, 0], spread * _DISC[pattern, tap, 1]
        total += _lit(x, y, z, axes[0], depth[0], inv_texel, texel * np.float32(2.5), inv_texel, du, dv)
    return total * np.float32(0.25)


@njit(cache=True, error_model="numpy", inline="always")
def _blend(rows, b0, b1, b2):  # type: ignore[no-untyped-def]
    """Barycentric mean of the rows of a (3, 3) array, as a tuple."""
    return (
        b0 * rows[0, 0] + b1 * rows[1, 0] + b2 * rows[2, 0],
        b0 * rows[0, 1] + b1 * rows[1, 1] + b2 * rows[2, 1],
        b0 * rows[0, 2] + b1 * rows[1, 2] + b2 * rows[2, 2],
    )


@njit(cache=True, error_model="numpy", inline="always")
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy", inline="always")
def _unit(a, sign):  # type: ignore[no-untyped-def]
    scale = sign / (np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) + np.float32(1e-20))
    return (a[0] * scale, a[1] * scale, a[2] * scale)


@njit(cache=True, error_model="numpy", inline="always")
def _face_normal(corners):  # type: ignore[no-untyped-def]
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    return _unit((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), np.float32(1.0))


@njit(cache=True, error_model="numpy")
def _light(p, n, g, view, gloss, sample, pattern, sky, key, lights):  # type: ignore[no-untyped-def]
    """Diffuse light on a surface, and the highlight and rim light added to it, at p (relative to the maps' centre).

    n is the shading normal, g the face's, both towards the camera; view the unit vector to the camera.
    """
    lift = sky[3] * np.float32(0.8)
    diffuse = lights[0] * _sky_light(
        p[0] + g[0] * lift, p[1] + g[1] * lift, p[2] + g[2] * lift, n, sample, pattern, sky
    )
    facing = _dot(n, key[0])
    shine = np.float32(0.0)
    if facing > 0:
        lift = key[3] * np.float32(1.5)
        seen = _key_light(p[0] + g[0] * lift, p[1] + g[1] * lift, p[2] + g[2] * lift, sample, pattern, key)
        half = _unit((key[0][0] + view[0], key[0][1] + view[1], key[0][2] + view[2]), np.float32(1.0))
        shine = lights[1] * seen * gloss * max(_dot(n, half), np.float32(0.0)) ** 38 * facing
        diffuse += lights[1] * seen * facing
    grazing = (np.float32(1.0) - max(_dot(n, view), np.float32(0.0))) ** 4
    rim = lights[2] * grazing * (np.float32(0.35) + np.float32(0.65) * max(n[2], np.float32(0.0)))
    return diffuse + np.float32(0.08), shine, rim  # 0.08: light bounced from everywhere


@njit(cache=True, error_model="numpy")
def shade_surfaces(image, scene, view, sky, key, lights, out):  # type: ignore[no-untyped-def]
    """Add the light of every sample to out = (colour (h, w, 3), coverage (h, w)).

    Args:
        image: face_index (3h, 3w), barycentric (3h, 3w, 3) of the samples.
        scene: per face: corners (F, 3, 3) world, normals (F, 3, 3), linear colours (F, 3, 3), gloss (F,).
        view: eye (3,), centre (3,) of the shadow maps, world.
        sky, key: directions (L, 3) or (3,), axes (L, 3, 3), depth (L, S, S), texel of the shadow maps.
        lights: strength of sky, key and rim.
    """
    face_index, barycentric = image
    corners, normals, colours, gloss = scene
    eye, centre = view
    out_colour, out_coverage = out
    one, ninth = np.float32(1.0), np.float32(1.0 / 9.0)
    for row in range(out_coverage.shape[0]):
        for column in range(out_coverage.shape[1]):
            pattern = (row * 7 + column * 13) % 16
            for sample in range(9):
                v, u = row * 3 + sample // 3, column * 3 + sample % 3
                face = face_index[v, u]
                if face < 0:
                    continue
                b0, b1, b2 = barycentric[v, u, 0], barycentric[v, u, 1], barycentric[v, u, 2]
                p = _blend(corners[face], b0, b1, b2)
                to_eye = _unit((eye[0] - p[0], eye[1] - p[1], eye[2] - p[2]), one)
                g = _face_normal(corners[face])
                side = one if _dot(g, to_eye) >= 0 else -one
                g = (g[0] * side, g[1] * side, g[2] * side)
                n = _unit(_blend(normals[face], b0, b1, b2), side)
                q = (p[0] - centre[0], p[1] - centre[1], p[2] - centre[2])
                diffuse, shine, rim = _light(q, n, g, to_eye, gloss[face], sample, pattern, sky, key, lights)
                rgb = _blend(colours[face], b0, b1, b2)
                for c in range(3):
                    glow = rim * np.float32(0.3) * (one + rgb[c])
                    out_colour[row, column, c] += (rgb[c] * diffuse + shine + glow) * ninth
                out_coverage[row, column] += ninth


@njit(cache=True, error_model="numpy")
def fill_ground(height, reach, sky, key, dark_sky, dark_key):  # type: ignore[no-untyped-def]
    """Share of the sky and of the lamp hidden from each ground cell (G, G) of a square of side 2 reach."""
    size = dark_sky.shape[0]
    up = (np.float32(0.0), np.float32(0.0), np.float32(1.0))
    for i in range(size):
        x = ((np.float32(i) + np.float32(0.5)) / size * 2 - 1) * reach
        for j in range(size):
            y = ((np.float32(j) + np.float32(0.5)) / size * 2 - 1) * reach
            light = np.float32(0.0)
            for sample in range(9):
                light += _sky_light(x, y, height, up, sample, 0, sky)
            dark_sky[i, j] = max(np.float32(1.0) - light / np.float32(9.0), np.float32(0.0))
            dark_key[i, j] = np.float32(1.0) - _key_light(x, y, height, 4, 0, key)
