"""Jacobians of points and frames on the links (numba kernels; torch-free)."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import turned_vector
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import FIXED, REVOLUTE, KinematicTree


@njit(cache=True, inline="always", error_model="numpy")
def _joint_motion(joint_type, axis, X_HL, point_H):  # type: ignore[no-untyped-def]
    """Linear velocity (3) of a point and angular velocity (3), in H, per unit speed of the joint that moves a link."""
    # the axis is unchanged by its own joint's motion, so the moved frame may be used
    ax, ay, az = turned_vector(X_HL, axis[0], axis[1], axis[2])
    if joint_type != REVOLUTE:
        return ax, ay, az, 0.0, 0.0, 0.0
    dx, dy, dz = point_H[0] - X_HL[0, 3], point_H[1] - X_HL[1, 3], point_H[2] - X_HL[2, 3]
    return ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx, ax, ay, az


@njit(cache=True, fastmath=False, error_model="numpy")
def frame_jacobian(parents, joint_types, axes, coupling, X_HL, link, point_H, out):  # type: ignore[no-untyped-def]
    """Velocity of a point fixed to a link, and of that link's rotation, per unit joint speed.

    Args:
        parents (L,), joint_types (L,), axes (L, 3), coupling (L, J): arrays of the `KinematicTree`.
        X_HL: (L, 4, 4) link poses at the posture in question.
        link: index of the link that carries the point.
        point_H: (3,) the point in the base frame, metres.
        out: (6, J) written: rows 0-2 linear (m/s), rows 3-5 angular (rad/s), both in the base frame.
    """
    out[:] = 0.0
    i = link
    while i >= 0:
        if joint_types[i] != FIXED:
            vx, vy, vz, wx, wy, wz = _joint_motion(joint_types[i], axes[i], X_HL[i], point_H)
            for j in range(coupling.shape[1]):
                c = coupling[i, j]
                if c != 0.0:
                    out[0, j] += c * vx
                    out[1, j] += c * vy
                    out[2, j] += c * vz
                    out[3, j] += c * wx
                    out[4, j] += c * wy
                    out[5, j] += c * wz
        i = parents[i]


@njit(cache=True, fastmath=False, error_model="numpy")
def point_jacobian(parents, joint_types, axes, coupling, X_HL, link, point_H, out):  # type: ignore[no-untyped-def]
    """Rows 0-2 of `frame_jacobian` into `out` (3, J): d point_H / d q, metres per rad or metre."""
    out[:] = 0.0
    i = link
    while i >= 0:
        if joint_types[i] != FIXED:
            vx, vy, vz, _, _, _ = _joint_motion(joint_types[i], axes[i], X_HL[i], point_H)
            for j in range(coupling.shape[1]):
                c = coupling[i, j]
                if c != 0.0:
                    out[0, j] += c * vx
                    out[1, j] += c * vy
                    out[2, j] += c * vz
        i = parents[i]


def link_jacobian(tree: KinematicTree, q: np.ndarray, link: int, point_L: np.ndarray) -> np.ndarray:
    """Jacobian of a point fixed to a link, at one posture.

    Args:
        tree: kinematic tree.
        q: (J,) rad or metres.
        link: index of the link.
        point_L: (3,) the point in the link frame, metres.
    Returns:
        (6, J) float64: rows 0-2 linear, rows 3-5 angular velocity in the base frame per unit joint speed.
    Raises:
        ShapeError: `q` does not have J values.
    """
    X_HL = forward_numpy(tree, q)
    point_H = X_HL[link, :3, :3] @ np.asarray(point_L, float) + X_HL[link, :3, 3]
    out = np.empty((6, tree.num_dofs))
    frame_jacobian(tree.parents, tree.joint_types, tree.axes, tree.coupling, X_HL, link, point_H, out)
    return out
