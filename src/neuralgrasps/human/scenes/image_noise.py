# ruff: noqa: NPY002 - compiled code has the old generator only, seeded by the caller
"""A structured-light camera's errors on small images: `sim.camera`'s model for images thinned from larger ones.

A thinned image takes every `ratio`-th pixel of the camera's. Beside a depth edge is what the camera's own neighbours
see, so that a thinned pixel is beside one `ratio` times less often; its sample wanders by `ratio` times less.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.sim.camera import STRUCTURED_LIGHT

_EDGE_M = 0.008
_AXIAL_M, _STEP_M, _LATERAL_PX = STRUCTURED_LIGHT.axial_m, STRUCTURED_LIGHT.step_m, STRUCTURED_LIGHT.lateral_px
_EDGE_LOSS, _FLYING, _BASELINE_M = STRUCTURED_LIGHT.edge_dropout, STRUCTURED_LIGHT.flying, STRUCTURED_LIGHT.baseline_m
_GRAZING_LOSS, _GRAZING_POWER = STRUCTURED_LIGHT.grazing_dropout, STRUCTURED_LIGHT.grazing_power


class ImageNoise(NamedTuple):
    """See `sim.camera.DepthNoise`; `baseline_m` below 0: the projector is to the left, as in a mirrored image."""

    axial_m: float
    step_m: float
    grazing_dropout: float
    edge_dropout: float
    flying: float
    lateral_px: float
    baseline_m: float


CAMERA_NOISE = ImageNoise(
    _AXIAL_M, _STEP_M, STRUCTURED_LIGHT.grazing_dropout, _EDGE_LOSS, _FLYING, _LATERAL_PX, _BASELINE_M
)  # fmt: skip
"""The camera's own."""


def sensed_image(depth: np.ndarray, fx: float, *, noise: ImageNoise, seed: int) -> np.ndarray:
    """`sense_image` of the camera's whole image, with a seed (0 to 2^32 - 1)."""
    out = np.empty(depth.shape, np.float32)
    _sense_seeded(np.asarray(depth, np.float32), fx, noise, np.uint32(seed), out)
    return out


@njit(cache=True, error_model="numpy")
def _sense_seeded(depth, fx, noise, seed, out):  # type: ignore[no-untyped-def]
    np.random.seed(seed)
    sense_image(depth, fx, 1.0, noise, out)


@njit(cache=True, error_model="numpy")
def draw_noise(strongest):  # type: ignore[no-untyped-def]
    """Noise of a random strength up to `strongest` times that of the camera, its projector on either side or none."""
    n = strongest * np.random.random()
    side, base = np.random.random(), _BASELINE_M * np.random.uniform(0.6, 1.5)
    baseline = 0.0 if side < 0.1 else base if side < 0.55 else -base
    return ImageNoise(
        _AXIAL_M * n, _STEP_M * n, _GRAZING_LOSS * min(n, 1.0), _EDGE_LOSS * n, _FLYING * n, _LATERAL_PX * n, baseline
    )


@njit(cache=True, error_model="numpy")
def sense_image(depth, fx, ratio, noise, out):  # type: ignore[no-untyped-def]
    """What the sensor reports, from numba's generator (seed it first).

    Args:
        depth: (h, w) float32 exact z-depth, metres; inf or 0 where nothing is.
        fx: focal length, pixels of this image; ratio: pixels of the camera's image per pixel of this one.
        noise: an `ImageNoise`.
        out: (h, w) float32, written: metres, 0 where nothing was measured.
    """
    height, width = depth.shape
    near_edge, wander = min(1.0, 1.0 / ratio), min(0.4 * noise.lateral_px / ratio, 0.4)
    lit, state = np.ones(width, np.bool_), np.empty(1, np.uint64)
    state[0] = np.uint64(np.random.randint(1, 2**62))
    for v in range(height):
        _light_row(depth[v], fx, noise.baseline_m, lit)
        for u in range(width):
            out[v, u] = 0.0
            su = min(max(u + _step(state, wander), 0), width - 1)
            sv = min(max(v + _step(state, wander), 0), height - 1)
            z = depth[sv, su]
            if not 0.0 < z < np.inf or not lit[su]:
                continue
            across, slope = _around(depth, sv, su)
            square = (slope * fx / z) ** 2
            loss = 0.0
            if square > 1.0:
                loss = noise.grazing_dropout * (square / (1.0 + square)) ** (0.5 * _GRAZING_POWER)
            if across >= 0.0 and _uniform(state) < near_edge:
                loss = noise.edge_dropout
                if across > 0.0 and _uniform(state) < noise.flying:
                    z += _uniform(state) * (across - z)
            if loss > 0.0 and _uniform(state) < loss:
                continue
            z += noise.axial_m * z * z * _normal(state)
            step = noise.step_m * z * z
            if step > 1e-6:
                z = math.floor(z / step + 0.5) * step
            out[v, u] = max(z, 0.0)


