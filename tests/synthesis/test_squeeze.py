"""Squeeze torques are J'f, within the limits; pre-grasps are open and clear."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.grasps.force_qp import contact_forces
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.synthesis.candidates import CONE_EDGES, VALID, close_and_assess
from neuralgrasps.synthesis.clusters import hand_clearance
from neuralgrasps.synthesis.finish import clear_pregrasps, finish_grasps
from neuralgrasps.synthesis.propose import propose_dexterous, propose_jaw
from neuralgrasps.synthesis.squeeze import (
    EFFORT_SHARE,
    GAP_M,
    JAW_SQUEEZE_M,
    PREGRASP_JAW_M,
    PREGRASP_RAD,
    contact_torques,
    joint_scale,
    pregrasp_joints,
    squeeze_joints,
)


def _valid(problem, count=300):
    rng = np.random.default_rng(0)
    if problem.hand.is_jaw:
        drawn = propose_jaw(problem.hand, problem.obj, count=count, friction=0.6, pad_depth_m=0.01, rng=rng)
    else:
        drawn = propose_dexterous(problem, count=count, friction=0.6, rng=rng)
    closed = close_and_assess(problem, drawn.X_OH, drawn.q)
    return closed.take(closed.outcome == VALID)


@pytest.mark.parametrize("name", ["panda", "barrett", "allegro", "human"])
def test_contact_torques_do_the_work_of_the_forces(hands, name):
    """Virtual work: torque . dq = sum force . d(point), the points moving with their links."""
    hand, rng = hands[name], np.random.default_rng(3)
    q = rng.uniform(hand.tree.lower, hand.tree.upper)
    X_HL = forward_numpy(hand.tree, q)
    X_OH = np.eye(4)
    X_OH[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    X_OH[:3, :3] *= np.linalg.det(X_OH[:3, :3])
    X_OH[:3, 3] = rng.uniform(-0.2, 0.2, 3)
    links = rng.integers(1, hand.tree.num_links, 6).astype(np.int32)
    links[4] = -1  # padding
    forces_O = rng.standard_normal((6, 3))
    points_L = rng.uniform(-0.02, 0.02, (6, 3))

    def points_O(q):
        X = X_OH @ forward_numpy(hand.tree, q)[links]
        return np.einsum("nij,nj->ni", X[:, :3, :3], points_L) + X[:, :3, 3]

    torque = contact_torques(hand, X_OH, X_HL, points_O(q), forces_O, links)
    for j in range(hand.num_dofs):
        step = np.zeros(hand.num_dofs)
        step[j] = 1e-6
        moved = (points_O(q + step) - points_O(q - step)) / 2e-6
        moved[4] = 0.0
        assert torque[j] == pytest.approx((moved * forces_O).sum(), abs=1e-7)


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
def test_commanded_torques_reach_their_share_of_the_limit_and_no_more(problem_of, name):
    problem = problem_of(name, "can")
    hand, closed = problem.hand, _valid(problem)
    stiffness = joint_scale(hand, 20.0, 3000.0)
    pressing = 0
    for i in range(min(len(closed), 20)):
        X_HL = forward_numpy(hand.tree, closed.q[i])
        points, normals, links = np.empty((99, 3)), np.empty((99, 3)), np.empty(99, np.int32)
        n = find_contacts(*problem.sdf_arrays, problem.packed, closed.X_OH[i], X_HL, 2.5e-3, 3, points, normals, links)
        balance = contact_forces(
            points[:n], normals[:n], problem.obj.com_O, problem.friction, CONE_EDGES, problem.torsion, problem.length
        )
        idle = np.zeros(hand.num_dofs, bool)
        target = squeeze_joints(
            problem, closed.q[i], closed.X_OH[i], X_HL, (points[:n], links[:n]), balance, stiffness=stiffness, idle=idle
        )
        torque = (target - closed.q[i]) * stiffness  # what the servo is asked for at the grasp, all included
        share = np.abs(torque / hand.tree.effort)
        assert share.max() == pytest.approx(EFFORT_SHARE, abs=1e-6)
        pressing += (torque * np.sign(hand.closing_rate)).sum() > 0
    assert pressing >= 15  # pressing is mostly closing


def test_a_jaw_squeezes_past_contact(problem_of, jaw_on_axes):
    problem = problem_of("panda", "box")
    q = np.array([0.02])
    nothing = (None, None), None
    idle = np.zeros(1, bool)
    target = squeeze_joints(problem, q, np.eye(4), np.zeros((3, 4, 4)), *nothing, stiffness=np.ones(1), idle=idle)
    assert target == pytest.approx(q - JAW_SQUEEZE_M - GAP_M)
    stiff = np.array([1e5])  # 10 mm of this servo would be 1000 N
    target = squeeze_joints(problem, q, np.eye(4), np.zeros((3, 4, 4)), *nothing, stiffness=stiff, idle=idle)
    assert (q - GAP_M - target) * stiff == pytest.approx(EFFORT_SHARE * problem.hand.tree.effort)


def test_pregrasps_open_every_closing_joint_within_the_limits(hands):
    for name, hand in hands.items():
        q = np.random.default_rng(0).uniform(hand.tree.lower, hand.tree.upper, (30, hand.num_dofs))
        opened = pregrasp_joints(hand, q)
        assert ((opened >= hand.tree.lower) & (opened <= hand.tree.upper)).all()
        assert ((q - opened) * hand.closing_rate >= 0).all()
        np.testing.assert_array_equal(opened[:, hand.closing_rate == 0], q[:, hand.closing_rate == 0])
        largest = np.abs(q - opened).max()
        assert largest == pytest.approx(PREGRASP_JAW_M if hand.is_jaw else PREGRASP_RAD), name


@pytest.mark.parametrize("name", ["panda", "barrett", "allegro", "human"])
def test_pregrasps_do_not_overlap_the_object(problem_of, name):
    problem = problem_of(name, "can")
    closed = _valid(problem)
    grasps = finish_grasps(problem, closed, protocol="dexgraspbench", seed=3, config={"a": "b"})
    assert len(grasps) > 5 and grasps.seed == 3 and grasps.config == {"a": "b"}
    opened = 0
    for X_OH, q, q_pre in zip(grasps.X_OH, grasps.q, grasps.q_pregrasp, strict=True):
        X_HL = forward_numpy(problem.hand.tree, q_pre)
        gap = hand_clearance(*problem.sdf_arrays, problem.packed, problem.clusters, X_OH, X_HL)
        assert gap >= -problem.max_penetration_m - 1e-9
        opened += (q_pre != q).any()
    assert opened > 0.8 * len(grasps)


def test_a_finger_with_something_behind_it_stays(problem_of):
    """Inside the cube every posture overlaps, so nothing may open."""
    problem = problem_of("allegro", "cube")
    q = np.full((2, problem.hand.num_dofs), 0.5)
    q = np.clip(q, problem.hand.tree.lower, problem.hand.tree.upper)
    np.testing.assert_array_equal(clear_pregrasps(problem, np.eye(4)[None].repeat(2, 0), q, np.zeros(q.shape, bool)), q)


@pytest.mark.parametrize("name", ["panda", "human"])
def test_finished_grasps_carry_contacts_on_the_surface_and_their_quality(problem_of, name):
    problem = problem_of(name, "box")
    grasps = finish_grasps(problem, _valid(problem), protocol="dexgraspbench", seed=0, config={})
    assert (grasps.epsilon > 0).all()
    assert (grasps.penetration_m <= problem.max_penetration_m).all()
    half = np.array([0.02, 0.03, 0.05])
    there = grasps.contact_links >= 0
    assert (there.sum(axis=1) >= 2).all()
    outside = np.abs(grasps.contact_points_O[there]) - half
    assert np.abs(outside.max(axis=1)).max() < 1.5e-3  # on a face; edges of the grid round off
    solid = {p.link for p in problem.hand.parts}
    assert set(grasps.contact_links[there]) <= solid


def test_no_candidates_finish_as_no_grasps(problem_of):
    problem = problem_of("human", "box")
    none = close_and_assess(problem, np.zeros((0, 4, 4)), np.zeros((0, 20)))
    assert len(finish_grasps(problem, none, protocol="dexgraspbench", seed=0, config={})) == 0
