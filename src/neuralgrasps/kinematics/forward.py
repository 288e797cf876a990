"""Differentiable forward kinematics in torch, and the torch-free versions beside it."""

from __future__ import annotations

import math

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
    order, starts = _levels(tree.parents)
    place = np.empty_like(order)  # where a link lies in `order`
    place[order] = np.arange(tree.num_links)
    X_PL = _local_poses(tree, q.reshape(math.prod(q.shape[:-1]), tree.num_dofs), order)  # (L, B, 4, 4), links by depth
    done = [X_PL[:1]]
    for below, start, stop in zip(starts[:-1], starts[1:], [*starts[2:], tree.num_links], strict=True):
        parents = place[tree.parents[order[start:stop]]] - below
        above = done[-1].index_select(0, torch.as_tensor(parents, device=q.device))
        done.append(above @ X_PL[start:stop])
    X_HL = torch.cat(done).index_select(0, torch.as_tensor(place, device=q.device))
    return X_HL.movedim(0, 1).reshape(*q.shape[:-1], tree.num_links, 4, 4)


def _local_poses(tree: KinematicTree, q: Tensor, order: np.ndarray) -> Tensor:
    """Pose of each link in its parent, (L, B, 4, 4), links in `order`, for `q` (B, J)."""

    def constant(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array[order], dtype=q.dtype, device=q.device)

    p = constant(tree.coupling) @ q.T + constant(tree.offset)[:, None]  # (L, B)
    turning, sliding = tree.joint_types[:, None] == REVOLUTE, tree.joint_types[:, None] == PRISMATIC
    K, slide = np.zeros((2, tree.num_links, 4, 4))
    x, y, z = np.where(turning, tree.axes, 0.0).T
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
    K[:, 1, 0], K[:, 2, 0], K[:, 2, 1] = z, -y, x
    slide[:, :3, 3] = np.where(sliding, tree.axes, 0.0)
    # X_joint @ (I + sin(p) K + (1 - cos(p)) K^2 + p slide): linear in (1, sin, 1 - cos, p)
    X = tree.X_parent_joint
    terms = np.stack([X, X @ K, X @ K @ K, X @ slide], axis=1).reshape(-1, 4, 16)
    basis = torch.stack([torch.ones_like(p), torch.sin(p), 1.0 - torch.cos(p), p], dim=-1)  # (L, B, 4)
    return (basis @ constant(terms)).unflatten(-1, (4, 4))


def _levels(parents: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Link indices ordered by depth, and where each depth starts."""
    depth = np.zeros(len(parents), np.int64)
    for i, parent in enumerate(parents):
        depth[i] = depth[parent] + 1 if parent >= 0 else 0
    order = np.argsort(depth, kind="stable")
    return order, np.searchsorted(depth[order], np.arange(depth.max() + 1)).tolist()