@njit(cache=True, error_model="numpy", inline="always")
def _bits(state):  # type: ignore[no-untyped-def]
    """64 random bits; Marsaglia 2003, xorshift with shifts 13, 7, 17."""
    x = state[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    state[0] = x
    return x


@njit(cache=True, error_model="numpy", inline="always")
def _uniform(state):  # type: ignore[no-untyped-def]
    return np.float64(_bits(state) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, error_model="numpy", inline="always")
def _normal(state):  # type: ignore[no-untyped-def]
    """Sum of four uniform numbers of 16 bits, with variance 1: normal to two and a half deviations."""
    x, mask = _bits(state), np.uint64(65535)
    total = (x & mask) + ((x >> np.uint64(16)) & mask) + ((x >> np.uint64(32)) & mask) + (x >> np.uint64(48))
    return (np.float64(total) / 65536.0 - 2.0) * 1.7320508


@njit(cache=True, error_model="numpy", inline="always")
def _step(state, share):  # type: ignore[no-untyped-def]
    """-1 or 1 with the probability `share` each, else 0."""
    x = _uniform(state)
    return 1 if x < share else -1 if x < 2.0 * share else 0


@njit(cache=True, error_model="numpy")
def _light_row(row, fx, baseline, lit):  # type: ignore[no-untyped-def]
    """Which pixels of a row the projector sees too; the projector's column of a pixel is u - fx baseline / z."""
    width = row.shape[0]
    lit[:] = True
    if baseline == 0.0:
        return
    edge = np.inf
    for k in range(width):
        u = width - 1 - k if baseline > 0.0 else k
        z = row[u]
        column = u - (fx * baseline / z if 0.0 < z < np.inf else 0.0)
        column = column if baseline > 0.0 else -column
        lit[u] = column <= edge
        edge = min(edge, column)


@njit(cache=True, error_model="numpy", inline="always")
def _around(depth, v, u):  # type: ignore[no-untyped-def]
    """Depth across a depth edge beside this pixel (0: nothing there; -1: no edge), and the slope of depth, metres.

    The inverse depth of a plane is linear over the image: a step there twice that of the pixels before and after is an
    edge.
    """
    height, width = depth.shape
    z = depth[v, u]
    across, slope = -1.0, 0.0
    for k in range(4):
        du, dv = (1 if k == 0 else -1 if k == 1 else 0), (1 if k == 2 else -1 if k == 3 else 0)
        if not (0 <= u + du < width and 0 <= v + dv < height):
            continue
        other = depth[v + dv, u + du]
        if not 0.0 < other < np.inf:
            across = max(across, 0.0)
        elif abs(other - z) > _EDGE_M and _is_edge(depth, v, u, dv, du):
            across = other
        else:
            slope = max(slope, abs(other - z))
    return across, slope


@njit(cache=True, error_model="numpy")
def _is_edge(depth, v, u, dv, du):  # type: ignore[no-untyped-def]
    step = _inverse_step(depth, v, u, dv, du)
    return step > 2.0 * min(_inverse_step(depth, v, u, -dv, -du), _inverse_step(depth, v + dv, u + du, dv, du))


@njit(cache=True, error_model="numpy", inline="always")
def _inverse_step(depth, v, u, dv, du):  # type: ignore[no-untyped-def]
    """Step of inverse depth from a pixel to a neighbour; inf beyond the image and where nothing is."""
    height, width = depth.shape
    if not (0 <= u + du < width and 0 <= v + dv < height):
        return np.inf
    a, b = depth[v, u], depth[v + dv, u + du]
    if not (0.0 < a < np.inf and 0.0 < b < np.inf):
        return np.inf
    return abs(1.0 / a - 1.0 / b)
