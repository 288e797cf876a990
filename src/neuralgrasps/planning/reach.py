"""How far a hand can be from the base: a bound that refuses hopeless poses without solving for them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.parts import bounding_sphere
from neuralgrasps.kinematics.forward_kernels import joint_motion
from neuralgrasps.kinematics.tree import PRISMATIC
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.chain import Chain

_Z = np.array([0.0, 0.0, 1.0])
_ROUNDING_M = 1e-6


class ReachBound(NamedTuple):
    """A point of the hand never leaves a capsule that stands in the base.

    Attributes:
        point_H: (3,) on the last axis that turns. a_B, b_B: (3,) ends of the capsule's segment: a point of the first
            axis that turns, with what slides before it at either end of its travel. radius: metres; inf = no bound.
    """

    point_H: np.ndarray
    a_B: np.ndarray
    b_B: np.ndarray
    radius: float


def bound_reach(chain: Chain) -> ReachBound:
    """The bound of a chain: links as straight as they can be, between the best points on the axes that turn.

    A point on an axis is at rest in both links that it joins, so that the distance between points on neighbouring axes
    is constant, and the hand is no farther away than their sum. Limits of turning joints are not used.
    """
    turning = np.flatnonzero(chain.is_turn)
    if not len(turning):
        return ReachBound(np.zeros(3), np.zeros(3), np.zeros(3), math.inf)
    X, travel = [], []  # from each turning axis to the next, what slides between in the middle
    at = -1
    for m in turning:
        between, slack = _between(chain, at, int(m))
        X.append(between)
        travel.append(slack)
        at = int(m)
    tail, slack = _between(chain, at, len(chain.is_turn))
    s = _shortest(X[1:])
    lengths = [np.linalg.norm(X[i][:3, :3] @ _Z * s[i] + X[i][:3, 3] - _Z * s[i - 1]) for i in range(1, len(X))]
    loose = sum(np.linalg.norm(t, axis=0).sum() for t in (*travel[1:], slack))
    centre = X[0][:3, :3] @ _Z * s[0] + X[0][:3, 3]
    sweep = travel[0][:, 0] if travel[0].shape[1] else np.zeros(3)
    loose += np.linalg.norm(travel[0][:, 1:], axis=0).sum()
    back = tail[:3, :3].T @ (_Z * s[-1] - tail[:3, 3])
    return ReachBound(back, centre - sweep, centre + sweep, float(sum(lengths) + loose + _ROUNDING_M))


def beyond_reach(bound: ReachBound, hand: Hand, obj: ObjectModel, X_BO: np.ndarray) -> float:
    """How far an object at X_BO (4, 4) certainly is out of the hand's reach, metres; 0 where it may be reached."""
    centre_B = X_BO[:3, :3] @ obj.mesh.bounds.mean(axis=0) + X_BO[:3, 3]
    size = float(np.linalg.norm(obj.mesh.extents)) / 2 + _farthest(hand, bound.point_H)
    along = bound.b_B - bound.a_B
    length2 = float(along @ along)
    t = float(np.clip((centre_B - bound.a_B) @ along / length2, 0.0, 1.0)) if length2 > 0 else 0.0
    return max(0.0, float(np.linalg.norm(centre_B - bound.a_B - t * along)) - bound.radius - size)


def _farthest(hand: Hand, point_H: np.ndarray) -> float:
    """Metres from a point of the hand base to the farthest point of the hand in any posture, at most."""
    tree = hand.tree
    span = np.zeros(tree.num_links)  # from the hand base's origin
    travel = np.abs(tree.coupling) @ np.maximum(np.abs(tree.lower), np.abs(tree.upper)) + np.abs(tree.offset)
    for i in range(1, tree.num_links):
        slide = travel[i] if tree.joint_types[i] == PRISMATIC else 0.0
        span[i] = span[tree.parents[i]] + np.linalg.norm(tree.X_parent_joint[i, :3, 3]) + slide
    spheres = [(p.link, *bounding_sphere(p)) for p in hand.parts]
    reach = max(span[link] + np.linalg.norm(centre) + radius for link, centre, radius in spheres)
    return float(reach + np.linalg.norm(point_H))


def _between(chain: Chain, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Frame (4, 4) of joint `last` (M: the hand) in what `first` (-1: the base) moves, and half travels (3, S)."""
    X, slides = np.eye(4), []
    for m in range(first + 1, last + 1):
        local = np.eye(4)
        local[:3] = chain.X_before[m] if m < len(chain.is_turn) else chain.X_tool
        X = X @ local
        if m < last:
            low, high = _range(chain, m)
            X = X @ joint_motion(PRISMATIC, _Z, 0.5 * (low + high))
            slides.append(0.5 * (high - low) * X[:3, 2])
    return X, np.array(slides).reshape(-1, 3).T


def _range(chain: Chain, m: int) -> tuple[float, float]:
    """Least and greatest position of joint m within the limits of the planned joints."""
    k = slice(chain.start[m], chain.start[m + 1])
    ends = np.stack([chain.gain[k] * chain.lower[chain.dof[k]], chain.gain[k] * chain.upper[chain.dof[k]]])
    return float(chain.offset[m] + ends.min(axis=0).sum()), float(chain.offset[m] + ends.max(axis=0).sum())


def _shortest(X: list[np.ndarray]) -> np.ndarray:
    """Places along the axes that make the sum of distances between neighbours small (reweighted least squares)."""
    count = len(X) + 1
    A, b = np.zeros((3 * len(X), count)), np.zeros(3 * len(X))
    for i, between in enumerate(X):
        rows = slice(3 * i, 3 * i + 3)
        A[rows, i], A[rows, i + 1], b[rows] = -_Z, between[:3, 2], -between[:3, 3]
    weight: np.ndarray = np.ones(len(X))
    s: np.ndarray = np.zeros(count)
    for _ in range(50):
        w = np.sqrt(np.repeat(weight, 3))
        s = np.linalg.lstsq(A * w[:, None], b * w, rcond=None)[0]
        weight = 1.0 / np.maximum(np.linalg.norm((A @ s - b).reshape(-1, 3), axis=1), 1e-4)
    return s


@njit(cache=True, error_model="numpy")
def within_reach(bound, X):  # type: ignore[no-untyped-def]
    """(N,) bool: the point of the hand at `X` (N, 4, 4) is in the capsule."""
    out = np.empty(X.shape[0], np.bool_)
    a, p = bound.a_B, bound.point_H
    ux, uy, uz = bound.b_B[0] - a[0], bound.b_B[1] - a[1], bound.b_B[2] - a[2]
    length2 = ux * ux + uy * uy + uz * uz
    for n in range(X.shape[0]):
        P = X[n]
        x = P[0, 0] * p[0] + P[0, 1] * p[1] + P[0, 2] * p[2] + P[0, 3] - a[0]
        y = P[1, 0] * p[0] + P[1, 1] * p[1] + P[1, 2] * p[2] + P[1, 3] - a[1]
        z = P[2, 0] * p[0] + P[2, 1] * p[1] + P[2, 2] * p[2] + P[2, 3] - a[2]
        t = 0.0
        if length2 > 0.0:
            t = min(max((x * ux + y * uy + z * uz) / length2, 0.0), 1.0)
        x, y, z = x - t * ux, y - t * uy, z - t * uz
        out[n] = math.sqrt(x * x + y * y + z * z) <= bound.radius
    return out
