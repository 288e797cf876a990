"""Joints of several frames as one, whichever camera saw them."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, rpy_matrix
from neuralgrasps.human.seen import SeenJoints
from neuralgrasps.human.video.fuse import mean_joints


def joints(points: np.ndarray, weight: float = 1.0) -> SeenJoints:
    return SeenJoints(points_C=points, weight=np.full(21, weight), mask=None, side="left", source="test")


@pytest.fixture
def scene():
    """Joints in C, and the poses of three cameras F in it."""
    rng = np.random.default_rng(0)
    points_C = rng.normal(0.0, 0.05, (21, 3)) + np.array([0.0, 0.0, 0.6])
    X_CF = [make_transform_np(rpy_matrix(rng.normal(0.0, 0.4, 3)), rng.normal(0.0, 0.2, 3)) for _ in range(3)]
    seen = [joints((points_C - X[:3, 3]) @ X[:3, :3]) for X in X_CF]
    return points_C, seen, X_CF


def test_frames_of_moving_cameras_agree(scene):
    points_C, seen, X_CF = scene
    mean = mean_joints(seen, X_CF)
    np.testing.assert_allclose(mean.points_C, points_C, atol=1e-12)
    np.testing.assert_allclose(mean.weight, 1.0)
    assert mean.side == "left" and mean.source == "test, 3 frames"
    np.testing.assert_allclose(seen[0].points_C, points_C @ inverse_np(X_CF[0])[:3, :3].T + inverse_np(X_CF[0])[:3, 3])


def test_one_frame_that_is_far_off_counts_little(scene):
    points_C, seen, X_CF = scene
    stray = joints(seen[2].points_C + np.array([0.0, 0.0, 0.08]))
    mean = mean_joints([*seen[:2], stray], X_CF)
    off = np.linalg.norm(mean.points_C - points_C, axis=1)
    assert off.max() < 0.004  # a third of 80 mm without robust weights
    assert (mean.weight < 0.75).all()


def test_what_no_frame_knows_stays_unknown(scene):
    points_C, seen, X_CF = scene
    for one in seen:
        one.points_C[4] = np.nan
    seen[0].points_C[8] = np.nan
    mean = mean_joints(seen, X_CF)
    assert np.isnan(mean.points_C[4]).all() and mean.weight[4] == 0.0
    np.testing.assert_allclose(mean.points_C[8], points_C[8], atol=1e-12)
    assert mean.weight[8] == pytest.approx(2 / 3)
