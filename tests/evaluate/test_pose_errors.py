"""Pose errors with known answers, modulo symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.evaluate.pose import FAILED, PoseErrors, diameter_m, pose_errors, score_by_visibility, score_poses
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


def _errors(add_s_mm: float, mssd_mm: float, degrees: float = 0.0, shift_mm: float = 0.0) -> PoseErrors:
    return PoseErrors(
        add_s_m=1e-3 * add_s_mm,
        mssd_m=1e-3 * mssd_mm,
        rotation_rad=np.deg2rad(degrees),
        translation_m=1e-3 * shift_mm,
    )


def test_scores_of_three_estimates_by_hand():
    errors = [_errors(2.0, 4.0, 1.0, 0.5), _errors(7.0, 22.0, 5.0, 3.0), _errors(150.0, 300.0, 90.0, 100.0)]
    score = score_poses(errors, [0.2, 0.2, 0.2])
    assert score["count"] == 3
    assert score["add_s_auc"] == pytest.approx(100 * (0.98 + 0.93 + 0.0) / 3)
    assert score["under_5mm"] == pytest.approx(1 / 3) and score["under_1cm"] == pytest.approx(2 / 3)
    assert score["mssd_01d"] == pytest.approx(1 / 3)  # 4 of 20 mm; 22 and 300 are more
    # of ten thresholds from 10 to 100 mm: 4 mm passes 10, 22 mm passes 8, 300 mm none
    assert score["ar_mssd"] == pytest.approx((10 + 8 + 0) / 30)
    assert score["add_s_median_mm"] == pytest.approx(7.0) and score["mssd_median_mm"] == pytest.approx(22.0)
    assert score["rotation_median_deg"] == pytest.approx(5.0) and score["translation_median_mm"] == pytest.approx(3.0)


def test_each_estimate_is_measured_by_its_own_diameter():
    errors = [_errors(1.0, 15.0), _errors(1.0, 15.0)]
    assert score_poses(errors, [0.2, 0.1])["mssd_01d"] == pytest.approx(0.5)


def test_the_area_is_that_under_the_accuracy_threshold_curve():
    add_s = np.random.default_rng(0).gamma(2.0, 0.02, 50)
    thresholds = np.linspace(0.0, 0.1, 20001)
    area = np.trapezoid((add_s[:, None] < thresholds).mean(axis=0), thresholds) / 0.1
    score = score_poses([_errors(1e3 * e, 0.0) for e in add_s], [0.1] * 50)
    assert score["add_s_auc"] == pytest.approx(100 * area, abs=0.01)


def test_a_failed_estimate_counts_as_a_miss():
    score = score_poses([_errors(0.0, 0.0), FAILED, FAILED], [0.1] * 3)
    assert score["add_s_auc"] == pytest.approx(100 / 3)
    assert score["mssd_01d"] == score["ar_mssd"] == score["under_1cm"] == pytest.approx(1 / 3)
    assert np.isinf(score["rotation_median_deg"])


def test_bands_hold_what_is_visible_within_them():
    shares = [0.3, 0.45, 0.5, 0.7, 0.9, 1.0]
    scores = score_by_visibility([_errors(k, 1.0) for k in range(6)], [0.1] * 6, shares)
    assert {name: score["count"] for name, score in scores.items()} == {"25-45": 2, "45-65": 1, "65-80": 1, "80-100": 2}
    assert scores["45-65"]["add_s_median_mm"] == pytest.approx(2.0)


def test_scores_need_estimates_and_a_diameter_for_each():
    for errors, diameters in (([], []), ([FAILED], [0.1, 0.2])):
        with pytest.raises(InputError, match="expected N of each"):
            score_poses(errors, diameters)


def test_the_diameter_is_the_longest_diagonal(box, ball):
    assert diameter_m(box) == pytest.approx(2 * np.linalg.norm([0.02, 0.03, 0.05]), rel=1e-12)
    assert diameter_m(ball) == pytest.approx(0.08, rel=1e-3)
