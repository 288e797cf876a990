"""Errors of an estimated object pose, modulo the object's own symmetry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import SymmetryGroup

_BALL = 100  # no group about one axis has as many samples; so many rotations about no single axis are those of a ball


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """How far an estimate is from the truth.

    Attributes:
        add_s_m: mean distance of the estimated model's points to the true surface (ADD-S with an exact surface in
            place of a second point set, so it has no sampling floor).
        mssd_m: maximum distance of corresponding points, least over the symmetry group (BOP's MSSD; a continuous
            symmetry is resolved exactly, not by its samples).
        rotation_rad, translation_m: geodesic angle, and distance of the centres, for the symmetry element of that
            least MSSD.
    """

    add_s_m: float
    mssd_m: float
    rotation_rad: float
    translation_m: float


def pose_errors(obj: ObjectModel, X_CO: np.ndarray, X_CO_true: np.ndarray) -> PoseErrors:
    """Compare an estimated pose (4, 4) with the true one, both object to camera."""
    check_shape("X_CO", np.shape(X_CO), (4, 4))
    check_shape("X_CO_true", np.shape(X_CO_true), (4, 4))
    points = obj.points_O
    estimated_C = points @ X_CO[:3, :3].T + X_CO[:3, 3]
    inverse = np.linalg.inv(X_CO_true)
    in_true_O = estimated_C @ inverse[:3, :3].T + inverse[:3, 3]
    candidates = X_CO_true @ _symmetries_near(obj.symmetry, inverse @ X_CO)
    true_C = points @ candidates[:, :3, :3].transpose(0, 2, 1) + candidates[:, None, :3, 3]
    worst = np.linalg.norm(true_C - estimated_C, axis=-1).max(axis=1)
    best = int(worst.argmin())
    turn = candidates[best, :3, :3].T @ X_CO[:3, :3]
    centre = np.append(obj.symmetry.centre, 1.0)
    return PoseErrors(
        add_s_m=float(np.abs(query_grid_numpy(obj.sdf, in_true_O)).mean()),
        mssd_m=float(worst[best]),
        rotation_rad=float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))),
        translation_m=float(np.linalg.norm((X_CO - candidates[best]) @ centre)),
    )


def _symmetries_near(symmetry: SymmetryGroup, X_OO: np.ndarray) -> np.ndarray:
    """The group's samples (S, 4, 4); of a continuous one, also its exact elements nearest to the rotation of `X_OO`.

    The samples of a continuous group lie 10 degrees apart, which alone would read as an error of up to 5 degrees.
    """
    samples, R, axis = symmetry.rotations, X_OO[:3, :3], symmetry.continuous_axis
    if axis is None:
        exact = R[None] if len(samples) > _BALL else np.zeros((0, 3, 3))
    else:
        # trace(turn(angle)' A) = constant + b cos(angle) + c sin(angle), largest at atan2(c, b)
        A = R @ samples[:, :3, :3].transpose(0, 2, 1)
        b = np.trace(A, axis1=1, axis2=2) - A @ axis @ axis
        skew = np.stack([A[:, 2, 1] - A[:, 1, 2], A[:, 0, 2] - A[:, 2, 0], A[:, 1, 0] - A[:, 0, 1]], axis=1)
        angle = np.arctan2(skew @ axis, b)
        exact = axis_angle_matrix(np.broadcast_to(axis, (len(A), 3)), angle) @ samples[:, :3, :3]
    nearest = np.tile(np.eye(4), (len(exact), 1, 1))
    nearest[:, :3, :3] = exact
    nearest[:, :3, 3] = symmetry.centre - exact @ symmetry.centre
    return np.concatenate([samples, nearest])
