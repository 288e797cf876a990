"""Diverse order: farthest points, blind to the jaw's half turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.synthesis.select import METRES_PER_RADIAN, diverse_order, grasp_features


def _poses(count, seed=0):
    rng = np.random.default_rng(seed)
    X = np.tile(np.eye(4), (count, 1, 1))
    X[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    X[:, :3, 3] = rng.uniform(-0.1, 0.1, (count, 3))
    return X


def _half_turn(hand, X_OH):
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    return X_OH @ hand.X_HP @ turn @ np.linalg.inv(hand.X_HP)


def test_a_jaw_turned_by_half_a_turn_is_the_same_grasp_and_a_hand_is_not(hands):
    for name in ("panda", "fetch"):
        hand, X = hands[name], _poses(10)
        q = np.full((10, 1), 0.02)
        np.testing.assert_allclose(grasp_features(hand, X, q), grasp_features(hand, _half_turn(hand, X), q), atol=1e-12)
    hand, X = hands["human"], _poses(10)
    q = np.zeros((10, 20))
    gap = np.linalg.norm(grasp_features(hand, X, q) - grasp_features(hand, _half_turn(hand, X), q), axis=1)
    assert gap.min() > 0.09


def test_a_small_turn_counts_as_its_share_of_a_shift(hands):
    for name in ("panda", "allegro"):
        hand, X = hands[name], _poses(1)
        q = np.repeat(hand.q_open[None], 1, 0)
        for axis in np.eye(3):
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(1e-3 * axis).as_matrix()
            turned = X @ hand.X_HP @ turn @ np.linalg.inv(hand.X_HP)
            gap = np.linalg.norm(grasp_features(hand, X, q) - grasp_features(hand, turned, q))
            assert METRES_PER_RADIAN * 1e-3 * 0.99 < gap < METRES_PER_RADIAN * 1e-3 * 1.5


def test_a_shift_is_a_shift_and_the_object_frame_does_not_matter(hands):
    hand, X = hands["barrett"], _poses(12)
    q = np.random.default_rng(0).uniform(hand.tree.lower, hand.tree.upper, (12, 7))
    moved = X.copy()
    moved[:, 0, 3] += 0.01
    gap = np.linalg.norm(grasp_features(hand, X, q) - grasp_features(hand, moved, q), axis=1)
    np.testing.assert_allclose(gap, 0.01)
    frame = _poses(1, seed=5)[0]
    np.testing.assert_array_equal(diverse_order(hand, X, q, start=3), diverse_order(hand, frame @ X, q, start=3))


def test_order_starts_where_told_spreads_and_names_everything_once(hands):
    hand, X = hands["panda"], _poses(40)
    q = np.full((40, 1), 0.02)
    order = diverse_order(hand, X, q, start=7)
    assert order[0] == 7 and sorted(order) == list(range(40))
    features = grasp_features(hand, X, q)
    gaps = [np.linalg.norm(features[order[:k]] - features[order[k]], axis=1).min() for k in range(1, 40)]
    assert (np.diff(gaps) <= 1e-12).all()  # farthest first
    assert len(diverse_order(hand, X, q, start=0, count=5)) == 5
    assert len(diverse_order(hand, X[:3], q[:3], start=0, count=5)) == 3
    assert diverse_order(hand, X[:1], q[:1], start=0).tolist() == [0]


def test_the_half_turned_copy_of_a_jaw_grasp_comes_last(hands):
    hand, X = hands["panda"], _poses(10)
    X = np.concatenate([X, _half_turn(hand, X[:1])])
    order = diverse_order(hand, X, np.full((11, 1), 0.02), start=0)
    assert order[-1] == 10
    assert pytest.approx(0.0, abs=1e-9) == np.linalg.norm(
        grasp_features(hand, X[[0]], np.full((1, 1), 0.02)) - grasp_features(hand, X[[10]], np.full((1, 1), 0.02))
    )


def test_quality_decides_between_grasps_that_are_as_new(hands):
    hand = hands["panda"]
    X_OH = np.tile(np.eye(4), (4, 1, 1))
    X_OH[:, 0, 3] = [0.0, 0.10, 0.105, 0.05]
    q = np.tile(hand.q_open, (4, 1))
    plain = diverse_order(hand, X_OH, q, start=0, count=2)
    assert plain.tolist() == [0, 2]
    weighted = diverse_order(hand, X_OH, q, start=0, count=4, quality=np.array([1.0, 1.0, 0.5, 1.0]))
    assert weighted.tolist()[:3] == [0, 1, 3]
    assert sorted(weighted.tolist()) == [0, 1, 2, 3]
