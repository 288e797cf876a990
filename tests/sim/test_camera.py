"""The simulated depth camera: exact without noise, and noise of the stated size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthNoise, render_depth_view

CAMERA = Intrinsics.from_fov(np.deg2rad(50.0), 160, 120)
WALL = box_mesh([1.0, 1.0, 0.01])


def _wall_view(distance: float, *, noise: DepthNoise | None = None, seed: int = 0):
    """A wall square to the view, its near side `distance` away."""
    X_WC = look_at(np.array([0.0, 0.0, distance + 0.01]), np.zeros(3), up=(0, 1, 0))
    return render_depth_view([WALL], np.eye(4)[None], X_WC=X_WC, intrinsics=CAMERA, noise=noise, seed=seed)


def test_depth_of_a_ball_is_exact_at_its_pole_and_empty_beside_it():
    X_WC = look_at(np.array([0.5, 0.0, 0.0]), np.zeros(3))
    odd = Intrinsics(200.0, 200.0, 80.0, 60.0, 161, 121)
    view = render_depth_view([sphere_mesh(0.05, segments=128)], np.eye(4)[None], X_WC=X_WC, intrinsics=odd)
    assert view.depth[60, 80] == pytest.approx(0.45, abs=1e-4)
    assert view.depth[0, 0] == 0.0
    assert view.mesh_index[60, 80] == 0 and view.mesh_index[0, 0] == -1
    points_W = back_project(view.depth, odd) @ X_WC[:3, :3].T + X_WC[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(points_W, axis=1), 0.05, atol=2e-4)


def test_the_nearer_mesh_hides_the_farther_and_both_are_named():
    X_WM = np.tile(np.eye(4), (2, 1, 1))
    X_WM[1, 0, 3] = 0.2
    X_WC = look_at(np.array([1.0, 0.0, 0.0]), np.zeros(3))
    view = render_depth_view(
        [box_mesh([0.05, 0.2, 0.2]), box_mesh([0.01, 0.05, 0.05])], X_WM, X_WC=X_WC, intrinsics=CAMERA
    )
    assert view.mesh_index[60, 80] == 1
    assert view.depth[60, 80] == pytest.approx(0.79, abs=1e-6)
    assert set(np.unique(view.mesh_index)) == {-1, 0, 1}


@pytest.mark.parametrize("distance", [0.5, 1.0])
def test_axial_noise_has_the_stated_deviation_and_grows_with_the_square_of_depth(distance):
    noise = DepthNoise(axial_m=0.002, step_m=0.0, grazing_dropout=0.0)
    error = _wall_view(distance, noise=noise).depth - distance
    assert np.abs(error.mean()) < 5 * 0.002 * distance**2 / np.sqrt(error.size)
    assert error.std() == pytest.approx(0.002 * distance**2, rel=0.03)


def test_quantisation_rounds_to_steps():
    depth = _wall_view(1.0, noise=DepthNoise(axial_m=0.003, step_m=0.002, grazing_dropout=0.0)).depth
    assert len(np.unique(np.round(depth, 5))) < 20
    np.testing.assert_allclose(np.round(depth / 0.002) * 0.002, depth, atol=1e-5)


def test_a_wall_seen_square_loses_nothing_and_one_seen_edge_on_loses_the_stated_share():
    noise = DepthNoise(axial_m=0.0, step_m=0.0, grazing_dropout=0.8)
    assert (_wall_view(0.8, noise=noise).depth > 0).all()
    X_WC = look_at(np.array([0.0, -0.6, 0.01 + 0.06]), np.array([0.0, 0.0, 0.01]), up=(0, 0, 1))
    exact = render_depth_view([WALL], np.eye(4)[None], X_WC=X_WC, intrinsics=CAMERA)
    sensed = render_depth_view([WALL], np.eye(4)[None], X_WC=X_WC, intrinsics=CAMERA, noise=noise)
    row = 60  # looks straight at the target, 84.3 degrees off the normal
    lost = 1.0 - (sensed.depth[row - 3 : row + 4] > 0).sum() / (exact.depth[row - 3 : row + 4] > 0).sum()
    cosine = 0.06 / np.hypot(0.6, 0.06)
    assert lost == pytest.approx(0.8 * (1 - cosine**2) ** 4, abs=0.06)


def test_a_wall_seen_at_an_angle_loses_little():
    noise = DepthNoise(axial_m=0.0, step_m=0.0, grazing_dropout=0.8)
    angle = np.deg2rad(60.0)
    eye = np.array([0.0, -0.6 * np.sin(angle), 0.01 + 0.6 * np.cos(angle)])
    X_WC = look_at(eye, np.array([0.0, 0.0, 0.01]))
    sensed = render_depth_view([WALL], np.eye(4)[None], X_WC=X_WC, intrinsics=CAMERA, noise=noise)
    lost = 1.0 - (sensed.depth[56:65] > 0).mean()
    assert lost == pytest.approx(0.8 * np.sin(angle) ** 8, abs=0.06)


def test_pixels_that_see_nothing_stay_empty():
    X_WC = look_at(np.array([0.5, 0.0, 0.0]), np.zeros(3))
    arguments = {"X_WC": X_WC, "intrinsics": CAMERA}
    exact = render_depth_view([sphere_mesh(0.05)], np.eye(4)[None], **arguments)
    noisy = render_depth_view([sphere_mesh(0.05)], np.eye(4)[None], noise=DepthNoise(), **arguments)
    assert (noisy.depth[exact.depth == 0] == 0).all()
    assert (noisy.depth >= 0).all() and np.isfinite(noisy.depth).all()


def test_one_seed_one_image():
    noise = DepthNoise()
    first, same, other = (_wall_view(0.7, noise=noise, seed=s).depth for s in (3, 3, 4))
    assert (first == same).all()
    assert (first != other).any()


QUIET = DepthNoise(axial_m=0.0, step_m=0.0, grazing_dropout=0.0, edge_dropout=0.0)
NEAR_M, FAR_M = 0.6, 0.9
PLATE = box_mesh([0.1, 0.08, 0.005])


def _plate_view(noise: DepthNoise | None, seed: int = 0):
    """A plate 0.6 m away, square to the view, before a wall 0.9 m away."""
    X_WM = np.tile(np.eye(4), (2, 1, 1))
    X_WM[0, 2, 3], X_WM[1, 2, 3] = FAR_M - NEAR_M - 0.005, -0.01
    X_WC = look_at(np.array([0.0, 0.0, FAR_M]), np.zeros(3), up=(0, 1, 0))
    return render_depth_view([PLATE, WALL], X_WM, X_WC=X_WC, intrinsics=CAMERA, noise=noise, seed=seed)


def _beside_the_edge() -> np.ndarray:
    """Pixels of the plate view with a neighbour above, below, left or right on the other surface."""
    plate = _plate_view(None).mesh_index == 0
    return ndimage.binary_dilation(plate) & ~ndimage.binary_erosion(plate)


def test_flying_pixels_lie_between_the_two_surfaces_and_only_at_their_edge():
    exact, flown = _plate_view(None).depth, _plate_view(replace(QUIET, flying=1.0)).depth
    beside = _beside_the_edge()
    np.testing.assert_array_equal(flown[~beside], exact[~beside])
    assert ((flown[beside] >= NEAR_M - 1e-6) & (flown[beside] <= FAR_M + 1e-6)).all()
    assert flown[beside].mean() == pytest.approx(0.5 * (NEAR_M + FAR_M), abs=0.01)
    some = _plate_view(replace(QUIET, flying=0.3)).depth[beside] != exact[beside]
    assert some.mean() == pytest.approx(0.3, abs=0.08)


def test_pixels_at_a_depth_edge_are_lost_in_the_stated_share_and_no_others():
    beside = _beside_the_edge()
    depth = np.stack([_plate_view(replace(QUIET, edge_dropout=0.4), seed).depth for seed in range(4)])
    assert (depth[:, ~beside] > 0).all()
    assert (depth[:, beside] == 0).mean() == pytest.approx(0.4, abs=0.05)


def test_a_steep_slope_is_no_depth_edge():
    X_WC = look_at(np.array([0.0, -0.6, 0.01 + 0.06]), np.array([0.0, 0.0, 0.01]), up=(0, 0, 1))
    view = render_depth_view(
        [WALL], np.eye(4)[None], X_WC=X_WC, intrinsics=CAMERA, noise=replace(QUIET, edge_dropout=1.0)
    )
    rows = view.depth[55:80]  # the depth of neighbours differs by up to 10 cm there
    assert np.abs(np.diff(rows, axis=0)).max() > 0.02
    assert (rows > 0).all()


def test_the_sampling_position_wanders_at_edges_and_nowhere_else():
    exact, noisy = _plate_view(None).depth, _plate_view(replace(QUIET, lateral_px=0.5)).depth
    plate = _plate_view(None).mesh_index == 0
    beside = _beside_the_edge()
    moved = noisy != exact
    assert 0.05 < moved[beside].mean() < 0.4
    assert not moved[~ndimage.binary_dilation(plate, iterations=4)].any()
    assert not moved[ndimage.binary_erosion(plate, iterations=4)].any()
    assert np.isin(noisy, exact).all()


def test_the_projector_throws_a_shadow_to_the_left_as_wide_as_the_disparities_differ():
    view = _plate_view(replace(QUIET, baseline_m=0.075))
    shadow = view.depth == 0
    np.testing.assert_array_equal(shadow, ~view.lit)
    left = np.nonzero(view.mesh_index[60] == 0)[0][0]
    columns = np.nonzero(shadow[60])[0]
    width = CAMERA.fx * 0.075 * (1.0 / NEAR_M - 1.0 / FAR_M)
    assert len(columns) == pytest.approx(width, abs=1.0)
    assert columns.max() == left - 1 and columns.min() == left - len(columns)
    assert _plate_view(QUIET).lit.all()


def test_scale_error_and_even_noise_are_those_stated():
    assert _wall_view(0.8, noise=replace(QUIET, scale_error=0.003)).depth == pytest.approx(0.8 * 1.003, abs=1e-6)
    for distance in (0.5, 1.0):
        error = _wall_view(distance, noise=replace(QUIET, white_m=0.0025)).depth - distance
        assert error.std() == pytest.approx(0.0025, rel=0.03)


def test_bias_is_smooth_and_of_the_stated_size():
    errors = [_wall_view(0.8, noise=replace(QUIET, bias_m=0.003), seed=seed).depth - 0.8 for seed in range(40)]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.003 / np.sqrt(2.0), rel=0.15)
    steepest = 0.003 * 2.0 * 2.0 * np.pi / (0.4 * CAMERA.width)  # four waves of weight 1/2, all as short as they get
    assert max(np.abs(np.diff(e, axis=axis)).max() for e in errors for axis in (0, 1)) < steepest
    assert np.std([e.mean() for e in errors]) > 1e-4  # not one field for all seeds


def test_the_whole_sensor_is_repeatable_and_near_the_truth():
    exact = _plate_view(None).depth
    first, same, other = (_plate_view(STRUCTURED_LIGHT, seed).depth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert (first != other).any()
    inside = ndimage.binary_erosion(_plate_view(None).mesh_index == 0, iterations=4)
    assert (first[inside] > 0).all()
    assert np.std(first[inside] - exact[inside]) == pytest.approx(
        NEAR_M**2 * np.hypot(0.0015, 0.0029 / 12**0.5), rel=0.1
    )
