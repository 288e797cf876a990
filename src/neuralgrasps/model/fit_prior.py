"""What is known of a hand's grasps before any point is seen: usual postures, links that touch. Torch-free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.hand_surface import packed_link_poses
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_numpy
from neuralgrasps.hands.packed import PackedHand

PROBES = 400
MATERIAL = 96
MAX_REACH_M = 0.03
_JOINT_SD = 0.04  # of a joint's range, added to what the examples show
_TOUCH_SD = 0.0005
DEPTH_SD_M = 0.0005  # of surface points inside the object
_TOUCH_SHARE = 0.75  # a link touches usually when so many examples have it within _TOUCH_NEAR of the object
_TOUCH_NEAR = 0.003


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspPrior:
    """Statistics of known grasps of one object by one hand.

    Attributes:
        q_mean: (J,) mean posture, rad or metres; q_precision: (J, J) inverse covariance.
        probe: (R,) well spread surface points of the hand, sorted by link; material: (K,) fewer of them.
        touch_mean, touch_sd: (L,) least distance of each link's probes to the object, metres; sd is inf for links that
            touch only in some grasps.
        reach_m: distance from the object of the example that is farthest from it, at most `MAX_REACH_M`.
    """

    q_mean: np.ndarray
    q_precision: np.ndarray
    probe: np.ndarray
    material: np.ndarray
    touch_mean: np.ndarray
    touch_sd: np.ndarray
    reach_m: float


def grasp_prior(packed: PackedHand, sdf: SdfGrid, X_OH: np.ndarray, q: np.ndarray) -> GraspPrior:
    """Statistics of known grasps X_OH (N, 4, 4), q (N, J) on the object of `sdf`."""
    probe, material = spread_points(packed, PROBES), spread_points(packed, MATERIAL)
    span = packed.upper - packed.lower
    u = (q - packed.lower) / span
    covariance = (u - u.mean(axis=0)).T @ (u - u.mean(axis=0)) / len(u) + _JOINT_SD**2 * np.eye(len(span))
    least = least_distances(packed, sdf, X_OH, q, probe)
    near = least < _TOUCH_NEAR
    usual = near.mean(axis=0) >= _TOUCH_SHARE
    mean, sd = np.zeros(len(usual)), np.full(len(usual), np.inf)
    for link in np.flatnonzero(usual):
        some = least[near[:, link], link]
        mean[link], sd[link] = some.mean(), np.hypot(some.std(), _TOUCH_SD)
    return GraspPrior(
        q_mean=packed.lower + u.mean(axis=0) * span,
        q_precision=np.linalg.inv(covariance) / np.outer(span, span),
        probe=probe,
        material=material,
        touch_mean=mean,
        touch_sd=sd,
        reach_m=min(float(least.min(axis=1).max()), MAX_REACH_M),
    )


def least_distances(packed: PackedHand, sdf: SdfGrid, X_OH: np.ndarray, q: np.ndarray, probe: np.ndarray) -> np.ndarray:
    """(N, L) least distance of each link's probes to the object, metres; inf for links without probes."""
    out = np.full((len(q), len(packed.parents)), np.inf)
    links = packed.point_link[probe]
    for i, (X, posture) in enumerate(zip(X_OH, q, strict=True)):
        np.minimum.at(out[i], links, query_grid_numpy(sdf, posed_points(packed, X, posture, probe)))
    return out


def posed_points(packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(K, 3) chosen surface points of a posed hand in the object frame."""
    X_OL = (X_OH @ packed_link_poses(packed, q))[packed.point_link[chosen]]
    return np.einsum("kij,kj->ki", X_OL[:, :3, :3], packed.point_L[chosen]) + X_OL[:, :3, 3]


def spread_points(packed: PackedHand, count: int) -> np.ndarray:
    """(count,) well spread surface points of a hand, sorted (so by link)."""
    every = np.arange(len(packed.point_L))
    middle = posed_points(packed, np.eye(4), 0.5 * (packed.lower + packed.upper), every)
    return np.sort(farthest_points(middle, min(count, len(every))))
