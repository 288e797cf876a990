"""Forward kinematics without torch: a plain numpy version, and the numba kernels of the hot loops."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import ShapeError
from neuralgrasps.kinematics.tree import PRISMATIC, REVOLUTE, KinematicTree


def joint_motion(joint_type: int, axis: np.ndarray, position: float | np.ndarray) -> np.ndarray:
    """Motion of one joint, `exp([axis] position)`.

    Args:
        joint_type: FIXED, REVOLUTE or PRISMATIC.
        axis: (3,) unit axis in the joint frame.
        position: (...) rad or metres.
    Returns:
        (..., 4, 4) float64, child frame in the joint frame.
    """
    position = np.asarray(position, float)
    X = np.broadcast_to(np.eye(4), (*position.shape, 4, 4)).copy()
    if joint_type == PRISMATIC:
        X[..., :3, 3] = position[..., None] * axis
    elif joint_type == REVOLUTE:
        x, y, z = axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        s, c = np.sin(position)[..., None, None], np.cos(position)[..., None, None]
        X[..., :3, :3] = np.eye(3) + s * K + (1.0 - c) * (K @ K)  # Rodrigues
    return X


def check_joint_values(tree: KinematicTree, shape: tuple[int, ...]) -> None:
    """Raise `ShapeError` unless the last axis has one value per independent joint of `tree`."""
    if not shape or shape[-1] != tree.num_dofs:
        columns = shape[-1] if shape else 0
        names = ", ".join(tree.dof_names)
        raise ShapeError(f"q has {columns} columns but the tree has {tree.num_dofs} independent joints ({names}).")


def forward_numpy(tree: KinematicTree, q: np.ndarray) -> np.ndarray:
    """Link poses for joint values `q`; the plain reference of the other versions.

    Args:
        tree: kinematic tree.
        q: (..., J) float64, rad or metres.
    Returns:
        X_HL (..., L, 4, 4) float64, link frames in the base link.
    Raises:
        ShapeError: the last axis of `q` is not J.
    """
    q = np.asarray(q, float)
    check_joint_values(tree, q.shape)
    positions = tree.joint_positions(q)
    X_HL = np.empty((*q.shape[:-1], tree.num_links, 4, 4))
    for i, parent in enumerate(tree.parents):
        X_PL = tree.X_parent_joint[i] @ joint_motion(int(tree.joint_types[i]), tree.axes[i], positions[..., i])
        X_HL[..., i, :, :] = X_PL if parent < 0 else X_HL[..., parent, :, :] @ X_PL
    return X_HL


@njit(cache=True, fastmath=False, error_model="numpy")
def link_poses(parents, joint_types, X_parent_joint, axes, coupling, offset, q, out):  # type: ignore[no-untyped-def]
    """Write X_HL of all links for one `q`; arrays as in `KinematicTree`.

    Args:
        parents (L,), joint_types (L,), X_parent_joint (L, 4, 4), axes (L, 3), coupling (L, J), offset (L,): the tree.
        q: (J,) float64 rad or metres.
        out: (L, 4, 4) float64, written: link frames in the base link.
    """
    for i in range(parents.shape[0]):
        p = offset[i]
        for j in range(q.shape[0]):
            p += coupling[i, j] * q[j]
        # local pose: R = R_joint @ motion, t = t_joint (+ R_joint @ axis * p)
        r00, r01, r02 = X_parent_joint[i, 0, 0], X_parent_joint[i, 0, 1], X_parent_joint[i, 0, 2]
        r10, r11, r12 = X_parent_joint[i, 1, 0], X_parent_joint[i, 1, 1], X_parent_joint[i, 1, 2]
        r20, r21, r22 = X_parent_joint[i, 2, 0], X_parent_joint[i, 2, 1], X_parent_joint[i, 2, 2]
        tx, ty, tz = X_parent_joint[i, 0, 3], X_parent_joint[i, 1, 3], X_parent_joint[i, 2, 3]
        ax, ay, az = axes[i, 0], axes[i, 1], axes[i, 2]
        if joint_types[i] == PRISMATIC:
            tx += p * (r00 * ax + r01 * ay + r02 * az)
            ty += p * (r10 * ax + r11 * ay + r12 * az)
            tz += p * (r20 * ax + r21 * ay + r22 * az)
        elif joint_types[i] == REVOLUTE:
            s, c = math.sin(p), math.cos(p)
            v = 1.0 - c
            m00, m01, m02 = c + ax * ax * v, ax * ay * v - az * s, ax * az * v + ay * s
            m10, m11, m12 = ay * ax * v + az * s, c + ay * ay * v, ay * az * v - ax * s
            m20, m21, m22 = az * ax * v - ay * s, az * ay * v + ax * s, c + az * az * v
            a0, a1, a2 = r00, r01, r02
            r00 = a0 * m00 + a1 * m10 + a2 * m20
            r01 = a0 * m01 + a1 * m11 + a2 * m21
            r02 = a0 * m02 + a1 * m12 + a2 * m22
            a0, a1, a2 = r10, r11, r12
            r10 = a0 * m00 + a1 * m10 + a2 * m20
            r11 = a0 * m01 + a1 * m11 + a2 * m21
            r12 = a0 * m02 + a1 * m12 + a2 * m22
            a0, a1, a2 = r20, r21, r22
            r20 = a0 * m00 + a1 * m10 + a2 * m20
            r21 = a0 * m01 + a1 * m11 + a2 * m21
            r22 = a0 * m02 + a1 * m12 + a2 * m22
        k = parents[i]
        if k < 0:
            out[i, 0, 0], out[i, 0, 1], out[i, 0, 2], out[i, 0, 3] = r00, r01, r02, tx
            out[i, 1, 0], out[i, 1, 1], out[i, 1, 2], out[i, 1, 3] = r10, r11, r12, ty
            out[i, 2, 0], out[i, 2, 1], out[i, 2, 2], out[i, 2, 3] = r20, r21, r22, tz
        else:
            for row in range(3):
                b0, b1, b2, b3 = out[k, row, 0], out[k, row, 1], out[k, row, 2], out[k, row, 3]
                out[i, row, 0] = b0 * r00 + b1 * r10 + b2 * r20
                out[i, row, 1] = b0 * r01 + b1 * r11 + b2 * r21
                out[i, row, 2] = b0 * r02 + b1 * r12 + b2 * r22
                out[i, row, 3] = b0 * tx + b1 * ty + b2 * tz + b3
        out[i, 3, 0], out[i, 3, 1], out[i, 3, 2], out[i, 3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, fastmath=False, error_model="numpy")
def link_poses_batch(parents, joint_types, X_parent_joint, axes, coupling, offset, q, out):  # type: ignore[no-untyped-def]
    """`link_poses` for every row of `q` (N, J) into `out` (N, L, 4, 4)."""
    for n in range(q.shape[0]):
        link_poses(parents, joint_types, X_parent_joint, axes, coupling, offset, q[n], out[n])


def forward_fast(tree: KinematicTree, q: np.ndarray) -> np.ndarray:
    """`forward_numpy` by the compiled kernel: same arguments, result and errors, for large batches."""
    q = np.ascontiguousarray(q, float)
    check_joint_values(tree, q.shape)
    rows = q.reshape(-1, tree.num_dofs) if tree.num_dofs else np.zeros((math.prod(q.shape[:-1]), 0))
    out = np.empty((len(rows), tree.num_links, 4, 4))
    link_poses_batch(
        tree.parents, tree.joint_types, tree.X_parent_joint, tree.axes, tree.coupling, tree.offset, rows, out
    )
    return out.reshape(*q.shape[:-1], tree.num_links, 4, 4)
