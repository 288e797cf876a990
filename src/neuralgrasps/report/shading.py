"""Offscreen pictures of meshes: sky light with true occlusion, a soft-shadowed key light, a rim light, 3x3 samples.

Every picture is the sum of a dome of small lights, each with its own shadow map, and one larger lamp. A pixel has nine
samples and each sample asks a ninth of the dome, so one pixel sees the whole sky and there is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from neuralgrasps.geometry.camera import Intrinsics, pixel_rays
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.report.light_kernels import fill_ground, shade_surfaces
from neuralgrasps.report.palette import linear_to_srgb
from neuralgrasps.report.shadow_maps import ShadowMaps, dome_directions, shadow_maps
from neuralgrasps.report.smooth_normals import corner_normals

SUPERSAMPLING = 3
_KNEE = 0.75  # linear light above which highlights roll off
_DOME_LIGHTS = 45  # a multiple of the nine samples of a pixel
_DOME_MAP, _KEY_MAP = 128, 512  # cells per side of a shadow map
_GROUND_CELLS, _GROUND_REACH = 128, 2.1  # the shadow on the ground: cells per side, half side in scene radii
Lights = tuple[np.ndarray, np.ndarray, np.ndarray, np.float32]  # directions, then axes, depths and cell of their maps


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """One thing in the picture.

    Attributes:
        mesh: its surface, world frame (Z up).
        colour: (3,) linear-light RGB, or (V, 3) one per vertex.
        gloss: strength of the highlight, 0 matte .. 1.
        caster: a coarser mesh of the same shape, world frame, that throws its shadows from the sky; the mesh when None.
    """

    mesh: Mesh
    colour: np.ndarray
    gloss: float = 0.25
    caster: Mesh | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Style:
    """Look of a picture.

    Attributes:
        sky, key, rim: strength of the dome, the lamp and the rim light.
        ground: draw a soft shadow on a ground plane under the lowest point.
        key_azimuth_rad, key_elevation_rad: lamp direction; azimuth counts from the camera, positive to its left.
    """

    sky: float = 0.84
    key: float = 0.66
    rim: float = 0.30
    ground: bool = True
    key_azimuth_rad: float = 0.75
    key_elevation_rad: float = 0.95


def shade(
    surfaces: Sequence[Surface], X_WC: np.ndarray, intrinsics: Intrinsics, *, style: Style | None = None
) -> np.ndarray:
    """Picture of `surfaces`.

    Args:
        surfaces: what to draw, world frame, z up.
        X_WC: (4, 4) camera pose (OpenCV camera).
        intrinsics: the camera; the picture has its size.
    Returns:
        (height, width, 4) uint8 sRGB with straight alpha; the background is transparent but for the ground shadow.
    """
    style = style or Style()
    vertices, faces, colours, gloss = _merge(surfaces)
    normals = np.concatenate([corner_normals(s.mesh.vertices, s.mesh.faces) for s in surfaces])
    fine = intrinsics.scaled(SUPERSAMPLING)
    image = rasterise([Mesh(vertices, faces)], np.linalg.inv(X_WC)[None], fine)
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    radius = float(np.sqrt(((vertices - centre) ** 2).sum(axis=1).max())) * 1.02
    dome, key_light = dome_directions(_DOME_LIGHTS), _key_direction(X_WC, style)
    coarse = merge_meshes([s.caster or s.mesh for s in surfaces])
    dome_maps = shadow_maps(coarse.vertices, coarse.faces, dome, centre=centre, radius=radius, size=_DOME_MAP)
    sky = lights_of(dome, dome_maps)
    key_maps = shadow_maps(vertices, faces, key_light[None], centre=centre, radius=radius, size=_KEY_MAP)
    key = lights_of(key_light, key_maps)
    colour = np.zeros((intrinsics.height, intrinsics.width, 3), np.float32)
    coverage = np.zeros((intrinsics.height, intrinsics.width), np.float32)
    shade_surfaces(
        (image.face_index, image.barycentric),
        (vertices[faces].astype(np.float32), normals, colours[faces].astype(np.float32), gloss),
        (X_WC[:3, 3].astype(np.float32), centre.astype(np.float32)),
        sky,
        key,
        np.array([style.sky, style.key, style.rim], np.float32),
        (colour, coverage),
    )
    ground = np.float32(vertices[:, 2].min() - 1e-4)
    shadow = _ground_shadow(ground - centre[2], radius, sky, key) if style.ground else np.zeros((2, 2))
    darkness = _look_up_ground(shadow, X_WC, intrinsics, ground=float(ground), centre=centre, radius=radius)
    return _encode(colour, coverage, darkness)


def lights_of(directions: np.ndarray, maps: ShadowMaps) -> Lights:
    """What the light kernels take: directions (L, 3) or (3,) towards the lights, and their maps."""
    return directions.astype(np.float32), maps.axes, maps.depth, np.float32(maps.texel_m)


def _ground_shadow(height: float, radius: float, sky: Lights, key: Lights) -> np.ndarray:
    """(G, G) darkness of the ground over a square of half side `_GROUND_REACH * radius` around the scene."""
    dark_sky = np.zeros((_GROUND_CELLS, _GROUND_CELLS), np.float32)
    dark_key = np.zeros_like(dark_sky)
    reach = _GROUND_REACH * radius
    fill_ground(np.float32(height), np.float32(reach), sky, key, dark_sky, dark_key)
    cell = 2 * reach / _GROUND_CELLS
    # The far shadows of single sky lights would show as a star: blur more, the farther from the contact.
    near, far = (gaussian_filter(dark_sky, sigma / cell) for sigma in (0.006, 0.10 * radius))
    at = (np.arange(_GROUND_CELLS) + 0.5) / _GROUND_CELLS * 2 - 1
    away = np.hypot(at[:, None], at[None, :])
    weight = np.clip((near - 0.30) / 0.35, 0, 1)
    dark = 0.50 * (weight * near + (1 - weight) * far) + 0.20 * gaussian_filter(dark_key, 0.007 / cell)
    return dark * np.clip((1 - away) / 0.45, 0, 1)


def _look_up_ground(
    shadow: np.ndarray, X_WC: np.ndarray, intrinsics: Intrinsics, *, ground: float, centre: np.ndarray, radius: float
) -> np.ndarray:
    """(h, w) darkness of the ground at every pixel."""
    rays = pixel_rays(intrinsics) @ X_WC[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(rays[..., 2] < 0, (ground - X_WC[2, 3]) / rays[..., 2], -1.0)
    points = X_WC[:2, 3] + distance[..., None] * rays[..., :2] - centre[:2]
    cells = (points / (_GROUND_REACH * radius) * 0.5 + 0.5) * len(shadow) - 0.5
    dark = map_coordinates(shadow, cells.reshape(-1, 2).T, order=1, cval=0.0).reshape(distance.shape)
    return np.where(distance > 0, dark, 0.0) * _fade_at_border(dark.shape)


def _fade_at_border(shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) weights that fall to 0 at the picture's border, so that no shadow ends in a straight cut."""
    down, across = (np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / (0.12 * n) for n in shape)
    weight = np.clip(np.minimum(down[:, None], across[None, :]), 0, 1)
    return weight * weight * (3 - 2 * weight)


