"""Signed distances on a regular grid: building, and trilinear look-ups for numba kernels and for torch.

Outside the grid the query is clamped to the grid's box and the distance to the box is added: it never jumps.
The numba kernels take the grid's plain arrays; torch is imported only by the functions that use it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.mesh_distance import signed_distance
from neuralgrasps.geometry.mesh_topology import Mesh

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, slots=True, eq=False)
class SdfGrid:
    """Signed distances at the nodes origin + spacing * (i, j, k), metres, negative inside.

    Attributes:
        values: (nx, ny, nz) float32, C order, every side at least 2.
        origin: (3,) float64 position of node (0, 0, 0) in the object frame.
        spacing: node distance, > 0.
    """

    values: NDArray[np.float32]
    origin: NDArray[np.float64]
    spacing: float

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values, dtype=np.float32)
        origin = np.array(self.origin, dtype=np.float64)
        if values.ndim != 3 or min(values.shape) < 2:
            raise ShapeError(f"values has shape {values.shape}; expected (nx, ny, nz) with every side at least 2.")
        if origin.shape != (3,):
            raise ShapeError(f"origin has shape {origin.shape}; expected (3,).")
        if not (self.spacing > 0 and math.isfinite(self.spacing)):
            raise InputError(f"spacing is {self.spacing}; expected a positive length in metres.")
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "spacing", float(self.spacing))

    @property
    def inv_spacing(self) -> float:
        """1 / spacing, as the kernels take it."""
        return 1.0 / self.spacing

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) first and last node."""
        return np.stack([self.origin, self.origin + self.spacing * (np.array(self.values.shape) - 1)])


