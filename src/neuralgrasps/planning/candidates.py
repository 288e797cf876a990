"""Which stored grasps can be used in a scene, and in which order to try them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import HandSurface, sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.planning.world import PlacedObject, PlanningWorld, box_distance
from neuralgrasps.synthesis.jaw import jaw_aperture, jaw_widths, leaves_room
from neuralgrasps.synthesis.strength import grasp_strengths

_SPACING_M = 0.012  # of the hand points of this first, coarse test; what passes is checked exactly later
_FULL_CLEARANCE_M = 0.02  # more of it is not better
_LEVER_M = 0.05  # a centre of mass so far from a jaw's axis costs as much as the best clearance gives
_WEIGHTS = {
    "clearance": 1.0,
    "epsilon": 0.5,
    "lever": 1.0,
    "room": 0.5,
    "shake": 1.0,
    "strength": 2.0,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RankedCandidates:
    """Candidates of one scene, best first.

    Attributes:
        index: (K,) into the grasps that were ranked.
        score: (K,) falling; clearance_m: (K,) of the hand, open and closed, to boxes and other objects, at points
            12 mm apart.
        dropped: how many fell out, by reason.
    """

    index: np.ndarray
    score: np.ndarray
    clearance_m: np.ndarray
    dropped: dict[str, int]


def rank_candidates(
    manipulator: Manipulator,
    grasps: GraspSet,
    world: PlanningWorld,
    *,
    clearance_m: float,
    preference: np.ndarray | None = None,
    preference_weight: float = 1.0,
) -> RankedCandidates:
    """Drop grasps that the scene rules out and order the others.

    The score sums: clearance, saturating at 2 cm; epsilon; for jaws room beside the object, less the lever of gravity
    about the line between the pads; whether the object's own weight was held in the "shake" trial, where that is known;
    how much of it the hand can lift by its contacts and motors, saturating at 1.5 weights; and the caller's preference.

    Args:
        grasps: of `world.target`. clearance_m: least distance of the hand to boxes and other objects.
        preference: (N,) 0 to 1, larger is better, as a retrieval gives it; None: no preference.
        preference_weight: of it, against 1 for the best clearance; a large one makes the preference the order.
    """
    target = world.target
    assert target is not None
    hand = manipulator.hand
    X_BH = target.X_BO @ grasps.X_OH
    clearance = _clearance(manipulator, X_BH, grasps, world)
    fits = leaves_room(hand, grasps.q)
    clear = clearance >= clearance_m
    kept = np.flatnonzero(fits & clear)
    score = _score(hand, grasps, target, X_BH, clearance)
    if preference is not None:
        score = score + preference_weight * np.asarray(preference, float)
    order = kept[np.argsort(-score[kept], kind="stable")]
    dropped = {"too wide for the jaw": int((~fits).sum()), "hand hits what is around": int((fits & ~clear).sum())}
    return RankedCandidates(index=order, score=score[order], clearance_m=clearance[order], dropped=dropped)


def _score(
    hand: Hand,
    grasps: GraspSet,
    target: PlacedObject,
    X_BH: np.ndarray,
    clearance: np.ndarray,
) -> np.ndarray:
    score = _WEIGHTS["clearance"] * np.clip(clearance / _FULL_CLEARANCE_M, 0.0, 1.0)
    score = score + _WEIGHTS["epsilon"] * grasps.epsilon
    score += _WEIGHTS["strength"] * grasp_strengths(hand, target.obj, grasps, target.X_BO[2, :3])
    if hand.is_jaw:
        score += _WEIGHTS["room"] * (1.0 - jaw_widths(hand, grasps.q) / jaw_aperture(hand))
        score -= _WEIGHTS["lever"] * gravity_lever(hand, target, X_BH) / _LEVER_M
    if "shake" in grasps.verdicts:
        score += _WEIGHTS["shake"] * grasps.verdicts["shake"].success
    return np.asarray(score)


def gravity_lever(hand: Hand, target: PlacedObject, X_BH: np.ndarray) -> np.ndarray:
    """(N,) lever arm, metres, of the object's weight about the line through a jaw's pads; 0 below or above the line."""
    axis = X_BH[:, :3, :3] @ hand.X_HP[:3, 0]
    pad = transform_points_np(X_BH, hand.jaw_pad_H[None])[:, 0]
    com = target.X_BO[:3, :3] @ target.obj.com_O + target.X_BO[:3, 3]
    return np.asarray(np.abs((np.cross(com - pad, [0.0, 0.0, 1.0]) * axis).sum(axis=1)))


def _clearance(manipulator: Manipulator, X_BH: np.ndarray, grasps: GraspSet, world: PlanningWorld) -> np.ndarray:
    """(N,) least distance of the hand at its pre-grasp and grasp postures to boxes and other objects."""
    surface = _coarse_surface(manipulator)
    least = np.full(len(grasps), np.inf)
    for q in (grasps.q_pregrasp, grasps.q):
        X_BL = X_BH[:, None] @ forward_fast(manipulator.hand.tree, q)
        X = X_BL[:, surface.links]
        points_B = np.einsum("nkij,kj->nki", X[..., :3, :3], surface.points_L) + X[..., :3, 3]
        for box in world.boxes:
            least = np.minimum(least, box_distance(box, points_B).min(axis=1))
        for other in world.objects:
            points_O = transform_points_np(inverse_np(other.X_BO), points_B.reshape(-1, 3))
            distance = query_grid_numpy(other.obj.sdf, points_O).reshape(points_B.shape[:2])
            least = np.minimum(least, distance.min(axis=1))
    return least


@lru_cache(maxsize=16)
def _coarse_surface(manipulator: Manipulator) -> HandSurface:
    return sample_hand_surface(manipulator.hand, spacing=_SPACING_M)
