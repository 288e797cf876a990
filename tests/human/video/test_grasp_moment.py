"""Still phases of a hand, and its distance to an object."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.human.seen import FittedHand
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.human.video.grasp_moment import (
    first_motion,
    joint_distances,
    still_runs,
    still_threshold,
    touch,
)


def _moving_and_still(noise_m: float = 0.0) -> np.ndarray:
    """(30, 21, 3) joints that come 4 cm a frame for 10 frames, stand 12, and leave."""
    step = np.r_[np.full(10, 0.04), np.zeros(12), np.full(8, 0.04)]
    rng = np.random.default_rng(0)
    start = rng.normal(size=(21, 3)) * 0.05
    points = start + np.cumsum(step)[:, None, None] * np.array([1.0, 0.0, 0.0])
    return points + rng.normal(size=points.shape) * noise_m


def test_the_still_phase_is_found():
    distance = joint_distances(_moving_and_still(), np.ones((30, 21)))
    run = still_runs(distance, range(30), within_m=0.006, least=3)[0]
    assert (run.frames[0], run.frames[-1]) == (9, 21)
    assert run.spread_m < 1e-9


def test_noisy_joints_are_still_too_and_frames_keep_their_numbers():
    distance = joint_distances(_moving_and_still(0.004), np.ones((30, 21)))
    within = still_threshold(distance, least_m=0.006, most_m=0.015)
    assert 0.006 < within <= 0.015
    runs = still_runs(distance, [5 * k for k in range(30)], within_m=within, least=3)
    assert (runs[0].frames[0], runs[0].frames[-1]) == (45, 105)
    assert len(runs) == 1


@pytest.mark.parametrize(("step_m", "longest"), [(0.004, 5), (0.0012, 13)])
def test_a_slow_drift_is_not_still(step_m, longest):
    points = np.zeros((40, 21, 3))
    points[..., 0] = step_m * np.arange(40)[:, None]
    runs = still_runs(joint_distances(points, np.ones((40, 21))), range(40), within_m=0.006, least=3)
    assert max(len(run.frames) for run in runs) <= longest


def test_one_bad_frame_does_not_end_a_still_phase():
    points = _moving_and_still()
    points[15] += 0.1
    run = still_runs(joint_distances(points, np.ones((30, 21))), range(30), within_m=0.006, least=3)[0]
    assert 15 not in run.frames and {14, 16} <= set(run.frames)


def test_distances_leave_out_what_is_not_known():
    points, weight = np.zeros((2, 21, 3)), np.ones((2, 21))
    points[1, :12] = 0.5  # most of the joints jump, but they are not trusted
    weight[1, :12] = 0.0
    assert joint_distances(points, weight)[0, 1] == 0.0
    points[0, 14:] = np.nan  # two are left: too few
    assert joint_distances(points, weight)[0, 1] == np.inf


@pytest.mark.parametrize("side", ["right", "left"])
def test_gaps_to_a_box_are_those_of_the_fingertips(make_object, side):
    hand, scale, q = human_hand(side), 0.8, np.zeros(20)
    tips = scale * joint_points(hand, np.eye(4), q)[[8, 12, 16, 20]]
    obj = make_object("brick", box_mesh([0.02, 0.15, 0.15]))
    X_CO = np.eye(4)
    X_CO[0, 3] = tips[:, 0].min() - 0.02 - 0.005  # beyond the longest finger (they point to -x), 5 mm off
    fitted = FittedHand(
        X_CH=np.eye(4), q=q, scale=scale, side=side, joints_C=np.zeros((21, 3)), cloud_rms_m=0.0, joint_rms_m=0.0,
        penetration_m=0.0, confidence=1.0,
    )  # fmt: skip
    near = touch(fitted, obj, X_CO)
    assert near.nearest_m == pytest.approx(0.005, abs=1.5e-3)
    assert near.touching(0.008) == ("middle",)
    assert not near.holds(0.008)
    assert near.gap_m["palm"] == pytest.approx(-X_CO[0, 3] - 0.02 - scale * 0.16, abs=0.02)


def test_the_object_moves_where_it_leaves_its_place():
    X = np.tile(np.eye(4), (20, 1, 1))
    X[12:, 2, 3] = 0.01 * np.arange(1, 9)
    X[3] = np.nan
    assert first_motion(X, range(20), moved_m=0.025) == 14
    assert first_motion(X, range(12), moved_m=0.025) is None
    assert first_motion(np.full((4, 4, 4), np.nan), range(4), moved_m=0.01) is None