def build_sdf_grid(mesh: Mesh, *, cells: int = 128, padding: float = 0.02) -> SdfGrid:
    """Exact signed distances at the nodes of a grid around `mesh`.

    Args:
        mesh: any mesh; where it is open, inside is decided by the winding number.
        cells: cells along the mesh's longest axis, >= 2.
        padding: metres of margin on every side, >= 0.
    """
    if cells < 2 or padding < 0:
        raise InputError(f"cells is {cells} and padding {padding}; expected at least 2 cells and no negative padding.")
    low, high = mesh.bounds
    spacing = float((high - low).max()) / cells
    if not spacing > 0:
        raise InputError("the mesh has no extent; expected a surface that encloses a volume.")
    margin = math.ceil(padding / spacing - 1e-9)
    sides = np.ceil((high - low) / spacing - 1e-9).astype(int) + 2 * margin + 1
    sides = np.maximum(sides, 2)
    origin = 0.5 * (low + high) - 0.5 * spacing * (sides - 1)
    axes = [origin[k] + spacing * np.arange(sides[k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return SdfGrid(signed_distance(mesh, nodes).reshape(sides).astype(np.float32), origin, spacing)


@njit(cache=True, inline="always", error_model="numpy")
def grid_distance(values, origin, inv_spacing, x, y, z):
    """Trilinear signed distance at (x, y, z): metres, float64."""
    nx, ny, nz = values.shape
    u = (x - origin[0]) * inv_spacing
    v = (y - origin[1]) * inv_spacing
    w = (z - origin[2]) * inv_spacing
    cu = min(max(u, 0.0), nx - 1.0)
    cv = min(max(v, 0.0), ny - 1.0)
    cw = min(max(w, 0.0), nz - 1.0)
    i = min(np.int64(cu), nx - 2)
    j = min(np.int64(cv), ny - 2)
    k = min(np.int64(cw), nz - 2)
    a = cu - i
    b = cv - j
    c = cw - k
    v00 = values[i, j, k] * (1.0 - c) + values[i, j, k + 1] * c
    v01 = values[i, j + 1, k] * (1.0 - c) + values[i, j + 1, k + 1] * c
    v10 = values[i + 1, j, k] * (1.0 - c) + values[i + 1, j, k + 1] * c
    v11 = values[i + 1, j + 1, k] * (1.0 - c) + values[i + 1, j + 1, k + 1] * c
    d = (v00 * (1.0 - b) + v01 * b) * (1.0 - a) + (v10 * (1.0 - b) + v11 * b) * a
    if cu != u or cv != v or cw != w:
        d += math.sqrt((u - cu) ** 2 + (v - cv) ** 2 + (w - cw) ** 2) / inv_spacing
    return d


@njit(cache=True, inline="always", error_model="numpy")
def grid_distance_gradient(values, origin, inv_spacing, x, y, z):
    """(d, gx, gy, gz): `grid_distance` and its exact gradient, 1 / 1, not normalised (its length is about 1)."""
    nx, ny, nz = values.shape
    u = (x - origin[0]) * inv_spacing
    v = (y - origin[1]) * inv_spacing
    w = (z - origin[2]) * inv_spacing
    cu = min(max(u, 0.0), nx - 1.0)
    cv = min(max(v, 0.0), ny - 1.0)
    cw = min(max(w, 0.0), nz - 1.0)
    i = min(np.int64(cu), nx - 2)
    j = min(np.int64(cv), ny - 2)
    k = min(np.int64(cw), nz - 2)
    a = cu - i
    b = cv - j
    c = cw - k
    v000 = np.float64(values[i, j, k])
    v001 = np.float64(values[i, j, k + 1])
    v010 = np.float64(values[i, j + 1, k])
    v011 = np.float64(values[i, j + 1, k + 1])
    v100 = np.float64(values[i + 1, j, k])
    v101 = np.float64(values[i + 1, j, k + 1])
    v110 = np.float64(values[i + 1, j + 1, k])
    v111 = np.float64(values[i + 1, j + 1, k + 1])
    v00 = v000 + (v001 - v000) * c
    v01 = v010 + (v011 - v010) * c
    v10 = v100 + (v101 - v100) * c
    v11 = v110 + (v111 - v110) * c
    v0 = v00 + (v01 - v00) * b
    v1 = v10 + (v11 - v10) * b
    d = v0 + (v1 - v0) * a
    gx = (v1 - v0) * inv_spacing
    gy = ((v01 - v00) * (1.0 - a) + (v11 - v10) * a) * inv_spacing
    dz0 = (v001 - v000) * (1.0 - b) + (v011 - v010) * b
    dz1 = (v101 - v100) * (1.0 - b) + (v111 - v110) * b
    gz = (dz0 * (1.0 - a) + dz1 * a) * inv_spacing
    if cu != u or cv != v or cw != w:
        du, dv, dw = u - cu, v - cv, w - cw
        out = math.sqrt(du * du + dv * dv + dw * dw)
        d += out / inv_spacing
        gx = du / out if cu != u else gx
        gy = dv / out if cv != v else gy
        gz = dw / out if cw != w else gz
    return d, gx, gy, gz


@njit(cache=True, error_model="numpy")
def grid_distances(values, origin, inv_spacing, points, out):
    """`grid_distance` of points (M, 3) into out (M,)."""
    for m in range(points.shape[0]):
        out[m] = grid_distance(values, origin, inv_spacing, points[m, 0], points[m, 1], points[m, 2])


@njit(cache=True, error_model="numpy")
def grid_distances_gradients(values, origin, inv_spacing, points, out, gradients):
    """`grid_distance_gradient` of points (M, 3) into out (M,) and gradients (M, 3)."""
    for m in range(points.shape[0]):
        d, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, points[m, 0], points[m, 1], points[m, 2])
        out[m] = d
        gradients[m, 0] = gx
        gradients[m, 1] = gy
        gradients[m, 2] = gz


def query_grid_numpy(grid: SdfGrid, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distance of points (..., 3), metres; (...) float64."""
    p = np.ascontiguousarray(points, dtype=np.float64)
    out = np.empty(p.shape[:-1])
    grid_distances(grid.values, grid.origin, grid.inv_spacing, p.reshape(-1, 3), out.reshape(-1))
    return out


def query_grid_gradient_numpy(
    grid: SdfGrid, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signed distance (...) and its gradient (..., 3) at points (..., 3), float64."""
    p = np.ascontiguousarray(points, dtype=np.float64)
    out, gradients = np.empty(p.shape[:-1]), np.empty(p.shape)
    grid_distances_gradients(
        grid.values, grid.origin, grid.inv_spacing, p.reshape(-1, 3), out.reshape(-1), gradients.reshape(-1, 3)
    )
    return out, gradients


def query_grid(grid: SdfGrid, points: Tensor) -> Tensor:
    """Signed distance of points (..., 3), metres; (...) of their dtype and device, differentiable."""
    distance, _ = _interpolate(grid, points, gradient=False)
    return distance


def query_grid_gradient(grid: SdfGrid, points: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (...) and its exact gradient (..., 3) at points (..., 3)."""
    distance, gradient = _interpolate(grid, points, gradient=True)
    assert gradient is not None
    return distance, gradient


def _interpolate(grid: SdfGrid, points: Tensor, *, gradient: bool) -> tuple[Tensor, Tensor | None]:
    import torch  # noqa: PLC0415 - workers that use the kernels only must not load it

    values = torch.as_tensor(grid.values, device=points.device).reshape(-1)
    ny, nz = grid.values.shape[1:]
    last = torch.tensor(grid.values.shape).to(points) - 1
    u = (points - torch.as_tensor(grid.origin).to(points)) * grid.inv_spacing
    clamped = torch.minimum(u.clamp(min=0), last)
    cell = torch.minimum(clamped.detach().floor(), last - 1).long()
    a, b, c = (clamped - cell).unbind(-1)
    base = (cell[..., 0] * ny + cell[..., 1]) * nz + cell[..., 2]

    def row(offset: int) -> tuple[Tensor, Tensor]:
        low = values[base + offset].to(points.dtype)
        return low, values[base + offset + 1].to(points.dtype) - low

    (v00, d00), (v01, d01), (v10, d10), (v11, d11) = row(0), row(nz), row(ny * nz), row(ny * nz + nz)
    v00, v01, v10, v11 = v00 + d00 * c, v01 + d01 * c, v10 + d10 * c, v11 + d11 * c
    v0, v1 = v00 + (v01 - v00) * b, v10 + (v11 - v10) * b
    outside = (u - clamped) * grid.spacing
    squared = (outside * outside).sum(-1)
    is_out = squared > 0
    length = torch.where(is_out, squared, torch.ones_like(squared)).sqrt()  # a gradient of sqrt at 0 would be NaN
    distance = v0 + (v1 - v0) * a + torch.where(is_out, length, torch.zeros_like(length))
    if not gradient:
        return distance, None
    gy = (v01 - v00) * (1 - a) + (v11 - v10) * a
    gz = (d00 * (1 - b) + d01 * b) * (1 - a) + (d10 * (1 - b) + d11 * b) * a
    inner = torch.stack([v1 - v0, gy, gz], dim=-1) * grid.inv_spacing
    return distance, torch.where(outside != 0, outside / length[..., None], inner)
