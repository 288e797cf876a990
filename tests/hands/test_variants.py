"""Scaled and mirrored hands."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.hands.packed import hand_distance_many, pack_hand
from neuralgrasps.hands.variants import mirror_matrix, mirrored_hand, scaled_hand
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy


def _distances(hand, q, points):
    out = np.empty(len(points))
    hand_distance_many(pack_hand(hand, spacing=0.01), np.eye(4), np.ascontiguousarray(q, np.float64), points, out)
    return out


@pytest.fixture
def cloud():
    return np.random.default_rng(3).uniform(-0.2, 0.2, (400, 3))


@pytest.mark.parametrize("name", hand_names())
def test_a_scaled_hand_is_as_far_from_scaled_points(name, cloud):
    hand = load_hand(name)
    small = scaled_hand(hand, 0.7)
    share = np.random.default_rng(0).uniform(size=hand.num_dofs)
    q = hand.tree.lower + share * (hand.tree.upper - hand.tree.lower)
    q_small = small.tree.lower + share * (small.tree.upper - small.tree.lower)
    np.testing.assert_allclose(_distances(small, q_small, 0.7 * cloud), 0.7 * _distances(hand, q, cloud), atol=1e-9)


@pytest.mark.parametrize("name", hand_names())
def test_a_mirrored_hand_is_as_far_from_mirrored_points(name, cloud):
    hand = load_hand(name)
    left, S = mirrored_hand(hand), mirror_matrix(hand)
    q = hand.tree.lower + np.random.default_rng(1).uniform(size=hand.num_dofs) * (hand.tree.upper - hand.tree.lower)
    np.testing.assert_allclose(_distances(left, q, cloud @ S[:3, :3].T), _distances(hand, q, cloud), atol=1e-9)
    np.testing.assert_allclose(forward_numpy(left.tree, q), S @ forward_numpy(hand.tree, q) @ S, atol=1e-12)
    assert np.linalg.det(left.X_HP[:3, :3]) == pytest.approx(1.0)


def test_the_image_of_the_image_is_the_hand():
    hand = load_hand("human")
    twice = mirrored_hand(mirrored_hand(hand))
    np.testing.assert_allclose(twice.tree.axes, hand.tree.axes, atol=1e-12)
    np.testing.assert_allclose(twice.X_HP, hand.X_HP, atol=1e-12)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_a_size_of_nothing_is_refused(scale):
    with pytest.raises(InputError, match="above 0"):
        scaled_hand(load_hand("human"), scale)


def test_names_tell_sizes_apart():
    hand = load_hand("human")
    assert scaled_hand(hand, 0.8).name == "human_x0.800"  # grasps that are kept are found by it
    assert scaled_hand(hand, 0.80001).name != scaled_hand(hand, 0.80049).name != scaled_hand(hand, 0.8).name