def _merge(surfaces: Sequence[Surface]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All surfaces as one: vertices (V, 3), faces (F, 3), colours (V, 3), gloss (F,)."""
    offsets = np.cumsum([0] + [len(s.mesh.vertices) for s in surfaces])
    vertices = np.concatenate([s.mesh.vertices for s in surfaces])
    faces = np.concatenate([s.mesh.faces + o for s, o in zip(surfaces, offsets, strict=False)]).astype(np.int32)
    colours = np.concatenate([np.broadcast_to(s.colour, s.mesh.vertices.shape) for s in surfaces])
    gloss = np.concatenate([np.full(len(s.mesh.faces), s.gloss, np.float32) for s in surfaces])
    return vertices, faces, colours, gloss


def _key_direction(X_WC: np.ndarray, style: Style) -> np.ndarray:
    """(3,) unit vector towards the lamp: up, and to the left of the camera."""
    towards_camera = -X_WC[:3, 2]
    azimuth = np.arctan2(towards_camera[1], towards_camera[0]) - style.key_azimuth_rad
    flat = np.cos(style.key_elevation_rad)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(style.key_elevation_rad)])


def roll_off(linear: np.ndarray) -> np.ndarray:
    """Linear light (...) that nears 1 instead of being clipped there."""
    over = np.maximum(linear - _KNEE, 0.0)
    return np.minimum(linear, _KNEE) + (1 - _KNEE) * (1 - np.exp(-over / (1 - _KNEE)))


def _encode(colour: np.ndarray, coverage: np.ndarray, darkness: np.ndarray) -> np.ndarray:
    """8-bit sRGB with straight alpha over the ground's shadow; highlights roll off instead of clipping."""
    colour = colour / np.maximum(coverage, 1e-6)[..., None]
    colour = linear_to_srgb(roll_off(colour))
    # Browsers blend in sRGB, so the shadow is put behind the object in sRGB too.
    alpha = coverage + (1 - coverage) * darkness
    colour = colour * (coverage / np.maximum(alpha, 1e-6))[..., None]
    levels = np.concatenate([colour, alpha[..., None]], axis=-1)
    return np.round(np.clip(levels, 0, 1) * 255).astype(np.uint8)
