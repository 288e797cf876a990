"""Orthographic depth maps from many light directions: what the sky and the key light can see of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowMaps:
    """Depth of the first surface along each of L light directions, over the scene's bounding sphere.

    Attributes:
        axes: (L, 3, 3) float32 rows: map column axis, map row axis, direction the light travels.
        depth: (L, S, S) float32 distance travelled past the sphere's centre; inf where nothing is hit.
        centre: (3,) float64 middle of the sphere; texel_m: width of one map cell.
    """

    axes: np.ndarray
    depth: np.ndarray
    centre: np.ndarray
    texel_m: float


def shadow_maps(
    vertices: np.ndarray, faces: np.ndarray, directions: np.ndarray, *, centre: np.ndarray, radius: float, size: int
) -> ShadowMaps:
    """Render the maps.

    Args:
        vertices: (V, 3) world; faces: (F, 3).
        directions: (L, 3) unit vectors towards the lights, world frame.
        centre, radius: a sphere around the scene, metres.
        size: cells per side of a map.
    """
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, directions)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(directions, first), -directions], axis=1)
    depth = np.full((len(directions), size, size), np.inf, np.float32)
    texel = 2.0 * radius / size
    _fill_maps((vertices - centre).astype(np.float32), faces, axes.astype(np.float32), np.float32(1 / texel), depth)
    return ShadowMaps(axes=axes.astype(np.float32), depth=depth, centre=centre, texel_m=texel)


def dome_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors evenly spread over the sky, from a little below the horizon to the zenith.

    A spiral of golden angles. Neighbours in the list are far apart in the sky, so any few consecutive ones cover it.
    """
    order = np.arange(count) * _coprime_step(count) % count
    z = 1.0 - (order + 0.5) / count * 1.18
    angle = order * (np.pi * (3.0 - np.sqrt(5.0)))
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _coprime_step(count: int) -> int:
    step = int(count * 0.381966) or 1
    while np.gcd(step, count) != 1:
        step += 1
    return step


@njit(cache=True, error_model="numpy")
def _fill_maps(points, faces, axes, inv_texel, depth):  # type: ignore[no-untyped-def]
    size = depth.shape[1]
    half = np.float32(0.5 * size - 0.5)
    uvd = np.empty((len(points), 3), np.float32)
    for light in range(len(axes)):
        ax = axes[light]
        for i in range(len(points)):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            uvd[i, 0] = (ax[0, 0] * x + ax[0, 1] * y + ax[0, 2] * z) * inv_texel + half
            uvd[i, 1] = (ax[1, 0] * x + ax[1, 1] * y + ax[1, 2] * z) * inv_texel + half
            uvd[i, 2] = ax[2, 0] * x + ax[2, 1] * y + ax[2, 2] * z
        _fill_map(uvd, faces, depth[light])


@njit(cache=True, error_model="numpy")
def _fill_map(uvd, faces, depth):  # type: ignore[no-untyped-def]
    size = depth.shape[0]
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        au, av, ad = uvd[a, 0], uvd[a, 1], uvd[a, 2]
        bu, bv, bd = uvd[b, 0] - au, uvd[b, 1] - av, uvd[b, 2] - ad
        cu, cv, cd = uvd[c, 0] - au, uvd[c, 1] - av, uvd[c, 2] - ad
        area = bu * cv - bv * cu
        if area == 0.0:
            continue
        u0 = max(int(np.ceil(au + min(0.0, bu, cu))), 0)
        u1 = min(int(np.floor(au + max(0.0, bu, cu))), size - 1)
        v0 = max(int(np.ceil(av + min(0.0, bv, cv))), 0)
        v1 = min(int(np.floor(av + max(0.0, bv, cv))), size - 1)
        inv = np.float32(1.0) / area
        for v in range(v0, v1 + 1):
            y = np.float32(v) - av
            for u in range(u0, u1 + 1):
                x = np.float32(u) - au
                s = (x * cv - y * cu) * inv
                t = (bu * y - bv * x) * inv
                if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
                    d = ad + s * bd + t * cd
                    depth[v, u] = min(depth[v, u], d)
