"""What is kept of a hand and an object: where symmetry takes contact points, and which protocol tries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from neuralgrasps.apply.transfer import TransferConfig, transfer
from neuralgrasps.apply.transfer_kernels import margins
from neuralgrasps.apply.transfer_pair import COMPARED, known_maps, target_of, transfer_pair, widest
from neuralgrasps.apply.transfer_query import query_from_contacts, query_from_grasp, query_from_points
from neuralgrasps.apply.transfer_search import rank_known
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.grasps.grasp_set import GraspSet
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


def test_known_grasps_are_turned_as_the_symmetry_turns(prism):
    """A query that is a known grasp turned by 120 degrees is that grasp, turned so, and not by 240."""
    hand = load_hand("panda")
    pair = transfer_pair(hand, prism, "dexgraspbench-quick")
    X_OP = np.eye(4)
    X_OP[:3, :3] = np.array([[0, 0, -1.0], [1, 0, 0], [0, -1, 0]])  # the palm looks along -x
    X_OP[:3, 3] = [0.06, 0.01, 0.03]
    X_OH = (X_OP @ np.linalg.inv(hand.X_HP))[None]
    left, _, right = np.linalg.svd(X_OH[:, :3, :3])
    X_OH[:, :3, :3] = left @ right
    q, none = hand.q_open[None], np.zeros((1, 0, 3))
    known = GraspSet(
        hand=hand.name, object=prism.name, X_OH=X_OH, q=q, q_pregrasp=q, q_squeeze=q, contact_points_O=none,
        contact_normals_O=none, contact_links=np.zeros((1, 0), np.int32), epsilon=np.zeros(1),
        penetration_m=np.zeros(1),
    )  # fmt: skip
    for X in prism.symmetry.rotations:
        query = query_from_grasp(hand, prism, X @ X_OH[0], q[0])
        maps = known_maps(pair, known, query.radius_m)
        ranked = rank_known(
            pair, query, target_of(query), maps, count=1, turn=True, allows=lambda X_OH, rows: np.ones(len(rows), bool)
        )
        assert ranked.difference[0] < 1e-3
        np.testing.assert_allclose(ranked.X_OH[0], X @ X_OH[0], atol=2e-3)


@pytest.mark.parametrize("drawn", [False, True])
def test_similarity_zero_is_the_farthest_there_is(box_world: BoxWorld, drawn: bool):
    hand, obj = box_world.hand, box_world.obj
    grasps = box_world.grasps[:1] if drawn else box_world.grasps
    corner = obj.points_O[np.argsort(obj.points_O @ np.array([1.0, 1.0, 1.0]))[-6:]]
    query = query_from_contacts(obj, corner) if drawn else query_from_points(obj, obj.points_O)  # touched all over
    result = transfer(query, hand, obj, known=grasps, config=TransferConfig(method="retrieve", count=1))
    maps = known_maps(transfer_pair(hand, obj, "dexgraspbench"), grasps, query.radius_m).maps
    widest = max(np.abs(a - b).mean() for a in maps for b in maps)
    own = max(np.average(np.abs(a - query.contact_map), weights=query.weight) for a in maps)
    assert own > widest * 1.05
    assert result.scale == pytest.approx(own, rel=1e-5)


def test_margins_are_of_this_mass_centre_and_these_contacts(box_world: BoxWorld):
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    usual = known_maps(transfer_pair(hand, obj, "dexgraspbench"), grasps, 0.02).margins
    pair = transfer_pair(hand, replace(obj, com_O=obj.com_O + np.array([0.0, 0.0, 0.04])), "dexgraspbench")
    contacts = grasps.contact_points_O, grasps.contact_normals_O, grasps.contact_links
    moved = known_maps(pair, grasps, 0.02).margins
    np.testing.assert_array_equal(moved, margins(pair.slippery, *contacts))
    assert np.abs(moved - usual).max() > 1e-3
    none, links = np.full_like(contacts[0], np.nan), np.full_like(contacts[2], -1)
    bare = replace(grasps, contact_points_O=none, contact_normals_O=none, contact_links=links)
    np.testing.assert_array_equal(known_maps(pair, bare, 0.02).margins, -1.0)


def test_drawn_contacts_weigh_the_scale_as_they_weigh_differences(box_world: BoxWorld):
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    pair = transfer_pair(hand, obj, "dexgraspbench")
    query = query_from_contacts(obj, grasps.contact_points_O[2][grasps.contact_links[2] >= 0])
    maps = known_maps(pair, grasps, query.radius_m).maps

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.average(np.abs(a - b), weights=query.weight))

    expected = max(apart(a, b) for a in [*maps, query.contact_map] for b in maps)
    assert abs(expected - max(apart(query.contact_map, b) for b in maps)) > 0.01 * expected
    assert abs(expected - known_maps(pair, grasps, query.radius_m).widest) > 0.01 * expected
    result = transfer(query, hand, obj, known=grasps, config=TransferConfig(method="retrieve", count=1))
    assert result.scale == pytest.approx(expected, rel=1e-5)


def test_of_many_maps_some_are_compared():
    maps = np.zeros((COMPARED, 4), np.float32)
    maps[7] = 1.0
    assert widest(maps) == 1.0 and widest(maps, np.array([0.5, 0.5, 0.0, 0.0])) == 1.0
    assert widest(maps[:1]) == 0.0 == widest(maps[:0])
    many = np.zeros((2 * COMPARED - 1, 4), np.float32)  # every second one is looked at
    many[8], many[11] = 0.25, 1.0
    assert widest(many) == 0.25
