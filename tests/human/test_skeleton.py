"""The 21 joints of the human hand."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.hands.variants import mirror_matrix, scaled_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.skeleton import BONES, JOINT_NAMES, NUM_JOINTS, TIPS, human_hand, joint_points, skeleton


def test_the_open_hand_has_the_published_lengths():
    hand = human_hand()
    joints = joint_points(hand, np.eye(4), np.zeros(20))
    length = {JOINT_NAMES[b]: np.linalg.norm(joints[b] - joints[a]) for a, b in BONES}
    assert length["index_pip"] == pytest.approx(0.04319, abs=1e-5)
    assert length["middle_dip"] == pytest.approx(0.03099, abs=1e-5)
    assert length["little_tip"] == pytest.approx(0.02316, abs=1e-5)
    assert length["thumb_mcp"] == pytest.approx(0.05212, abs=1e-5)
    assert np.linalg.norm(joints[12]) == pytest.approx(0.252, abs=2e-3)  # wrist to middle fingertip
    assert (joints[list(TIPS[1:]), 0] < -0.2).all()


def test_joints_of_other_sizes_and_sides_follow():
    right, left = human_hand("right"), human_hand("left")
    q = 0.5 * (right.tree.lower + right.tree.upper)
    joints = joint_points(right, np.eye(4), q)
    np.testing.assert_allclose(joint_points(scaled_hand(right, 0.8), np.eye(4), q), 0.8 * joints, atol=1e-12)
    S = mirror_matrix(right)[:3, :3]
    np.testing.assert_allclose(joint_points(left, np.eye(4), q), joints @ S.T, atol=1e-12)


def test_batches_are_loops():
    hand, rng = human_hand(), np.random.default_rng(0)
    q = rng.uniform(hand.tree.lower, hand.tree.upper, (3, 20))
    X = np.tile(np.eye(4), (3, 1, 1))
    X[:, :3, 3] = rng.standard_normal((3, 3))
    many = joint_points(hand, X, q)
    assert many.shape == (3, NUM_JOINTS, 3)
    for k in range(3):
        np.testing.assert_allclose(many[k], joint_points(hand, X[k], q[k]), atol=1e-12)


def test_other_hands_are_refused():
    with pytest.raises(InputError, match="human hand"):
        skeleton(load_hand("allegro"))
    with pytest.raises(InputError, match="'right' or 'left'"):
        human_hand("both")
