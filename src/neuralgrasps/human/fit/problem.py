"""What a fit of a human hand is given, as arrays for compiled code. Torch-free."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


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
