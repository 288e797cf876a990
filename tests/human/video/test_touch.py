"""How near a bent hand of either side is to a box, against its mesh."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.seen import FittedHand
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.human.video.grasp_moment import touch

HALF = np.array([0.03, 0.04, 0.05])


def box_distance(points: np.ndarray) -> np.ndarray:
    off = np.abs(points) - HALF
    return np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(off.max(axis=1), 0.0)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("seed", range(4))
def test_gaps_are_those_of_the_mesh(make_object, side, seed):
    rng, hand = np.random.default_rng(seed), scaled_hand(human_hand(side), 0.8)
    q = rng.uniform(hand.tree.lower, hand.tree.upper)
    left, _, right = np.linalg.svd(rng.normal(size=(3, 3)))
    X_OH, X_CO = np.eye(4), np.eye(4)
    X_OH[:3, :3] = left @ right * np.linalg.det(left @ right)
    mesh = hand_mesh(hand, q, segments=24).vertices
    X_OH[:3, 3] = rng.uniform(-0.05, 0.05, 3) - X_OH[:3, :3] @ mesh.mean(axis=0) + [0.12, 0.0, 0.0]
    X_CO[:3, 3] = [0.1, -0.05, 0.6]
    fitted = FittedHand(
        X_CH=X_CO @ X_OH, q=q, scale=0.8, side=side, joints_C=np.zeros((21, 3)), cloud_rms_m=0.0, joint_rms_m=0.0,
        penetration_m=0.0, confidence=1.0,
    )  # fmt: skip
    expected = box_distance(mesh @ X_OH[:3, :3].T + X_OH[:3, 3]).min()
    found = touch(fitted, make_object("brick", box_mesh(HALF)), X_CO).nearest_m
    assert found == pytest.approx(expected, abs=0.006)  # points every 6 mm
