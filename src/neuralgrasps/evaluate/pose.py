"""Errors of an estimated object pose, modulo the object's own symmetry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.objects.object_model import ObjectModel


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """How far an estimate is from the truth.

    Attributes:
        add_s_m: mean distance of the estimated model's points to the true surface (ADD-S with an exact surface in place of a
            second point set, so it has no sampling floor).
        mssd_m: maximum distance of corresponding points, least over the symmetry group (BOP's MSSD).
        rotation_rad, translation_m: geodesic angle, and distance of the centres, for the symmetry element of that least MSSD.
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
    candidates = X_CO_true @ obj.symmetry.rotations
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
