"""The weight a hand can lift: cases worked out by hand, a slow reference, and that only the grasp itself counts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, rpy_matrix
from neuralgrasps.grasps.lift_capacity import (
    MOST_PRESS,
    Joints,
    edge_torques,
    joints_of,
    lift_grip,
    lift_weights,
    strongest_lift,
)
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.kinematics.jacobian import link_jacobian
from tests.grasps.conftest import box_contacts

UP, EFFORT, FRICTION, TORSION = np.array([0.0, 0.0, 1.0]), 40.0, 0.5, 0.02
LEFT, RIGHT = [-0.03, 0.0, 0.0], [0.03, 0.0, 0.0]
# base; two pads that one motor moves together, along x and against it; a finger that turns about y, its joint at x = 0
JAW = Joints(
    parents=np.array([-1, 0, 0, 0], np.int32),
    joint_types=np.array([0, 2, 2, 1], np.int8),
    axes=np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0]]),
    coupling=np.array([[0.0, 0], [1, 0], [1, 0], [0, 1]]),
)
LIMITS = np.array([EFFORT, 0.7])
STILL = np.tile(np.eye(4), (4, 1, 1))


def lifted(points, normals, links, *, com=(0.0, 0.0, 0.0), torsion=0.0, most=1000.0, limits=LIMITS):
    return lift_grip(
        JAW, STILL, np.eye(4), np.array(points), np.array(normals), np.array(links, np.int32), np.array(com), UP, most,
        limits, FRICTION, torsion, 0.1,
    )  # fmt: skip


def test_two_pads_lift_what_friction_allows_at_the_motors_limit():
    """One motor of E drives both pads, so that each presses E / 2; both together hold friction * E."""
    grip = lifted([LEFT, RIGHT], [[-1.0, 0, 0], [1.0, 0, 0]], [1, 2])
    assert grip.weight == pytest.approx(FRICTION * EFFORT)
    np.testing.assert_allclose(grip.forces[:, 0], [EFFORT / 2, -EFFORT / 2])
    np.testing.assert_allclose(grip.forces.sum(axis=0), [0.0, 0.0, grip.weight], atol=1e-9)
    np.testing.assert_allclose(grip.torques, [EFFORT, 0.0], atol=1e-9)


@pytest.mark.parametrize("lever", [0.01, 0.05])
def test_a_weight_beside_the_pads_is_held_by_torsion(lever):
    """Each pad gives w / 2 of friction and w lever / 2 of torsion: w (1 / friction + lever / torsion) = E."""
    pads = [LEFT, RIGHT], [[-1.0, 0, 0], [1.0, 0, 0]], [1, 2]
    assert lifted(*pads, com=(0.0, lever, 0.0)).weight == pytest.approx(0.0, abs=1e-9)
    soft = lifted(*pads, com=(0.0, lever, 0.0), torsion=TORSION)
    assert soft.weight == pytest.approx(EFFORT / (1.0 / FRICTION + lever / TORSION))


def test_a_finger_below_lifts_as_much_as_its_torque_allows():
    below = [[0.05, 0.0, -0.02]], [[0.0, 0.0, -1.0]], [3]
    grip = lifted(*below, com=(0.05, 0.0, 0.0))
    assert grip.weight == pytest.approx(0.7 / 0.05)
    assert abs(grip.torques[1]) == pytest.approx(0.7)
    twice = lifted(*below, com=(0.05, 0.0, 0.0), limits=2 * LIMITS)
    assert twice.weight == pytest.approx(2 * grip.weight)
    assert lifted(*below, com=(0.08, 0.0, 0.0)).weight == pytest.approx(0.0, abs=1e-9)  # it would tip over


def test_what_no_motor_holds_lifts_all_that_is_asked_for():
    palm = [[0.05, 0.0, -0.02]], [[0.0, 0.0, -1.0]], [0]
    assert lifted(*palm, com=(0.05, 0.0, 0.0), most=7.0).weight == pytest.approx(7.0)
    assert lifted(*palm, com=(0.05, 0.0, 0.0), most=1e4).weight == pytest.approx(MOST_PRESS)


def test_from_above_nothing_is_lifted():
    assert lifted([[0.0, 0.0, 0.02]], [[0.0, 0.0, 1.0]], [0]).weight == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_the_weight_is_that_of_a_general_solver(seed):
    rng = np.random.default_rng(seed)
    points, normals = box_contacts(rng, int(rng.integers(3, 14)), np.array([0.03, 0.04, 0.05]))
    torsion = 0.02 * (seed % 2)
    wrenches = grasp_wrenches(points, normals, np.zeros(3), 0.6, 8, torsion, 0.07)
    count, motors = len(wrenches), 6
    torques = 0.05 * rng.standard_normal((count, motors)) * (rng.random((count, motors)) < 0.5)
    effort, pull, most = rng.uniform(0.3, 1.0, motors), np.array([0.0, 0, -1, 0, 0, 0]), 60.0
    weight, f = strongest_lift(wrenches, torques, effort, pull, most)
    bounded = np.concatenate([torques.T / effort[:, None], -torques.T / effort[:, None], np.full((1, count), 1 / 500)])
    slow = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=np.pad(bounded, ((0, 0), (0, 1))), b_ub=np.ones(len(bounded)),
        A_eq=np.column_stack([wrenches.T, pull]), b_eq=np.zeros(6), bounds=[(0, None)] * count + [(0, most)],
    )  # fmt: skip
    assert weight == pytest.approx(-slow.fun, abs=1e-6)
    assert f.min() >= 0.0 and (np.abs(f @ torques) <= effort + 1e-7).all()
    np.testing.assert_allclose(f @ wrenches, -weight * pull, atol=1e-7)


@pytest.fixture(scope="module")
def held():
    """Contacts of an Allegro hand's links on nothing in particular: its tree, link poses, pose and contacts."""
    hand, rng = load_hand("allegro"), np.random.default_rng(4)
    q = rng.uniform(hand.preshape_lower, hand.preshape_upper)
    X_OH = make_transform_np(rpy_matrix([0.3, -0.8, 1.2]), [0.02, -0.05, 0.1])
    links = np.array([0, 3, 3, 7, 11, 15, 15], np.int32)
    X_OL = X_OH @ forward_fast(hand.tree, q[None])[0, links]
    points = X_OL[:, :3, 3] + 0.01 * rng.standard_normal((len(links), 3))
    normals = points - points.mean(axis=0)
    return hand, q, X_OH, points, normals / np.linalg.norm(normals, axis=1, keepdims=True), links


