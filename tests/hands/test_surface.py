"""Even surface points, posed surfaces and meshes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.mesh import is_closed
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.parts import part_distances, part_mesh, sample_part
from neuralgrasps.hands.surface import (
    hand_link_meshes,
    hand_mesh,
    hand_part_meshes,
    pose_surface,
    sample_hand_surface,
)
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy


@pytest.mark.parametrize("spacing", [0.009, 0.005])
def test_points_are_spaced_as_asked(hand, spacing):
    surface = sample_hand_surface(hand, spacing=spacing)
    gaps = []
    for link in np.unique(surface.links):
        own = surface.points_L[surface.links == link]
        if len(own) > 30:
            gaps.append(cKDTree(own).query(own, k=2)[0][:, 1])
    gaps = np.concatenate(gaps)
    assert gaps.mean() == pytest.approx(spacing, rel=0.1)
    assert gaps.min() > 0.8 * spacing  # even: no clumps


def test_points_lie_on_the_outside_of_their_rigid_body(hand):
    surface = sample_hand_surface(hand, spacing=0.006)
    bodies = rigid_bodies(hand.tree)
    for link in np.unique(surface.links):
        mine = surface.links == link
        own = [p for p in hand.parts if bodies[p.link] == bodies[link]]  # these hands have no fixed joints
        distance = np.min([part_distances(p, surface.points_L[mine]) for p in own], axis=0)
        assert np.abs(distance).max() < 1.1e-5
        out = surface.points_L[mine] + 1e-4 * surface.normals_L[mine]
        free = np.min([part_distances(p, out) for p in own], axis=0) > 0
        assert free.mean() > 0.95  # all but those in a crease between two parts
    assert np.allclose(np.linalg.norm(surface.normals_L, axis=1), 1)
    assert np.all(np.diff(surface.links) >= 0)


def test_no_exposed_surface_is_left_uncovered(hand):
    spacing = 0.006
    surface = sample_hand_surface(hand, spacing=spacing)
    for link in range(hand.tree.num_links):
        own = [p for p in hand.parts if p.link == link]
        points = np.concatenate([sample_part(p, 1 / 0.003**2)[0] for p in own])
        outside = np.min([part_distances(p, points) for p in own], axis=0) > -1e-9
        gap = cKDTree(surface.points_L[surface.links == link]).query(points[outside])[0]
        assert gap.max() < 1.2 * spacing


def test_same_points_every_time():
    hand = load_hand("barrett")
    first, second = (sample_hand_surface(hand, spacing=0.008) for _ in range(2))
    assert np.array_equal(first.points_L, second.points_L)


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan"), 1e-5])
def test_bad_spacing(spacing):
    with pytest.raises(InputError, match="spacing is"):
        sample_hand_surface(load_hand("panda"), spacing=spacing)


def test_posed_points_move_with_the_links(hand, random_postures):
    surface = sample_hand_surface(hand, spacing=0.012)
    q = random_postures(hand, 3)
    rng = np.random.default_rng(0)
    X_OH = np.tile(np.eye(4), (3, 1, 1))
    X_OH[:, :3, :3] = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    X_OH[:, :3, 3] = rng.normal(size=(3, 3))
    posed = pose_surface(hand, surface, torch.tensor(X_OH), torch.tensor(q)).numpy()
    X = X_OH[:, None] @ forward_numpy(hand.tree, q)
    for k in (0, len(surface.links) // 2, len(surface.links) - 1):
        expected = X[:, surface.links[k]] @ np.append(surface.points_L[k], 1.0)
        assert np.allclose(posed[:, k], expected[:, :3], atol=1e-12)


def test_meshes_of_parts_links_and_hand(hand):
    assert all(is_closed(part_mesh(p)) for p in hand.parts)
    links = hand_link_meshes(hand)
    assert len(links) == hand.tree.num_links
    whole = hand_mesh(hand, hand.q_open)
    assert len(whole.faces) == sum(len(m.faces) for m in links if m)
    assert len(hand_part_meshes(hand, hand.q_open)) == len(hand.parts)
    with pytest.raises(ShapeError, match=rf"hand '{hand.name}' has {hand.num_dofs} joints"):
        hand_mesh(hand, np.zeros(hand.num_dofs + 2))
