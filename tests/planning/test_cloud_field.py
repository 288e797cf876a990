"""Distances to observed points, against brute force; and which points nothing explains."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.planning.cloud_field import COARSEST_M, FINEST_M, cloud_grid


def _cloud(seed: int, count: int, size: float = 0.2) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (count, 3)) * [1, 0.7, 0.5]


@pytest.mark.parametrize(("seed", "count"), [(0, 1), (1, 40), (2, 3000)])
def test_values_are_the_distances_to_the_nearest_occupied_node(seed: int, count: int) -> None:
    points = _cloud(seed, count)
    grid, error = cloud_grid(points, spacing_m=0.02)
    nodes = grid.origin + 0.02 * np.stack(np.meshgrid(*map(np.arange, grid.values.shape), indexing="ij"), axis=-1)
    occupied = np.unique(np.rint((points - grid.origin) / 0.02), axis=0) * 0.02 + grid.origin
    reference = cKDTree(occupied).query(nodes.reshape(-1, 3))[0].reshape(grid.values.shape)
    np.testing.assert_allclose(grid.values, reference, atol=1e-7)
    assert error <= (np.sqrt(3) / 2 + 0.29) * 0.02 + 1e-9


@pytest.mark.parametrize(("seed", "count"), [(0, 1), (1, 40), (2, 3000)])
def test_a_value_less_its_error_is_never_more_than_the_distance(seed: int, count: int) -> None:
    points = _cloud(seed, count)
    grid, error = cloud_grid(points)
    assert FINEST_M - 1e-12 <= grid.spacing <= COARSEST_M
    asked = np.random.default_rng(9).uniform(*grid.bounds, (20000, 3))
    true = cKDTree(points).query(asked)[0]
    value = query_grid_numpy(grid, asked) - error
    assert (value <= true + 1e-6).all()
    assert (value >= true - 2.3 * grid.spacing).all()  # and not needlessly small


def test_interpolation_adds_no_more_than_stated() -> None:
    """The trilinear distance to one node, over a cell near it."""
    corner = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, 21)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    weight = np.prod(np.where(corner == 1.0, x, 1.0 - x), axis=2)
    worst = 0.0
    for node in np.stack(np.meshgrid(*[np.arange(-2.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3):
        value = weight @ np.linalg.norm(corner - node, axis=1)
        worst = max(worst, float((value - np.linalg.norm(x[:, 0] - node, axis=1)).max()))
    assert 0.2 < worst < 0.29


def test_bad_clouds_are_refused() -> None:
    with pytest.raises(InputError, match="at least one, all finite"):
        cloud_grid(np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(InputError, match="at least one, all finite"):
        cloud_grid(np.zeros((0, 3)))
