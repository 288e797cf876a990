"""Contact maps of known scenes, and their similarity."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.grasps.contact_map import (
    contact_distance_matrix,
    contact_map,
    contact_map_from_points,
    contact_map_packed,
    similarity_matrix,
)
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand


def random_scene(hand, count, points, seed=0):
    rng = np.random.default_rng(seed)
    X_OH = np.tile(np.eye(4), (count, 1, 1))
    X_OH[:, :3, 3] = rng.normal(0, 0.05, (count, 3))
    q = rng.uniform(hand.tree.lower, hand.tree.upper, (count, hand.num_dofs))
    return rng.normal(0, 0.08, (points, 3)), X_OH, q


def test_known_values_beside_and_inside_a_pad(jaw, X_OH):
    # pad 1 fills x in [0.02, 0.03], |y| <= 0.01, |z| <= 0.012 in O
    points = torch.tensor([[0.025, 0, 0], [0.02, 0, 0], [0.015, 0, 0], [0.034, 0.013, 0]], dtype=torch.float64)
    q = torch.tensor([[0.02, 0.04]], dtype=torch.float64)
    phi = contact_map(points, jaw, torch.from_numpy(X_OH)[None], q, radius=0.01)
    assert phi.dtype == torch.float32
    np.testing.assert_allclose(phi[0], [1.0, 1.0, np.exp(-0.5), np.exp(-0.5)], rtol=1e-6)


def test_chunks_and_versions_agree():
    hand = load_hand("barrett")
    points, X_OH, q = random_scene(hand, 5, 37)
    tensors = (torch.from_numpy(points), hand, torch.from_numpy(X_OH), torch.from_numpy(q))
    whole = contact_map(*tensors, radius=0.05)
    for chunk in (1, 10, 80):
        np.testing.assert_allclose(contact_map(*tensors, radius=0.05, chunk_pairs=chunk), whole, atol=1e-6)
    np.testing.assert_allclose(contact_map_packed(points, pack_hand(hand, spacing=0.01), X_OH, q), whole, atol=1e-6)
    own = tensors[0] + 0.01 * torch.arange(5)[:, None, None]  # other points for every grasp
    one_by_one = [contact_map(own[n], hand, tensors[2][n : n + 1], tensors[3][n : n + 1]) for n in range(5)]
    np.testing.assert_allclose(contact_map(own, *tensors[1:], chunk_pairs=80), torch.cat(one_by_one), atol=1e-6)
    assert 0 < whole.min() < whole.max() <= 1


def test_moving_object_points_and_hand_together_changes_nothing():
    hand = load_hand("fetch")
    points, X_OH, q = random_scene(hand, 3, 20)
    shift = np.eye(4)
    shift[:3, :3], shift[:3, 3] = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), (0.3, -0.2, 0.1)
    packed = pack_hand(hand, spacing=0.01)
    moved = contact_map_packed(points @ shift[:3, :3].T + shift[:3, 3], packed, shift @ X_OH, q)
    np.testing.assert_allclose(moved, contact_map_packed(points, packed, X_OH, q), atol=1e-6)


def test_contact_map_is_differentiable(jaw, X_OH):
    X = torch.from_numpy(X_OH)[None]
    q = torch.tensor([[0.025, 0.04]], dtype=torch.float64, requires_grad=True)
    points = torch.tensor([[0.015, 0.0, 0.0]], dtype=torch.float64)
    contact_map(points, jaw, X, q, radius=0.01).sum().backward()
    # d = q0 - 0.015, so dphi / dq0 = -exp(-1) / 0.01
    np.testing.assert_allclose(q.grad, [[-np.exp(-1.0) / 0.01, 0.0]], rtol=1e-5, atol=1e-9)


def test_map_from_points_is_the_distance_to_the_nearest():
    rng = np.random.default_rng(0)
    points, hand_points = rng.normal(0, 0.1, (30, 3)), rng.normal(0, 0.1, (50, 3))
    nearest = np.linalg.norm(points[:, None] - hand_points, axis=-1).min(axis=1)
    np.testing.assert_allclose(
        contact_map_from_points(points, hand_points, radius=0.02), np.exp(-nearest / 0.02), rtol=1e-5
    )


def test_distances_and_similarity():
    maps = np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.0]])
    distances = contact_distance_matrix(maps, maps)
    np.testing.assert_allclose(distances, [[0, 1, 0.25], [1, 0, 0.75], [0.25, 0.75, 0]])
    np.testing.assert_allclose(similarity_matrix(2 * distances), 1 - distances)
    np.testing.assert_array_equal(similarity_matrix(np.zeros((2, 2))), np.ones((2, 2)))


def test_wrong_input_is_refused(jaw, X_OH):
    points, X, q = torch.zeros(4, 3), torch.from_numpy(X_OH)[None].float(), torch.zeros(1, 2)
    with pytest.raises(InputError, match="radius is 0"):
        contact_map(points, jaw, X, q, radius=0)
    with pytest.raises(ShapeError):
        contact_map(points, jaw, X, torch.zeros(1, 3))
    with pytest.raises(InputError, match="at least one point"):
        contact_map_from_points(np.zeros((2, 3)), np.zeros((0, 3)))
    with pytest.raises(ShapeError):
        contact_distance_matrix(np.zeros((2, 3)), np.zeros((2, 4)))


def test_numpy_arrays_give_the_same_map_as_tensors() -> None:
    hand = load_hand("fetch")
    points = np.random.default_rng(3).normal(scale=0.1, size=(50, 3))
    X, q = np.eye(4)[None], hand.q_open[None]
    from_numpy = contact_map(points, hand, X, q, radius=0.02)
    from_torch = contact_map(*(torch.from_numpy(points), hand, torch.from_numpy(X), torch.from_numpy(q)), radius=0.02)
    assert 0.0 < float(from_torch.max()) <= 1.0
    assert isinstance(from_numpy, np.ndarray) and from_numpy.dtype == np.float32
    np.testing.assert_array_equal(from_numpy, from_torch.numpy())
