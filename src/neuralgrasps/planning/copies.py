"""Grasps that come for free: a jaw turned by 180 degrees, and grasps carried over by an object's symmetry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.grasp_set import GraspSet, concatenate
from neuralgrasps.hands.extent import hand_extent
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel

_ALIKE_M = 1.0e-3  # the two fingers of a jaw may differ by so much and still do each other's work
_DIRECTIONS = 64


def roll_twins(hand: Hand, grasps: GraspSet) -> GraspSet:
    """The same grasps of a parallel jaw turned by half a turn about its approach axis, the fingers changing sides.

    Empty for other hands, and for jaws whose fingers differ by more than 1 mm.
    """
    turn = _half_turn(hand)
    if len(grasps) == 0 or not hand.is_jaw or not _fingers_alike(hand, turn):
        return grasps[:0]
    other = np.arange(hand.tree.num_links)
    first, second = (list(finger.links) for finger in hand.fingers)
    other[first], other[second] = second, first
    links = np.where(grasps.contact_links >= 0, other[grasps.contact_links], -1)
    return replace(grasps, X_OH=_orthonormal(grasps.X_OH @ turn), contact_links=links)


def moved_grasps(grasps: GraspSet, X_OO: np.ndarray) -> GraspSet:
    """Grasps carried along by a motion (4, 4) of the object onto itself."""
    R, t = X_OO[:3, :3], X_OO[:3, 3]
    return replace(
        grasps,
        X_OH=_orthonormal(X_OO @ grasps.X_OH),
        contact_points_O=grasps.contact_points_O @ R.T + t,
        contact_normals_O=grasps.contact_normals_O @ R.T,
    )


def symmetric_copies(obj: ObjectModel, grasps: GraspSet) -> GraspSet:
    """Grasps carried over by every rotation of the object's symmetry but the identity, rotation by rotation."""
    if len(grasps) == 0 or len(obj.symmetry) == 1:
        return grasps[:0]
    return concatenate([moved_grasps(grasps, X) for X in obj.symmetry.rotations[1:]])


def _half_turn(hand: Hand) -> np.ndarray:
    """(4, 4) half a turn about the approach axis through the middle of a jaw's pads, in H."""
    turn = np.eye(4)
    turn[:3, :3] = axis_angle_matrix(hand.X_HP[:3, 2], np.pi)
    turn[:3, 3] = hand.jaw_pad_H - turn[:3, :3] @ hand.jaw_pad_H
    return turn


def _fingers_alike(hand: Hand, turn: np.ndarray) -> bool:
    """Whether each finger of a jaw, half closed, takes the other's place when turned."""
    if len(hand.fingers) != 2 or len(hand.fingers[0].links) != len(hand.fingers[1].links):
        return False
    directions = np.random.default_rng(0).standard_normal((_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    q = np.repeat(0.5 * (hand.q_open + np.where(hand.closing_rate > 0, hand.tree.upper, hand.tree.lower))[None], 64, 0)
    first, second = (finger.links for finger in hand.fingers)
    here = hand_extent(hand, q, directions, links=first)
    there = hand_extent(hand, q, directions @ turn[:3, :3].T, links=second) - directions @ turn[:3, :3].T @ turn[:3, 3]
    return bool(np.abs(here - there).max() <= _ALIKE_M)


def _orthonormal(X: np.ndarray) -> np.ndarray:
    """X (N, 4, 4) with the nearest rotations: frames in hand files are rotations to six digits only."""
    left, _, right = np.linalg.svd(X[:, :3, :3])
    X = X.copy()
    X[:, :3, :3] = left @ right
    return X
