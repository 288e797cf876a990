"""Corner normals that are smooth over curved surfaces and sharp at real edges."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit


def corner_normals(vertices: np.ndarray, faces: np.ndarray, *, crease_rad: float = math.radians(38)) -> np.ndarray:
    """Shading normals at the three corners of every face.

    A corner takes the area-weighted mean of those faces around its vertex whose normal is within `crease_rad` of its
    own face's. Vertices at the same place (seams of scans, primitives without shared corners) count as one.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) int.
        crease_rad: edges sharper than this stay sharp.
    Returns:
        (F, 3, 3) float32 unit normals, same frame as `vertices`; zero for degenerate faces.
    """
    merged = _merge_vertices(vertices)[faces]
    corners = vertices[faces]
    scaled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # length = 2 x area
    order = np.argsort(merged.ravel(), kind="stable")
    start = np.searchsorted(merged.ravel()[order], np.arange(merged.max(initial=-1) + 2))
    return _blend(merged, scaled, order // 3, start, math.cos(crease_rad))


def _merge_vertices(vertices: np.ndarray) -> np.ndarray:
    """(V,) id per vertex, equal for vertices in one cell of a micrometre (a millionth of meshes above 2 m)."""
    low = vertices.min(axis=0, initial=0.0)
    extent = float((vertices - low).max(initial=0.0))
    cells = np.round((vertices - low) / max(1e-6, extent / 2**20)).astype(np.int64)
    return np.unique(cells[:, 0] << 42 | cells[:, 1] << 21 | cells[:, 2], return_inverse=True)[1].reshape(-1)


@njit(cache=True, error_model="numpy")
def _blend(merged, scaled, around, start, cos_crease):  # type: ignore[no-untyped-def]
    count = len(merged)
    length = np.sqrt((scaled**2).sum(axis=1))
    out = np.zeros((count, 3, 3), np.float32)
    for face in range(count):
        if length[face] == 0.0:
            continue
        for corner in range(3):
            x = y = z = 0.0
            vertex = merged[face, corner]
            for i in range(start[vertex], start[vertex + 1]):
                other = around[i]
                dot = (
                    scaled[face, 0] * scaled[other, 0]
                    + scaled[face, 1] * scaled[other, 1]
                    + scaled[face, 2] * scaled[other, 2]
                )
                if dot >= cos_crease * length[face] * length[other]:
                    x += scaled[other, 0]
                    y += scaled[other, 1]
                    z += scaled[other, 2]
            norm = np.sqrt(x * x + y * y + z * z)
            if norm > 0.0:
                out[face, corner, 0] = x / norm
                out[face, corner, 1] = y / norm
                out[face, corner, 2] = z / norm
    return out
