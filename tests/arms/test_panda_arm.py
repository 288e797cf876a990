"""The Panda model against the maker's table of joints, written out here on its own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.hands.parts import part_distances, sample_part
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

# Craig's convention: a and alpha before the joint, then d and theta. Metres, quarter turns; the last row is the flange.
DH = (
    (0.0, 0, 0.333),
    (0.0, -1, 0.0),
    (0.0, 1, 0.316),
    (0.0825, 1, 0.0),
    (-0.0825, -1, 0.384),
    (0.0, 1, 0.0),
    (0.088, 1, 0.0),
    (0.0, 0, 0.107),
)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("panda")


def _by_table(q: np.ndarray) -> list[np.ndarray]:
    """Frames of links 1 to 8 in the base."""
    X, frames = np.eye(4), []
    for (a, quarters, d), theta in zip(DH, (*q, 0.0), strict=True):
        ct, st = math.cos(theta), math.sin(theta)
        ca, sa = math.cos(quarters * math.pi / 2), math.sin(quarters * math.pi / 2)
        X = X @ np.array(
            [[ct, -st, 0, a], [st * ca, ct * ca, -sa, -d * sa], [st * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]]
        )
        frames.append(X)
    return frames


def test_link_frames_follow_the_table(arm):
    rng = np.random.default_rng(1)
    for q in rng.uniform(arm.tree.lower, arm.tree.upper, (30, 7)):
        X_BL = forward_numpy(arm.tree, q)
        for k, expected in enumerate(_by_table(q), start=1):
            assert X_BL[k] == pytest.approx(expected, abs=1e-9), k


def test_flange_poses_computed_by_hand(arm):
    def flange(*q: float) -> np.ndarray:
        return forward_numpy(arm.tree, np.array(q))[arm.flange]

    straight = flange(0, 0, 0, 0, 0, 0, 0)  # upright: 0.333 + 0.316 + 0.384 - 0.107 high, 0.088 to the front
    assert straight[:3, 3] == pytest.approx([0.088, 0, 0.926]) and straight[:3, 2] == pytest.approx([0, 0, -1])
    turned = flange(math.pi / 2, 0, 0, 0, 0, 0, 0)
    assert turned[:3, 3] == pytest.approx([0, 0.088, 0.926], abs=1e-9)
    # elbow and wrist at right angles: the forearm level at 0.333 + 0.316 + 0.0825, the flange straight down from it
    bent = flange(0, 0, 0, -math.pi / 2, 0, math.pi / 2, 0)
    assert bent[:3, 3] == pytest.approx([0.0825 + 0.384 + 0.088, 0, 0.333 + 0.316 + 0.0825 - 0.107])
    assert bent[:3, 2] == pytest.approx([0, 0, -1], abs=1e-9)


def test_limits_are_those_of_the_data_sheet(arm):
    lower = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    upper = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    assert arm.tree.lower.tolist() == lower and arm.tree.upper.tolist() == upper
    assert arm.velocity.tolist() == [2.175] * 4 + [2.61] * 3
    assert arm.acceleration.tolist() == [15, 7.5, 10, 12.5, 15, 20, 20]
    assert arm.tree.effort.tolist() == [87] * 4 + [12] * 3
    assert not arm.continuous.any() and arm.joints.tolist() == list(range(7))


def test_the_makers_hand_is_turned_by_an_eighth(arm):
    robot = mount(arm, load_hand("panda"))
    X_FH = robot.tree.X_parent_joint[robot.hand_link]
    c = math.sqrt(0.5)
    assert pytest.approx(np.array([[c, c, 0, 0], [-c, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])) == X_FH
    home = robot.hand_pose(robot.q_home[robot.arm_dofs])
    assert home[:3, 2] == pytest.approx([0, 0, -1], abs=2e-3)  # points down at home
    assert np.abs(home[:3, 1]) == pytest.approx([0, 1, 0], abs=2e-3)  # fingers move sideways


def test_links_of_the_model_join_up(arm):
    """Each link's shapes reach those of the link before it: no gaps in the arm, at any posture."""
    for q in np.random.default_rng(2).uniform(arm.tree.lower, arm.tree.upper, (5, 7)):
        X_BL = forward_numpy(arm.tree, q)
        for link in range(1, 8):
            before = [p for p in arm.parts if p.link == link - 1]
            own = np.concatenate([sample_part(p, 2e4)[0] for p in arm.parts if p.link == link])
            X = np.linalg.inv(X_BL[link - 1]) @ X_BL[link]
            gap = min(part_distances(p, own @ X[:3, :3].T + X[:3, 3]).min() for p in before)
            assert gap < 0.0, link
