"""Start poses: antipodal pairs obey the cone and the aperture; thumb and fingers stand on a pair."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.sdf_grid import query_grid_gradient_numpy
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.synthesis.clusters import hand_clearance
from neuralgrasps.synthesis.jaw import jaw_aperture, pad_middles
from neuralgrasps.synthesis.oppose import opposition, pose_on_pair, thumb_and_fingers, tip_points
from neuralgrasps.synthesis.propose import (
    START_GAP_M,
    draw_pairs,
    draw_preshapes,
    perpendicular,
    poses_from_palm,
    propose_approach,
    propose_dexterous,
    propose_jaw,
    propose_opposed,
)

FRICTION = 0.6


def _rng(seed=0):
    return np.random.default_rng(seed)


def test_perpendicular_vectors_are_unit_and_perpendicular():
    axes = _rng().standard_normal((50, 3))
    axes[:3] = np.eye(3)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angle = _rng(1).uniform(0, 2 * np.pi, 50)
    u, v = perpendicular(axes, angle), perpendicular(axes, angle + 0.3)
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1.0)
    np.testing.assert_allclose((u * axes).sum(1), 0.0, atol=1e-12)
    np.testing.assert_allclose((u * v).sum(1), np.cos(0.3))
    np.testing.assert_allclose((np.cross(u, v) * axes).sum(1), np.sin(0.3))  # right-handed about the axis


def test_the_palm_stands_where_it_was_asked_to(hands):
    hand = hands["human"]
    z = _rng().standard_normal((20, 3))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = perpendicular(z, np.linspace(0, 6, 20))
    X_OP = poses_from_palm(hand.X_HP, np.arange(60.0).reshape(20, 3), x, z) @ hand.X_HP
    np.testing.assert_allclose(X_OP[:, :3, 0], x, atol=1e-12)
    np.testing.assert_allclose(X_OP[:, :3, 2], z, atol=1e-12)
    np.testing.assert_allclose(X_OP[:, :3, 3], np.arange(60.0).reshape(20, 3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(X_OP[:, :3, :3]), 1.0)


def test_apertures_are_those_of_the_makers(hands):
    assert jaw_aperture(hands["panda"]) == pytest.approx(0.08)
    assert jaw_aperture(hands["fetch"]) == pytest.approx(0.10)


@pytest.mark.parametrize("solid", ["ball", "box", "can"])
@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_pairs_obey_both_friction_cones_and_the_width(solids, solid, friction):
    obj = solids[solid]
    start, exits, keep = draw_pairs(obj, 2000, friction, 0.07, _rng())
    start, exits = start[keep], exits[keep]
    assert len(start) > 100
    width = np.linalg.norm(exits - start, axis=1)
    assert (width <= 0.07).all() and (width > 0.01).all()
    distance, normal_out = query_grid_gradient_numpy(obj.sdf, exits)
    np.testing.assert_allclose(distance, 0.0, atol=5e-4)
    direction = (exits - start) / width[:, None]
    normal_out /= np.linalg.norm(normal_out, axis=1, keepdims=True)
    limit = np.cos(np.arctan(friction)) - 1e-6
    assert ((direction * normal_out).sum(1) >= limit).all()
    nearest = np.linalg.norm(start[:, None] - obj.points_O, axis=-1).argmin(axis=1)
    assert (-(direction * obj.normals_O[nearest]).sum(1) >= limit).all()
    middle = 0.5 * (start + exits)
    assert (query_grid_gradient_numpy(obj.sdf, middle)[0] < 0).all()


def test_the_width_of_a_ball_pair_is_its_chord(solids):
    start, exits, keep = draw_pairs(solids["ball"], 500, FRICTION, 0.1, _rng())
    direction = exits - start
    width = np.linalg.norm(direction, axis=1)
    chord = -2 * (start * direction).sum(1) / width
    np.testing.assert_allclose(width[keep], chord[keep], atol=6e-4)


def test_nothing_wider_than_the_aperture_is_proposed(hands, solids):
    assert (
        len(propose_jaw(hands["panda"], solids["cube"], count=500, friction=0.6, pad_depth_m=0.01, rng=_rng()).q) == 0
    )


def test_jaw_proposals_close_along_the_pair_and_centre_on_it(hands, solids):
    hand, box = hands["panda"], solids["box"]
    proposals = propose_jaw(hand, box, count=800, friction=1e-3, pad_depth_m=0.0, rng=_rng())
    X_HP = hand.X_HP.copy()
    X_HP[:3, 3] = hand.jaw_pad_H
    X_OP = proposals.X_OH @ X_HP
    closing = np.abs(X_OP[:, :3, 0])
    axis = closing.argmax(axis=1)
    np.testing.assert_allclose(closing[np.arange(len(axis)), axis], 1.0, atol=1e-3)
    # without friction the pads' middle lies in the box's middle plane across the closing axis
    np.testing.assert_allclose(X_OP[np.arange(len(axis)), axis, 3], 0.0, atol=1e-3)
    assert set(axis) == {0, 1}  # 40 and 60 mm fit 80 mm; 100 mm does not
    np.testing.assert_array_equal(proposals.q, np.repeat(hand.q_open[None], len(axis), 0))


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
def test_preshapes_stay_in_their_range_and_groups_move_together(hands, name):
    hand = hands[name]
    q = draw_preshapes(hand, 400, _rng())
    assert (q >= hand.preshape_lower - 1e-12).all() and (q <= hand.preshape_upper + 1e-12).all()
    span = np.maximum(hand.preshape_upper - hand.preshape_lower, 1e-12)
    u = (q - hand.preshape_lower) / span
    for group in hand.preshape_groups:
        wide = [j for j in group if span[j] > 1e-6]
        if wide:
            assert np.ptp(u[:, wide], axis=1).max() <= 0.2 + 1e-9
            assert u[:, wide].std() > 0.2


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
@pytest.mark.parametrize("propose", [propose_approach, propose_opposed])
def test_start_poses_touch_or_clear_the_object(problem_of, name, propose):
    problem = problem_of(name, "can")
    arguments = {} if propose is propose_approach else {"friction": FRICTION}
    proposals = propose(problem, count=200, rng=_rng(), **arguments)
    assert 150 < len(proposals.q) <= 200
    R = proposals.X_OH[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.eye(3)[None].repeat(len(R), 0), atol=1e-9)
    gap = np.array(
        [
            hand_clearance(*problem.sdf_arrays, problem.packed, problem.clusters, X, X_HL)
            for X, X_HL in zip(proposals.X_OH, forward_fast(problem.hand.tree, proposals.q), strict=True)
        ]
    )
    assert gap.min() > -2e-4
    assert (gap <= START_GAP_M + 1e-9).mean() > 0.1
    assert gap.max() < 0.08


def test_opposed_tips_are_as_far_apart_as_the_width_and_lie_on_the_pair(hands, problem_of):
    problem = problem_of("human", "can")
    hand = hands["human"]
    thumb, fingers = thumb_and_fingers(hand)
    q = draw_preshapes(hand, 60, _rng())
    share = np.zeros((60, len(fingers)))
    share[:, 1] = 1.0
    width = _rng(1).uniform(0.01, 0.07, 60)
    thumb_H, finger_H, met, _ = opposition(hand, problem.packed, q, share, width)
    assert met.sum() > 20
    gap = np.linalg.norm(finger_H - thumb_H, axis=1)[met] - 0.016
    np.testing.assert_allclose(gap, width[met], atol=2e-3)  # between two postures of the path
    start, end = _rng(2).uniform(-0.03, 0.03, (2, 60, 3))
    X_OH = pose_on_pair(thumb_H, finger_H, start, end, np.linspace(0, 6, 60))
    np.testing.assert_allclose(np.linalg.det(X_OH[:, :3, :3]), 1.0)
    at_O = [np.einsum("nij,nj->ni", X_OH[:, :3, :3], p) + X_OH[:, :3, 3] for p in (thumb_H, finger_H)]
    np.testing.assert_allclose(0.5 * (at_O[0] + at_O[1]), 0.5 * (start + end), atol=1e-12)
    line, pair = at_O[1] - at_O[0], end - start
    cosine = (line * pair).sum(1) / np.linalg.norm(line, axis=1) / np.linalg.norm(pair, axis=1)
    np.testing.assert_allclose(cosine, 1.0)
    link, _ = tip_points(problem.packed, thumb)
    assert hand.tree.link_names[link] == "thumb_distal"


def test_hands_without_a_thumb_approach_only(hands, problem_of):
    assert thumb_and_fingers(hands["panda"]) is None
    assert len(propose_dexterous(problem_of("panda", "box"), count=50, friction=FRICTION, rng=_rng()).q) > 20


def test_nothing_too_wide_for_the_hand_is_opposed(problem_of):
    assert len(propose_opposed(problem_of("allegro", "cube"), count=100, friction=FRICTION, rng=_rng()).q) == 0
    assert len(propose_dexterous(problem_of("allegro", "cube"), count=100, friction=FRICTION, rng=_rng()).q) > 10


def test_proposals_are_a_function_of_the_generator(problem_of):
    problem = problem_of("barrett", "box")
    first, same, other = (propose_dexterous(problem, count=100, friction=FRICTION, rng=_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.X_OH, same.X_OH)
    np.testing.assert_array_equal(first.q, same.q)
    assert first.X_OH.shape != other.X_OH.shape or (first.X_OH != other.X_OH).any()


@pytest.mark.parametrize("name", ["fetch", "panda"])
def test_pads_that_slide_have_one_middle(hands, name):
    hand = hands[name]
    widths = np.linspace(0.0, jaw_aperture(hand), 7)
    np.testing.assert_allclose(pad_middles(hand, widths), np.repeat(hand.jaw_pad_H[None], 7, axis=0), atol=1e-12)


def test_pads_on_cranks_move_out_of_the_palm_as_they_open(tmp_path):
    """Cranks of 60 mm swing inwards from upright, tips stay upright: x = 50 - 60 sin t, z = 50 + 60 cos t, in mm."""
    crank, t_max = 0.06, 0.7
    lines = ['<robot name="cranks"><link name="base">' + _box("0.06 0.03 0.02", "0 0 0.02") + "</link>"]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        mimic = '<mimic joint="left" multiplier="{}"/>'
        turn = "" if side == "left" else mimic.format(-1.0)
        low, high = (-t_max, 0.0) if side == "left" else (0.0, t_max)
        lines.append(
            f'<link name="{side}_crank">{_box("0.008 0.02 0.05", "0 0 0.03")}</link>'
            f'<link name="{side}_tip">{_box("0.008 0.02 0.04", f"{sign * 0.004} 0 0.025")}</link>'
            f'<joint name="{side}" type="revolute"><parent link="base"/><child link="{side}_crank"/><axis xyz="0 1 0"/>'
            f'<origin xyz="{sign * 0.05} 0 0.05"/><limit lower="{low}" upper="{high}" effort="5" velocity="1"/>{turn}'
            f'</joint><joint name="{side}_level" type="revolute">'
            f'<parent link="{side}_crank"/><child link="{side}_tip"/>'
            f'<axis xyz="0 1 0"/><origin xyz="0 0 {crank}"/><limit lower="-1" upper="1" effort="5" velocity="1"/>'
            f"{mimic.format(-sign)}</joint>"
        )
    path = tmp_path / "cranks.urdf"
    path.write_text("".join([*lines, "</robot>"]))
    hand = load_hand(path)
    assert hand.is_jaw
    t = np.array([0.05, 0.2, 0.45, 0.65])
    widths = 2 * crank * (np.sin(t_max) - np.sin(t))
    height = pad_middles(hand, widths) @ hand.X_HP[:3, 2]
    np.testing.assert_allclose(height - height[0], crank * (np.cos(t) - np.cos(t[0])), atol=1e-4)


def _box(size, xyz):
    return f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision>'
