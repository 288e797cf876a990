"""What a fit of a hand hands back, and what it left unexplained."""

from __future__ import annotations

import numpy as np

from neuralgrasps.dataset.hand_surface import packed_link_poses
from neuralgrasps.geometry.sdf_grid import grid_distances
from neuralgrasps.human.fit.confidence import FitEvidence, confidence, reasons_against
from neuralgrasps.human.fit.problem import HandProblem
from neuralgrasps.human.fit.right_hand import right_hand, righted
from neuralgrasps.human.fit.steps import cloud_distances, curvature
from neuralgrasps.human.seen import FittedHand, Side
from neuralgrasps.human.skeleton import NUM_JOINTS, human_hand, joint_points


def fit_result(problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float, *, side: Side) -> FittedHand:
    """The hand of `side` at a result for the right one: X_CH (4, 4), q (20,)."""
    right = joint_points(human_hand("right"), np.eye(4), q) * scale @ X_CH[:3, :3].T + X_CH[:3, 3]
    evidence = _evidence(problem, X_CH, q, scale, right)
    return FittedHand(
        X_CH=righted(X_CH, side),
        q=q,
        scale=scale,
        side=side,
        joints_C=right * [-1.0, 1.0, 1.0] if side == "left" else right,
        cloud_rms_m=evidence.cloud_rms_m,
        joint_rms_m=evidence.joint_rms_m,
        penetration_m=evidence.penetration_m,
        confidence=confidence(evidence),
        reasons=reasons_against(evidence),
    )


def _evidence(problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float, joints_C: np.ndarray) -> FitEvidence:
    """What is left over, `joints_C` (21, 3) being the fitted joints."""
    known = problem.joint_weight > 0.0
    miss = np.linalg.norm(joints_C - problem.joints_C, axis=1)[known]
    distance, link = cloud_distances(right_hand().packed, problem, X_CH, q, scale)
    near = np.abs(distance) < 3.0 * problem.cloud_width
    return FitEvidence(
        cloud_rms_m=float(np.sqrt(np.mean(distance[near] ** 2))) if near.any() else float("nan"),
        near_share=float(near.mean()) if len(near) else float("nan"),
        links_seen=len(np.unique(link[near])),
        joint_sd_m=_joint_deviation(problem, X_CH, q, scale),
        joint_rms_m=float(np.sqrt(np.mean(miss**2))) if known.any() else float("nan"),
        penetration_m=_penetration(problem, X_CH, q, scale),
    )


def _penetration(problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float) -> float:
    """Depth of the hand's probes in the object, metres; 0 without one."""
    if problem.deep_weight == 0.0:
        return 0.0
    X_HL = packed_link_poses(right_hand().packed, q)[problem.probe_link]
    points_H = (X_HL[:, :3, :3] @ problem.probe_L[:, :, None])[..., 0] + X_HL[:, :3, 3]
    points_O = (scale * points_H @ X_CH[:3, :3].T + X_CH[:3, 3]) @ problem.X_OC[:, :3].T + problem.X_OC[:, 3]
    out = np.empty(len(points_O))
    grid_distances(problem.sdf_values, problem.sdf_origin, problem.sdf_inv_spacing, points_O, out)
    return max(-float(out.min()), 0.0)


def _joint_deviation(problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float) -> float:
    """Standard deviation of the joints' places (root mean square length), metres, by the curvature of the cost.

    Linear, and as if the residuals were independent: of use to compare fits, not as a length to rely on. Joints at a
    limit count as free to leave it. Where nothing is seen of the hand it is huge.
    """
    A, J = curvature(right_hand().packed, problem, X_CH, q, scale)
    A[np.diag_indices_from(A)] += 1e-6
    return float(np.sqrt(np.einsum("ij,jk,ik->", J, np.linalg.inv(A), J) / NUM_JOINTS))
