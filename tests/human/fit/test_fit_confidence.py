"""The confidence of a hand fit: sure of what agrees, never of joints and points that contradict each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.evaluate.hand_surface import posed_surface
from neuralgrasps.human.fit.confidence import FitEvidence, agreement, confidence, reasons_against
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.postures import usual_postures
from neuralgrasps.human.seen import FittedHand, SeenJoints, Side
from neuralgrasps.human.skeleton import human_hand, joint_points

GOOD = FitEvidence(
    cloud_rms_m=0.001, near_share=1.0, links_seen=16, joint_sd_m=0.003, joint_rms_m=0.007, penetration_m=0.0
)


def _fitted(shift_m: float, *, side: Side = "right", noise_m: float = 0.005) -> FittedHand:
    """A right hand's joints, and the half of its surface that is nearer to the camera, moved away from them."""
    rng, q, X_CH = np.random.default_rng(1), usual_postures().closed, np.eye(4)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    X_CH[:3, :3], X_CH[:3, 3] = R * np.linalg.det(R), [0.02, 0.03, 0.6]
    surface = posed_surface("right", 0.8, X_CH, q)
    cloud = surface[surface[:, 2] < np.median(surface[:, 2])] + [0.0, 0.0, shift_m]
    joints = 0.8 * joint_points(human_hand("right"), np.eye(4), q) @ X_CH[:3, :3].T + X_CH[:3, 3]
    seen = SeenJoints(
        points_C=joints + noise_m * rng.normal(size=(21, 3)), weight=np.ones(21), mask=None, side=side, source="test"
    )
    return fit_hand(seen, cloud, side=side, scale=0.8)


def test_joints_and_points_of_one_place_are_sure() -> None:
    fitted = _fitted(0.0)
    assert fitted.confidence > 0.99 and fitted.reasons == ()


@pytest.mark.parametrize(("shift_m", "most"), [(0.03, 0.35), (0.06, 0.01), (0.1, 0.01), (0.3, 0.01), (2.0, 0.01)])
def test_joints_and_points_of_two_places_are_not(shift_m: float, most: float) -> None:
    fitted = _fitted(shift_m)
    assert fitted.confidence < most and fitted.reasons
    assert not any("no depth points" in reason for reason in fitted.reasons)


def test_a_hand_taken_for_the_other_one_is_doubted() -> None:
    fitted = _fitted(0.0, side="left")
    assert fitted.confidence < 0.5 and any("the other hand" in reason for reason in fitted.reasons)


def test_usual_residuals_of_joints_cost_nothing() -> None:
    by_joints = [agreement(replace(GOOD, joint_rms_m=r)) for r in (0.0, 0.007, 0.015, 0.02, 0.03, 0.06)]
    assert by_joints == sorted(by_joints, reverse=True)
    assert by_joints[2] > 0.98 and by_joints[3] > 0.9 and by_joints[4] < 0.31 and by_joints[5] < 0.01
    assert confidence(GOOD) > 0.99


def test_points_that_the_hand_leaves_out_count() -> None:
    by_share = [confidence(replace(GOOD, near_share=share)) for share in (1.0, 0.8, 0.6, 0.49, 0.2)]
    assert by_share == sorted(by_share, reverse=True)
    assert by_share[1] > 0.99 and by_share[3] < 0.3 and by_share[4] < 0.01


def test_no_points_is_not_none_near() -> None:
    absent = replace(GOOD, cloud_rms_m=np.nan, near_share=np.nan, links_seen=0)
    elsewhere = replace(absent, near_share=0.0)
    assert reasons_against(absent) == ("no depth points of the hand: fitted to the joints alone",)
    (reason,) = reasons_against(elsewhere)
    assert reason.startswith("none of the depth points is near")
    assert confidence(absent) > 0.9 and confidence(elsewhere) < 0.01
    assert agreement(replace(absent, joint_rms_m=0.03)) == 1.0  # nothing to contradict them
