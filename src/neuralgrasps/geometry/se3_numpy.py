"""Rigid transforms on numpy arrays, for file readers and worker processes that must not import torch.

Conventions as in `neuralgrasps.geometry.se3`: X_AB is (..., 4, 4) and maps B coordinates into A.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuralgrasps.errors import InputError, check_shape

Array = NDArray[np.float64]


def make_transform_np(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> Array:
    """(..., 4, 4) float64 transform of a (..., 3, 3) rotation (else identity) and a (..., 3) translation (else 0)."""
    R = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
    t = np.zeros(3) if translation is None else np.asarray(translation, dtype=np.float64)
    check_shape("rotation", R.shape, (3, 3))
    check_shape("translation", t.shape, (3,))
    batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    X = np.zeros((*batch, 4, 4))
    X[..., :3, :3] = R
    X[..., :3, 3] = t
    X[..., 3, 3] = 1.0
    return X


def inverse_np(X: ArrayLike) -> Array:
    """Inverse of rigid transforms (..., 4, 4): X_AB -> X_BA."""
    X = np.asarray(X, dtype=np.float64)
    check_shape("X", X.shape, (4, 4))
    Rt = np.swapaxes(X[..., :3, :3], -1, -2)
    return make_transform_np(Rt, -np.einsum("...ij,...j->...i", Rt, X[..., :3, 3]))


def transform_points_np(X_AB: ArrayLike, points_B: ArrayLike) -> Array:
    """Points (..., M, 3) in B to A, float64; the batch axes of X_AB (..., 4, 4) and of the points broadcast."""
    X, p = np.asarray(X_AB, dtype=np.float64), np.asarray(points_B, dtype=np.float64)
    check_shape("X_AB", X.shape, (4, 4))
    check_shape("points_B", p.shape, (None, 3))
    return p @ np.swapaxes(X[..., :3, :3], -1, -2) + X[..., None, :3, 3]


def rpy_matrix(rpy: ArrayLike) -> Array:
    """(..., 3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll) from roll, pitch, yaw (..., 3), radians about fixed axes."""
    rpy = np.asarray(rpy, dtype=np.float64)
    check_shape("rpy", rpy.shape, (3,))
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(rpy), -1, 0), np.moveaxis(np.sin(rpy), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_matrix(quaternion: ArrayLike) -> Array:
    """(..., 3, 3) rotation from wxyz quaternions (..., 4) of any non-zero length.

    Raises:
        InputError: a quaternion is zero or not finite.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    check_shape("quaternion", q.shape, (4,))
    norm2 = np.sum(q * q, axis=-1)
    if not np.all(np.isfinite(norm2) & (norm2 > 1e-24)):
        raise InputError("A quaternion is zero or not finite; expected a non-zero (w, x, y, z).")
    w, x, y, z = np.moveaxis(q, -1, 0)
    s = 2.0 / norm2
    rows = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def axis_angle_matrix(axis: ArrayLike, angle: ArrayLike) -> Array:
    """(..., 3, 3) rotation by `angle` radians about a non-zero `axis` (..., 3) (Rodrigues' formula)."""
    a, angle = np.asarray(axis, dtype=np.float64), np.asarray(angle, dtype=np.float64)
    check_shape("axis", a.shape, (3,))
    norm = np.linalg.norm(a, axis=-1, keepdims=True)
    if not np.all(norm > 1e-12):
        raise InputError("A rotation axis is zero; expected a non-zero (x, y, z).")
    half = 0.5 * angle[..., None]
    a = np.broadcast_to(a / norm, (*np.broadcast_shapes(a.shape[:-1], angle.shape), 3))
    return quaternion_matrix(np.concatenate([np.broadcast_to(np.cos(half), (*a.shape[:-1], 1)), np.sin(half) * a], -1))
