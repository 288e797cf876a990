"""How sure a pose is: covariance from curvature, shares of the alternatives, and a calibrated probability."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.geometry.sdf_grid import grid_distances
from neuralgrasps.perception.observation import Observation
from neuralgrasps.perception.pose_kernels import normal_equations
from neuralgrasps.perception.pose_model import PoseModel
from neuralgrasps.perception.pose_search import Candidates, PoseConfig
from neuralgrasps.perception.pose_visibility import COST, EXPLAINED, FREE

EFFECTIVE_POINTS = 40.0  # depth errors of neighbouring pixels are alike: all points count as so many independent ones
_NOISE_FLOOR_M = 1.0e-3
_SHARED_M, _SCALE_ERROR = 0.002, 0.003  # errors of a depth camera that no number of points averages out
SHARPNESS = 40.0  # of the shares: a cost lower by 1 / SHARPNESS makes a pose e times as likely
# Logistic regressions on `confidence_features`; benchmarks/pose_confidence.py fits them on simulated views.
WEIGHTS = np.array([-11.127, -0.896, -1.976, -1.529, -0.255, -0.761])
TABLE_WEIGHTS = np.array([8.647, -1.246, -1.972, -1.599, -0.297, -0.733, -0.855, -6.306])
_BLIND = 2.0  # what a cloud alone takes off the log odds
_FEWEST = 0.003  # shares below this count as so much
# Misfits below these are a real camera's, scan's and table's. So small floors as simulation would allow made nearly all
# poses in real images doubtful, and so did the distance of the points.
_SUNK_M = 0.008  # a table is solid; it may be found so much too high
_HEIGHT_M, _TILT_RAD, _UNEXPLAINED = 0.015, float(np.deg2rad(15.0)), 0.02


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


def with_sensor_errors(covariance: np.ndarray, model: PoseModel, X_CO: np.ndarray) -> np.ndarray:
    """A covariance of `pose_covariance` and what all points share: 2 mm, and 0.3 % of the depth along the ray."""
    centre = X_CO[:3, :3] @ model.centre + X_CO[:3, 3]
    out = covariance.copy()
    out[:3, :3] += _SHARED_M**2 * np.eye(3) + _SCALE_ERROR**2 * np.outer(centre, centre)
    out[3:, 3:] += (_SHARED_M / model.radius) ** 2 * np.eye(3)
    return out


def surface_distances(model: PoseModel, points_C: np.ndarray, X_CO: np.ndarray) -> np.ndarray:
    """(M,) signed distances of points in the camera frame to the posed object."""
    points = np.ascontiguousarray((points_C - X_CO[:3, 3]) @ X_CO[:3, :3])
    out = np.empty(len(points))
    grid_distances(model.values, model.origin, model.inv_spacing, points, out)
    return out


def confidence_features(
    model: PoseModel, scene: Observation, found: Candidates, share: float, covariance: np.ndarray
) -> np.ndarray:
    """(6,) or with a table (8,): one, and what speaks against the first candidate.

    Its cost, and as logarithms: the share of the mask that it does not explain; free space that it fills; the share of
    the other candidates; its standard deviation over a tenth of the diameter; with a table also its height over it and
    its tilt from the nearest stable pose.

    Args:
        share: of all poses that are the first one up to symmetry.
    """
    evidence = found.evidence[0]
    slide = float(np.linalg.eigvalsh(covariance[:3, :3]).max())
    turn = float(np.linalg.eigvalsh(covariance[3:, 3:]).max()) * model.radius**2
    features = [
        1.0,
        evidence[COST],
        np.log(max(1.0 - evidence[EXPLAINED], _FEWEST) + _UNEXPLAINED),
        np.log(evidence[FREE] + 0.01),
        np.log(max(1.0 - share, _FEWEST)),
        np.log(np.sqrt(slide + turn) / (0.1 * model.diameter)),
    ]
    if scene.table.any():
        height, tilt = table_misfit(model, scene.table, found.X_CO[0])
        features += [np.log(1e3 * (abs(height) + _HEIGHT_M)), np.log(np.rad2deg(tilt + _TILT_RAD))]
    return np.array(features)


def table_misfit(model: PoseModel, table: np.ndarray, X_CO: np.ndarray) -> tuple[float, float]:
    """Height of the posed object's lowest point over a table (4,), metres, and its tilt from rest, radians."""
    hull = model.hull @ X_CO[:3, :3].T + X_CO[:3, 3]
    down = -(model.rests @ X_CO[:3, :3].T) @ table[:3]
    return float((hull @ table[:3]).min() + table[3]), float(np.arccos(np.clip(down.max(), -1.0, 1.0)))


def confidence_of(features: np.ndarray, *, present: bool, surroundings: bool) -> float:
    """Probability that the candidate with these `confidence_features` is right, see `PoseResult.confidence`.

    surroundings: more was measured than the object's own points; without, nothing can speak against a larger object.

    With a table there are two opinions, one that knows of it and one that looks at the view alone. Of an object that is
    known to be `present` the better counts, for it may lean or stand on something; else both count alike.
    """
    free = float(WEIGHTS @ features[: len(WEIGHTS)])
    if len(features) > len(WEIGHTS):
        standing = float(TABLE_WEIGHTS @ features[: len(TABLE_WEIGHTS)])
        free = max(free, standing) if present else 0.5 * (free + standing)
    if not surroundings:
        free -= _BLIND
    return float(1.0 / (1.0 + np.exp(-free)))


def physical_share(model: PoseModel, scene: Observation, X_CO: np.ndarray, covariance: np.ndarray) -> float:
    """What physics and spread leave of a confidence: 0 deep inside the table, and where the view fixes too little."""
    spread = np.sqrt(float(np.linalg.eigvalsh(covariance[:3, :3]).max())) / (0.1 * model.diameter)
    spread *= 1.0 - float(scene.free.min())  # an outline that nothing hides fixes what the points leave open
    share = math.erf(1.0 / (math.sqrt(2.0) * max(spread, 1e-3)))
    if scene.table.any():
        sunk = max(-table_misfit(model, scene.table, X_CO)[0] - _SUNK_M, 0.0)
        share *= math.exp(-((sunk / _SUNK_M) ** 2))
    return share
