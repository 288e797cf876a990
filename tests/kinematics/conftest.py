"""Trees and files shared by the kinematics tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.geometry.se3_numpy import make_transform_np, quaternion_matrix
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE, KinematicTree


def make_random_tree(seed: int, *, links: int = 12, dofs: int = 5) -> KinematicTree:
    """A random tree with all joint types, offsets, and couplings of several joints to several dofs."""
    rng = np.random.default_rng(seed)
    types = rng.choice([FIXED, REVOLUTE, PRISMATIC], links, p=[0.2, 0.5, 0.3]).astype(np.int8)
    types[0] = FIXED
    axes = rng.normal(size=(links, 3))
    axes = np.where(types[:, None] == FIXED, 0.0, axes / np.linalg.norm(axes, axis=1, keepdims=True))
    rotations = quaternion_matrix(rng.normal(size=(links, 4)))
    X_parent_joint = make_transform_np(rotations, rng.normal(scale=0.1, size=(links, 3)))
    X_parent_joint[0] = np.eye(4)
    moving = (types != FIXED)[:, None]
    return KinematicTree(
        link_names=tuple(f"link_{i}" for i in range(links)),
        parents=np.array([-1, *(rng.integers(0, i) for i in range(1, links))], np.int32),
        joint_names=("", *(f"joint_{i}" for i in range(1, links))),
        joint_types=types,
        X_parent_joint=X_parent_joint,
        axes=axes,
        coupling=np.where(moving, rng.normal(size=(links, dofs)) * rng.integers(0, 2, (links, dofs)), 0.0),
        offset=np.where(moving[:, 0], rng.normal(size=links), 0.0),
        dof_names=tuple(f"dof_{j}" for j in range(dofs)),
        lower=-np.ones(dofs),
        upper=np.ones(dofs),
        effort=np.ones(dofs),
    )


@pytest.fixture
def random_tree() -> Callable[..., KinematicTree]:
    return make_random_tree


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    """Write a text file in the test's own folder and return its path."""

    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write_file


@pytest.fixture
def two_link_arm() -> KinematicTree:
    """A planar arm in x-y: hinge about z, 0.3 m, hinge about z, 0.2 m to the fixed tip."""
    X = np.tile(np.eye(4), (4, 1, 1))
    X[2, 0, 3], X[3, 0, 3] = 0.3, 0.2
    return KinematicTree(
        link_names=("base", "upper", "fore", "tip"),
        parents=np.array([-1, 0, 1, 2], np.int32),
        joint_names=("", "shoulder", "elbow", "wrist"),
        joint_types=np.array([FIXED, REVOLUTE, REVOLUTE, FIXED], np.int8),
        X_parent_joint=X,
        axes=np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 0]]),
        coupling=np.array([[0.0, 0], [1, 0], [0, 1], [0, 0]]),
        offset=np.zeros(4),
        dof_names=("shoulder", "elbow"),
        lower=np.full(2, -3.0),
        upper=np.full(2, 3.0),
        effort=np.ones(2),
    )
