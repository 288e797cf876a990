"""What hand fits are measured by: the surface of a hand, the frames, and that a better start gives a better figure."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.evaluate.hand_fit_bench import hand_fit_figures, is_front, measure_fit, noisy_joints
from neuralgrasps.evaluate.hand_fit_frames import HandFrame, hand_frames
from neuralgrasps.evaluate.hand_surface import posed_surface, surface_rms
from neuralgrasps.geometry.camera import project
from neuralgrasps.human.seen import FittedHand
from neuralgrasps.objects.zoo import load_object


@pytest.fixture(scope="module")
def shown() -> HandFrame:
    return next(hand_frames([load_object("potted_meat_can")], count=1, seed=0))


def _as_fit(shown: HandFrame, *, shift_m: float = 0.0) -> FittedHand:
    X_CH = shown.X_CH.copy()
    X_CH[2, 3] += shift_m
    return FittedHand(
        X_CH=X_CH, q=shown.q, scale=shown.scale, side="right", joints_C=shown.joints_C, cloud_rms_m=0.0,
        joint_rms_m=0.0, penetration_m=0.0, confidence=1.0,
    )  # fmt: skip


def test_the_true_hand_is_on_its_own_surface(shown: HandFrame) -> None:
    points_C = posed_surface("right", shown.scale, shown.X_CH, shown.q)
    assert surface_rms(_as_fit(shown), points_C) < 1e-4
    assert 0.001 < surface_rms(_as_fit(shown, shift_m=0.003), points_C) < 0.003


def test_a_frame_shows_the_hand_where_it_is(shown: HandFrame) -> None:
    points_C = posed_surface("right", shown.scale, shown.X_CH, shown.q)
    front_C = points_C[is_front(shown, points_C)]
    assert len(front_C) > 100
    u, v = np.rint(project(front_C, shown.frame.intrinsics)).astype(int).T
    measured = shown.frame.depth[v, u]
    near = np.abs(measured - front_C[:, 2])[measured > 0]
    assert np.median(near) < 0.003
    overlap = (shown.mask & shown.true_mask).sum() / (shown.mask | shown.true_mask).sum()
    assert 0.75 < overlap < 0.99  # it is a mask as found, not the true one


def test_the_fit_lowers_the_error_of_the_joints(shown: HandFrame) -> None:
    seen = noisy_joints(shown, 0.01, np.random.default_rng(0))
    errors = measure_fit(shown, seen, scale=shown.scale)
    assert errors.root < 0.5 * errors.seen_root
    assert errors.surface < 0.0025


def test_figures_are_the_same_again() -> None:
    objects = [load_object("potted_meat_can")]
    first, again = (hand_fit_figures(objects, count=1, seed=0) for _ in range(2))
    assert {k: v for k, v in first.items() if k != "fit_ms"} == {k: v for k, v in again.items() if k != "fit_ms"}
    assert first["fit_rms_mm"] < 2.5
    assert first["fit_side_right"] == 1.0
