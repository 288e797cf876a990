"""Further starts for a fit that went wrong: poses and postures that the seen joints allow. Torch-free."""

from __future__ import annotations

from functools import cache

import numpy as np

from neuralgrasps.hands.least_squares import moved_pose
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.human.fit.problem import HandProblem, fewer_points, joints_only
from neuralgrasps.human.fit.right_hand import right_hand
from neuralgrasps.human.fit.steps import curvature, lower_costs
from neuralgrasps.seeds import child_rng

COUNT = 16
_SPREAD = 1.5  # times the deviations that the joints leave
_FAR_WIDTH_M = 0.03


def other_starts(
    problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The two most promising of `COUNT` starts round a fit to the joints: X_CH (2, 4, 4), q (2, 20), sizes (2,)."""
    X, postures = _drawn_starts(right_hand().packed, problem, X_CH, q, scale)
    sizes, cost = np.full(len(X), scale), np.empty(len(X))
    coarse = fewer_points(problem, 4)._replace(cloud_width=_FAR_WIDTH_M)
    lower_costs(right_hand().packed, coarse, X, postures, sizes, 3, 1e-2, cost)
    best = np.argsort(cost, kind="stable")[:2]
    return np.ascontiguousarray(X[best]), np.ascontiguousarray(postures[best]), sizes[best]


def _drawn_starts(
    packed: PackedHand, problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """`COUNT` starts X_CH (16, 4, 4), q (16, J), drawn round the fit to the joints alone; the same at every call.

    They are drawn from the Gaussian that the joints and the distribution of postures leave there, 1.5 times as wide:
    its thin directions are those that the joints determine, its wide ones those that points may have led astray.

    Args:
        packed: the hand of size 1; problem: what is fitted to; its cloud is not looked at.
        X_CH: (4, 4), q: (J,), scale: the fit to the joints alone.
    """
    A, _ = curvature(packed, joints_only(problem), X_CH, q, scale)
    A = A[:-1, :-1]  # the size stays
    A[np.diag_indices_from(A)] += np.where(A.diagonal() > 0.0, 1e-6, 1e6)  # a base of which no joint tells stays
    factor = np.linalg.cholesky(A)
    steps = _SPREAD * np.linalg.solve(factor.T, _normals(len(A)).T).T
    X_out, q_out = np.repeat(X_CH[None], COUNT, axis=0), np.clip(q + steps[:, 6:], packed.lower, packed.upper)
    for X, step in zip(X_out, steps, strict=True):
        moved_pose(X_CH, np.append(step[:3] * scale, step[3:6]), X)
    return X_out, q_out


@cache
def _normals(unknowns: int) -> np.ndarray:
    return child_rng(0, "starts of hand fits").standard_normal((COUNT, unknowns))
