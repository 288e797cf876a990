"""Frames: what is refused, and heights above a plane."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.plane import horizontal_plane
from neuralgrasps.perception.frame import Frame, camera_poses, checked_pose

CAMERA = Intrinsics(90.0, 95.0, 31.0, 22.0, 64, 48)
DEPTH = np.full((48, 64), 0.8)


def test_pixels_without_a_measurement_become_zero():
    depth = DEPTH.astype(np.float32)
    depth[0, :4] = [np.nan, np.inf, -1.0, -np.inf]
    frame = Frame(depth, CAMERA)
    assert frame.depth.dtype == np.float64
    assert (frame.depth[0, :4] == 0).all() and (frame.depth == 0).sum() == 4
    assert np.isnan(frame.points[0, :4]).all()
    assert depth[0, 2] == -1.0  # the caller's array is left alone


def test_points_and_heights_are_those_of_the_camera():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 1.5, (48, 64)) * (rng.random((48, 64)) > 0.2)
    X_WC = look_at(np.array([0.5, 0.3, 0.6]), np.zeros(3))
    frame = Frame(depth, CAMERA, X_WC=X_WC)
    measured = frame.depth > 0
    np.testing.assert_allclose(frame.points[measured], back_project(depth, CAMERA), atol=1e-12)
    height = frame.height(horizontal_plane(0.05, X_WC))
    np.testing.assert_allclose(height[measured], (frame.points[measured] @ X_WC[2, :3] + X_WC[2, 3]) - 0.05, atol=1e-9)
    assert np.isnan(height[~measured]).all()


@pytest.mark.parametrize(("factor", "cause"), [(1000, "millimetres were read as metres"), (0.001, "metres were read")])
def test_a_depth_in_other_units_is_refused(factor, cause):
    with pytest.raises(InputError, match=cause) as caught:
        Frame(DEPTH * factor, CAMERA, name="kitchen")
    assert "'kitchen'" in str(caught.value) and "--depth-scale" in str(caught.value)


@pytest.mark.parametrize("nothing", [0.0, np.nan, -1.0, np.inf])
def test_an_image_without_measurements_is_refused(nothing):
    with pytest.raises(InputError, match="holds no measurement"):
        Frame(np.full((48, 64), nothing), CAMERA)


def test_images_of_other_sizes_are_refused():
    with pytest.raises(ShapeError, match="48 x 64"):
        Frame(DEPTH.T, CAMERA)
    with pytest.raises(ShapeError, match="32 x 24 pixels but its depth image 64 x 48"):
        Frame(DEPTH, CAMERA, np.zeros((24, 32, 3), np.uint8))
    with pytest.raises(ShapeError, match="colour"):
        Frame(DEPTH, CAMERA, np.zeros((48, 64), np.uint8))
    with pytest.raises(InputError, match="uint8"):
        Frame(DEPTH, CAMERA, np.zeros((48, 64, 3)))


def test_a_camera_of_another_image_is_refused():
    with pytest.raises(InputError, match=r"principal point of 'frame' is \(312, 241\), far outside its 64 x 48"):
        Frame(DEPTH, Intrinsics(90.0, 90.0, 312.0, 241.0, 64, 48))
    with pytest.raises(InputError, match="too short"):
        Frame(DEPTH, Intrinsics(0.9, 0.9, 31.0, 23.0, 64, 48))
    Frame(DEPTH, Intrinsics(90.0, 90.0, -20.0, 60.0, 64, 48))  # a crop


GOOD = look_at(np.array([0.5, 0.3, 0.6]), np.zeros(3))


def _changed(**entries):
    X = GOOD.copy()
    for name, value in entries.items():
        X[int(name[1]), int(name[2])] = value
    return X


@pytest.mark.parametrize(
    ("X", "reason"),
    [
        (GOOD @ np.diag([-1.0, 1.0, 1.0, 1.0]), "reflection"),
        (GOOD @ np.diag([1.1, 1.1, 1.1, 1.0]), "not rigid"),
        (GOOD.T, "Transpose it"),
        (_changed(e33=2.0), "last row"),
        (_changed(e03=np.nan), "not finite"),
        (np.zeros((4, 4)) + np.diag([0.0, 0.0, 0.0, 1.0]), "no rotation"),
        (np.eye(3), "4 x 4"),
    ],
)
def test_a_pose_that_is_not_a_rigid_motion_is_refused(X, reason):
    with pytest.raises(InputError, match=reason):
        Frame(DEPTH, CAMERA, X_WC=X)


def test_an_upside_down_pose_is_allowed_and_a_rounded_one_made_rigid():
    turned = GOOD @ np.diag([-1.0, -1.0, 1.0, 1.0])
    np.testing.assert_allclose(Frame(DEPTH, CAMERA, X_WC=turned).X_WC, turned, atol=1e-12)
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix().round(4)
    R = checked_pose(X, "pose")[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, X[:3, :3], atol=1e-4)
    np.testing.assert_array_equal(checked_pose(GOOD[:3], "pose")[3], [0, 0, 0, 1])


def _poses(*poses):
    return [Frame(DEPTH, CAMERA, X_WC=X, name=f"{n:03d}") for n, X in enumerate(poses)]


def test_cameras_are_at_rest_unless_they_say_otherwise():
    np.testing.assert_array_equal(camera_poses(_poses(None, None)), np.tile(np.eye(4), (2, 1, 1)))
    moved = _changed(e03=GOOD[0, 3] + 0.1)
    np.testing.assert_array_equal(
        camera_poses(_poses(GOOD, moved)), np.stack([_poses(X)[0].X_WC for X in (GOOD, moved)])
    )
    hardly = _changed(e03=GOOD[0, 3] + 5e-4)
    np.testing.assert_allclose(camera_poses(_poses(None, GOOD, hardly, None)), np.tile(GOOD, (4, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("turn_deg", [0.0, 0.5])
def test_a_moving_camera_must_say_where_it_is_in_every_frame(turn_deg):
    moved = GOOD.copy()
    if turn_deg:
        moved[:3, :3] = Rotation.from_rotvec([0.0, np.deg2rad(turn_deg), 0.0]).as_matrix() @ GOOD[:3, :3]
    else:
        moved[0, 3] += 0.003
    frames = _poses(GOOD, None, moved, None)
    assert len(camera_poses([frames[0], frames[2]])) == 2
    with pytest.raises(InputError, match=r"2 of 4 frames have no camera pose X_WC: 1 \('001'\), 3 \('003'\)\. Leave"):
        camera_poses(frames)
    with pytest.raises(InputError, match=r"\('006'\) and 3 more"):
        camera_poses(_poses(GOOD, *[None] * 9, moved))
