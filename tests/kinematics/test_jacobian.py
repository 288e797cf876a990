"""Jacobians: by hand, against finite differences, and for couplings."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.jacobian import link_jacobian, point_jacobian


def finite_differences(tree, q, link, point_L, step=1e-6):
    """(6, J) central differences of the point and of the link's rotation."""
    columns = []
    for j in range(tree.num_dofs):
        delta = np.zeros(tree.num_dofs)
        delta[j] = step
        ahead, behind = forward_numpy(tree, q + delta)[link], forward_numpy(tree, q - delta)[link]
        linear = ((ahead - behind) @ [*point_L, 1.0])[:3] / (2 * step)
        spin = (ahead[:3, :3] - behind[:3, :3]) @ forward_numpy(tree, q)[link, :3, :3].T / (2 * step)
        columns.append([*linear, spin[2, 1], spin[0, 2], spin[1, 0]])
    return np.array(columns).T


@pytest.mark.parametrize("seed", range(8))
def test_jacobian_matches_finite_differences(random_tree, seed):
    tree, rng = random_tree(seed), np.random.default_rng(seed)
    for link in (0, 5, tree.num_links - 1):
        q, point_L = rng.normal(size=tree.num_dofs), rng.normal(scale=0.1, size=3)
        expected = finite_differences(tree, q, link, point_L)
        np.testing.assert_allclose(link_jacobian(tree, q, link, point_L), expected, atol=2e-8)


def test_two_link_arm_matches_the_textbook(two_link_arm):
    a, b = 0.4, 1.1
    s, c, s2, c2 = np.sin(a), np.cos(a), np.sin(a + b), np.cos(a + b)
    expected = np.zeros((6, 2))
    expected[0] = [-0.3 * s - 0.2 * s2, -0.2 * s2]
    expected[1] = [0.3 * c + 0.2 * c2, 0.2 * c2]
    expected[5] = 1.0
    np.testing.assert_allclose(link_jacobian(two_link_arm, np.array([a, b]), 3, np.zeros(3)), expected, atol=1e-15)


def test_point_kernel_is_the_upper_half_and_overwrites(random_tree):
    tree, q, point_L = random_tree(1), np.full(5, 0.3), np.array([0.02, -0.01, 0.05])
    link = tree.num_links - 1
    X_HL = forward_numpy(tree, q)
    point_H = (X_HL[link] @ [*point_L, 1.0])[:3]
    out = np.full((3, tree.num_dofs), np.nan)
    point_jacobian(tree.parents, tree.joint_types, tree.axes, tree.coupling, X_HL, link, point_H, out)
    np.testing.assert_allclose(out, link_jacobian(tree, q, link, point_L)[:3], atol=1e-15)


def test_the_base_does_not_move(random_tree):
    tree = random_tree(2)
    assert not link_jacobian(tree, np.ones(tree.num_dofs), 0, np.ones(3)).any()
