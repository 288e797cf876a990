"""The lines of a posed model as a camera sees it: occluding contours and creases, from its depth and normal images.

Edges of the mesh itself say little on scans, whose thousands of small faces all meet at some angle; the images do not
depend on how the surface is cut into faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from neuralgrasps.geometry.camera import Intrinsics, pixel_rays, project
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.report.smooth_normals import corner_normals

_STEP_M = 0.003  # a step in depth above this, beyond the slope around it, is an inner contour
_BLUR_M = 0.0012  # scan noise of normals is averaged over this
_FAINT, _SHARP = 55.0, 110.0  # bending per metre of a crease's ends and of its sharpest place
_LEAST_CONTOUR_M, _LEAST_CREASE_M = 0.006, 0.014  # shorter lines are dents and noise of a scan
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelLines:
    """Lines of one model in a window of the image.

    Attributes:
        top, left: first row and column of the window; all arrays have its size, which is 0 when nothing is in view.
        depth: (h, w) float32 z-depth of the model, metres; inf beside it.
        contour: (h, w) bool pixels of the model along its occluding contours, outer and inner.
        crease: (h, w) bool pixels along its sharp edges.
    """

    top: int
    left: int
    depth: np.ndarray
    contour: np.ndarray
    crease: np.ndarray

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the image that the window covers."""
        height, width = self.depth.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


def model_lines(mesh: Mesh, X_CO: np.ndarray, intrinsics: Intrinsics, *, margin: int = 8) -> ModelLines:
    """Find the lines of a mesh posed at `X_CO`.

    Args:
        mesh: the model; X_CO: (4, 4) its pose in the camera frame.
        intrinsics: the camera; lines are found at its resolution.
        margin: free pixels around the model.
    """
    X_CO = np.asarray(X_CO, np.float64)
    top, left, height, width = _window(mesh, X_CO, intrinsics, margin)
    if height == 0 or width == 0:
        none = np.zeros((0, 0), bool)
        return ModelLines(top=0, left=0, depth=np.zeros((0, 0), np.float32), contour=none, crease=none)
    camera = Intrinsics(intrinsics.fx, intrinsics.fy, intrinsics.cx - left, intrinsics.cy - top, width, height)
    image = rasterise([mesh], X_CO[None], camera)
    hit = image.face_index >= 0
    weight = image.barycentric[..., None]
    normals = (corner_normals(mesh.vertices, mesh.faces)[image.face_index] * weight).sum(axis=-2) * hit[..., None]
    pixel_m = float(np.median(image.depth[hit])) / camera.fx if hit.any() else 1.0
    contour, step = _contour(image.depth, hit)
    contour = _long_ones(contour, None, _LEAST_CONTOUR_M / pixel_m)
    smooth = hit & ~ndimage.binary_dilation(step, iterations=2)
    crease = _crease(image.depth, normals @ X_CO[:3, :3].T.astype(np.float32), camera, smooth, pixel_m)
    return ModelLines(top=top, left=left, depth=image.depth, contour=contour, crease=crease & ~contour)


def _window(mesh: Mesh, X_CO: np.ndarray, k: Intrinsics, margin: int) -> tuple[int, int, int, int]:
    """Top, left, height, width of the part of the image that can show the model."""
    points_C = mesh.vertices @ X_CO[:3, :3].T + X_CO[:3, 3]
    low, high = np.zeros(2), np.array([k.width, k.height], np.float64)
    if points_C[:, 2].max() <= 0:
        return 0, 0, 0, 0
    if points_C[:, 2].min() > 1e-3:
        pixels = project(points_C, k)
        low, high = np.maximum(low, pixels.min(axis=0) - margin), np.minimum(high, pixels.max(axis=0) + margin + 1)
    left, top = np.floor(low).astype(int).tolist()
    right, bottom = np.ceil(high).astype(int).tolist()
    return top, left, max(bottom - top, 0), max(right - left, 0)


