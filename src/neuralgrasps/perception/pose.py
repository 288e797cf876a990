"""6D pose of a known object from one depth view.

Rotations of a grid and stable poses on the table are scored at once on the object's exact signed distances, the best
are polished by Levenberg-Marquardt on SE(3) with a robust loss, and what the camera saw decides: a surface where the
camera saw farther speaks against a pose, a surface behind what it saw does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.contact import ContactPoints
from neuralgrasps.perception.contact_search import with_contact
from neuralgrasps.perception.observation import Observation, observe_depth, observe_points
from neuralgrasps.perception.pose_confidence import (
    confidence_features,
    confidence_of,
    physical_share,
    pose_covariance,
    shares_of,
    with_sensor_errors,
)
from neuralgrasps.perception.pose_model import PoseModel, pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, Candidates, PoseConfig, distinct, same_pose, search
from neuralgrasps.perception.pose_visibility import COST, EXPLAINED

__all__ = ["PoseConfig", "PoseResult", "estimate_pose"]

_LEAST_SHARE = 0.01  # alternatives less likely than this are not listed


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseResult:
    """Where an object is.

    Attributes:
        X_CO: (4, 4) object frame in the camera frame, the best pose.
        confidence: probability that the pose is right: surface within 1 cm of the true one on average (ADD-S), and no
            point off by a tenth of the diameter (MSSD, up to symmetry). Fitted in simulation; presumes that the depth
            scale and the camera's numbers are right.
        score: how well the view is explained, 1 = fully; comparable between poses and between objects of one view.
        residual_m: median distance of the observed points to the surface.
        explained: share of the observed surface within 5 mm of the model's where that is visible.
        covariance: (6, 6) of a twist [v, w] that moves the object about its centre, camera axes, metres and radians:
            of the fit, and 2 mm and 0.3 % of the depth that a camera may be off everywhere.
        converged: `confidence` is at least one half.
        alternatives_X_CO: (K, 4, 4) distinct poses that the view may also come from, best first, the first is `X_CO`;
            alternatives_probability: (K,) how the confidence that one of them is right falls to each; sums to 1.
        seed: of the choice of points.
    """

    X_CO: np.ndarray
    confidence: float
    score: float
    residual_m: float
    explained: float
    covariance: np.ndarray
    converged: bool
    alternatives_X_CO: np.ndarray
    alternatives_probability: np.ndarray
    seed: int


def estimate_pose(
    obj: ObjectModel,
    points_C: np.ndarray | None = None,
    *,
    depth: np.ndarray | None = None,
    intrinsics: Intrinsics | None = None,
    mask: np.ndarray | None = None,
    table: Plane | None = None,
    contact: ContactPoints | None = None,
    config: PoseConfig | None = None,
    seed: int = 0,
) -> PoseResult:
    """Find the object's pose from what one depth camera sees of it.

    Args:
        obj: the object.
        points_C: (M, 3) observed points on it, camera frame, metres; M >= 20. Not needed with a mask.
        depth: (h, w) z-depth image, metres, of the whole scene; 0, inf or nan = nothing measured.
        intrinsics: camera of `depth`; both or neither. mask: (h, w) bool, the pixels of `depth` that show the object.
        table: plane that the object probably rests on, camera frame, normal up; a prior, not a condition.
        contact: points of a hand that touches the object; they choose among poses that explain the view about alike.
        config: knobs; seed: of the choice of points.
    Raises:
        InputError: fewer than 20 finite points, a contradictory or missing observation, points in millimetres.
    Source:
        The multi-start search replaces the 45-degree grid and single descent of Khargonkar et al. 2022, Eq. 1 of the
        supplement (`perception.paper_pose` has those).
    """
    config = config or PoseConfig()
    model = pose_model(obj)
    scene = observe(
        points_C, depth=depth, intrinsics=intrinsics, mask=mask, table=table, reach_m=model.diameter, seed=seed
    )
    found = search(model, scene, NO_CONTACTS, config)
    if contact is not None:
        found = with_contact(model, scene, contact, found, config)
    return result_of(model, scene, found, config, seed)


def observe(
    points_C: np.ndarray | None,
    *,
    depth: np.ndarray | None,
    intrinsics: Intrinsics | None,
    mask: np.ndarray | None,
    table: Plane | None,
    reach_m: float,
    seed: int,
) -> Observation:
    """The observation that the arguments of `estimate_pose` describe."""
    if (depth is None) != (intrinsics is None):
        raise InputError("a depth image needs its camera: give both `depth` and `intrinsics`; got only one of them.")
    if depth is None or intrinsics is None:
        if points_C is None or mask is not None:
            raise InputError("nothing to look at: give `points_C`, or `depth` with `intrinsics` and `mask`.")
        return observe_points(points_C, reach_m=reach_m, table=table, seed=seed)
    if points_C is None and mask is None:
        raise InputError("which part of the depth image is the object? Give `mask` or `points_C`, or use find_objects.")
    return observe_depth(depth, intrinsics, mask, points_C=points_C, reach_m=reach_m, table=table, seed=seed)


def result_of(
    model: PoseModel, scene: Observation, found: Candidates, config: PoseConfig, seed: int, *, present: bool = True
) -> PoseResult:
    """The result that candidates amount to; present: the object is known to be there, see `confidence_of`."""
    kept, shares = merged_shares(model, found)
    covariance, residual = pose_covariance(model, scene, found.X_CO[0], config)
    features = confidence_features(model, scene, found, float(shares[0]), covariance)
    surroundings = bool(((scene.depth > 0.0) & (scene.outside > 0.0)).any())
    confidence = confidence_of(features, present=present, surroundings=surroundings)
    confidence *= physical_share(model, scene, found.X_CO[0], covariance)
    likely = shares >= _LEAST_SHARE
    likely[0] = True
    return PoseResult(
        X_CO=found.X_CO[0].copy(),
        confidence=confidence,
        score=float(1.0 - found.evidence[0, COST]),
        residual_m=residual,
        explained=float(found.evidence[0, EXPLAINED]),
        covariance=with_sensor_errors(covariance, model, found.X_CO[0]),
        converged=confidence >= 0.5,
        alternatives_X_CO=found.X_CO[kept[likely]].copy(),
        alternatives_probability=shares[likely] / shares[likely].sum(),
        seed=seed,
    )


def merged_shares(model: PoseModel, found: Candidates) -> tuple[np.ndarray, np.ndarray]:
    """Candidates that differ by more than the object's symmetry: their indices, best first, and their shares."""
    shares = shares_of(found)
    kept = distinct(model, found.X_CO, found.cost, len(shares), model.same)
    alike = same_pose(model, found.X_CO, found.X_CO[kept])
    return kept, np.bincount(alike, weights=shares, minlength=len(kept))
