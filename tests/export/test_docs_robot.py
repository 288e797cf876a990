"""The example of docs/robots.md does what it says, as it is printed, on a driver of a few lines."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import neuralgrasps as ng
from neuralgrasps.apply.robot import Robot
from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.planning.pick import PickPlan
from tests.export.conftest import smooth_motion

PAGE = Path(__file__).parents[2] / "docs" / "robots.md"
WIDTH_M = 0.04


class Driver:
    """An arm that is where its last motion ended, and a gripper that stops at an object, refusing what no gripper can
    do."""

    def __init__(self, q_arm: np.ndarray, width_m: float) -> None:
        self.q_arm, self.width_m, self.gap_m, self.forces = q_arm, width_m, 0.08, list[float]()

    def joint_positions(self, names: tuple[str, ...]) -> list[float]:
        return self.q_arm.tolist()

    def opening(self) -> float:
        return self.gap_m

    def depth_image(self) -> tuple[np.ndarray, tuple[float, float, float, float]]:
        return np.full((48, 64), 0.9), (60.0, 60.0, 32.0, 24.0)

    def follow(self, names: tuple[str, ...], t: np.ndarray, q: np.ndarray, qd: np.ndarray) -> None:
        assert len(t) == len(q) == len(qd) and len(names) == q.shape[1]
        self.q_arm = q[-1]

    def move_gripper(self, opening: float, *, max_force: float) -> None:
        assert 0.0 <= opening <= 0.08
        self.gap_m = max(float(opening), self.width_m)
        self.forces.append(max_force)


def blocks() -> list[str]:
    """The Python of the example: the class, and its use."""
    found = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [b for b in found if "JawRobot" in b]


@pytest.fixture
def plan(grasps_by: Callable[..., GraspSet]) -> PickPlan:
    robot = ng.mount(ng.load_arm("panda"), ng.load_hand("panda"))
    motions = [smooth_motion(robot.arm_names, seed) for seed in range(3)]
    joined = [replace(b, q=np.concatenate([a.q[-1:], b.q[1:]])) for a, b in pairwise(motions)]
    return PickPlan(
        grasp=grasps_by(robot.hand, 1), index=0, X_BH=np.eye(4), transfer=motions[0], approach=joined[0],
        lift=joined[1], q_pregrasp=np.array([0.04]), q_grasp=np.array([WIDTH_M / 2]), q_squeeze=np.array([-0.0146]),
        clearance_m=0.01,
    )  # fmt: skip


def run_example(plan: PickPlan | None, driver: Driver, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Both blocks as printed, with this plan in place of a search for one; returns the robot."""
    monkeypatch.setattr(time, "sleep", lambda s: None)
    monkeypatch.setattr(ng, "propose_pick", lambda robot, obj: SimpleNamespace(plan=plan, reason="too far away"))
    names: dict[str, Any] = {"driver": driver, "X_BC": np.eye(4)}
    for block in blocks():
        exec(compile(block, str(PAGE), "exec"), names)
    return names["robot"]


def test_it_is_short_and_offers_all_that_a_robot_must() -> None:
    described, used = blocks()
    assert len(described.splitlines()) <= 40 and "propose_pick" in used
    names: dict[str, Any] = {}
    exec(compile(described, str(PAGE), "exec"), names)
    wanted = {n for n in vars(Robot) if not n.startswith("_")} - {"manipulator"}
    assert wanted <= set(dir(names["JawRobot"]))


def test_it_picks_up_within_the_limits(plan: PickPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(plan.transfer.q[0], WIDTH_M)
    robot = run_example(plan, driver, monkeypatch)
    np.testing.assert_array_equal(driver.q_arm, plan.lift.q[-1])
    assert driver.gap_m == WIDTH_M and driver.forces == [70.0, 70.0]
    assert robot.look().depth.shape == (48, 64)
    with pytest.raises(InputError, match="plan anew"):
        robot.execute(plan.transfer)


def test_an_empty_hand_is_noticed_before_the_lift(plan: PickPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(plan.transfer.q[0], 0.0)
    with pytest.raises(SystemExit, match="nothing in the hand after 'close'"):
        run_example(plan, driver, monkeypatch)
    np.testing.assert_array_equal(driver.q_arm, plan.approach.q[-1])
    with pytest.raises(SystemExit, match="too far away"):
        run_example(None, driver, monkeypatch)
