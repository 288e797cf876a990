"""The simulated depth camera: exact without noise, and noise of the stated size."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.sim.camera import DepthNoise, render_depth_view

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
