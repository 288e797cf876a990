"""Signed distances on a regular grid: building, and trilinear look-ups for numba kernels and for torch.

Outside the grid the query is clamped to the grid's box and the distance to the box is added: it never jumps.
The numba kernels take the grid's plain arrays; torch is imported only by the functions that use it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.mesh_distance import contains, signed_distance
from neuralgrasps.geometry.mesh_topology import Mesh, is_closed
from neuralgrasps.geometry.triangle_tree import grid_unsigned_distance

if TYPE_CHECKING:
    from torch import Tensor


ONE = np.uint64(1)  # unsigned indices spare numba the test for negative ones: 1.1-1.2 x faster


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

    def __repr__(self) -> str:
        sides = " x ".join(map(str, self.values.shape))
        return f"SdfGrid({sides} nodes, {1e3 * self.spacing:.3g} mm apart)"

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
    distance = grid_unsigned_distance(mesh, origin, spacing, (int(sides[0]), int(sides[1]), int(sides[2])))
    inside = _inside_nodes(mesh, origin, spacing, distance)
    return SdfGrid(np.where(inside, -distance, distance).astype(np.float32), origin, spacing)


def _inside_nodes(
    mesh: Mesh, origin: NDArray[np.float64], spacing: float, distance: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which nodes are inside. A closed surface cannot pass between neighbours whose distances add up to over a spacing.

    So all nodes farther than half a spacing that connect share a sign, and one of them is asked; nearer ones are asked
    one by one. An open surface may let a sign change through a hole: all nodes are asked.
    """
    if not is_closed(mesh):
        return contains(mesh, _node_positions(origin, spacing, np.indices(distance.shape).reshape(3, -1).T)).reshape(
            distance.shape
        )
    region, count = label(distance > (0.5 + 1e-6) * spacing)
    region_ids, first = np.unique(region, return_index=True)
    first = first[region_ids > 0]
    near = np.flatnonzero(region == 0)
    asked = np.stack(np.unravel_index(np.concatenate([first, near]), distance.shape), axis=1)
    is_inside = signed_distance(mesh, _node_positions(origin, spacing, asked)) < 0
    by_region = np.concatenate([[False], is_inside[:count]])
    inside = by_region[region]
    inside.reshape(-1)[near] = is_inside[count:]
    return inside


def _node_positions(origin: NDArray[np.float64], spacing: float, index: NDArray[np.int64]) -> NDArray[np.float64]:
    return origin + spacing * index


@njit(cache=True, inline="always", error_model="numpy")
def _along_axis(x, origin, inv_spacing, nodes):  # type: ignore[no-untyped-def]
    """(cell, place in it 0..1, how far x is outside the grid), in cells along one axis."""
    u = (x - origin) * inv_spacing
    clamped = min(max(u, 0.0), nodes - 1.0)
    i = np.uint64(min(np.int64(clamped), nodes - 2))
    return i, clamped - np.int64(i), u - clamped


@njit(cache=True, inline="always", error_model="numpy")
def grid_distance(values, origin, inv_spacing, x, y, z):  # type: ignore[no-untyped-def]
    """Trilinear signed distance at (x, y, z): metres, float64."""
    i, a, du = _along_axis(x, origin[0], inv_spacing, values.shape[0])
    j, b, dv = _along_axis(y, origin[1], inv_spacing, values.shape[1])
    k, c, dw = _along_axis(z, origin[2], inv_spacing, values.shape[2])
    v00 = values[i, j, k] * (1.0 - c) + values[i, j, k + ONE] * c
    v01 = values[i, j + ONE, k] * (1.0 - c) + values[i, j + ONE, k + ONE] * c
    v10 = values[i + ONE, j, k] * (1.0 - c) + values[i + ONE, j, k + ONE] * c
    v11 = values[i + ONE, j + ONE, k] * (1.0 - c) + values[i + ONE, j + ONE, k + ONE] * c
    d = (v00 * (1.0 - b) + v01 * b) * (1.0 - a) + (v10 * (1.0 - b) + v11 * b) * a
    if du != 0.0 or dv != 0.0 or dw != 0.0:
        d += math.sqrt(du * du + dv * dv + dw * dw) / inv_spacing
    return d


@njit(cache=True, inline="always", error_model="numpy")
def grid_distance_gradient(values, origin, inv_spacing, x, y, z):  # type: ignore[no-untyped-def]
    """(d, gx, gy, gz): `grid_distance` and its exact gradient, 1 / 1, not normalised (its length is about 1)."""
    i, a, du = _along_axis(x, origin[0], inv_spacing, values.shape[0])
    j, b, dv = _along_axis(y, origin[1], inv_spacing, values.shape[1])
    k, c, dw = _along_axis(z, origin[2], inv_spacing, values.shape[2])
    v000 = np.float64(values[i, j, k])
    v001 = np.float64(values[i, j, k + ONE])
    v010 = np.float64(values[i, j + ONE, k])
    v011 = np.float64(values[i, j + ONE, k + ONE])
    v100 = np.float64(values[i + ONE, j, k])
    v101 = np.float64(values[i + ONE, j, k + ONE])
    v110 = np.float64(values[i + ONE, j + ONE, k])
    v111 = np.float64(values[i + ONE, j + ONE, k + ONE])
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
    if du != 0.0 or dv != 0.0 or dw != 0.0:
        out = math.sqrt(du * du + dv * dv + dw * dw)
        d += out / inv_spacing
        gx = du / out if du != 0.0 else gx
        gy = dv / out if dv != 0.0 else gy
        gz = dw / out if dw != 0.0 else gz
    return d, gx, gy, gz


@njit(cache=True, error_model="numpy")
def grid_distances(values, origin, inv_spacing, points, out):  # type: ignore[no-untyped-def]
    """`grid_distance` of points (M, 3) into out (M,)."""
    for m in range(points.shape[0]):
        out[m] = grid_distance(values, origin, inv_spacing, points[m, 0], points[m, 1], points[m, 2])


@njit(cache=True, error_model="numpy")
def grid_distances_gradients(values, origin, inv_spacing, points, out, gradients):  # type: ignore[no-untyped-def]
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
