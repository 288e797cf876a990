"""A depth camera that looks at posed meshes, with an optional sensor model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.seeds import child_rng
from neuralgrasps.sim.camera_kernels import mark_edges, mark_lit, measure, wander, write_loss

_WAVES = 4  # of the smooth bias
_WAVE_WIDTHS = (0.4, 1.2)  # their lengths, image widths


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthNoise:
    """Errors of a structured-light or stereo depth camera.

    Such a camera measures disparity, the inverse of depth, so that a constant error there is one that grows with the
    square of depth. Depth edges are modelled on their own: the sample of a pixel wanders by `lateral_px`, a pixel on
    the edge may see both surfaces and report a depth between them ("flying pixel"), or nothing.

    Attributes:
        axial_m: standard deviation along the ray at 1 m; it grows with the square of the depth.
        step_m: quantisation at 1 m, growing with the square of the depth; 0 = none.
        grazing_dropout: share of pixels lost where the surface is seen edge-on (at 90 degrees; below, it falls with the
            sine to the power of `grazing_power`).
        edge_dropout: share of the pixels beside a depth edge that are lost.
        flying: share of the pixels beside a depth edge that report a depth between the two surfaces.
        lateral_px: standard deviation of the sampling position, pixels; in metres it grows with depth.
        baseline_m: distance of the projector or second eye, to the right of the camera; what it cannot see, such as a
            band of background to the left of a near object, is not measured. 0 = no such shadow.
        white_m: standard deviation of further independent noise, the same at all depths.
        scale_error: relative error of all depths, e.g. 0.003 for 0.3 % too far.
        bias_m: amplitude of a smooth error over the image: four waves, 0.4 to 1.2 image widths long, together as large
            in the mean square as one wave of this amplitude.
    Source:
        Khoshelham and Elberink 2012 (first Kinect: deviation 1.4 mm and step 2.9 mm at 1 m, both growing with z^2,
        baseline 75 mm); Nguyen, Izadi and Lovell 2012 (lateral deviation 0.8 pixels at any depth);
        Handa et al. 2014 (lateral jitter 0.5 pixels before quantised disparity).
    """

    axial_m: float = 0.0015
    step_m: float = 0.001
    grazing_dropout: float = 0.8
    grazing_power: float = 8.0
    edge_dropout: float = 0.5
    flying: float = 0.0
    lateral_px: float = 0.0
    baseline_m: float = 0.0
    white_m: float = 0.0
    scale_error: float = 0.0
    bias_m: float = 0.0


STRUCTURED_LIGHT = DepthNoise(
    axial_m=0.0015, step_m=0.0029, grazing_power=20.0, edge_dropout=0.3, flying=0.3, lateral_px=0.5, baseline_m=0.05
)
"""A camera of the first Kinect's kind, with the shorter baseline of later ones; sources as of `DepthNoise`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthView:
    """One depth image.

    Attributes:
        depth: (h, w) float32 z-depth, metres; 0 where nothing was measured.
        mesh_index: (h, w) int32, which mesh is seen, -1 for none (the truth, for masks).
        lit: (h, w) bool, pixels that the projector or second eye sees too; all without one.
        intrinsics: the camera; X_WC: (4, 4) its pose.
    """

    depth: np.ndarray
    mesh_index: np.ndarray
    lit: np.ndarray
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
    depth, lit = sense_depth(depth, intrinsics, noise, seed)
    return DepthView(
        depth=depth.astype(np.float32), mesh_index=image.mesh_index, lit=lit, intrinsics=intrinsics,
        X_WC=np.asarray(X_WC),
    )  # fmt: skip


def sense_depth(
    depth: np.ndarray, intrinsics: Intrinsics, noise: DepthNoise | None, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """What a camera with this noise reports for an exact depth image (h, w), metres, 0 = nothing; and what is lit.

    Returns:
        (h, w) depth, 0 where nothing is measured, and (h, w) bool, pixels that the projector or second eye sees too.
    """
    lit = np.ones(depth.shape, bool)
    if noise is None:
        return depth, lit
    depth = np.ascontiguousarray(depth, np.float64)
    if noise.baseline_m:
        mark_lit(depth, float(intrinsics.fx) * noise.baseline_m, lit)
    return _sense(depth, lit, intrinsics, noise, seed), lit


def _sense(depth: np.ndarray, lit: np.ndarray, intrinsics: Intrinsics, noise: DepthNoise, seed: int) -> np.ndarray:
    """What the sensor reports for exact depths (h, w); 0 = nothing."""
    rng = child_rng(seed, "depth noise")
    shape = depth.shape
    beside, across, loss = np.zeros(shape, bool), np.zeros(shape), np.empty(shape)
    mark_edges(depth, beside, across)
    write_loss(
        depth, beside, float(intrinsics.fx), float(intrinsics.fy), noise.edge_dropout, noise.grazing_dropout,
        noise.grazing_power, loss,
    )  # fmt: skip
    seen = lit & (depth > 0)
    if noise.flying:
        depth = _fly(depth, beside & (across > 0), across, noise.flying, child_rng(seed, "flying pixels"))
    if noise.lateral_px:
        normals = child_rng(seed, "lateral noise").standard_normal((2, *shape))
        exact = (depth, loss, seen)
        depth, loss, seen = np.empty(shape), np.empty(shape), np.empty(shape, bool)
        wander(normals, noise.lateral_px, *exact, depth, loss, seen)
    normals, bias = rng.standard_normal(shape), np.zeros((0, 0))
    if noise.scale_error or noise.bias_m:
        bias = _smooth_field(shape, child_rng(seed, "bias")) * noise.bias_m
    out = np.empty(shape)
    measure(
        depth, normals, noise.axial_m, noise.white_m, bias, 1.0 + noise.scale_error, noise.step_m, rng.random(shape),
        loss, seen, out,
    )  # fmt: skip
    return out


def _fly(
    depth: np.ndarray, beside: np.ndarray, across: np.ndarray, share: float, rng: np.random.Generator
) -> np.ndarray:
    """Replace a share of the pixels beside an edge by depths between its two sides."""
    row, column = np.nonzero(beside)
    chosen = rng.random(len(row)) < share
    row, column = row[chosen], column[chosen]
    weight = rng.random(len(row))
    out = depth.copy()
    out[row, column] = (1.0 - weight) * depth[row, column] + weight * across[row, column]
    return out


def _smooth_field(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """(h, w) sum of plane waves with a mean square of 1/2 on average."""
    weight = rng.standard_normal(_WAVES)
    weight /= np.linalg.norm(weight)
    length, angle, phase = rng.uniform(*_WAVE_WIDTHS, _WAVES) * shape[1], *rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    kx, ky = 2.0 * np.pi * np.array([np.cos(angle), np.sin(angle)]) / length
    along_x = np.exp(1j * np.arange(shape[1])[:, None] * kx)
    along_y = weight * np.exp(1j * (np.arange(shape[0])[:, None] * ky + phase))
    return (along_y @ along_x.T).real
