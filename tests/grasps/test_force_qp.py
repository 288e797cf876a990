"""Squeezing forces against scipy's non-negative least squares and by symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from neuralgrasps.grasps.epsilon import epsilon
from neuralgrasps.grasps.force_qp import WEIGHT, contact_forces, edge_forces
from neuralgrasps.grasps.wrench_space import grasp_wrenches


def reference(wrenches: np.ndarray, weight: float) -> np.ndarray:
    """The same problem as an equivalent non-negative least squares: the sum is free, then scaled to 1."""
    system = np.concatenate([wrenches.T, np.sqrt(weight) * np.eye(len(wrenches)), np.ones((1, len(wrenches)))])
    target = np.zeros(len(system))
    target[-1] = 1.0
    f, _ = nnls(system, target, maxiter=20 * len(wrenches))
    return f / f.sum()


def test_edge_forces_agree_with_scipy(contacts):
    for wrenches in contacts.wrench_cases(21, 70):
        f, converged = edge_forces(wrenches)
        assert converged
        np.testing.assert_allclose(f, reference(wrenches, WEIGHT), atol=1e-6)
        assert (f >= 0).all()
        assert f.sum() == pytest.approx(1.0, abs=1e-12)


def test_force_closure_grasps_balance_and_others_do_not(contacts):
    for wrenches in contacts.wrench_cases(22, 70):
        residual = np.linalg.norm(wrenches.T @ edge_forces(wrenches)[0])
        quality = epsilon(wrenches)
        if quality > 0:
            assert residual < 1e-5 / quality
    _, normals = contacts.ball(np.random.default_rng(0), 6, 0.05)
    one_side = normals * np.sign(normals[:, :1])
    result = contact_forces(0.05 * one_side, one_side, np.zeros(3), 0.3, 8, 0.0, 0.05)
    assert result.residual > 1e-2


def test_antipodal_squeeze_is_along_the_line_and_shared():
    normals = np.array([[0, 1.0, 0], [0, -1.0, 0]])
    result = contact_forces(0.03 * normals, normals, np.zeros(3), 0.6, 8, 0.0, 0.03)
    np.testing.assert_allclose(result.forces, -0.5 * normals, atol=1e-9)
    assert result.residual < 1e-9
    assert result.converged


def test_three_fingers_share_by_symmetry():
    angle = 2 * np.pi * np.arange(3) / 3
    normals = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    result = contact_forces(0.03 * normals, normals, np.zeros(3), 0.6, 8, 0.0, 0.03)
    np.testing.assert_allclose(result.forces, -normals / 3, atol=1e-9)


def test_forces_lie_in_their_cones_and_do_not_depend_on_order(contacts):
    rng = np.random.default_rng(4)
    points, normals = contacts.ball(rng, 9, 0.05)
    points = points + rng.normal(0, 0.004, (9, 3))
    forces = contact_forces(points, normals, np.zeros(3), 0.6, 8, 0.005, 0.05).forces
    inward = -(forces * normals).sum(axis=1)
    assert inward.sum() == pytest.approx(1.0, abs=1e-9)
    assert (np.linalg.norm(forces + inward[:, None] * normals, axis=1) <= 0.6 * inward + 1e-9).all()
    order = rng.permutation(9)
    again = contact_forces(points[order], normals[order], np.zeros(3), 0.6, 8, 0.005, 0.05).forces
    np.testing.assert_allclose(again, forces[order], atol=1e-7)


def test_a_single_contact_gets_all_the_force():
    normal = np.array([[0, 0, 1.0]])
    result = contact_forces(0.02 * normal, normal, np.zeros(3), 0.5, 8, 0.0, 0.02)
    np.testing.assert_allclose(result.forces, -normal, atol=1e-9)
    assert result.residual == pytest.approx(1.0, abs=1e-6)
    assert len(grasp_wrenches(0.02 * normal, normal, np.zeros(3), 0.5, 8, 0.01, 0.02)) == 10
