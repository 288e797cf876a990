"""Hand distances: closed forms, fast against slow, gradients, packed arrays and self pairs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.packed import hand_distance, hand_distance_many, nearest_part, pack_hand, pack_shapes
from neuralgrasps.hands.parts import part_distances, part_mesh
from neuralgrasps.hands.signed_distance import differentiable_distance, hand_signed_distance
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_fast, forward_numpy

from .conftest import three_finger_urdf


def _scene(hand, random_postures, poses=4, points=300):
    rng = np.random.default_rng(1)
    X_OH = np.tile(np.eye(4), (poses, 1, 1))
    R = np.linalg.qr(rng.normal(size=(poses, 3, 3)))[0]
    X_OH[:, :3, :3] = R * np.linalg.det(R)[:, None, None]
    X_OH[:, :3, 3] = rng.normal(scale=0.05, size=(poses, 3))
    return X_OH, random_postures(hand, poses), rng.normal(scale=0.12, size=(points, 3))


def _slow(hand, X_OH, q, points_O):
    """Least distance over the parts, one part at a time, in numpy."""
    X_OL = X_OH @ forward_numpy(hand.tree, q)
    local = [(points_O - X[:3, 3]) @ X[:3, :3] for X in X_OL]
    return np.min([part_distances(p, local[p.link]) for p in hand.parts], axis=0)


def test_kernels_and_torch_equal_the_slow_reference(hand, random_postures):
    X_OH, q, points = _scene(hand, random_postures)
    slow = np.stack([_slow(hand, X, row, points) for X, row in zip(X_OH, q, strict=True)])
    tensors = (torch.tensor(X_OH), torch.tensor(q), torch.tensor(points))
    assert np.allclose(hand_signed_distance(hand, *tensors).numpy(), slow, atol=1e-12)
    assert np.allclose(differentiable_distance(hand, *tensors).numpy(), slow, atol=1e-12)
    packed, out = pack_shapes(hand), np.empty(len(points))
    hand_distance_many(packed, X_OH[1], q[1], points, out)
    assert np.allclose(out, slow[1], atol=1e-12)
    X_HL = forward_fast(hand.tree, q[1])
    points_H = (points - X_OH[1, :3, 3]) @ X_OH[1, :3, :3]
    assert np.allclose([hand_distance(packed, X_HL, *p) for p in points_H], slow[1], atol=1e-12)


def test_own_points_per_hand_equal_shared_points(random_postures):
    hand = load_hand("human")
    X_OH, q, points = (torch.tensor(v) for v in _scene(hand, random_postures))
    shared = hand_signed_distance(hand, X_OH, q, points)
    assert torch.equal(hand_signed_distance(hand, X_OH, q, points.expand(4, -1, -1)), shared)
    one = hand_signed_distance(hand, X_OH[2:3], q[2:3], points)
    assert torch.equal(one[0], shared[2])


def test_box_hand_by_hand(all_hands):
    """Panda: 0.2 m in front of the fingertips' end face, and 1 mm inside the palm's flange."""
    hand = all_hands["panda"]
    X, q = torch.eye(4, dtype=torch.float64)[None], torch.tensor([[0.0]], dtype=torch.float64)
    end = 0.0584 + 0.0444 + 0.0094
    points = torch.tensor([[0.0, 0.005, end + 0.2], [0.0, 0.0, -0.006]], dtype=torch.float64)
    assert hand_signed_distance(hand, X, q, points)[0].tolist() == pytest.approx([0.2, -0.001], abs=1e-12)


def test_hulls_equal_the_exact_mesh_distance(assets):
    """The real Allegro's fingertip meshes, as hulls, against the pseudonormal distance of their triangles."""
    hand = load_hand(assets / "hands/allegro_hand/allegro_hand_right.urdf")
    tip = next(p for p in hand.parts if p.kind == 4)
    points = np.random.default_rng(0).normal(scale=0.02, size=(500, 3)) + tip.X_LP[:3, 3]
    assert np.allclose(part_distances(tip, points), signed_distance(part_mesh(tip), points), atol=1e-9)


def test_moving_hand_and_points_together_changes_nothing(hand, random_postures):
    X_OH, q, points = (torch.tensor(v) for v in _scene(hand, random_postures))
    Y = X_OH[3]
    moved = hand_signed_distance(hand, Y @ X_OH, q, points @ Y[:3, :3].T + Y[:3, 3])
    assert torch.allclose(moved, hand_signed_distance(hand, X_OH, q, points), atol=1e-12)


