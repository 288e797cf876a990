"""Contacts, overlaps and qualities of a two-pad jaw on a box, where every answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.grasps.penetration import depth_in_part, penetration_depths
from neuralgrasps.grasps.quality import QualityConfig, grasp_quality
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.signed_distance import hand_signed_distance
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy


@pytest.fixture(scope="module")
def packed(jaw):
    return pack_hand(jaw, spacing=0.003)


def contacts_at(jaw, packed, box, X_OH, q, *, threshold=0.0025, per_link=3, slots=20):
    points, normals, links = np.empty((slots, 3)), np.empty((slots, 3)), np.empty(slots, np.int32)
    X_HL = forward_numpy(jaw.tree, np.asarray(q, float))
    sdf = box.sdf
    count = find_contacts(
        sdf.values, sdf.origin, sdf.inv_spacing, packed, X_OH, X_HL, threshold, per_link, points, normals, links
    )
    return points[:count], normals[:count], links[:count]


def test_contacts_lie_on_the_faces_with_outward_normals(jaw, packed, box, X_OH):
    points, normals, links = contacts_at(jaw, packed, box, X_OH, [0.021, 0.0205])
    assert links.tolist() == [1, 1, 1, 2, 2, 2]
    side = np.where(links == 1, 1.0, -1.0)
    np.testing.assert_allclose(points[:, 0], 0.02 * side, atol=1e-6)
    np.testing.assert_allclose(normals, side[:, None] * [1, 0, 0], atol=1e-6)
    assert (np.abs(points[:, 1:]) <= [0.0101, 0.0121]).all()
    for link in (1, 2):  # three far-apart points, not three neighbours
        own = points[links == link]
        gaps = np.linalg.norm(own[:, None] - own[None], axis=-1)[np.triu_indices(3, 1)]
        assert gaps.min() > 0.008


def test_only_links_within_the_threshold_touch(jaw, packed, box, X_OH):
    assert contacts_at(jaw, packed, box, X_OH, [0.0224, 0.0226])[2].tolist() == [1, 1, 1]
    assert contacts_at(jaw, packed, box, X_OH, [0.0224, 0.0226], threshold=0.003)[2].tolist() == [1, 1, 1, 2, 2, 2]
    assert contacts_at(jaw, packed, box, X_OH, [0.021, 0.021], per_link=1)[2].tolist() == [1, 2]
    assert len(contacts_at(jaw, packed, box, X_OH, [0.021, 0.021], slots=4)[2]) == 4


def test_contacts_move_with_object_frame_only_by_the_hand_pose(jaw, packed, box, X_OH):
    turn = np.eye(4)
    turn[:3, :3] = np.diag([-1.0, -1.0, 1.0])  # half a turn maps the box to itself and swaps the pads
    points, _, links = contacts_at(jaw, packed, box, turn @ X_OH, [0.021, 0.021])
    np.testing.assert_allclose(points[:, 0], np.where(links == 1, -0.02, 0.02), atol=1e-6)


@pytest.mark.parametrize("depth", [0.0, 0.0005, 0.002, 0.004])
def test_overlap_depths_are_known(jaw, packed, box, X_OH, depth):
    q = np.array([[0.02 - depth, 0.021]])
    depths = penetration_depths(packed, box.sdf, box.points_O, X_OH=X_OH[None], q=q)
    assert depths.hand_in_object[0] == pytest.approx(depth, abs=2e-5)
    assert depths.object_in_hand[0] == pytest.approx(depth, abs=2e-5)
    assert depths.hand_in_hand[0] == 0.0
    assert depths.deepest[0] == pytest.approx(depth, abs=2e-5)


def test_self_overlap_is_known(jaw, packed, box, X_OH):
    far = X_OH.copy()
    far[0, 3] = 1.0
    q = np.array([[-0.002, 0.0], [-0.001, -0.003], [0.001, 0.001]])
    depths = penetration_depths(packed, box.sdf, box.points_O, X_OH=np.tile(far, (3, 1, 1)), q=q)
    np.testing.assert_allclose(depths.hand_in_hand, [0.002, 0.004, 0.0], atol=1e-9)
    assert (depths.hand_in_object == 0).all()
    assert (depths.object_in_hand == 0).all()


@pytest.mark.parametrize("small", [1, 2])
def test_a_small_link_inside_a_large_one_is_seen_from_either_side(jaw, box, X_OH, small):
    # only the small link's points are inside the other: both directions of every pair must be checked
    ball = replace(jaw.parts[small], kind=PartKind.SPHERE, size=np.array([0.001, 0, 0]))
    parts = tuple(ball if p.link == small else p for p in jaw.parts)
    packed = pack_hand(replace(jaw, parts=parts), spacing=0.003)
    far = X_OH.copy()
    far[0, 3] = 1.0
    # both centres coincide: the ball's points are 4 to 5 mm deep in the 10 mm thick pad
    depths = penetration_depths(packed, box.sdf, box.points_O, X_OH=far[None], q=np.array([[-0.005, -0.005]]))
    assert 0.004 <= depths.hand_in_hand[0] <= 0.005


@pytest.mark.parametrize("name", ["barrett", "human", "fetch"])
def test_depth_of_object_points_agrees_with_the_exact_distance(name, box):
    # random poses that overlap the box; the exact torch distance is the reference for every kind of part
    hand = load_hand(name)
    packed = pack_hand(hand, spacing=0.008)
    rng = np.random.default_rng(0)
    X = np.tile(np.eye(4), (24, 1, 1))
    X[:, :3, :3] = Rotation.random(24, random_state=0).as_matrix()
    X[:, :3, 3] = rng.uniform(-0.1, 0.1, (24, 3))
    q = rng.uniform(hand.tree.lower, hand.tree.upper, (24, hand.num_dofs))
    depths = penetration_depths(packed, box.sdf, box.points_O, X_OH=X, q=q)
    exact = hand_signed_distance(hand, torch.from_numpy(X), torch.from_numpy(q), torch.from_numpy(box.points_O))
    reference = (-exact.min(dim=1).values).clamp(min=0).numpy()
    assert (reference > 0).sum() > 5
    np.testing.assert_allclose(depths.object_in_hand, reference, atol=1e-9)


def test_depths_inside_hulls_agree_with_the_exact_distance():
    # a box given as a hull, so that both kinds of part must agree
    hand = load_hand("fetch")
    mesh = box_mesh([0.01, 0.02, 0.03])
    solid = replace(hand.parts[0], kind=PartKind.BOX, size=np.array([0.01, 0.02, 0.03]))
    hull = replace(solid, kind=PartKind.HULL, size=np.zeros(3), vertices=mesh.vertices, faces=mesh.faces)
    packed = pack_hand(replace(hand, parts=(solid, hull)), spacing=0.01)
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (200, 3))
    for p in points:
        a, b = depth_in_part(packed, 0, *p), depth_in_part(packed, 1, *p)
        assert (a > 0) == (b > 0)
        if a > 0:
            assert a == pytest.approx(b, abs=1e-12)


def test_quality_of_a_jaw_on_a_box(jaw, packed, box, X_OH):
    q = np.array([[0.0205, 0.0205], [0.0205, 0.03], [0.04, 0.04]])
    quality = grasp_quality(jaw, packed, box, X_OH=np.tile(X_OH, (3, 1, 1)), q=q)
    assert quality.epsilon[0] > 0.01
    assert quality.epsilon[1:].tolist() == [0.0, 0.0]
    assert quality.force_residual[0] < 1e-3
    assert quality.force_residual[1] > 0.5
    assert quality.force_residual[2] == np.inf
    np.testing.assert_allclose(quality.contact_distance_m, [0.0005, (0.0005 + 0.01) / 2, 0.01], atol=1e-6)
    assert quality.touching_links.tolist() == [2, 1, 0]
    assert quality.contact_links.shape == (3, 6)
    assert (quality.contact_links[1] >= 0).sum() == 3
    assert np.isnan(quality.contact_points_O[2]).all()
    soft = grasp_quality(jaw, packed, box, X_OH=X_OH[None], q=q[:1], config=QualityConfig(torsion_m=0.01, friction=0.6))
    assert soft.epsilon[0] > quality.epsilon[0]


def test_wrong_quality_input_is_refused(jaw, packed, box, X_OH):
    with pytest.raises(ShapeError, match="q has shape"):
        grasp_quality(jaw, packed, box, X_OH=X_OH[None], q=np.zeros((1, 3)))
    for wrong in ({"friction": 0.0}, {"edges": 2}, {"torsion_m": -1.0}, {"threshold_m": 0.0}):
        with pytest.raises(InputError):
            QualityConfig(**wrong)
