"""Errors of an estimated object pose, modulo the object's own symmetry, and scores over many of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.mesh import convex_hull
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import SymmetryGroup

VISIBILITY_BANDS: tuple[tuple[float, float], ...] = ((0.0, 0.25), (0.25, 0.45), (0.45, 0.65), (0.65, 0.80), (0.80, 1.0))
"""Shares of the object's own pixels that are visible, for scores by visibility; the upper end belongs to a band."""
_AUC_M = 0.10  # Xiang et al. 2018
_BOP_THRESHOLDS = np.arange(0.05, 0.501, 0.05)  # diameters; Hodan et al. 2020
_ROWS = 1024  # of a matrix of distances at a time
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


FAILED = PoseErrors(add_s_m=math.inf, mssd_m=math.inf, rotation_rad=math.inf, translation_m=math.inf)
"""The errors of an estimator that gave no pose."""


def diameter_m(obj: ObjectModel) -> float:
    """The largest distance of two points of an object, exact: between vertices of its hull; metres."""
    corners = convex_hull(obj.mesh.vertices)[0]
    return max(float(cdist(corners[i : i + _ROWS], corners).max()) for i in range(0, len(corners), _ROWS))


def score_poses(errors: Sequence[PoseErrors], diameters_m: Sequence[float]) -> dict[str, float]:
    """Scores over N estimates; a failed one counts as infinitely far off.

    Args:
        errors: N errors. diameters_m: N diameters of the objects.
    Returns:
        count: N.
        add_s_auc: percent, area under the share of estimates below a threshold of ADD-S from 0 to 10 cm, exact:
            the mean of max(0, 1 - ADD-S / 10 cm).
        under_5mm, under_1cm: share with a smaller ADD-S.
        mssd_01d: share with an MSSD below a tenth of the diameter.
        ar_mssd: mean share with an MSSD below .05, .10, ... .50 diameters (BOP's average recall of MSSD).
        add_s_median_mm, mssd_median_mm, rotation_median_deg, translation_median_mm: medians; inf when half failed.
    Raises:
        InputError: no estimate, or another number of diameters.
    Source:
        Xiang et al. 2018 (area under the curve to 10 cm), with ADD-S to the exact surface; Hodan et al. 2020 (MSSD).
    """
    if not errors or len(errors) != len(diameters_m):
        raise InputError(
            f"score_poses got {len(errors)} errors, {len(diameters_m)} diameters; expected N of each, N > 0."
        )
    add_s, mssd, rotation, translation = np.array(
        [(e.add_s_m, e.mssd_m, e.rotation_rad, e.translation_m) for e in errors]
    ).T
    relative = mssd / np.asarray(diameters_m, np.float64)
    return {
        "count": float(len(errors)),
        "add_s_auc": float(100.0 * np.maximum(0.0, 1.0 - add_s / _AUC_M).mean()),
        "under_5mm": float((add_s < 0.005).mean()),
        "under_1cm": float((add_s < 0.01).mean()),
        "mssd_01d": float((relative < 0.1).mean()),
        "ar_mssd": float((relative[:, None] < _BOP_THRESHOLDS).mean()),
        "add_s_median_mm": float(1e3 * np.median(add_s)),
        "mssd_median_mm": float(1e3 * np.median(mssd)),
        "rotation_median_deg": float(np.rad2deg(np.median(rotation))),
        "translation_median_mm": float(1e3 * np.median(translation)),
    }


def score_by_visibility(
    errors: Sequence[PoseErrors], diameters_m: Sequence[float], visible_shares: Sequence[float]
) -> dict[str, dict[str, float]]:
    """`score_poses` for each of the `VISIBILITY_BANDS` that holds estimates, under names such as "25-45"."""
    shares = np.asarray(visible_shares, np.float64)
    scores = {}
    for low, high in VISIBILITY_BANDS:
        chosen = np.nonzero((shares > low) & (shares <= high))[0].tolist()
        if len(chosen):
            scores[f"{100 * low:.0f}-{100 * high:.0f}"] = score_poses(
                [errors[i] for i in chosen], [diameters_m[i] for i in chosen]
            )
    return scores


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
