"""How sure a pose is: covariance from curvature, shares of the alternatives, and a calibrated probability."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.sdf_grid import grid_distances
from neuralgrasps.perception.observation import Observation
from neuralgrasps.perception.pose_kernels import normal_equations
from neuralgrasps.perception.pose_model import PoseModel
from neuralgrasps.perception.pose_search import Candidates, PoseConfig
from neuralgrasps.perception.pose_visibility import CONFIRMED, COST, EXPLAINED, FREE

EFFECTIVE_POINTS = 40.0  # depth errors of neighbouring pixels are alike: all points count as so many independent ones
_NOISE_FLOOR_M = 1.0e-3
SHARPNESS = 40.0  # of the shares: a cost lower by 1 / SHARPNESS makes a pose e times as likely
# Logistic regression on `confidence_features`, fitted on 2,912 estimates of the 13 scans in simulated easy, occluded and
# hard scenes (none of them used in the benchmark): half with the right object, with and without a table, half with a
# wrong one (weight 0.2).
WEIGHTS = np.array([-11.863, -1.239, -1.504, -2.211, -0.359, -1.110, 0.573])
_FEWEST = 0.003  # shares below this count as so much


def shares_of(found: Candidates) -> np.ndarray:
    """(K,) how likely each candidate is, given that one of them is right; sums to 1."""
    weight = np.exp(-SHARPNESS * (found.cost - found.cost.min()))
    return weight / weight.sum()


def pose_covariance(
    model: PoseModel, scene: Observation, X_CO: np.ndarray, config: PoseConfig
) -> tuple[np.ndarray, float]:
    """Covariance (6, 6) of a twist [v, w] about the object's centre, and the median distance of the points, metres."""
    points = scene.points[: config.points[2]]
    distance = np.abs(surface_distances(model, points, X_CO))
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


def surface_distances(model: PoseModel, points_C: np.ndarray, X_CO: np.ndarray) -> np.ndarray:
    """(M,) signed distances of points in the camera frame to the posed object."""
    points = np.ascontiguousarray((points_C - X_CO[:3, 3]) @ X_CO[:3, :3])
    out = np.empty(len(points))
    grid_distances(model.values, model.origin, model.inv_spacing, points, out)
    return out


def confidence_features(found: Candidates, share: float, covariance: np.ndarray, model: PoseModel) -> np.ndarray:
    """(7,) one, and what the view leaves open about the first candidate, mostly as logarithms.

    Its cost; the share of the mask not explained; free space that it fills; the share of the other candidates; its
    standard deviation over a tenth of the diameter; the share of its visible surface that was not measured there.

    Args:
        share: of all poses that are the first one up to symmetry.
    """
    evidence = found.evidence[0]
    slide = float(np.linalg.eigvalsh(covariance[:3, :3]).max())
    turn = float(np.linalg.eigvalsh(covariance[3:, 3:]).max()) * model.radius**2
    return np.array(
        [
            1.0,
            evidence[COST],
            np.log(max(1.0 - evidence[EXPLAINED], _FEWEST)),
            np.log(evidence[FREE] + 0.01),
            np.log(max(1.0 - share, _FEWEST)),
            np.log(np.sqrt(slide + turn) / (0.1 * model.diameter)),
            np.log(max(1.0 - evidence[CONFIRMED], 0.0) + 0.01),
        ]
    )


def confidence_of(found: Candidates, share: float, covariance: np.ndarray, model: PoseModel) -> float:
    """Probability that the first candidate is right, see `PoseResult.confidence`."""
    return float(1.0 / (1.0 + np.exp(-WEIGHTS @ confidence_features(found, share, covariance, model))))
