"""Pose errors with known answers, modulo symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import ShapeError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh


def _pose(rotvec, t) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    X[:3, 3] = t
    return X


TRUE = _pose([0.3, -0.8, 0.5], [0.1, 0.05, 0.7])


@pytest.fixture(scope="module")
def box(make_object):
    return make_object("box", box_mesh([0.02, 0.03, 0.05]), symmetry=True)


@pytest.fixture(scope="module")
def can(make_object):
    return make_object("can", cylinder_mesh(0.03, 0.05, segments=96), symmetry=True)


@pytest.fixture(scope="module")
def ball(make_object):
    return make_object("ball", sphere_mesh(0.04, segments=64), symmetry=True)


def test_the_truth_has_no_error(box):
    e = pose_errors(box, TRUE, TRUE)
    assert e.mssd_m < 1e-12 and e.rotation_rad < 1e-6 and e.translation_m < 1e-12
    assert e.add_s_m < 2e-4  # the grid's own error


def test_a_shift_is_a_shift(box):
    e = pose_errors(box, _pose([0, 0, 0], [0.001, 0.002, -0.002]) @ TRUE, TRUE)
    assert e.translation_m == pytest.approx(0.003)
    assert e.mssd_m == pytest.approx(0.003)
    assert e.rotation_rad < 1e-6
    assert 0.0 < e.add_s_m < 0.003  # points slide along the faces


def test_a_small_turn_is_its_angle(box):
    e = pose_errors(box, TRUE @ _pose([0.0, 0.1, 0.0], [0, 0, 0]), TRUE)
    assert e.rotation_rad == pytest.approx(0.1)
    assert e.translation_m < 1e-6  # the centre is measured
    corner = np.hypot(0.02, 0.05)  # the farthest point from the axis
    assert e.mssd_m == pytest.approx(2 * np.sin(0.05) * corner, rel=0.02)


def test_half_turns_of_a_box_are_no_error_and_quarter_turns_are(box):
    assert len(box.symmetry) == 4
    for axis in np.eye(3):
        assert pose_errors(box, TRUE @ _pose(np.pi * axis, [0, 0, 0]), TRUE).rotation_rad < 1e-6
    quarter = pose_errors(box, TRUE @ _pose([0, 0, np.pi / 2], [0, 0, 0]), TRUE)
    assert quarter.rotation_rad == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("angle", [0.0, 0.0873, 1.0, 2.5, -3.0])
def test_turns_about_the_axis_of_a_can_are_no_error_at_any_angle(can, angle):
    for flip in (0.0, np.pi):
        estimate = TRUE @ _pose([flip, 0, 0], [0, 0, 0]) @ _pose([0, 0, angle], [0, 0, 0])
        e = pose_errors(can, estimate, TRUE)
        assert e.rotation_rad < 1e-6
        assert e.translation_m < 1e-5 and e.mssd_m < 1e-5  # the measured centre is that good


def test_the_tilt_of_a_can_is_not_hidden_by_its_symmetry(can):
    estimate = TRUE @ _pose([0, 0, 1.3], [0, 0, 0]) @ _pose([0.2, 0, 0], [0, 0, 0])
    assert pose_errors(can, estimate, TRUE).rotation_rad == pytest.approx(0.2, abs=1e-6)


def test_a_ball_has_no_orientation(ball):
    e = pose_errors(ball, TRUE @ _pose([0.4, 0.5, -0.9], [0, 0, 0.002]), TRUE)
    assert e.rotation_rad < 1e-6
    assert e.translation_m == pytest.approx(0.002, abs=1e-4)


def test_moving_camera_and_object_together_changes_nothing(box):
    move = _pose([1.0, 0.2, -0.4], [0.3, 0.1, 0.2])
    estimate = _pose([0.02, 0.03, 0], [0.001, 0, 0.002]) @ TRUE
    first, second = pose_errors(box, estimate, TRUE), pose_errors(box, move @ estimate, move @ TRUE)
    for name in ("add_s_m", "mssd_m", "rotation_rad", "translation_m"):
        assert getattr(first, name) == pytest.approx(getattr(second, name), rel=1e-6)


def test_wrong_shapes_are_named(box):
    with pytest.raises(ShapeError, match="X_CO has shape"):
        pose_errors(box, np.eye(3), TRUE)
