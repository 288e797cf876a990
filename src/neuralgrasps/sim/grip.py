"""Servo targets that make a closed hand press with a chosen share of its motors' limits."""

from __future__ import annotations

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.tree import PRISMATIC
from neuralgrasps.sim.build import leaders
from neuralgrasps.sim.protocols import PROTOCOLS, Protocol

_JAW_BEYOND_M, _JAW_BEYOND_RAD = 0.015, 0.2  # a jaw's target lies this far past where its motor is at its limit


def grip_target(
    hand: Hand, q: np.ndarray, q_squeeze: np.ndarray, *, grip: float = 1.0, protocol: Protocol | None = None
) -> np.ndarray:
    """Targets (J,) for hand joints that are stopped by the object at about `q`.

    A jaw gets a target so far past contact that its motor stays at its limit wherever the object is; the limit itself
    (`force` of `TableTop.move_hand`) is then its grip, as in a real jaw. Other hands get `q_squeeze`, scaled so that
    the joint that uses most of its limit uses the share `grip`: the balance between the fingers stays.

    Args:
        hand: the hand. q: (J,) joints at the grasp. q_squeeze: (J,) targets of the stored grasp.
        grip: share of the effort limits, in [0, 1].
        protocol: whose servos the targets are for; default those of the table top.
    Raises:
        InputError: `grip` is outside [0, 1].
    """
    if not 0.0 <= grip <= 1.0:
        raise InputError(f"grip is {grip}; expected a share of the effort limits from 0 to 1.")
    protocol = protocol or PROTOCOLS["shake"]
    links, _, _ = leaders(hand)
    slides = hand.tree.joint_types[links] == PRISMATIC
    kp = np.where(slides, protocol.prismatic.kp, protocol.revolute.kp)
    q, q_squeeze = np.asarray(q, np.float64), np.asarray(q_squeeze, np.float64)
    if grip == 0.0:
        return q.copy()
    if hand.is_jaw:
        past = grip * hand.tree.effort / kp + np.where(slides, _JAW_BEYOND_M, _JAW_BEYOND_RAD)
        return q + np.sign(hand.closing_rate) * past
    share = np.abs(kp * (q_squeeze - q) / hand.tree.effort).max()
    return q + (q_squeeze - q) * (grip / max(float(share), 1e-9))
