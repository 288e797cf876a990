"""Improve closed grasps by local search: perturb the start, close again, keep what is better."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.parallel import blocks, thread_map
from neuralgrasps.synthesis.candidates import Candidates, GraspProblem, close_and_assess


def perturb(
    hand: Hand, seeds: Candidates, *, scale: float, children: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`children` start poses around each seed: 6 mm, 0.1 rad and 10 % of the preshape range, all times `scale`.

    Returns X_OH (N * children, 4, 4) and q (N * children, J); children of one seed are neighbours.
    """
    count = len(seeds) * children
    X_OH = np.repeat(seeds.X_OH, children, axis=0)
    turn = rng.standard_normal((count, 3)) * (0.1 * scale)
    angle = np.linalg.norm(turn, axis=1)
    R = axis_angle_matrix(turn, angle)
    palm = X_OH @ hand.X_HP
    X_OH[:, :3, :3] = R @ X_OH[:, :3, :3]
    # turn about the palm, not about the wrist
    X_OH[:, :3, 3] += palm[:, :3, 3] - (X_OH @ hand.X_HP)[:, :3, 3]
    X_OH[:, :3, 3] += rng.standard_normal((count, 3)) * (0.006 * scale)
    span = hand.preshape_upper - hand.preshape_lower
    q = np.repeat(seeds.q_start, children, axis=0)
    q = q + rng.standard_normal((count, hand.num_dofs)) * (0.1 * scale) * span
    return X_OH, np.clip(q, hand.preshape_lower, hand.preshape_upper)


def assess_all(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray, *, threads: int = 1) -> Candidates:
    """`close_and_assess` in as many blocks as threads; the result is the same for any number."""
    if problem.device != "cpu":
        return close_and_assess(problem, X_OH, q)
    rows = blocks(len(q), threads)
    return Candidates.join(thread_map(lambda b: close_and_assess(problem, X_OH[b], q[b]), rows, threads=threads))


def refine(
    problem: GraspProblem,
    seeds: Candidates,
    *,
    generations: int,
    children: int,
    rng: np.random.Generator,
    threads: int = 1,
) -> Candidates:
    """Local search without derivatives: perturb, close again, keep the better epsilon; the scale shrinks by 0.7."""
    best = seeds
    for generation in range(generations):
        X_OH, q = perturb(problem.hand, best, scale=0.7**generation, children=children, rng=rng)
        tried = assess_all(problem, X_OH, q, threads=threads)
        score = tried.epsilon.reshape(len(best), children)
        winner = score.argmax(axis=1) + np.arange(len(best)) * children
        better = tried.epsilon[winner] > best.epsilon
        index = np.where(better, len(best) + winner, np.arange(len(best)))
        best = Candidates.join([best, tried]).take(index)
    return best