def test_gradients_are_those_of_finite_differences(random_postures):
    hand = load_hand("barrett")
    X_OH, q, points = _scene(hand, random_postures, poses=1, points=4)
    X, q, points = torch.tensor(X_OH), torch.tensor(q, requires_grad=True), torch.tensor(points, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda j, p: differentiable_distance(hand, X, j, p), (q, points), atol=1e-5, fast_mode=True
    )
    d = hand_signed_distance(hand, X, q.detach(), points)
    (gradient,) = torch.autograd.grad(d[0].sum(), points)
    assert torch.allclose(gradient.norm(dim=1), torch.ones(4, dtype=torch.float64), atol=1e-9)  # eikonal


def test_float32_stays_float32(random_postures):
    hand = load_hand("allegro")
    scene = [torch.tensor(v, dtype=torch.float32) for v in _scene(hand, random_postures)]
    fast, slow = hand_signed_distance(hand, *scene), differentiable_distance(hand, *scene)
    assert fast.dtype == slow.dtype == torch.float32
    assert torch.allclose(fast, slow, atol=1e-5)


@pytest.mark.parametrize(
    ("X", "q", "points", "message"),
    [
        ((2, 4, 4), (2, 15), (5, 3), r"q has shape \(2, 15\); expected \(2, 16\) for hand 'allegro'"),
        ((2, 4, 4), (3, 16), (5, 3), r"q has shape \(3, 16\); expected \(2, 16\)"),
        ((4, 4), (1, 16), (5, 3), r"X_OH has shape \(4, 4\); expected \(N, 4, 4\)"),
        ((2, 4, 4), (2, 16), (5, 2), r"points_O has shape \(5, 2\)"),
        ((2, 4, 4), (2, 16), (3, 5, 3), r"expected \(M, 3\) or \(2, M, 3\)"),
    ],
)
def test_wrong_shapes(all_hands, X, q, points, message):
    with pytest.raises(ShapeError, match=message):
        hand_signed_distance(all_hands["allegro"], torch.zeros(X), torch.zeros(q), torch.zeros(points))


def test_packed_arrays_are_consistent(hand):
    packed = pack_hand(hand, spacing=0.009)
    assert all(a.flags["C_CONTIGUOUS"] for a in packed)
    start = packed.link_point_start
    assert start[0] == 0 and start[-1] == len(packed.point_L)
    for link in range(hand.tree.num_links):
        own = packed.point_L[start[link] : start[link + 1]]
        assert np.all(packed.point_link[start[link] : start[link + 1]] == link)
        gap = np.linalg.norm(own - packed.link_centre[link], axis=1)
        assert gap.max() == pytest.approx(packed.link_radius[link])
    X_HL = forward_fast(hand.tree, hand.q_open)
    own = packed.point_L[start[-2] :]
    own_H = own @ X_HL[-1, :3, :3].T + X_HL[-1, :3, 3]
    distance, part = nearest_part(packed, X_HL, *own_H[np.argmax(own_H @ hand.X_HP[:3, 2])])
    assert packed.part_link[part] == hand.tree.num_links - 1 and abs(distance) < 1e-9
    assert np.allclose(packed.part_X_PL[part] @ sorted(hand.parts, key=lambda p: p.link)[part].X_LP, np.eye(4))


def test_self_pairs_are_apart_when_open_and_never_neighbours(hand):
    packed = pack_hand(hand, spacing=0.009)
    body = rigid_bodies(hand.tree)
    X_HL = forward_fast(hand.tree, hand.q_open)
    for a, b in packed.self_pairs:
        assert body[hand.tree.parents[b]] != body[a] and body[a] != body[b]
        points = packed.point_L[packed.link_point_start[a] : packed.link_point_start[a + 1]]
        points_H = points @ X_HL[a, :3, :3].T + X_HL[a, :3, 3]
        inside = (points_H - X_HL[b, :3, 3]) @ X_HL[b, :3, :3]
        assert min(part_distances(p, inside).min() for p in hand.parts if p.link == b) > -5e-4
    tips = [f.links[-1] for f in hand.fingers]
    pairs = {tuple(p) for p in packed.self_pairs.tolist()}
    assert all((min(a, b), max(a, b)) in pairs for a in tips for b in tips if a != b)  # tips can always collide


def test_a_folded_finger_is_seen_by_its_pair(write_robot):
    """A claw closed to its limits collides; its pairs say between which links."""
    hand = load_hand(write_robot(three_finger_urdf()))
    packed = pack_hand(hand, spacing=0.005)
    X_HL = forward_fast(hand.tree, np.full(6, 1.6))
    hit = set()
    for a, b in packed.self_pairs:
        points = packed.point_L[packed.link_point_start[a] : packed.link_point_start[a + 1]]
        points_H = points @ X_HL[a, :3, :3].T + X_HL[a, :3, 3]
        local = (points_H - X_HL[b, :3, 3]) @ X_HL[b, :3, :3]
        if min(part_distances(p, local).min() for p in hand.parts if p.link == b) < -0.002:
            hit.add((hand.tree.link_names[a], hand.tree.link_names[b]))
    assert ("a1", "c1") in hit
