"""Does a grasp lift the object's own weight off the table it lies on, and with which squeeze?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.grasp_trial import GraspTrial, silent_engine
from neuralgrasps.sim.grip import grip_target
from neuralgrasps.sim.protocols import PROTOCOLS
from neuralgrasps.sim.validate import check_pair, verdict_parameters

LIFT = replace(
    PROTOCOLS["shake"],
    name="lift",
    hold_s=1.5,
    from_reset=True,
    max_displacement_m=0.02,
    max_rotation_rad=np.deg2rad(25),
)
"""The object's own weight and friction, pulled down for 1.5 s, once; 2 cm and 25 degrees."""
GRIPS = (1.0, 0.6)
"""Shares of the effort limits that are tried, in this order: the strongest first, since heavy things need it."""


def tried_to_lift(hand: Hand, obj: ObjectModel, grasps: GraspSet, up_O: np.ndarray) -> GraspSet:
    """The grasps with a verdict "lift", and with the squeeze that held.

    The hand closes on the floating object and then the weight acts, as when the table lets go of it.

    Args:
        up_O: (3,) unit vector up, in O.
    Returns:
        All grasps in their order; `q_squeeze` is `grip_target` of the first of `GRIPS` that held, else the strongest.
    """
    check_pair(hand, obj, grasps)
    trial = GraspTrial(hand, obj, LIFT, directions_O=-np.asarray(up_O, np.float64)[None])
    squeeze, held = grasps.q_squeeze.copy(), np.zeros(len(grasps), bool)
    moved, turned = np.full(len(grasps), np.nan), np.full(len(grasps), np.nan)
    with silent_engine():
        for i in range(len(grasps)):
            for grip in GRIPS:
                target = grip_target(hand, grasps.q[i], grasps.q_squeeze[i], grip=grip)
                outcome = trial.run(grasps.X_OH[i], grasps.q_pregrasp[i], grasps.q[i], target)
                if outcome.success or grip == GRIPS[0]:
                    squeeze[i] = target
                    moved[i], turned[i] = outcome.displacement_m, outcome.rotation_rad
                held[i] = outcome.success
                if held[i]:
                    break
    verdict = Verdict(
        success=held, displacement_m=moved, rotation_rad=turned, parameters=verdict_parameters(hand, obj, LIFT)
    )
    return replace(grasps, q_squeeze=squeeze).with_verdict(LIFT.name, verdict, decides=False)
