"""Robots shared by the planning tests."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.manipulator import Manipulator, mount_at
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE, KinematicTree

_TURN = np.pi / 2


def _serial(
    name: str,
    frames: list[tuple[float, float, float, float]],
    tip: tuple[float, float, float],
    reach: list[float],
    *,
    types: list[int] | None = None,
    coupling: np.ndarray | None = None,
) -> Manipulator:
    """A chain of joints about z, each at (x, y, z) and a roll from the one before, limits +- `reach`."""
    joints, dofs = len(frames), len(reach)
    links = joints + 2
    X = np.tile(np.eye(4), (links, 1, 1))
    for i, (x, y, z, roll) in enumerate(frames, 1):
        X[i] = make_transform_np(rpy_matrix([roll, 0, 0]), [x, y, z])
    X[-1, :3, 3] = tip
    moving = np.arange(1, joints + 1)
    joint_types, axes = np.full(links, FIXED, np.int8), np.zeros((links, 3))
    joint_types[moving], axes[moving, 2] = types or REVOLUTE, 1.0
    rows = np.zeros((links, dofs))
    rows[moving] = np.eye(joints) if coupling is None else coupling
    tree = KinematicTree(
        link_names=tuple(f"link_{i}" for i in range(links)),
        parents=np.arange(-1, links - 1, dtype=np.int32),
        joint_names=("", *(f"joint_{i}" for i in range(1, links))),
        joint_types=joint_types,
        X_parent_joint=X,
        axes=axes,
        coupling=rows,
        offset=np.zeros(links),
        dof_names=tuple(f"dof_{j}" for j in range(dofs)),
        lower=-np.array(reach),
        upper=np.array(reach),
        effort=np.ones(dofs),
    )
    arm = Arm(
        name=name, tree=tree, parts=(), flange=links - 1, X_FM=np.eye(4), joints=np.arange(dofs),
        continuous=np.zeros(dofs, bool), q_home=np.zeros(dofs), velocity=np.ones(dofs), acceleration=np.ones(dofs),
        camera=None, table_height_m=0.0, licence="", provenance="",
    )  # fmt: skip
    return mount_at(arm, load_hand("panda"), np.eye(4))


@cache
def _robot(name: str) -> Manipulator:
    if name == "six":
        frames = [(0, 0, 0.15, 0), (0, 0, 0, _TURN), (0.43, 0, 0, 0), (0.39, 0, 0.11, 0), (0, -0.095, 0, _TURN)]
        return _serial(name, [*frames, (0, 0.08, 0, -_TURN)], (0, 0, 0.05), [2 * np.pi] * 2 + [2.9] + [2 * np.pi] * 3)
    if name == "planar":
        return _serial(name, [(0, 0, 0, 0), (0.3, 0, 0, 0), (0.2, 0, 0, 0)], (0.1, 0, 0), [2.5] * 3)
    if name == "coupled":  # dof 0 turns two hinges; dof 3 turns a hinge and pushes a slide
        frames = [(0, 0, 0.2, 0), (0, 0, 0.1, _TURN), (0.3, 0, 0, 0), (0.25, 0, 0, _TURN), (0, 0, 0.1, -_TURN)]
        frames += [(0, 0, 0.05, _TURN), (0, 0, 0.05, 0.7)]
        rows = np.zeros((7, 6))
        rows[[0, 1, 2, 3, 4, 5, 6], [0, 1, 0, 2, 3, 4, 5]] = [1, 1, -0.5, 1, 1, 0.1, 1]
        rows[5, 3] = 0.05
        types = [REVOLUTE] * 5 + [PRISMATIC, REVOLUTE]
        return _serial(name, frames, (0, 0, 0.05), [2.0] * 6, types=types, coupling=rows)
    return mount(load_arm(name), load_hand(name))


@pytest.fixture(scope="session")
def make_robot() -> Callable[[str], Manipulator]:
    """`make_robot(name)`: "fetch" or "panda" with its hand, "six" joints, a "planar" arm, or "coupled" joints."""
    return _robot
