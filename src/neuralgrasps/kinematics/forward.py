"""Differentiable forward kinematics in torch, and the torch-free versions beside it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.kinematics.forward_kernels import (
    check_joint_values,
    forward_fast,
    forward_numpy,
    link_poses,
    link_poses_batch,
)
from neuralgrasps.kinematics.tree import PRISMATIC, REVOLUTE, KinematicTree

__all__ = ["forward_fast", "forward_kinematics", "forward_numpy", "link_poses", "link_poses_batch"]


def forward_kinematics(tree: KinematicTree, q: Tensor) -> Tensor:
    """Link poses for joint values `q`, differentiable in `q`.

    Links of equal depth are multiplied together, so the cost grows with the depth of the tree.

    Args:
        tree: kinematic tree.
        q: (..., J) rad or metres, any floating dtype and device.
    Returns:
        X_HL (..., L, 4, 4), link frames in the base link, dtype and device of `q`.
    Raises:
        ShapeError: the last axis of `q` is not J.
    """
    check_joint_values(tree, tuple(q.shape))
    X_PL = _local_poses(tree, q)
    levels = _levels(tree.parents)
    done = X_PL[..., :1, :, :]
    position = np.zeros(tree.num_links, np.int64)  # where a link lies in its level; level 0 is link 0 alone
    parts = [done]
    for level in levels[1:]:
        above = torch.as_tensor(position[tree.parents[level]], device=q.device)
        here = torch.as_tensor(level, device=q.device)
        done = done.index_select(-3, above) @ X_PL.index_select(-3, here)
        position[level] = np.arange(len(level))
        parts.append(done)
    order = np.argsort(np.concatenate(levels))
    return torch.cat(parts, dim=-3).index_select(-3, torch.as_tensor(order, device=q.device))


def _local_poses(tree: KinematicTree, q: Tensor) -> Tensor:
    """(..., L, 4, 4) pose of each link in its parent."""

    def constant(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=q.dtype, device=q.device)

    p = q @ constant(tree.coupling).T + constant(tree.offset)  # (..., L)
    K = np.zeros((tree.num_links, 4, 4))
    x, y, z = np.where((tree.joint_types == REVOLUTE)[:, None], tree.axes, 0.0).T
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
    K[:, 1, 0], K[:, 2, 0], K[:, 2, 1] = z, -y, x
    slide = np.zeros((tree.num_links, 4, 4))
    slide[:, :3, 3] = np.where((tree.joint_types == PRISMATIC)[:, None], tree.axes, 0.0)
    # X_joint @ (I + sin(p) K + (1 - cos(p)) K^2 + p slide), with the constant products taken first
    X = tree.X_parent_joint
    turn = torch.sin(p)[..., None, None] * constant(X @ K) + (1.0 - torch.cos(p))[..., None, None] * constant(X @ K @ K)
    return constant(X) + turn + p[..., None, None] * constant(X @ slide)


def _levels(parents: np.ndarray) -> list[np.ndarray]:
    """Link indices by depth, root first."""
    depth = np.zeros(len(parents), np.int64)
    for i, parent in enumerate(parents):
        depth[i] = depth[parent] + 1 if parent >= 0 else 0
    return [np.flatnonzero(depth == d) for d in range(int(depth.max()) + 1)]
