"""What is kept of a hand and an object: where symmetry takes contact points, and which protocol tries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from neuralgrasps.apply.transfer_pair import known_maps, target_of, transfer_pair
from neuralgrasps.apply.transfer_query import query_from_contacts, query_from_grasp
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.hands.zoo import load_hand
from tests.apply.conftest import BoxWorld


@pytest.fixture(scope="module")
def prism(make_object):
    """A rod of three equal sides: its turns by 120 and by 240 degrees are each other's inverses."""
    angle = np.radians([90.0, 210.0, 330.0])
    ring = 0.03 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners = np.concatenate([np.column_stack([ring, np.full(3, z)]) for z in (-0.05, 0.07)])
    return make_object("prism", Mesh(*convex_hull(corners)), symmetry=True)


def test_symmetry_takes_each_point_where_the_rotation_does(prism):
    pair = transfer_pair(load_hand("panda"), prism, "dexgraspbench-quick")
    rotations = prism.symmetry.rotations
    assert len(rotations) >= 3 and pair.turned.shape == (len(rotations), len(pair.sparse))
    tree = KDTree(prism.points_O)
    for turned, X in zip(pair.turned, rotations, strict=True):
        goal = prism.points_O[pair.sparse] @ X[:3, :3].T + X[:3, 3]
        off = np.linalg.norm(prism.points_O[turned] - goal, axis=1)
        np.testing.assert_allclose(off, tree.query(goal)[0], atol=1e-9)


def test_each_protocol_has_a_pair_of_its_own(box_world: BoxWorld):
    hand, obj = box_world.hand, box_world.obj
    pairs = [transfer_pair(hand, obj, name) for name in ("dexgraspbench", "shake", "dexgraspbench")]
    assert pairs[0] is pairs[2] and pairs[0].trial is not pairs[1].trial


def test_known_maps_are_of_these_grasps_and_this_radius(box_world: BoxWorld):
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    pair = transfer_pair(hand, obj, "dexgraspbench")
    radius = query_from_grasp(hand, obj, grasps.X_OH[0], grasps.q[0]).radius_m
    maps = known_maps(pair, grasps, radius).maps
    for k in (0, 3):
        query = query_from_grasp(hand, obj, grasps.X_OH[k], grasps.q[k])
        np.testing.assert_allclose(maps[k], query.contact_map, atol=1e-6)
    away = grasps.X_OH.copy()
    away[:, 2, 3] += 0.05
    assert np.abs(known_maps(pair, replace(grasps, X_OH=away), radius).maps - maps).max() > 0.1
    np.testing.assert_allclose(known_maps(pair, grasps, 2 * radius).maps, np.sqrt(maps), atol=1e-4)


def test_a_target_keeps_weights_and_the_inverse_radius(box_world: BoxWorld):
    query = query_from_contacts(box_world.obj, box_world.obj.points_O[:4])
    rows = np.arange(0, len(query.weight), 3)
    target = target_of(query, rows)
    assert target.inv_radius == pytest.approx(1.0 / query.radius_m)
    assert target.weight.mean() == pytest.approx(1.0)
    np.testing.assert_allclose(target.weight / target.weight[0], query.weight[rows] / query.weight[rows[0]])
