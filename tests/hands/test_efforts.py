"""Torque limits: absurd ones are lowered and this is said, stated ones stay."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.hands.zoo import load_hand

from .conftest import three_finger_urdf


def _with_effort(effort: float) -> str:
    return three_finger_urdf().replace('effort="1"', f'effort="{effort}"')


def test_torques_beyond_a_finger_are_lowered_to_20_newton_at_the_tip(write_robot):
    hand = load_hand(write_robot(_with_effort(50)))
    inner, outer = hand.tree.effort[0::2], hand.tree.effort[1::2]
    assert inner == pytest.approx(20 * 0.1, rel=0.03) and outer == pytest.approx(20 * 0.05, rel=0.05)  # two 50 mm links
    assert "a0_joint 50 to 2" in hand.extra["annotated"]


def test_sensible_and_stated_torques_stay(write_robot):
    assert np.all(load_hand(write_robot(_with_effort(0.6))).tree.effort == 0.6)
    path = write_robot(_with_effort(50), "stated.urdf")
    path.with_suffix(".toml").write_text("[joints]\na0_joint = { effort = 40.0 }\n")
    assert load_hand(path).tree.effort[0] == 40.0


def test_torques_too_weak_to_hold_anything_are_doubted(write_robot):
    hand = load_hand(write_robot(_with_effort(0.01)))
    assert "less than 0.5 N at a fingertip from a0_joint" in hand.extra["annotated"]
    assert np.all(hand.tree.effort == 0.01)