def test_torques_are_those_of_the_jacobian(held):
    hand, q, X_OH, points, normals, links = held
    com, length = points.mean(axis=0), 0.1
    wrenches = grasp_wrenches(points, normals, com, 0.6, 8, 0.02, length)
    out, X_HL = np.empty((len(wrenches), 16)), forward_fast(hand.tree, q[None])[0]
    edge_torques(joints_of(hand.tree), X_HL, X_OH, points, links, wrenches, com, length, 10, out)
    for i, w in enumerate(wrenches):
        c = i // 10
        point_L = (inverse_np(X_OH @ X_HL[links[c]]) @ np.append(points[c], 1.0))[:3]
        moment = w[3:] * length - np.cross(points[c] - com, w[:3])
        J = link_jacobian(hand.tree, q, int(links[c]), point_L)
        expected = J[:3].T @ (X_OH[:3, :3].T @ w[:3]) + J[3:].T @ (X_OH[:3, :3].T @ moment)
        np.testing.assert_allclose(out[i], expected, atol=1e-9)


def test_only_the_grasp_counts_not_the_frame(held):
    hand, q, X_OH, points, normals, links = held
    X_HL, up, com = forward_fast(hand.tree, q[None]), np.array([0.0, 0.6, 0.8]), points.mean(axis=0) + 0.01

    def weight(X):
        R, out = X[:3, :3], np.empty(1)
        lift_weights(
            joints_of(hand.tree), X_HL, (X @ X_OH)[None], (points @ R.T + X[:3, 3])[None], (normals @ R.T)[None],
            links[None], R @ com + X[:3, 3], R @ up, 200.0, hand.tree.effort, 0.6, 0.02, 0.1, out,
        )  # fmt: skip
        return out[0]

    here = weight(np.eye(4))
    assert 0.1 < here < 199.0
    assert weight(make_transform_np(rpy_matrix([1.0, 0.4, -2.0]), [0.3, -0.7, 0.2])) == pytest.approx(here, rel=1e-7)
