"""Hands on arms: known mountings, the default one, and what a manipulator says of itself."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.arms.home import SelfClearance
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import arm_names, load_arm
from neuralgrasps.errors import ShapeError
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.parts import part_distances, sample_part
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

OWN = {("fetch", "fetch"), ("panda", "panda")}
PAIRS = [(a, h) for a in arm_names() for h in hand_names()]


@pytest.fixture(scope="module")
def arms():
    return {name: load_arm(name) for name in arm_names()}


@pytest.mark.parametrize(("arm_name", "hand_name"), PAIRS)
def test_the_back_of_a_hand_lies_on_the_face(arms, arm_name, hand_name):
    arm, hand = arms[arm_name], load_hand(hand_name)
    robot = mount(arm, hand)
    X_MH = np.linalg.inv(arm.X_FM) @ robot.tree.X_parent_joint[robot.hand_link]
    assert np.linalg.det(X_MH[:3, :3]) == pytest.approx(1.0)
    X_HL = forward_numpy(hand.tree, hand.q_open)
    points = np.concatenate([sample_part(p, 2e4)[0] @ X_HL[p.link, :3, :3].T + X_HL[p.link, :3, 3] for p in hand.parts])
    points_M = points @ X_MH[:3, :3].T + X_MH[:3, 3]
    near_axis = np.linalg.norm(points_M[:, :2], axis=1) < 0.03
    assert points_M[near_axis, 2].min() == pytest.approx(0.0, abs=0.009 if (arm_name, hand_name) in OWN else 0.002)
    assert points_M[:, 2].max() > 0.1  # the hand reaches out of the face


@pytest.mark.parametrize(("arm_name", "hand_name"), PAIRS)
def test_hands_point_where_an_engineer_would_point_them(arms, arm_name, hand_name):
    arm, hand = arms[arm_name], load_hand(hand_name)
    robot = mount(arm, hand)
    R_MP = (arm.X_FM[:3, :3].T @ robot.tree.X_parent_joint[robot.hand_link][:3, :3]) @ hand.X_HP[:3, :3]
    if hand_name in ("allegro", "human"):  # fingers along z of the face, the palm looks along x
        X_HL = forward_numpy(hand.tree, hand.q_open)
        tips = np.mean([X_HL[f.links[-1], :3, 3] for f in hand.fingers if not f.is_thumb], axis=0)
        way = R_MP @ hand.X_HP[:3, :3].T @ (tips - hand.X_HP[:3, 3])
        assert way[2] > 0.95 * np.linalg.norm(way)
        assert R_MP[:, 2] == pytest.approx([1, 0, 0], abs=1e-6)
    else:
        assert pytest.approx(np.eye(3), abs=1e-3) == R_MP


@pytest.mark.parametrize(("arm_name", "hand_name"), PAIRS)
def test_nothing_touches_at_home(arms, arm_name, hand_name):
    robot = mount(arms[arm_name], load_hand(hand_name))
    arm_only = arms[arm_name]
    assert SelfClearance(arm_only.tree, arm_only.parts, arm_only.q_home)(arm_only.q_home) > 0.02
    body = rigid_bodies(robot.tree)
    X_BL = forward_numpy(robot.tree, robot.q_home)
    flange_body = body[robot.arm.flange]
    for p in robot.parts:
        if p.link < robot.hand_link:
            continue
        points = sample_part(p, 5e3)[0] @ X_BL[p.link, :3, :3].T + X_BL[p.link, :3, 3]
        for other in robot.parts:
            if other.link < robot.hand_link and body[other.link] not in (
                flange_body,
                body[robot.tree.parents[flange_body]],
            ):
                X = np.linalg.inv(X_BL[other.link])
                assert part_distances(other, points @ X[:3, :3].T + X[:3, 3]).min() > 0.01
        assert points[:, 2].min() > robot.arm.table_height_m + 0.2  # well above the table


def test_a_mounting_of_ones_own(arms):
    arm, hand = arms["panda"], load_hand("fetch")
    X_MH = np.eye(4)
    X_MH[:3, 3] = [0.0, 0.01, 0.2]
    robot = mount(arm, hand, X_MH)
    assert robot.tree.X_parent_joint[robot.hand_link] == pytest.approx(arm.X_FM @ X_MH)
    with pytest.raises(ShapeError, match="X_MH"):
        mount(arm, hand, np.eye(3))


def test_a_manipulator_moves_both_its_parts(arms):
    arm, hand = arms["fetch"], load_hand("allegro")
    robot = mount(arm, hand)
    rng = np.random.default_rng(3)
    q_arm, q_hand = rng.uniform(robot.lower, robot.upper), rng.uniform(hand.tree.lower, hand.tree.upper)
    full = robot.full_q(q_arm, q_hand)
    X_BL, X_HL = forward_numpy(robot.tree, full), forward_numpy(hand.tree, q_hand)
    X_BH = robot.hand_pose(q_arm)
    for k in range(hand.tree.num_links):
        assert X_BL[robot.hand_link + k] == pytest.approx(X_BH @ X_HL[k])
    assert robot.arm_names == tuple(arm.tree.dof_names[j] for j in arm.joints)
    assert full[arm.tree.dof_names.index("head_tilt_joint")] == arm.q_home[arm.tree.dof_names.index("head_tilt_joint")]
