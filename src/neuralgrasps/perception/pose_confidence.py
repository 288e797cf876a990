"""How sure a pose is: covariance from curvature, shares of the alternatives, and a calibrated probability."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.perception.observation import Observation
from neuralgrasps.perception.pose_kernels import normal_equations
from neuralgrasps.perception.pose_model import PoseModel
from neuralgrasps.perception.pose_search import Candidates, PoseConfig
from neuralgrasps.perception.pose_visibility import CONFIRMED, COST, EXPLAINED, FREE

EFFECTIVE_POINTS = 40.0  # depth errors of neighbouring pixels are alike: all points count as so many independent ones
_NOISE_FLOOR_M = 1.0e-3
SHARPNESS = 40.0  # of the shares: a cost lower by 1 / SHARPNESS makes a pose e times as likely
# logistic regression on `confidence_features`
WEIGHTS = np.array([3.0, -4.0, 3.0, -2.0, 3.0, -2.0])


def shares_of(found: Candidates) -> np.ndarray:
    """(K,) how likely each candidate is, given that one of them is right; sums to 1."""
    weight = np.exp(-SHARPNESS * (found.cost - found.cost.min()))
    return weight / weight.sum()


def pose_covariance(
    model: PoseModel, scene: Observation, X_CO: np.ndarray, config: PoseConfig
) -> tuple[np.ndarray, float]:
    """Covariance (6, 6) of a twist [v, w] about the object's centre, and the median distance of the points, metres."""
    points = scene.points[: config.points[2]]
    distance = np.abs(query_grid_numpy_at(model, points, X_CO))
    residual = float(np.median(distance))
    H, b = np.empty((6, 6)), np.empty(6)
    centre = X_CO[:3, :3] @ model.centre + X_CO[:3, 3]
    normal_equations(model, scene, np.zeros((0, 4)), config.terms(2), X_CO, centre, H, b)
    sigma = max(1.4826 * residual, _NOISE_FLOOR_M)
    scale = np.array([1.0, 1.0, 1.0, model.radius, model.radius, model.radius])
    information = H / len(points) * EFFECTIVE_POINTS / (scale[:, None] * scale) / sigma**2
    # a motion that nothing resists is known to half the object's size
    information += np.eye(6) / (0.5 * model.radius) ** 2
    return np.linalg.inv(information) / (scale[:, None] * scale), residual


def query_grid_numpy_at(model: PoseModel, points_C: np.ndarray, X_CO: np.ndarray) -> np.ndarray:
    """(M,) signed distances of points in the camera frame to the posed object."""
    from neuralgrasps.geometry.sdf_grid import grid_distances

    points = np.ascontiguousarray((points_C - X_CO[:3, 3]) @ X_CO[:3, :3])
    out = np.empty(len(points))
    grid_distances(model.values, model.origin, model.inv_spacing, points, out)
    return out


def confidence_features(
    found: Candidates, shares: np.ndarray, covariance: np.ndarray, model: PoseModel
) -> np.ndarray:
    """(F,) what the confidence is computed from."""
    evidence = found.evidence[0]
    worst = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]).max()))
    turn = float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:]).max())) * model.radius
    return np.array(
        [
            1.0,
            evidence[COST],
            evidence[EXPLAINED],
            evidence[FREE],
            shares[0],
            np.hypot(worst, turn) / (0.1 * model.diameter),
        ]
    )


def confidence_of(found: Candidates, shares: np.ndarray, covariance: np.ndarray, model: PoseModel) -> float:
    """Probability that the first candidate is right, see `PoseResult.confidence`."""
    return float(1.0 / (1.0 + np.exp(-WEIGHTS @ confidence_features(found, shares, covariance, model))))
