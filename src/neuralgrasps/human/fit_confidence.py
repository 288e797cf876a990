"""How far a fitted hand can be trusted, from what the fit left unexplained. Torch-free."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class FitEvidence:
    """What a fit left over.

    Attributes:
        cloud_rms_m: of the points near the hand; near_share: how many of all are; nan without points.
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
    """0 to 1, how likely the fitted surface is within 10 mm (rms)."""
    if not math.isfinite(evidence.cloud_rms_m):
        return 0.3
    odds = 4.0 - 0.6e3 * max(evidence.cloud_rms_m - 0.003, 0.0) - 12.0 * (1.0 - evidence.near_share)
    if math.isfinite(evidence.joint_rms_m):
        odds -= 80.0 * max(evidence.joint_rms_m - 0.015, 0.0)
    return 1.0 / (1.0 + math.exp(-odds))


def reasons_against(evidence: FitEvidence) -> tuple[str, ...]:
    """What speaks against a fit, in words."""
    reasons = []
    if not math.isfinite(evidence.cloud_rms_m):
        reasons.append("no depth points of the hand: fitted to the joints alone")
    elif evidence.cloud_rms_m > 0.006:
        reasons.append(f"the depth points are {1e3 * evidence.cloud_rms_m:.0f} mm (rms) off the fitted hand")
    if evidence.near_share < 0.8:
        reasons.append(f"{100 * (1 - evidence.near_share):.0f} % of the depth points are far from the fitted hand")
    if evidence.joint_rms_m > 0.03:
        reasons.append(f"the seen joints are {1e3 * evidence.joint_rms_m:.0f} mm (rms) off the fitted hand's")
    if evidence.penetration_m > 0.005:
        reasons.append(f"the fitted hand is {1e3 * evidence.penetration_m:.0f} mm deep in the object")
    return tuple(reasons)
