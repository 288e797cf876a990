"""Grasps and motions to write: random, but the same every time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.export.bare_grasps import bare_grasps
from neuralgrasps.geometry.se3_numpy import make_transform_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand


def poses(count: int, seed: int = 0) -> np.ndarray:
    """(N, 4, 4) random poses; half of them have a rotation of nearly half a turn, where quaternions are delicate."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=seed)
    axes = rng.normal(size=(count, 3))
    half = Rotation.from_rotvec((np.pi - 1e-9) * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    R = np.where((np.arange(count) % 2 == 0)[:, None, None], turns.as_matrix(), half.as_matrix())
    return make_transform_np(R, rng.normal(size=(count, 3)))


def _grasps(hand: Hand, count: int = 4, seed: int = 0) -> GraspSet:
    rng = np.random.default_rng(seed)
    q = rng.uniform(hand.tree.lower, hand.tree.upper, (3, count, hand.num_dofs))
    return bare_grasps(
        hand, "box", X_OH=poses(count, seed), q_pregrasp=q[0], q=q[1], q_squeeze=q[2],
        quality=rng.uniform(0.0, 1.0, count), source="tests",
    )  # fmt: skip


@pytest.fixture(scope="session")
def grasps_by() -> Callable[..., GraspSet]:
    """`grasps_by(hand, count=4, seed=0)`: random grasps of a box."""
    return _grasps


@pytest.fixture(scope="session")
def fetch() -> Manipulator:
    return mount(load_arm("fetch"), load_hand("fetch"))


def smooth_motion(joint_names: tuple[str, ...], seed: int = 0) -> Trajectory:
    """Ten samples at uneven times that no short decimal fraction can write."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.7, 9))])
    shape = (len(t), len(joint_names))
    return Trajectory(joint_names=joint_names, t=t, q=rng.normal(size=shape), qd=rng.normal(size=shape))
