"""A depth camera that looks at posed meshes, with an optional sensor model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.seeds import child_rng


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthNoise:
    """Errors of a structured-light or stereo depth camera.

    Attributes:
        axial_m: standard deviation along the ray at 1 m; it grows with the square of the depth.
        step_m: quantisation at 1 m, growing with the square of the depth; 0 = none.
        grazing_dropout: share of pixels lost where the surface is seen edge-on (at 90 degrees; below, it falls with the
            eighth power of the sine).
    """

    axial_m: float = 0.0015
    step_m: float = 0.001
    grazing_dropout: float = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthView:
    """One depth image.

    Attributes:
        depth: (h, w) float32 z-depth, metres; 0 where nothing was measured.
        mesh_index: (h, w) int32, which mesh is seen, -1 for none (the truth, for masks).
        intrinsics: the camera; X_WC: (4, 4) its pose.
    """

    depth: np.ndarray
    mesh_index: np.ndarray
    intrinsics: Intrinsics
    X_WC: np.ndarray


def render_depth_view(
    meshes: Sequence[Mesh],
    X_WM: np.ndarray,
    *,
    X_WC: np.ndarray,
    intrinsics: Intrinsics,
    noise: DepthNoise | None = None,
    seed: int = 0,
) -> DepthView:
    """Look at K meshes posed at `X_WM` (K, 4, 4) from `X_WC`; without `noise` the depth is exact."""
    image = rasterise(list(meshes), np.linalg.inv(X_WC) @ X_WM, intrinsics)
    depth = np.where(np.isfinite(image.depth), image.depth, 0.0).astype(np.float64)
    if noise is not None:
        depth = _sense(depth, intrinsics, noise, child_rng(seed, "depth noise"))
    return DepthView(
        depth=depth.astype(np.float32), mesh_index=image.mesh_index, intrinsics=intrinsics, X_WC=np.asarray(X_WC)
    )


def _sense(depth: np.ndarray, intrinsics: Intrinsics, noise: DepthNoise, rng: np.random.Generator) -> np.ndarray:
    seen = depth > 0
    out = depth + rng.standard_normal(depth.shape) * noise.axial_m * depth**2
    if noise.step_m > 0:
        step = np.maximum(noise.step_m * depth**2, 1e-6)
        out = np.round(out / step) * step
    # tan of the viewing angle from the depth slope across one pixel
    slope_y, slope_x = np.gradient(depth)
    slope = np.hypot(slope_x * intrinsics.fx, slope_y * intrinsics.fy) / np.maximum(depth, 1e-6)
    edge_on = slope / np.sqrt(1.0 + slope**2)
    lost = rng.random(depth.shape) < noise.grazing_dropout * edge_on**8
    return np.where(seen & ~lost, np.maximum(out, 0.0), 0.0)
