"""Pinhole cameras: round trips, conventions, clear errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at, pixel_rays, project

CAMERA = Intrinsics(310.0, 305.0, 158.2, 121.7, 320, 240)


def test_look_at_follows_the_opencv_convention():
    X_WC = look_at(np.array([2.0, 0.0, 0.0]), np.zeros(3), (0, 0, 1))
    np.testing.assert_allclose(X_WC[:3, 2], [-1, 0, 0], atol=1e-15)  # z forward
    np.testing.assert_allclose(X_WC[:3, 1], [0, 0, -1], atol=1e-15)  # y down
    np.testing.assert_allclose(X_WC[:3, 0], [0, 1, 0], atol=1e-15)  # x right
    np.testing.assert_allclose(X_WC[:3, 3], [2, 0, 0])


@pytest.mark.parametrize("seed", range(20))
def test_look_at_is_a_rotation_that_puts_the_target_on_the_axis(seed):
    rng = np.random.default_rng(seed)
    eye, target, up = rng.normal(size=(3, 3))
    X_WC = look_at(eye, target, up)
    np.testing.assert_allclose(X_WC[:3, :3].T @ X_WC[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(X_WC[:3, :3]) == pytest.approx(1.0)
    target_C = X_WC[:3, :3].T @ (target - eye)
    np.testing.assert_allclose(target_C, [0, 0, np.linalg.norm(target - eye)], atol=1e-12)
    up_C = X_WC[:3, :3].T @ up
    assert up_C[1] < 0 and abs(up_C[0]) < 1e-12


def test_look_at_straight_down_still_gives_a_camera():
    X_WC = look_at(np.array([0.0, 0.0, 1.0]), np.zeros(3), (0, 0, 1))
    np.testing.assert_allclose(X_WC[:3, :3].T @ X_WC[:3, :3], np.eye(3), atol=1e-12)


def test_look_at_refuses_an_eye_on_the_target():
    with pytest.raises(InputError, match="eye != target"):
        look_at(np.ones(3), np.ones(3))


def test_back_project_inverts_project():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 2.0, (240, 320))
    points = back_project(depth, CAMERA)
    v, u = np.mgrid[:240, :320]
    np.testing.assert_allclose(project(points, CAMERA), np.stack([u.ravel(), v.ravel()], 1), atol=1e-9)
    np.testing.assert_allclose(points, (pixel_rays(CAMERA) * depth[..., None]).reshape(-1, 3), atol=1e-12)


def test_back_project_drops_pixels_without_a_measurement():
    depth = np.full((240, 320), np.nan)
    depth[0, 0], depth[0, 1], depth[0, 2] = 0.0, -1.0, np.inf
    depth[100, 50] = 0.5
    points = back_project(depth, CAMERA)
    np.testing.assert_allclose(points, [[(50 - 158.2) / 310 * 0.5, (100 - 121.7) / 305 * 0.5, 0.5]])
    assert len(back_project(depth, CAMERA, mask=np.zeros((240, 320), bool))) == 0


def test_points_behind_the_camera_have_no_pixel():
    assert np.isnan(project(np.array([[0.1, 0.2, -1.0], [0.0, 0.0, 0.0]]), CAMERA)).all()


def test_scaled_keeps_the_view():
    point = np.array([[0.07, -0.03, 0.6]])
    fine = project(point, CAMERA.scaled(3))
    np.testing.assert_allclose((fine - 1) / 3, project(point, CAMERA), atol=1e-9)


def test_from_fov_covers_the_field_of_view():
    k = Intrinsics.from_fov(math.pi / 4, 320, 240)
    top = np.array([0.0, -math.tan(math.pi / 8), 1.0])
    np.testing.assert_allclose(project(top, k), [159.5, -0.5], atol=1e-9)


def test_wrong_input_is_explained():
    with pytest.raises(InputError, match="fx"):
        Intrinsics(0.0, 1.0, 0.0, 0.0, 10, 10)
    with pytest.raises(InputError, match="pixels"):
        Intrinsics(1.0, 1.0, 0.0, 0.0, 0, 10)
    with pytest.raises(ShapeError, match=r"\(240, 320\)"):
        back_project(np.zeros((10, 10)), CAMERA)
    with pytest.raises(InputError, match="field of view"):
        Intrinsics.from_fov(4.0, 10, 10)
