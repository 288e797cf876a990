"""Probe points cover faces and edges, and groups lose none of them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.grasps.probe_points import group_points, probe_hand, probe_surface, sharp_edge_points
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.hands.signed_distance import hand_signed_distance
from neuralgrasps.hands.zoo import load_hand


def test_a_box_has_twelve_sharp_edges_and_no_diagonals():
    half = np.array([0.01, 0.02, 0.03])
    points = sharp_edge_points(box_mesh(half), spacing=0.002)
    assert ((np.abs(np.abs(points) - half) < 1e-12).sum(axis=1) >= 2).all()
    assert len(points) == 8 + 4 * (9 + 19 + 29)
    assert len(sharp_edge_points(sphere_mesh(0.03, segments=64), spacing=0.002)) == 0


def test_probe_points_lie_on_the_surface_and_leave_no_hole():
    mesh = box_mesh([0.02, 0.03, 0.05])
    probe = probe_surface(mesh, spacing=0.002)
    assert np.abs(signed_distance(mesh, probe.points)).max() < 1e-12
    gap, _ = cKDTree(probe.points).query(sample_surface(mesh, 20_000, 3)[0])
    assert gap.max() < 0.0025


@pytest.mark.parametrize("count", [0, 1, 500])
def test_groups_hold_every_point_once_in_their_balls(count):
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (count, 3))
    groups = group_points(points)
    assert sorted(map(tuple, groups.points)) == sorted(map(tuple, points))
    for g in range(len(groups.radius)):
        own = groups.points[groups.start[g] : groups.start[g + 1]]
        assert len(own) and (np.linalg.norm(own - groups.centre[g], axis=1) <= groups.radius[g] + 1e-15).all()
    assert groups.start[-1] == count


def test_points_of_a_hand_lie_on_its_parts_and_no_link_is_without():
    hand = load_hand("barrett")
    packed = probe_hand(hand, spacing=0.003)
    assert set(packed.point_link) == {p.link for p in hand.parts}
    q = 0.5 * (hand.tree.lower + hand.tree.upper)
    X = np.empty((hand.tree.num_links, 4, 4))
    pose_links(packed, q, X)
    X = X[packed.point_link]
    points = (X[:, :3, :3] @ packed.point_L[..., None])[..., 0] + X[:, :3, 3]
    distance = hand_signed_distance(
        hand, torch.eye(4, dtype=torch.float64)[None], torch.from_numpy(q)[None], torch.from_numpy(points)
    )[0].numpy()
    assert distance.max() < 1e-9  # on a part or inside another
    assert (np.abs(distance) < 1e-9).mean() > 0.5
