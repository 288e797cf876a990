"""Errors of joints."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.human.nets.joint_errors import procrustes_error, root_relative_error


@pytest.fixture
def truth():
    return np.random.default_rng(0).uniform(-0.1, 0.1, (4, 21, 3))


def test_a_shift_is_no_root_relative_error(truth):
    np.testing.assert_allclose(root_relative_error(truth + np.array([0.3, -0.1, 0.2]), truth), 0.0, atol=1e-12)


def test_one_joint_off_counts_a_twentieth(truth):
    off = truth.copy()
    off[:, 8, 2] += 0.020
    np.testing.assert_allclose(root_relative_error(off, truth), 0.001, atol=1e-12)


def test_a_wrist_that_is_off_moves_all_others(truth):
    off = truth.copy()
    off[:, 0, 0] += 0.010
    np.testing.assert_allclose(root_relative_error(off, truth), 0.010, atol=1e-12)


def test_turn_shift_and_size_are_no_procrustes_error(truth):
    R = axis_angle_matrix(np.array([0.0, 0.6, 0.8]), 1.1)
    np.testing.assert_allclose(procrustes_error(1.7 * truth @ R.T + [1.0, 2.0, 3.0], truth), 0.0, atol=1e-10)


def test_the_mirror_image_is_an_error(truth):
    assert (procrustes_error(truth * [-1.0, 1.0, 1.0], truth) > 0.03).all()


def test_no_similarity_does_better(truth):
    noisy = truth + np.random.default_rng(1).normal(0.0, 0.01, truth.shape)
    least = procrustes_error(noisy, truth)
    assert (least <= np.linalg.norm(noisy - truth, axis=-1).mean(axis=-1) + 2e-4).all()
    assert (least > 0.01).all()


def test_batches_are_loops_and_shapes_are_checked(truth):
    noisy = truth + 0.01
    noisy[:, 3] += 0.02
    for k in range(len(truth)):
        assert procrustes_error(noisy, truth)[k] == pytest.approx(float(procrustes_error(noisy[k], truth[k])))
    with pytest.raises(ShapeError, match="21"):
        root_relative_error(truth[:, :20], truth)
