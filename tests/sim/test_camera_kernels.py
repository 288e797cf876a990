"""The compiled sensor model against plain array code that says the same slowly."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.sim.camera import render_depth_view
from neuralgrasps.sim.camera_kernels import mark_edges, mark_lit, wander, write_loss

CAMERA = Intrinsics(170.0, 165.0, 81.3, 58.2, 160, 120)


@pytest.fixture(scope="module")
def depth() -> np.ndarray:
    """A ball and a box on a table that does not fill the image."""
    X_WM = np.tile(np.eye(4), (3, 1, 1))
    X_WM[:, :3, 3] = [[0.0, 0.0, 0.04], [0.1, 0.05, 0.03], [0.0, 0.0, -0.01]]
    meshes = [sphere_mesh(0.04), box_mesh([0.02, 0.04, 0.03]), box_mesh([0.3, 0.2, 0.01])]
    X_WC = look_at(np.array([0.5, -0.1, 0.3]), np.zeros(3))
    image = render_depth_view(meshes, X_WM, X_WC=X_WC, intrinsics=CAMERA).depth.astype(np.float64)
    assert (image == 0).any() and (image > 0).mean() > 0.5
    return image


def slow_edges(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    beside, across = np.zeros(depth.shape, bool), np.zeros(depth.shape)
    for z, mark, other in ((depth.T, beside.T, across.T), (depth, beside, across)):  # rows last: they win
        inverse = np.divide(1.0, z, out=np.zeros(z.shape), where=z > 0)
        step = np.abs(np.diff(inverse, axis=1))
        before = np.pad(step[:, :-1], ((0, 0), (1, 0)), mode="edge")
        after = np.pad(step[:, 1:], ((0, 0), (0, 1)), mode="edge")
        edge = (np.abs(np.diff(z, axis=1)) > 0.008) & (step > 2.0 * np.minimum(before, after))
        mark[:, :-1] |= edge
        mark[:, 1:] |= edge
        np.copyto(other[:, :-1], z[:, 1:], where=edge)
        np.copyto(other[:, 1:], z[:, :-1], where=edge)
    return beside, across


def test_edges_equal_those_of_the_slow_code(depth):
    beside, across = np.zeros(depth.shape, bool), np.zeros(depth.shape)
    mark_edges(depth, beside, across)
    expected, other = slow_edges(depth)
    assert 100 < beside.sum() < 0.2 * beside.size
    np.testing.assert_array_equal(beside, expected)
    np.testing.assert_array_equal(across, other)


def test_the_projectors_shadow_equals_that_of_the_slow_code(depth):
    lit = np.zeros(depth.shape, bool)
    mark_lit(depth, CAMERA.fx * 0.05, lit)
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    column = np.arange(depth.shape[1]) - CAMERA.fx * 0.05 * inverse
    np.testing.assert_array_equal(lit, column <= np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1])
    assert (~lit).sum() > 50


@pytest.mark.parametrize("power", [0.0, 3.0, 20.0])
def test_the_chance_to_be_lost_is_that_of_the_sine_of_the_angle(depth, power):
    beside, loss = slow_edges(depth)[0], np.empty(depth.shape)
    write_loss(depth, beside, CAMERA.fx, CAMERA.fy, 0.3, 0.8, power, loss)
    slope_y, slope_x = np.gradient(depth)
    square = ((slope_x * CAMERA.fx) ** 2 + (slope_y * CAMERA.fy) ** 2) / np.maximum(depth, 1e-6) ** 2
    sine = np.sqrt(square / (1.0 + square))
    np.testing.assert_allclose(loss, np.where(beside, 0.3, 0.8 * sine**power), rtol=1e-9, atol=1e-17)


def test_pixels_wander_by_whole_pixels_and_stay_in_the_image(depth):
    normals = np.random.default_rng(0).standard_normal((2, *depth.shape))
    out, out_loss, out_seen = np.empty(depth.shape), np.empty(depth.shape), np.empty(depth.shape, bool)
    wander(normals, 1.5, depth, 2.0 * depth, depth > 0, out, out_loss, out_seen)
    shift = np.rint(normals * 1.5).astype(int)
    row = np.clip(np.arange(120)[:, None] + shift[0], 0, 119)
    column = np.clip(np.arange(160) + shift[1], 0, 159)
    np.testing.assert_array_equal(out, depth[row, column])
    np.testing.assert_array_equal(out_loss, 2.0 * depth[row, column])
    np.testing.assert_array_equal(out_seen, depth[row, column] > 0)
