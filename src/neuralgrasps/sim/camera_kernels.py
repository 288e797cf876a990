"""Compiled steps of the depth camera's sensor model, over the pixels of one image; see `sim.camera`."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit

_EDGE_M = 0.008  # neighbours farther apart than this, and than their slopes explain, lie on two surfaces
_NEVER = 1e-18  # a share smaller than this is none


@njit(cache=True, error_model="numpy", inline="always")
def _inverse(z):  # type: ignore[no-untyped-def]
    return 1.0 / z if z > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def _is_edge(before, here, there, after):  # type: ignore[no-untyped-def]
    """Whether a depth edge lies between two neighbours; `before` and `after` go on in their line, negative beyond it.

    The inverse depth of a plane is linear over the image, so that a step there that is twice that of the neighbouring
    pixels is no slope, however steep.
    """
    if not abs(there - here) > _EDGE_M:
        return False
    step = abs(_inverse(there) - _inverse(here))
    slope = abs(_inverse(here) - _inverse(before)) if before >= 0.0 else step
    return step > 2.0 * min(slope, abs(_inverse(after) - _inverse(there)) if after >= 0.0 else step)


@njit(cache=True, error_model="numpy", inline="always")
def _at(z, v, u):  # type: ignore[no-untyped-def]
    """Depth of a pixel, -1 outside the image."""
    return z[v, u] if 0 <= v < z.shape[0] and 0 <= u < z.shape[1] else -1.0


@njit(cache=True, error_model="numpy")
def mark_edges(z, beside, across):  # type: ignore[no-untyped-def]
    """Mark pixels beside a depth edge, with the depth on its other side: of the left, right, upper, lower neighbour.

    Args:
        z: (h, w) depth, metres, 0 where nothing is seen.
        beside: (h, w) bool, all False; across: (h, w), all 0. Written.
    """
    height, width = z.shape
    for v in range(height):
        for u in range(width):
            here = z[v, u]
            far = u > 0 and abs(z[v, u - 1] - here) > _EDGE_M
            far |= u + 1 < width and abs(z[v, u + 1] - here) > _EDGE_M
            far |= v > 0 and abs(z[v - 1, u] - here) > _EDGE_M
            far |= v + 1 < height and abs(z[v + 1, u] - here) > _EDGE_M
            for k in range(4 if far else 0):  # most pixels end here
                du = -1 if k == 0 else (1 if k == 1 else 0)
                dv = -1 if k == 2 else (1 if k == 3 else 0)
                there = _at(z, v + dv, u + du)
                if there < 0.0:
                    continue
                if _is_edge(_at(z, v - dv, u - du), here, there, _at(z, v + 2 * dv, u + 2 * du)):
                    beside[v, u], across[v, u] = True, there
                    break


@njit(cache=True, error_model="numpy")
def mark_lit(z, shift, lit):  # type: ignore[no-untyped-def]
    """Mark pixels that a projector to the right sees too; `shift` = focal length in pixels times the baseline.

    Its column of a pixel is u - shift / z. Along a row that no surface hides it grows; where a pixel further right has
    a smaller one, a nearer surface stands in between.
    """
    for v in range(z.shape[0]):
        least = np.inf
        for u in range(z.shape[1] - 1, -1, -1):
            column = u - shift * _inverse(z[v, u])
            least = min(least, column)
            lit[v, u] = column <= least


@njit(cache=True, error_model="numpy")
def write_loss(z, beside, fx, fy, edge_dropout, grazing_dropout, power, out):  # type: ignore[no-untyped-def]
    """Chance of every pixel to be lost: beside an edge, else by the sine of the angle at which its surface is seen."""
    height, width = z.shape
    flattest = _NEVER ** (2.0 / power) if power > 0.0 else -1.0  # squared sine below which nothing is lost
    for v in range(height):
        low, high = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(width):
            if beside[v, u]:
                out[v, u] = edge_dropout
                continue
            left, right = max(u - 1, 0), min(u + 1, width - 1)
            x = (z[v, right] - z[v, left]) * (0.5 if right - left == 2 else 1.0) * fx
            y = (z[high, u] - z[low, u]) * (0.5 if high - low == 2 else 1.0) * fy
            here = max(z[v, u], 1e-6)
            if x * x + y * y < 0.9 * flattest * here * here:
                out[v, u] = 0.0
                continue
            square = (x * x + y * y) / (here * here)
            squared = square / (1.0 + square)
            out[v, u] = 0.0 if squared < flattest else grazing_dropout * squared ** (0.5 * power)


@njit(cache=True, error_model="numpy")
def wander(normals, deviation_px, z, loss, seen, out_z, out_loss, out_seen):  # type: ignore[no-untyped-def]
    """Take every pixel from one that `normals` (2, h, w) times the deviation, rounded, is away (rows, columns)."""
    height, width = z.shape
    for v in range(height):
        for u in range(width):
            row = min(max(v + int(np.rint(normals[0, v, u] * deviation_px)), 0), height - 1)
            column = min(max(u + int(np.rint(normals[1, v, u] * deviation_px)), 0), width - 1)
            out_z[v, u], out_loss[v, u], out_seen[v, u] = z[row, column], loss[row, column], seen[row, column]


@njit(cache=True, error_model="numpy")
def measure(z, normals, axial_m, white_m, add, scale, step_m, chance, loss, seen, out):  # type: ignore[no-untyped-def]
    """What is reported: noise along the ray, `scale` and `add` (h, w) or (0, 0), rounded to steps, and what is lost."""
    for v in range(z.shape[0]):
        for u in range(z.shape[1]):
            if not seen[v, u] or chance[v, u] < loss[v, u]:
                out[v, u] = 0.0
                continue
            square = z[v, u] * z[v, u]
            value = z[v, u] + normals[v, u] * math.hypot(axial_m * square, white_m)
            if add.shape[0]:
                value = value * scale + add[v, u]
            if step_m > 0.0:
                step = max(step_m * square, 1e-6)
                value = np.rint(value / step) * step
            out[v, u] = max(value, 0.0)