def _shifted(image: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """`image` at (row + rows, column + columns), the border repeated."""
    height, width = image.shape[:2]
    reach = max(abs(rows), abs(columns))
    padded = np.pad(image, ((reach, reach), (reach, reach), *((0, 0),) * (image.ndim - 2)), mode="edge")
    return padded[reach + rows : reach + rows + height, reach + columns : reach + columns + width]


def _contour(depth: np.ndarray, hit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the model beside something farther away, and of them and their partners those of inner contours.

    Inverse depth is linear across a plane, so what it changes by beyond the change next to it is a step.
    """
    inverse = np.where(hit, 1.0 / np.where(hit, depth, 1.0), 0.0)
    outer, inner, step = np.zeros_like(hit), np.zeros_like(hit), np.zeros_like(hit)
    for down, right in ((0, 1), (1, 0)):
        partner = _shifted(hit, down, right)
        outer |= hit & (~partner | ~_shifted(hit, -down, -right))
        change = _shifted(inverse, down, right) - inverse
        both = hit & partner
        slopes = [
            np.where(_shifted(both, s * down, s * right), np.abs(_shifted(change, s * down, s * right)), np.inf)
            for s in (-1, 1)
        ]
        slope = np.minimum(*slopes)
        excess = np.abs(change) - 1.5 * np.where(np.isfinite(slope), slope, np.abs(change))
        found = both & (excess > _STEP_M * inverse**2)
        inner |= found & (change < 0) | _shifted(found & (change > 0), -down, -right)
        step |= found | _shifted(found, -down, -right)
    return outer | inner, step | outer


def _crease(
    depth: np.ndarray, normals_C: np.ndarray, camera: Intrinsics, allowed: np.ndarray, pixel_m: float
) -> np.ndarray:
    """Thin ridges of the surface's bending, per metre along the surface."""
    if not allowed.any():
        return allowed
    hit = np.isfinite(depth)
    sigma = max(_BLUR_M / pixel_m, 1.0)
    smooth = np.stack([ndimage.gaussian_filter(normals_C[..., i], sigma, truncate=3.0) for i in range(3)], axis=-1)
    smooth /= np.maximum(_length(smooth), 1e-6)[..., None]
    points_C = pixel_rays(camera).astype(np.float32) * np.where(hit, depth, 0.0)[..., None]
    reach = max(round(1.5 * sigma), 1)
    bending, direction = np.zeros(depth.shape, np.float32), np.zeros(depth.shape, np.int8)
    for index, (down, right) in enumerate(_NEIGHBOURS):
        ends = [(s * reach * down, s * reach * right) for s in (-1, 1)]
        turn, way = (_length(_shifted(a, *ends[1]) - _shifted(a, *ends[0])) for a in (smooth, points_C))
        usable = _shifted(hit, *ends[0]) & _shifted(hit, *ends[1])
        found = np.where(usable, turn / np.maximum(way, 1e-6), 0.0)
        direction[found > bending] = index
        np.maximum(bending, found, out=bending)
    return _long_ones(_ridges(bending, direction, reach) & allowed, bending, _LEAST_CREASE_M / pixel_m)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def _ridges(strength: np.ndarray, direction: np.ndarray, reach: int) -> np.ndarray:
    """Pixels that no pixel within half of `reach` along their own direction surpasses."""
    ridge = strength > _FAINT
    smooth = ndimage.gaussian_filter(strength, 0.5 * reach)  # one line along the middle of a plateau
    for index, (down, right) in enumerate(_NEIGHBOURS):
        for s in (-1, 1):
            ridge &= (direction != index) | (smooth >= _shifted(smooth, s * down, s * right))
    return ridge


def _long_ones(lines: np.ndarray, strength: np.ndarray | None, least: float) -> np.ndarray:
    """Connected lines of at least `least` pixels that, where `strength` is given, are sharp somewhere."""
    labels, count = ndimage.label(lines, structure=np.ones((3, 3)))
    if count == 0:
        return lines
    index = np.arange(1, count + 1)
    kept = ndimage.sum_labels(lines, labels, index) >= least
    if strength is not None:
        kept &= ndimage.maximum(strength, labels, index) >= _SHARP
    return np.concatenate([[False], kept])[labels]
