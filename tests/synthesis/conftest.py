"""Hands and solids of known answers for the synthesis tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.candidates import GraspProblem, make_problem


@pytest.fixture(scope="session")
def hands() -> dict[str, Hand]:
    return {name: load_hand(name) for name in ("panda", "fetch", "barrett", "allegro", "human")}


@pytest.fixture(scope="session")
def solids(make_object: Callable[..., ObjectModel]) -> dict[str, ObjectModel]:
    return {
        "ball": make_object("ball", sphere_mesh(0.03, segments=48)),
        "box": make_object("box", box_mesh([0.02, 0.03, 0.05])),
        "can": make_object("can", cylinder_mesh(0.033, 0.05, segments=48)),
        "cube": make_object("cube", box_mesh([0.15, 0.15, 0.15])),
    }


@pytest.fixture(scope="session")
def problem_of(hands: dict[str, Hand], solids: dict[str, ObjectModel]) -> Callable[[str, str], GraspProblem]:
    made: dict[tuple[str, str], GraspProblem] = {}

    def get(hand: str, obj: str) -> GraspProblem:
        if (hand, obj) not in made:
            made[hand, obj] = make_problem(
                hands[hand], solids[obj], friction=0.6, torsion=0.02, contact_threshold_m=2.5e-3, max_penetration_m=1e-3
            )
        return made[hand, obj]

    return get


@pytest.fixture(scope="session")
def jaw_on_axes() -> Callable[..., np.ndarray]:
    """Pose that puts the pads' middle at `centre`, closing along x and approaching along y of the object."""

    def pose(hand: Hand, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
        X_OP = np.eye(4)
        X_OP[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
        X_OP[:3, 3] = centre
        X_HP = hand.X_HP.copy()
        X_HP[:3, 3] = hand.jaw_pad_H
        return X_OP @ np.linalg.inv(X_HP)

    return pose
