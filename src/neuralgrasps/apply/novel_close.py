"""From decoded hands to closed ones: open what overlaps the object, draw back where that is not enough, close.

A code near a known one decodes to a hand that is nearly right: some fingers are in the object, others short of it. It
is changed as little as a closed grasp needs: fingers that overlap open until they do not, and then all close.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.synthesis.candidates import Candidates, GraspProblem, close_and_assess
from neuralgrasps.synthesis.contacts import TOUCH_M
from neuralgrasps.synthesis.settle import TOLERANCE_M, draw_apart

LARGEST_RETREAT_M = 0.03
CLOSING_OVERLAP_M = 0.003  # that closing may leave; settling takes it away
_RETREAT_M = 0.003  # at once, along the approach
_ROUNDS = 4  # of drawing apart before each step back
CHILDREN = 8  # variations that are tried before the best so far is varied further
SHIFT_M, TURN_RAD, CURL = 0.006, 0.1, 0.05  # standard deviations of variations at scale 1; curl in shares of the range
FIRST_SCALE, _GROWTH = 0.5, 1.3


@njit(cache=True, error_model="numpy", nogil=True)
def _free_all(  # type: ignore[no-untyped-def]
    values, origin, inv_spacing, fine, probe, closing, is_jaw, approach_H, tolerance, X_OH, q, left
):
    X_HL, depth = np.zeros((fine.link_radius.shape[0], 4, 4)), np.empty(fine.link_radius.shape[0])
    for i in range(q.shape[0]):
        retreat = 0.0
        while True:
            for _ in range(_ROUNDS):
                left[i] = draw_apart(
                    values, origin, inv_spacing, fine, probe, closing, is_jaw, approach_H, tolerance,
                    X_OH[i], q[i], X_HL, depth,
                )  # fmt: skip
                if left[i] <= tolerance:
                    break
            if left[i] <= tolerance or retreat >= LARGEST_RETREAT_M:
                break
            retreat += _RETREAT_M
            for k in range(3):
                for m in range(3):
                    X_OH[i, k, 3] -= _RETREAT_M * X_OH[i, k, m] * approach_H[m]


def free_hands(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (N, 4, 4) and postures (N, J) without overlap, near the given ones, and the overlap left (N,), metres.

    Joints that carry a link that overlaps open, the palm is drawn back by what it overlaps; hands that still overlap
    are drawn back along their approach, up to `LARGEST_RETREAT_M`. Hands that do not overlap are not changed.
    """
    X_OH, q, left = np.ascontiguousarray(X_OH).copy(), np.ascontiguousarray(q).copy(), np.zeros(len(q))
    _free_all(
        *problem.sdf_arrays, problem.hand_probe, problem.probe, problem.closing, problem.hand.is_jaw,
        np.ascontiguousarray(problem.hand.X_HP[:3, 2]), TOLERANCE_M, X_OH, q, left,
    )  # fmt: skip
    return X_OH, q, left


def free_and_close(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> tuple[Candidates, np.ndarray]:
    """Hands freed, closed and judged by what counts as contact when finished; and the overlap left before (N,), m."""
    X_free, q_free, left = free_hands(problem, X_OH, q)
    lenient = replace(problem, max_penetration_m=CLOSING_OVERLAP_M, contact_threshold_m=TOUCH_M)
    return close_and_assess(lenient, X_free, q_free), left


def vary(
    hand: Hand, X_OH: np.ndarray, q: np.ndarray, *, scale: float, rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """`count` hands around one: X_OH (count, 4, 4) and q (count, J), turned about the palm."""
    turn = rng.standard_normal((count, 3)) * (TURN_RAD * scale)
    R = axis_angle_matrix(turn, np.linalg.norm(turn, axis=1))
    palm_O = X_OH[:3, :3] @ hand.X_HP[:3, 3] + X_OH[:3, 3]
    out = np.repeat(X_OH[None], count, axis=0)
    out[:, :3, :3] = R @ X_OH[:3, :3]
    out[:, :3, 3] = palm_O - out[:, :3, :3] @ hand.X_HP[:3, 3] + rng.standard_normal((count, 3)) * (SHIFT_M * scale)
    span = hand.tree.upper - hand.tree.lower
    joints = q + rng.standard_normal((count, len(q))) * (CURL * scale) * span
    return out, np.clip(joints, hand.tree.lower, hand.tree.upper)


def best_variation(
    problem: GraspProblem,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    search: int,
    enough: float,
    rng: np.random.Generator,
) -> tuple[Candidates, float]:
    """The decoded hand freed and closed, or a better variation of it; and the overlap that freeing left, metres.

    Where its epsilon is below `enough`, up to `search` variations are closed too, in rounds of `CHILDREN` around the
    best hand so far, each round wider than the last, until one has enough: a good grasp stays where its code put it.

    Args:
        X_OH: (4, 4); q: (J,) as decoded. search: 0 = only the decoded hand.
    """
    best, left = free_and_close(problem, X_OH[None], q[None])
    overlap, seed_X, seed_q, scale = float(left[0]), X_OH, q, FIRST_SCALE
    while search > 0 and best.epsilon[0] < enough:
        count = min(search, CHILDREN)
        search -= count
        X_try, q_try = vary(problem.hand, seed_X, seed_q, scale=scale, rng=rng, count=count)
        tried, left = free_and_close(problem, X_try, q_try)
        winner = int(tried.epsilon.argmax())
        if tried.epsilon[winner] > best.epsilon[0]:
            best = tried.take(np.array([winner]))
            overlap, seed_X, seed_q = float(left[winner]), X_try[winner], q_try[winner]
        scale *= _GROWTH
    return best, overlap
