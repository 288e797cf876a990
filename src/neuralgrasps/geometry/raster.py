"""Depth and geometry images of triangle meshes: an exact z-buffer on one CPU core, no graphics library.

A pixel is the ray through its centre. Inside a triangle with camera-frame corners p0, p1, p2 the ray d = (x, y, 1)
has the barycentrics d . (p1 x p2), d . (p2 x p0), d . (p0 x p1) over their sum, and the z-depth p0 . (p1 x p2) over
their sum (Olano and Greer 1997). That is exact ray casting: perspective-correct, and right for triangles that pass
behind the camera. A shared edge gives exactly opposite numbers on its two sides, so closed meshes have no holes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.camera import Intrinsics

if TYPE_CHECKING:
    from neuralgrasps.geometry.mesh import Mesh

NEAR_M = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class RasterImage:
    """What every pixel's ray meets first.

    Attributes:
        depth: (h, w) float32 z-depth, metres; inf where nothing is hit.
        mesh_index: (h, w) int32 index into the list of meshes; -1 where nothing is hit.
        face_index: (h, w) int32 face within that mesh; -1 where nothing is hit.
        barycentric: (h, w, 3) float32 weights of the face's three corners at the hit; zero where nothing is hit.
    """

    depth: np.ndarray
    mesh_index: np.ndarray
    face_index: np.ndarray
    barycentric: np.ndarray


def rasterise(
    meshes: Sequence[Mesh], X_CM: np.ndarray, intrinsics: Intrinsics, *, near_m: float = NEAR_M
) -> RasterImage:
    """Render meshes into depth, mesh, face and barycentric images.

    Both sides of a face are visible. At equal depth the earlier mesh, then the earlier face wins, so the result is
    deterministic.

    Args:
        meshes: K meshes (anything with `vertices` (V, 3) and `faces` (F, 3)).
        X_CM: (K, 4, 4) poses of the meshes in the camera frame.
        intrinsics: the camera; its width and height are the image's.
        near_m: surfaces nearer than this z-depth are not seen, > 0.
    Raises:
        ShapeError: `X_CM` does not hold one pose per mesh.
    """
    X_CM = np.asarray(X_CM, np.float64)
    if X_CM.shape != (len(meshes), 4, 4):
        raise ShapeError(f"X_CM has shape {X_CM.shape}; expected ({len(meshes)}, 4, 4), one pose per mesh.")
    shape = (intrinsics.height, intrinsics.width)
    depth = np.full(shape, np.inf, np.float32)
    mesh_index = np.full(shape, -1, np.int32)
    face_index = np.full(shape, -1, np.int32)
    barycentric = np.zeros((*shape, 3), np.float32)
    for index, mesh in enumerate(meshes):
        points_C = mesh.vertices @ X_CM[index, :3, :3].T + X_CM[index, :3, 3]
        _draw(
            points_C, mesh.faces, *_numbers(intrinsics), near_m, depth,
            np.full(len(mesh.faces), index, np.int32), mesh_index, face_index, barycentric,
        )  # fmt: skip
    return RasterImage(depth=depth, mesh_index=mesh_index, face_index=face_index, barycentric=barycentric)


def depth_images(mesh: Mesh, X_CM: np.ndarray, intrinsics: Intrinsics, *, near_m: float = NEAR_M) -> np.ndarray:
    """Depth images of one mesh in N poses (faster than `rasterise`: nothing but depth is kept).

    Args:
        mesh: the mesh.
        X_CM: (N, 4, 4) poses of the mesh in the camera frame.
    Returns:
        (N, h, w) float32 z-depth, metres; inf where nothing is hit.
    """
    X_CM = np.asarray(X_CM, np.float64)
    if X_CM.ndim != 3 or X_CM.shape[1:] != (4, 4):
        raise ShapeError(f"X_CM has shape {X_CM.shape}; expected (N, 4, 4).")
    depth = np.full((len(X_CM), intrinsics.height, intrinsics.width), np.inf, np.float32)
    for image, X in zip(depth, X_CM, strict=True):
        points_C = mesh.vertices @ X[:3, :3].T + X[:3, 3]
        _draw(points_C, mesh.faces, *_numbers(intrinsics), near_m, image, None, None, None, None)
    return depth


def _numbers(k: Intrinsics) -> tuple[float, float, float, float]:
    return float(k.fx), float(k.fy), float(k.cx), float(k.cy)


@njit(cache=True, error_model="numpy", inline="always")
def _pixel_box(p, near, fx, fy, cx, cy, width, height):  # type: ignore[no-untyped-def]
    """First and one-past-last column and row whose centres a triangle (3, 3) can cover; empty when out of view."""
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(3):
        j = i + 1 if i < 2 else 0
        z = p[i, 2]
        if z >= near:
            u, v = p[i, 0] / z, p[i, 1] / z
            low_u, high_u = min(low_u, u), max(high_u, u)
            low_v, high_v = min(low_v, v), max(high_v, v)
        if (z >= near) != (p[j, 2] >= near):  # the edge leaves through the near plane: its crossing bounds the rest
            t = (near - z) / (p[j, 2] - z)
            u = (p[i, 0] + t * (p[j, 0] - p[i, 0])) / near
            v = (p[i, 1] + t * (p[j, 1] - p[i, 1])) / near
            low_u, high_u = min(low_u, u), max(high_u, u)
            low_v, high_v = min(low_v, v), max(high_v, v)
    if not low_u <= high_u:
        return 0, 0, 0, 0
    # A margin of 1e-9 pixels keeps rounding in the division from dropping a pixel that the edge functions accept.
    first_u = max(np.ceil(low_u * fx + cx - 1e-9), 0.0)
    last_u = min(np.floor(high_u * fx + cx + 1e-9) + 1.0, float(width))
    first_v = max(np.ceil(low_v * fy + cy - 1e-9), 0.0)
    last_v = min(np.floor(high_v * fy + cy + 1e-9) + 1.0, float(height))
    if first_u >= last_u or first_v >= last_v:
        return 0, 0, 0, 0
    return int(first_u), int(last_u), int(first_v), int(last_v)


@njit(cache=True, error_model="numpy", inline="always")
def _edge_planes(p, planes):  # type: ignore[no-untyped-def]
    """Write p1 x p2, p2 x p0, p0 x p1 into `planes` (3, 3), signed so that inside is >= 0; return their scale."""
    for i in range(3):
        a = i + 1 if i < 2 else 0
        b = a + 1 if a < 2 else 0
        planes[i, 0] = p[a, 1] * p[b, 2] - p[a, 2] * p[b, 1]
        planes[i, 1] = p[a, 2] * p[b, 0] - p[a, 0] * p[b, 2]
        planes[i, 2] = p[a, 0] * p[b, 1] - p[a, 1] * p[b, 0]
    volume = p[0, 0] * planes[0, 0] + p[0, 1] * planes[0, 1] + p[0, 2] * planes[0, 2]
    if volume < 0.0:
        for i in range(3):
            for k in range(3):
                planes[i, k] = -planes[i, k]
        volume = -volume
    return volume


@njit(cache=True, error_model="numpy")
def _draw(points, faces, fx, fy, cx, cy, near, depth, face_labels, labels, face_index, barycentric):  # type: ignore[no-untyped-def]
    """The one loop over triangles and pixels; what is None is not drawn, and not compiled in either."""
    height, width = depth.shape
    p = np.empty((3, 3))
    e = np.empty((3, 3))
    for face in range(faces.shape[0]):
        for i in range(3):
            for k in range(3):
                p[i, k] = points[faces[face, i], k]
        u0, u1, v0, v1 = _pixel_box(p, near, fx, fy, cx, cy, width, height)
        if u1 <= u0:
            continue
        volume = _edge_planes(p, e)
        if not volume > 0.0:
            continue  # degenerate, or seen edge-on
        for v in range(v0, v1):
            y = (v - cy) / fy
            r0, r1, r2 = e[0, 1] * y + e[0, 2], e[1, 1] * y + e[1, 2], e[2, 1] * y + e[2, 2]
            for u in range(u0, u1):
                x = (u - cx) / fx
                b0, b1, b2 = r0 + e[0, 0] * x, r1 + e[1, 0] * x, r2 + e[2, 0] * x
                if b0 >= 0.0 and b1 >= 0.0 and b2 >= 0.0:
                    total = b0 + b1 + b2
                    z = volume / total
                    if z >= near and np.float32(z) < depth[v, u]:
                        depth[v, u] = np.float32(z)
                        if labels is not None:
                            labels[v, u] = face_labels[face]
                        if barycentric is not None:
                            face_index[v, u] = face
                            barycentric[v, u, 0] = b0 / total
                            barycentric[v, u, 1] = b1 / total
                            barycentric[v, u, 2] = b2 / total


@njit(cache=True, error_model="numpy")
def raster_labels(points, faces, face_labels, fx, fy, cx, cy, near, depth, labels):  # type: ignore[no-untyped-def]
    """Draw triangles into a depth image and, where they are nearest, their labels into a label image.

    Args:
        points: (V, 3) float64 corners, camera frame, metres.
        faces: (F, 3) integer corners of the triangles.
        face_labels: (F,) integer label of each triangle.
        fx, fy, cx, cy: the camera, pixels.
        near: surfaces nearer than this z-depth are not seen, metres.
        depth: (h, w) float32 z-depth, changed in place; start with inf.
        labels: (h, w) int8, changed in place; start with the label of what is not hit.
    """
    _draw(points, faces, fx, fy, cx, cy, near, depth, face_labels, labels, None, None)
