"""Where a fit of the hand starts: the palm laid on its seen joints in closed form, the fingers in usual postures."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.human.fit.fit_config import HandFitConfig
from neuralgrasps.human.fit.problem import HandProblem, joints_only
from neuralgrasps.human.fit.right_hand import right_hand, righted
from neuralgrasps.human.fit.steps import lower_costs
from neuralgrasps.human.postures import usual_postures
from neuralgrasps.human.seen import FittedHand
from neuralgrasps.human.skeleton import human_hand, joint_points

_PALM = (0, 1, 5, 9, 13, 17)  # joints that hardly move in the hand's base


def first_starts(
    problem: HandProblem, start: FittedHand | None, scale: float | None, config: HandFitConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts X_CH (N, 4, 4), q (N, 20), sizes (N,), best first: from the joints alone, and the one that is given."""
    packed, size = right_hand().packed, scale if scale is not None else config.scale_mean
    X, q, sizes = np.zeros((0, 4, 4)), np.zeros((0, 20)), np.zeros(0)
    if np.count_nonzero(problem.joint_weight) >= 4:
        X, q = hand_starts(problem.joints_C, problem.joint_weight, size)
        sizes = np.full(len(q), size)
        cost = np.empty(len(q))
        lower_costs(packed, joints_only(problem), X, q, sizes, 15, 1e-3, cost)
        order = np.argsort(cost, kind="stable")[: config.starts]
        X, q, sizes = X[order], q[order], sizes[order]
    if start is not None:
        X = np.concatenate([X, righted(start.X_CH, start.side)[None]])
        q = np.concatenate([q, np.asarray(start.q, np.float64)[None]])
        sizes = np.append(sizes, scale if scale is not None else start.scale)
    if not len(q):
        raise InputError("fewer than 4 of the 21 joints are known, and there is no start; expected 4 joints or more.")
    return np.ascontiguousarray(X), np.ascontiguousarray(q), sizes


def hand_starts(joints_C: np.ndarray, weight: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Starts of a right hand: X_CH (3, 4, 4) and q (3, 20), for the usual, the open and the closed posture.

    Args:
        joints_C: (21, 3) seen joints, metres; weight: (21,), 0 = not known; at least 4 are.
        scale: the hand's size.
    Source:
        Kabsch 1976, with weights.
    """
    postures, X = _postures(), []
    palm = np.zeros(len(weight))
    palm[list(_PALM)] = weight[list(_PALM)]
    use = palm if np.count_nonzero(palm) >= 4 else weight
    for points_H in postures.points_H:
        X.append(_laid(scale * points_H, joints_C, use / use.sum()))
    return np.array(X), postures.q.copy()


def _laid(points_H: np.ndarray, points_C: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """X_CH (4, 4), the rigid motion that brings points (K, 3) nearest to others, weights summing to 1."""
    middle_H, middle_C = weight @ points_H, weight @ points_C
    U, _, Vt = np.linalg.svd(((points_C - middle_C) * weight[:, None]).T @ (points_H - middle_H))
    turn = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = turn, middle_C - turn @ middle_H
    return X


class _Starts(NamedTuple):
    q: np.ndarray
    points_H: np.ndarray


@cache
def _postures() -> _Starts:
    """The postures (3, 20) to start from, and their joints (3, 21, 3) in the base of the right hand of size 1."""
    usual = usual_postures()
    q = np.stack([usual.mean, usual.open, usual.closed])
    return _Starts(q, joint_points(human_hand("right"), np.eye(4), q))
