"""Grasps that a person could make of an object on a table: proven in physics, with an arm that fits behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate, empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.forearm import forearm_directions
from neuralgrasps.human.seen import Side
from neuralgrasps.human.skeleton import LARGEST, SMALLEST, human_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.grasp_cache import pair_fingerprint, remembered
from neuralgrasps.planning.resting_plane import rounded_plane
from neuralgrasps.synthesis.support import Support
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

_BATCH = 12  # grasps made at a time
_MOST_BATCHES = 3
_ROUNDS = 4
_EFFORT = 3.5  # of the wrist, at most; see `forearm_directions`
_SUPPORT_CLEARANCE_M, _RETREAT_M = 0.003, 0.06


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PersonGrasps:
    """N grasps of one object in one resting pose by a person's hand.

    Attributes:
        hand: the human hand of that size and side.
        grasps: validated by `dexgraspbench`; the easiest for the wrist first.
        forearm_H: (N, 3) unit direction from the wrist to the elbow of each, in H.
        reason: why there are fewer than wanted; "" when there are enough.
    """

    hand: Hand
    grasps: GraspSet
    forearm_H: np.ndarray
    reason: str


def person_grasps(
    obj: ObjectModel, *, scale: float, side: Side = "right", plane_O: Plane, count: int = 6, seed: int = 0
) -> PersonGrasps:
    """Validated grasps whose hand, open and closed, clears the table, and which a person's arm can reach.

    Half of those made are precision and half power grasps where the object allows both. They are kept (`remembered`):
    the first call for a hand, object and resting pose takes seconds, later ones milliseconds.

    Args:
        scale: of the hand, people's are 0.66 to 0.92; side: right or left.
        plane_O: the table in the object's frame, its normal up (see `resting_planes`).
        count: grasps wanted; there may be more. seed: of the synthesis.
    Raises:
        InputError: not a person's size, another side, or `count` below 1.
    """
    if not SMALLEST <= scale <= LARGEST:
        raise InputError(f"scale of a person's hand is {scale}; expected {SMALLEST} to {LARGEST}.")
    if count < 1:
        raise InputError(f"count is {count}; expected at least 1 grasp.")
    hand = scaled_hand(human_hand(side), scale)
    support = Support(plane=rounded_plane(plane_O, finely=True), clearance_m=_SUPPORT_CLEARANCE_M, retreat_m=_RETREAT_M)
    none = empty_grasps(hand.name, obj.name, num_joints=hand.num_dofs, seed=seed)
    kept, reason = PersonGrasps(hand=hand, grasps=none, forearm_H=np.zeros((0, 3)), reason=""), ""
    for batch in range(_MOST_BATCHES):
        made = _made(hand, obj, support, seed + 1000 * batch)
        if len(made) == 0:
            reason = made.config.get("shortfall", "")
            break
        kept = _joined(kept, _reachable(hand, obj, made, plane_O, scale))
        if len(kept.grasps) >= count:
            return kept
        reason = f"of the grasps made, only {len(kept.grasps)} leave room for a person's arm"
    return PersonGrasps(hand=hand, grasps=kept.grasps, forearm_H=kept.forearm_H, reason=reason)


def table_frame(plane_O: Plane) -> np.ndarray:
    """(4, 4) X_WO that brings the table in O to z = 0 by the smallest turn."""
    normal, X = plane_O.normal, np.eye(4)
    axis, cosine = np.cross(normal, [0.0, 0.0, 1.0]), normal[2]
    sine = float(np.linalg.norm(axis))
    if sine > 1e-9:
        X[:3, :3] = axis_angle_matrix(axis, np.arctan2(sine, cosine))
    elif cosine < 0:
        X[:3, :3] = np.diag([1.0, -1.0, -1.0])
    X[2, 3] = plane_O.offset_m
    return X


def _made(hand: Hand, obj: ObjectModel, support: Support, seed: int) -> GraspSet:
    config = SynthesisConfig(count=_BATCH, max_rounds=_ROUNDS, power_share=0.5)

    def make() -> GraspSet:
        result = synthesise(hand, obj, config=config, seed=seed, support=support)
        return result.grasps.with_config(shortfall=result.reason)

    return remembered(("person", pair_fingerprint(hand, obj), config, seed, support), make)


def _reachable(hand: Hand, obj: ObjectModel, made: GraspSet, plane_O: Plane, scale: float) -> PersonGrasps:
    X_WO = table_frame(plane_O)
    points_W = obj.points_O @ X_WO[:3, :3].T + X_WO[:3, 3]
    direction_H, effort = forearm_directions(hand, X_WO @ made.X_OH, points_W, scale=scale)
    chosen = [i for i in np.argsort(effort, kind="stable") if effort[i] <= _EFFORT]
    return PersonGrasps(hand=hand, grasps=made[chosen], forearm_H=direction_H[chosen], reason="")


def _joined(a: PersonGrasps, b: PersonGrasps) -> PersonGrasps:
    if len(a.grasps) == 0 or len(b.grasps) == 0:
        return b if len(b.grasps) else a
    return PersonGrasps(
        hand=a.hand, grasps=concatenate([a.grasps, b.grasps]),
        forearm_H=np.concatenate([a.forearm_H, b.forearm_H]), reason="",
    )  # fmt: skip
