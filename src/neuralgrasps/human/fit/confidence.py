"""How far a fitted hand can be trusted, from what the fit left unexplained. Torch-free."""

from __future__ import annotations

import math
from dataclasses import dataclass

_USUAL_JOINT_M = 0.015
_APART_M, _STEEP = 0.027, 8.0  # joints so far off, with points: as likely as not those of something else
_NEAR_SHARE, _SLOPE = 0.55, 25.0  # the same of the share of the points that the hand explains
_ODD_JOINTS_M = 0.018  # 1 of 100 good fits has more


@dataclass(frozen=True, slots=True, kw_only=True)
class FitEvidence:
    """What a fit left over.

    Attributes:
        cloud_rms_m: of the points near the hand, nan without such points; near_share: how many of all are near, 0 to
            1; nan where no points were given.
        links_seen: links of the hand that have such points.
        joint_sd_m: standard deviation that the cost's curvature gives the fitted joints.
        joint_rms_m: length of the seen joints' errors; nan without joints.
        penetration_m: depth in the object.
    """

    cloud_rms_m: float
    near_share: float
    links_seen: int
    joint_sd_m: float
    joint_rms_m: float
    penetration_m: float


def confidence(evidence: FitEvidence) -> float:
    """0 to 1, how likely the fitted surface is within 10 mm of the true one (root mean square).

    Logistic regression on synthetic frames whose answers are known, with the default weights of the fit: 873 fits
    with points and 135 without, joints 6 to 50 mm off, masks of IoU 1 to .5, sizes 4 % off, some of the wrong side. Of
    those with points, all but 1 % of the 69 % above .95 were within 10 mm, and 14 % of the 13 % below .5; in cross
    validation a good fit ranks above a bad one in 98 % of pairs.

    No such frame had joints and points of two different places; where points were given, the probability is therefore
    multiplied by their `agreement`: a hand that fits one of them only is not the one that was seen.
    """
    joints = evidence.joint_rms_m if math.isfinite(evidence.joint_rms_m) else _USUAL_JOINT_M
    unsure = math.log(1e3 * max(evidence.joint_sd_m, 1e-4))
    off = math.log(1e3 * max(joints, 5e-3))
    if math.isfinite(evidence.cloud_rms_m):
        points = math.log(1e3 * max(evidence.cloud_rms_m, 5e-4))
        odds = 15.3 - 2.93 * points - 1.91 * off - 2.57 * unsure - 150.0 * evidence.penetration_m
    else:
        odds = 15.6 - 2.56 * off - 3.00 * unsure
    return agreement(evidence) / (1.0 + math.exp(min(-odds, 50.0)))


def agreement(evidence: FitEvidence) -> float:
    """0 to 1, how far seen joints and depth points are of one hand; 1 where only one of both is known.

    By the joints' residual: .99 at 15 mm, .92 at 20, .30 at 30, .002 at 60 (of 341 good fits to what the nets read in
    videos, half had less than 7 mm, and 99 % less than 15). By the share of the points that are near the hand: 1 at .8,
    .78 at .6, .22 at .5, 0 at 0.
    """
    if not math.isfinite(evidence.near_share):
        return 1.0
    joints = evidence.joint_rms_m if math.isfinite(evidence.joint_rms_m) else 0.0
    by_joints = 1.0 / (1.0 + (joints / _APART_M) ** _STEEP)
    return by_joints / (1.0 + math.exp(-_SLOPE * (evidence.near_share - _NEAR_SHARE)))


def reasons_against(evidence: FitEvidence) -> tuple[str, ...]:
    """What speaks against a fit, in words."""
    reasons = []
    with_points = math.isfinite(evidence.near_share)
    if not with_points and not math.isfinite(evidence.joint_rms_m):
        reasons.append("neither joints nor depth points of the hand: nothing says where it is")
    elif not with_points:
        reasons.append("no depth points of the hand: fitted to the joints alone")
    elif evidence.near_share == 0.0:
        reasons.append("none of the depth points is near the fitted hand: are they of something else than the joints?")
    elif evidence.near_share < 0.8:
        reasons.append(f"{100 * (1 - evidence.near_share):.0f} % of the depth points are far from the fitted hand")
    if evidence.cloud_rms_m > 0.006:
        reasons.append(f"the depth points are {1e3 * evidence.cloud_rms_m:.0f} mm (rms) off the fitted hand")
    if evidence.joint_rms_m > (_ODD_JOINTS_M if with_points else _APART_M):
        why = ": it is the other hand, or joints and depth points are not of one" if with_points else ""
        reasons.append(f"the seen joints are {1e3 * evidence.joint_rms_m:.0f} mm (rms) off the fitted hand's{why}")
    if evidence.penetration_m > 0.005:
        reasons.append(f"the fitted hand is {1e3 * evidence.penetration_m:.0f} mm deep in the object")
    return tuple(reasons)
