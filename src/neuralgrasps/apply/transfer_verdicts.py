"""What known verdicts say about a trial that ends early: what the whole trial held, it holds too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.protocols import PROTOCOLS, get_protocol
from neuralgrasps.sim.validate import current_verdicts, verdict_parameters


def whole_trial(protocol: str) -> str:
    """The preset that a protocol is the beginning of: the same, but no force ends before its time; or itself."""
    short = get_protocol(protocol)
    for name, whole in PROTOCOLS.items():
        if replace(whole, name=short.name, settled_speed=short.settled_speed) == short and whole.settled_speed == 0.0:
            return name
    return protocol


def verdict_of(hand: Hand, obj: ObjectModel, grasps: GraspSet, protocol: str) -> Mapping[str, Verdict]:
    """The verdict of a protocol by its name, where it is known with the numbers of today; else nothing.

    Until it ends, a trial that ends early is the whole one: what that held is held, and moved no farther. What it let
    fall is taken as fallen.
    """
    current = current_verdicts(hand, obj, grasps)
    if protocol in current:
        return {protocol: current[protocol]}
    whole = whole_trial(protocol)
    if whole not in current:
        return {}
    return {protocol: replace(current[whole], parameters=verdict_parameters(hand, obj, protocol))}
