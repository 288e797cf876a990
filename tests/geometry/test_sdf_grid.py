"""Grids: nodes are exact, linear fields are reproduced, numba = torch = slow reference, gradients, outside."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.mesh import Mesh, box_mesh, load_mesh, merge_meshes, signed_distance, sphere_mesh
from neuralgrasps.geometry.sdf_grid import (
    SdfGrid,
    build_sdf_grid,
    query_grid,
    query_grid_gradient,
    query_grid_gradient_numpy,
    query_grid_numpy,
)
from neuralgrasps.geometry.se3_numpy import make_transform_np

RNG = np.random.default_rng(0)
RANDOM = SdfGrid(RNG.normal(size=(5, 7, 4)).astype(np.float32), np.array([-0.1, 0.2, 0.3]), 0.05)


def points_around(grid: SdfGrid, count: int, margin: float, seed: int = 0) -> np.ndarray:
    low, high = grid.bounds
    return np.random.default_rng(seed).uniform(low - margin, high + margin, (count, 3))


def test_inside_it_equals_scipys_interpolator() -> None:
    axes = [RANDOM.origin[k] + RANDOM.spacing * np.arange(RANDOM.values.shape[k]) for k in range(3)]
    reference = RegularGridInterpolator(axes, RANDOM.values.astype(np.float64))
    points = points_around(RANDOM, 2000, -1e-9)
    np.testing.assert_allclose(query_grid_numpy(RANDOM, points), reference(points), atol=1e-14)


def test_outside_it_is_clamped_plus_the_distance_to_the_box() -> None:
    points = points_around(RANDOM, 2000, 0.3)
    low, high = RANDOM.bounds
    inside = np.clip(points, low, high)
    expected = query_grid_numpy(RANDOM, inside) + np.linalg.norm(points - inside, axis=1)
    np.testing.assert_allclose(query_grid_numpy(RANDOM, points), expected, atol=1e-14)


@pytest.mark.parametrize("margin", [-1e-6, 0.2])
def test_gradient_equals_finite_differences(margin: float) -> None:
    points = points_around(RANDOM, 3000, margin)
    d, gradient = query_grid_gradient_numpy(RANDOM, points)
    np.testing.assert_allclose(d, query_grid_numpy(RANDOM, points), atol=1e-14)
    step = 1e-7
    numeric = np.stack(
        [
            (query_grid_numpy(RANDOM, points + e) - query_grid_numpy(RANDOM, points - e)) / (2 * step)
            for e in step * np.eye(3)
        ],
        axis=-1,
    )
    near_kink = (np.abs((points - RANDOM.origin) / RANDOM.spacing % 1.0 - 0.5) > 0.5 - 1e-5).any(axis=1)
    np.testing.assert_allclose(gradient[~near_kink], numeric[~near_kink], atol=1e-5)
    assert near_kink.mean() < 0.01


def test_torch_equals_numba_and_its_autograd_is_the_gradient() -> None:
    points = points_around(RANDOM, 3000, 0.2, seed=1)
    p = torch.tensor(points, requires_grad=True)
    d, gradient = query_grid_gradient(RANDOM, p)
    d_numba, gradient_numba = query_grid_gradient_numpy(RANDOM, points)
    np.testing.assert_allclose(d.detach(), d_numba, atol=1e-14)
    np.testing.assert_allclose(gradient.detach(), gradient_numba, atol=1e-12)
    (automatic,) = torch.autograd.grad(query_grid(RANDOM, p).sum(), p)
    np.testing.assert_allclose(automatic, gradient_numba, atol=1e-12)
    assert torch.autograd.gradcheck(lambda q: query_grid_gradient(RANDOM, q)[1], (p[:5],))


def test_nodes_corners_and_batches() -> None:
    corners = np.stack(np.meshgrid(*RANDOM.bounds.T, indexing="ij"), axis=-1)
    for values in (query_grid_numpy(RANDOM, corners), query_grid(RANDOM, torch.tensor(corners)).numpy()):
        np.testing.assert_allclose(values, RANDOM.values[::4, ::6, ::3], atol=1e-14)
    assert query_grid(RANDOM, torch.zeros(2, 3, 3, dtype=torch.float32)).dtype == torch.float32
    d, g = query_grid_gradient(RANDOM, torch.zeros(2, 5, 3))
    assert d.shape == (2, 5) and g.shape == (2, 5, 3)


@pytest.mark.parametrize("name", ["box", "sphere"])
def test_built_grids_are_exact_at_nodes_and_close_between(name: str) -> None:
    mesh = box_mesh([0.03, 0.05, 0.02]) if name == "box" else sphere_mesh(0.05, segments=64)
    grid = build_sdf_grid(mesh, cells=32)
    assert max(mesh.extents) / grid.spacing == pytest.approx(32)
    low, high = grid.bounds
    assert (low <= mesh.bounds[0] - 0.02 + 1e-12).all() and (high >= mesh.bounds[1] + 0.02 - 1e-12).all()
    index = np.indices(grid.values.shape).reshape(3, -1).T
    nodes = grid.origin + grid.spacing * index
    np.testing.assert_allclose(grid.values.ravel(), signed_distance(mesh, nodes), atol=1e-8)
    points = points_around(grid, 3000, 0.0)
    error = np.abs(query_grid_numpy(grid, points) - signed_distance(mesh, points))
    assert error.max() < 0.9 * grid.spacing and np.median(error) < 0.02 * grid.spacing
    _, gradient = query_grid_gradient_numpy(grid, points)
    assert np.median(np.abs(np.linalg.norm(gradient, axis=1) - 1)) < 0.01


@pytest.mark.parametrize("kind", ["thin", "cavity", "open", "overlapping"])
def test_signs_of_difficult_grids_equal_asking_every_node(kind: str) -> None:
    whole, inner = box_mesh([0.03, 0.05, 0.02]), box_mesh([0.02, 0.02, 0.01])
    mesh = {
        "thin": box_mesh([0.03, 0.05, 5e-4]),  # a third of a cell thick
        "cavity": merge_meshes([whole, Mesh(inner.vertices, inner.faces[:, ::-1])]),
        "open": Mesh(whole.vertices, whole.faces[:-1]),
        "overlapping": merge_meshes([whole, whole.transformed(make_transform_np(None, [0.02, 0.03, 0]))]),
    }[kind]
    grid = build_sdf_grid(mesh, cells=30, padding=0.01)
    nodes = grid.origin + grid.spacing * np.indices(grid.values.shape).reshape(3, -1).T
    np.testing.assert_allclose(grid.values.ravel(), signed_distance(mesh, nodes), atol=1e-8)


def test_far_outside_it_is_nearly_the_distance() -> None:
    mesh = sphere_mesh(0.05, segments=64)
    grid = build_sdf_grid(mesh, cells=32)
    points = 0.3 * np.random.default_rng(3).normal(size=(500, 3))
    error = query_grid_numpy(grid, points) - signed_distance(mesh, points)
    assert error.min() > -1e-3  # never below the truth by more than the grid's own error: safe to trace with
    assert error.max() < 0.05


def test_a_real_scan(assets: Path) -> None:
    mesh = load_mesh(assets / "ycb" / "006_mustard_bottle.ply").mesh
    grid = build_sdf_grid(mesh, cells=64)
    points = points_around(grid, 20000, 0.0)
    exact = signed_distance(mesh, points)
    d = query_grid_numpy(grid, points)
    assert np.percentile(np.abs(d - exact), 99) < 0.25 * grid.spacing
    clear = np.abs(exact) > grid.spacing
    np.testing.assert_array_equal(d[clear] < 0, exact[clear] < 0)


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ShapeError, match="values has shape"):
        SdfGrid(np.zeros((1, 3, 3), dtype=np.float32), np.zeros(3), 0.1)
    with pytest.raises(InputError, match="spacing is 0"):
        SdfGrid(np.zeros((2, 3, 3), dtype=np.float32), np.zeros(3), 0.0)
    with pytest.raises(InputError, match="cells is 1"):
        build_sdf_grid(box_mesh([1, 1, 1]), cells=1)


def test_workers_do_not_load_torch() -> None:
    names = "se3_numpy, mesh, sdf_grid, sampling, shape_kernels"
    code = f"import sys; from neuralgrasps.geometry import {names}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
