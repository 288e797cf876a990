"""All hands, loaded once; small robot files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import hand_names, load_hand


@pytest.fixture(scope="session")
def all_hands() -> dict[str, Hand]:
    return {name: load_hand(name) for name in hand_names()}


@pytest.fixture(params=hand_names())
def hand(request: pytest.FixtureRequest, all_hands: dict[str, Hand]) -> Hand:
    return all_hands[request.param]


@pytest.fixture
def random_postures() -> Callable[[Hand, int], np.ndarray]:
    def draw(hand: Hand, count: int) -> np.ndarray:
        rng = np.random.default_rng(7)
        return rng.uniform(hand.tree.lower, hand.tree.upper, (count, hand.num_dofs))

    return draw


SLIDE_JAW = """<robot name="two_slides">
  <link name="base"><collision><geometry><box size="0.1 0.12 0.08"/></geometry></collision></link>
  <link name="left"><collision><origin xyz="0.05 0 0"/>
    <geometry><box size="0.06 0.01 0.02"/></geometry></collision></link>
  <link name="right"><collision><origin xyz="0.05 0 0"/>
    <geometry><box size="0.06 0.01 0.02"/></geometry></collision></link>
  <joint name="left_slide" type="prismatic"><parent link="base"/><child link="left"/><origin xyz="0.05 0.005 0"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="30"/></joint>
  <joint name="right_slide" type="prismatic"><parent link="base"/><child link="right"/><origin xyz="0.05 -0.005 0"/>
    <axis xyz="0 1 0"/><limit lower="-0.05" upper="0" effort="30"/></joint>
</robot>"""


def three_finger_urdf(*, curl_sign: int = 1) -> str:
    """Two fingers and an opposing one on a flat palm facing -z; `curl_sign` flips the sense of every joint."""
    lower, upper = (-0.1, 1.6) if curl_sign > 0 else (-1.6, 0.1)
    palm = '<link name="palm"><collision><geometry><box size="0.08 0.1 0.03"/></geometry></collision></link>'
    text = f'<robot name="claw">{palm}'
    for name, x, y, side in (("a", 0.04, 0.03, 1), ("b", 0.04, -0.03, 1), ("c", -0.04, 0.02, -1)):
        yaw = 0 if side > 0 else np.pi
        for k, (parent, origin) in enumerate((("palm", (x, y, 0)), (f"{name}0", (0.05, 0, 0)))):
            rpy = f"0 0 {yaw}" if k == 0 else "0 0 0"
            text += (
                f'<link name="{name}{k}"><collision><origin xyz="0.025 0 0"/><geometry><box size="0.05 0.015 0.015"/>'
                f'</geometry></collision></link><joint name="{name}{k}_joint" type="revolute"><parent link="{parent}"/>'
                f'<child link="{name}{k}"/><origin xyz="{origin[0]} {origin[1]} {origin[2]}" rpy="{rpy}"/>'
                f'<axis xyz="0 {curl_sign} 0"/><limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/></joint>'
            )
    return text + "</robot>"


@pytest.fixture
def write_robot(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str, name: str = "robot.urdf") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write
