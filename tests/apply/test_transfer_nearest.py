"""Distances part by part against the distance point by point."""

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.transfer_nearest import nearest_parts, new_nearest, points_in_hand
from neuralgrasps.geometry.primitives import capsule_mesh
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.hand import ConvexPart, Hand, PartKind
from neuralgrasps.hands.packed import hand_distance_many, nearest_part, pack_shapes, pose_links
from neuralgrasps.hands.posed_parts import part_poses_H
from neuralgrasps.hands.zoo import hand_names, load_hand


def hands() -> list[Hand]:
    zoo = [load_hand(name) for name in hand_names()]
    jaw = load_hand("panda")
    mesh = capsule_mesh(0.02, 0.03, segments=12)
    hull = ConvexPart(
        link=jaw.parts[-1].link, kind=PartKind.HULL, size=np.zeros(3), X_LP=jaw.parts[-1].X_LP, vertices=mesh.vertices,
        faces=mesh.faces,
    )  # fmt: skip
    ball = replace(jaw.parts[0], kind=PartKind.SPHERE, size=np.array([0.03, 0.0, 0.0]))
    return [*zoo, replace(jaw, parts=(ball, *jaw.parts[1:], hull))]


@pytest.mark.parametrize("hand", hands(), ids=lambda hand: f"{hand.name} of {len(hand.parts)} parts")
def test_part_by_part_is_as_exact_as_point_by_point(hand: Hand) -> None:
    rng = np.random.default_rng(0)
    packed, q = pack_shapes(hand), hand.tree.lower + 0.4 * (hand.tree.upper - hand.tree.lower)
    X_OH = np.eye(4)
    X_OH[:3, :3] = axis_angle_matrix(np.array([0.6, -0.64, 0.48]), 1.1)
    X_OH[:3, 3] = 0.02, -0.01, 0.03
    X_HL, X_PH = np.empty((len(packed.parents), 4, 4)), np.empty((len(hand.parts), 3, 4))
    centre_H = np.empty((len(hand.parts), 3))
    pose_links(packed, q, X_HL)
    part_poses_H(packed, X_HL, X_PH, centre_H)
    points_H = centre_H[rng.integers(len(centre_H), size=400)] + rng.normal(scale=0.02, size=(400, 3))
    points_O = np.ascontiguousarray(points_H @ X_OH[:3, :3].T + X_OH[:3, 3])
    nearest = new_nearest(400)
    points_in_hand(X_OH, points_O, nearest.points_A)
    assert np.allclose(nearest.points_A.T, points_H, atol=1e-12)
    nearest_parts(packed, X_PH, nearest)
    slow = np.empty(400)
    hand_distance_many(packed, X_OH, q, points_O, slow)
    assert (slow < 0).any() and np.allclose(nearest.distance, slow, atol=1e-12)
    assert len(set(nearest.part)) > len(hand.parts) / 4
    for i in range(0, 400, 20):
        d, part = nearest_part(packed, X_HL, *points_H[i])
        assert nearest.distance[i] == pytest.approx(d, abs=1e-12) and nearest.part[i] == part
