"""What a fit of a human hand is given, as arrays for compiled code: joints, points, free space, object, postures."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from neuralgrasps.errors import check_shape
from neuralgrasps.human.fit.fit_config import HandFitConfig
from neuralgrasps.human.fit.right_hand import FLIP_X, right_hand
from neuralgrasps.human.fit.view import hand_view, no_view
from neuralgrasps.human.postures import usual_postures
from neuralgrasps.human.seen import FittedHand, SeenJoints, Side
from neuralgrasps.human.skeleton import NUM_JOINTS, TIPS
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame

_STILL = 0.2  # weight of the joints of a fit shortly before, in place of seen ones


class HandProblem(NamedTuple):
    """What a hand is fitted to. Lengths are metres in the camera frame; weights are inverse variances, 1 / m^2.

    Attributes:
        joint_link (21,), joint_L (21, 3): where the joints sit on the hand of size 1.
        joints_C (21, 3), joint_weight (21,): where they are seen; weight 0 leaves one out. joint_width: Cauchy's.
        cloud_C (M, 3), cloud_weight: points of the hand's surface; cloud_width: beyond it a point is soon left out.
        probe_L (K, 3), probe_link (K,): spread surface points of the hand of size 1, sorted by link.
        depth (h, w): measured depth in a crop of the image, 0 = none; near (h, w, 2): row and column of the nearest
            pixel at which nothing forbids the hand; camera (fx, fy, cx, cy) of the crop; free_weight, free_slack,
            free_width: of probes in front of what is measured; weight 0 leaves it out.
        X_OC (3, 4), sdf_values, sdf_origin, sdf_inv_spacing: the object; deep_weight, deep_slack: of probes inside it
            (weight 0: no object); touch_weight (L,), touch_width: links that lie on it when they are near.
        q_mean (J,), q_precision (J, J), q_freedom: t distribution of postures.
        log_scale, log_scale_weight: usual size; free_scale: whether it is fitted.
    """

    joint_link: np.ndarray
    joint_L: np.ndarray
    joints_C: np.ndarray
    joint_weight: np.ndarray
    joint_width: float
    cloud_C: np.ndarray
    cloud_weight: float
    cloud_width: float
    probe_L: np.ndarray
    probe_link: np.ndarray
    depth: np.ndarray
    near: np.ndarray
    camera: np.ndarray
    free_weight: float
    free_slack: float
    free_width: float
    X_OC: np.ndarray
    sdf_values: np.ndarray
    sdf_origin: np.ndarray
    sdf_inv_spacing: float
    deep_weight: float
    deep_slack: float
    touch_weight: np.ndarray
    touch_width: float
    q_mean: np.ndarray
    q_precision: np.ndarray
    q_freedom: float
    log_scale: float
    log_scale_weight: float
    free_scale: bool


def hand_problem(
    seen: SeenJoints | None,
    cloud_C: np.ndarray | None,
    *,
    side: Side,
    scale: float | None,
    obj: tuple[ObjectModel, np.ndarray] | None,
    frame: Frame | None,
    config: HandFitConfig,
    start: FittedHand | None = None,
) -> HandProblem:
    """What is lowered, for a right hand: what is seen of a left one is mirrored (x to -x)."""
    model, postures, left = right_hand(), usual_postures(), side == "left"
    joints, weight = _usable_joints(seen, start)
    cloud = _thinned(cloud_C, config.points)
    if left:
        joints, cloud = joints * [-1.0, 1.0, 1.0], cloud * [-1.0, 1.0, 1.0]
    return HandProblem(
        joint_link=model.bones.links,
        joint_L=model.bones.points_L,
        joints_C=joints,
        joint_weight=weight * 3.0 / config.joint_sd_m**2,
        joint_width=config.joint_width_m,
        cloud_C=cloud,
        cloud_weight=1.0 / config.cloud_sd_m**2,
        cloud_width=config.cloud_width_m,
        probe_L=model.probe_L,
        probe_link=model.probe_link,
        q_mean=postures.mean,
        q_precision=postures.precision,
        q_freedom=config.freedom,
        log_scale=float(np.log(config.scale_mean)),
        log_scale_weight=config.scale_sd**-2,
        free_scale=scale is None,
        **_view_terms(frame, seen, left, config),
        **_object_terms(obj, left, config),
    )


def _view_terms(frame: Frame | None, seen: SeenJoints | None, left: bool, config: HandFitConfig) -> dict[str, Any]:
    """Free space: of a depth image with a mask of the hand."""
    view = no_view()
    if frame is not None and seen is not None and seen.mask is not None and config.free_sd_m > 0.0:
        view = hand_view(frame, seen.mask, mirrored=left)
    return {
        "depth": view.depth,
        "near": view.near,
        "camera": view.camera,
        "free_weight": 1.0 / config.free_sd_m**2 if len(view.depth) else 0.0,
        "free_slack": config.free_slack_m,
        "free_width": config.free_width_m,
    }


def _object_terms(obj: tuple[ObjectModel, np.ndarray] | None, left: bool, config: HandFitConfig) -> dict[str, Any]:
    """What is held, X_CO (4, 4) its pose; without it, a grid that is not looked at."""
    model = right_hand()
    touch = np.zeros(len(model.packed.parents))
    touch[model.bones.links[list(TIPS)]] = 1.0 / config.touch_sd_m**2
    X_OC = np.eye(4) if obj is None else np.linalg.inv(obj[1]) @ (FLIP_X if left else np.eye(4))
    grid = obj[0].sdf if obj is not None else None
    return {
        "X_OC": np.ascontiguousarray(X_OC[:3]),
        "sdf_values": grid.values if grid is not None else np.zeros((2, 2, 2), np.float32),
        "sdf_origin": grid.origin if grid is not None else np.zeros(3),
        "sdf_inv_spacing": 1.0 / grid.spacing if grid is not None else 1.0,
        "deep_weight": 1.0 / config.deep_sd_m**2 if grid is not None else 0.0,
        "deep_slack": config.deep_slack_m,
        "touch_weight": touch,
        "touch_width": config.touch_width_m,
    }


def _usable_joints(seen: SeenJoints | None, start: FittedHand | None) -> tuple[np.ndarray, np.ndarray]:
    """(21, 3) joints without nan, (21,) weights, 0 for the unknown; those of the start where none are seen."""
    if seen is None:
        still = np.zeros((NUM_JOINTS, 3)) if start is None else start.joints_C
        return np.array(still, np.float64), np.full(NUM_JOINTS, 0.0 if start is None else _STILL)
    check_shape("seen joints", np.shape(seen.points_C), (NUM_JOINTS, 3))
    points = np.array(seen.points_C, np.float64)
    known = np.isfinite(points).all(axis=1) & np.isfinite(seen.weight)
    return np.where(known[:, None], points, 0.0), np.where(known, np.clip(seen.weight, 0.0, 1.0), 0.0)


def _thinned(cloud_C: np.ndarray | None, count: int) -> np.ndarray:
    """At most `count` points, evenly picked from the list; too few to say anything: none."""
    if cloud_C is None:
        return np.zeros((0, 3))
    check_shape("cloud_C", np.shape(cloud_C), (None, 3))
    cloud = np.asarray(cloud_C, np.float64)
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if len(cloud) < 30:
        return np.zeros((0, 3))
    if len(cloud) > count:
        cloud = cloud[np.linspace(0, len(cloud) - 1, count).astype(np.int64)]
    return np.ascontiguousarray(cloud)


def joints_only(problem: HandProblem) -> HandProblem:
    """The problem without points, free space and object."""
    return problem._replace(cloud_C=np.zeros((0, 3)), free_weight=0.0, deep_weight=0.0)


def fewer_points(problem: HandProblem, step: int) -> HandProblem:
    """The problem with every `step`-th point of the cloud, of as much weight together."""
    return problem._replace(
        cloud_C=np.ascontiguousarray(problem.cloud_C[::step]), cloud_weight=step * problem.cloud_weight
    )
