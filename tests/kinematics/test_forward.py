"""Forward kinematics: by hand, three versions against each other, derivatives."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from neuralgrasps.errors import ShapeError
from neuralgrasps.kinematics.forward import forward_fast, forward_kinematics, forward_numpy, link_poses
from neuralgrasps.kinematics.forward_kernels import joint_motion
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE

VERSIONS = [
    pytest.param(forward_numpy, id="numpy"),
    pytest.param(forward_fast, id="numba"),
    pytest.param(lambda tree, q: forward_kinematics(tree, torch.as_tensor(q)).numpy(), id="torch"),
]


@pytest.mark.parametrize("forward", VERSIONS)
def test_two_link_arm_matches_the_textbook(two_link_arm, forward):
    a, b = 0.7, -1.9
    X_HL = forward(two_link_arm, np.array([a, b]))
    tip = [0.3 * np.cos(a) + 0.2 * np.cos(a + b), 0.3 * np.sin(a) + 0.2 * np.sin(a + b), 0.0]
    np.testing.assert_allclose(X_HL[3, :3, 3], tip, atol=1e-15)
    np.testing.assert_allclose(X_HL[2, :2, 0], [np.cos(a + b), np.sin(a + b)], atol=1e-15)
    np.testing.assert_allclose(X_HL[0], np.eye(4))


@pytest.mark.parametrize("forward", VERSIONS[1:])
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3), (0,)])
def test_fast_versions_match_the_plain_one(random_tree, forward, seed, batch):
    tree = random_tree(seed)
    q = np.random.default_rng(seed).normal(scale=2.0, size=(*batch, tree.num_dofs))
    X_HL = forward(tree, q)
    assert X_HL.shape == (*batch, tree.num_links, 4, 4)
    np.testing.assert_allclose(X_HL, forward_numpy(tree, q), atol=1e-13)


@pytest.mark.parametrize("forward", VERSIONS)
def test_a_batch_equals_a_loop(random_tree, forward):
    tree = random_tree(3)
    q = np.random.default_rng(0).normal(size=(6, tree.num_dofs))
    np.testing.assert_allclose(forward(tree, q), np.stack([forward(tree, row) for row in q]), atol=1e-14)


@pytest.mark.parametrize("forward", VERSIONS)
@pytest.mark.parametrize("seed", range(3))
def test_link_poses_are_rigid(random_tree, forward, seed):
    tree = random_tree(seed)
    X_HL = forward(tree, np.random.default_rng(seed).normal(scale=3.0, size=(4, tree.num_dofs)))
    R = X_HL[..., :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-13)
    np.testing.assert_array_equal(X_HL[..., 3, :], np.broadcast_to([0, 0, 0, 1], (*X_HL.shape[:-2], 4)))


def test_kernel_fills_the_array_given(two_link_arm):
    t, out = two_link_arm, np.full((4, 4, 4), np.nan)
    q = np.array([0.2, 0.3])
    link_poses(t.parents, t.joint_types, t.X_parent_joint, t.axes, t.coupling, t.offset, q, out)
    np.testing.assert_allclose(out, forward_numpy(t, q), atol=1e-15)


@pytest.mark.parametrize("seed", range(3))
def test_torch_derivative_is_right(random_tree, seed):
    tree = random_tree(seed, links=7, dofs=3)
    generator = torch.Generator().manual_seed(seed)
    q = torch.randn(2, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: forward_kinematics(tree, x), (q,))


def test_torch_derivative_is_finite_at_zero(two_link_arm):
    q = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    forward_kinematics(two_link_arm, q)[3, 1, 3].backward()
    np.testing.assert_allclose(q.grad.numpy(), [0.5, 0.2], atol=1e-15)


def test_torch_keeps_the_dtype(two_link_arm):
    assert forward_kinematics(two_link_arm, torch.zeros(3, 2)).dtype == torch.float32


@pytest.mark.parametrize("forward", VERSIONS)
@pytest.mark.parametrize("shape", [(3,), (4, 1), ()])
def test_a_wrong_number_of_joints_is_named(two_link_arm, forward, shape):
    with pytest.raises(ShapeError, match=r"q has \d columns but the tree has 2 independent joints \(shoulder, elbow\)"):
        forward(two_link_arm, np.zeros(shape))


def test_joint_motion_by_hand():
    z = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(joint_motion(FIXED, np.zeros(3), 5.0), np.eye(4))
    np.testing.assert_allclose(joint_motion(PRISMATIC, z, 0.3)[:3, 3], [0, 0, 0.3])
    quarter = joint_motion(REVOLUTE, z, np.pi / 2)
    np.testing.assert_allclose(quarter[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_worker_side_does_not_import_torch():
    code = (
        "import sys, neuralgrasps.kinematics.urdf, neuralgrasps.kinematics.mjcf, neuralgrasps.kinematics.jacobian, "
        "neuralgrasps.kinematics.forward_kernels; sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("forward", VERSIONS)
def test_a_tree_without_joints_has_constant_poses(random_tree, forward):
    tree = random_tree(0, dofs=0)
    X_HL = forward(tree, np.zeros((2, 3, 0)))
    assert X_HL.shape == (2, 3, tree.num_links, 4, 4)
    np.testing.assert_allclose(X_HL[1, 2], forward_numpy(tree, np.zeros(0)), atol=1e-14)
