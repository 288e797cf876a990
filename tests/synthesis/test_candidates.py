"""Closed hands are judged rightly, and refinement never makes one worse."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.grasps.penetration import penetration_depths
from neuralgrasps.grasps.quality import QualityConfig, grasp_quality
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.synthesis.candidates import (
    COLLIDES,
    FEW_CONTACTS,
    SELF_COLLIDES,
    VALID,
    Candidates,
    close_and_assess,
)
from neuralgrasps.synthesis.propose import propose_dexterous, propose_jaw
from neuralgrasps.synthesis.refine import perturb, refine


def _closed(problem, count=300, seed=0) -> Candidates:
    rng = np.random.default_rng(seed)
    if problem.hand.is_jaw:
        drawn = propose_jaw(problem.hand, problem.obj, count=count, friction=0.6, pad_depth_m=0.01, rng=rng)
    else:
        drawn = propose_dexterous(problem, count=count, friction=0.6, rng=rng)
    return close_and_assess(problem, drawn.X_OH, drawn.q)


@pytest.mark.parametrize("name", ["panda", "barrett"])
def test_valid_grasps_are_force_closed_and_free_of_overlap_by_the_plain_measures(problem_of, name):
    problem = problem_of(name, "can")
    closed = _closed(problem)
    valid = closed.take(closed.outcome == VALID)
    assert len(valid) > 20
    packed = pack_hand(problem.hand, spacing=0.0033)  # finer than what closed them
    depths = penetration_depths(packed, problem.obj.sdf, problem.obj.points_O, X_OH=valid.X_OH, q=valid.q)
    assert np.quantile(depths.deepest, 0.95) < problem.max_penetration_m + 3e-4
    quality = grasp_quality(
        problem.hand, problem.packed, problem.obj, X_OH=valid.X_OH, q=valid.q,
        config=QualityConfig(friction=0.6, torsion_m=0.02),
    )  # fmt: skip
    assert (quality.epsilon > 0).mean() > 0.95
    agree = np.isclose(quality.epsilon, valid.epsilon, rtol=0.05, atol=1e-3)
    assert agree.mean() > 0.9
    assert (valid.epsilon > 0).all() and (valid.penetration_m <= problem.max_penetration_m).all()
    assert (closed.epsilon[closed.outcome != VALID] == 0).all()


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
def test_the_thumb_makes_most_hands_valid(problem_of, name):
    """What opposed proposals, fine closing and idle fingers brought; a tenth of it before."""
    closed = _closed(problem_of(name, "can"))
    assert (closed.outcome == VALID).mean() > 0.3
    assert (closed.outcome == COLLIDES).sum() == 0
    assert (closed.outcome == SELF_COLLIDES).mean() < 0.1


def test_the_epsilon_of_a_jaw_on_a_box_does_not_depend_on_the_frame_of_the_hand(hands, problem_of, jaw_on_axes):
    problem, hand = problem_of("panda", "box"), hands["panda"]
    half_turned = jaw_on_axes(hand) @ hand.X_HP @ np.diag([-1.0, -1, 1, 1]) @ np.linalg.inv(hand.X_HP)
    closed = close_and_assess(problem, np.stack([jaw_on_axes(hand), half_turned]), np.repeat(hand.q_open[None], 2, 0))
    assert (closed.outcome == VALID).all()
    assert closed.epsilon[0] == pytest.approx(closed.epsilon[1], rel=0.05)


def test_outcomes_of_known_cases(hands, problem_of, jaw_on_axes):
    jaw = hands["panda"]
    beside = jaw_on_axes(jaw, (0.0, 0.5, 0.0))
    closed = close_and_assess(problem_of("panda", "box"), beside[None], jaw.q_open[None])
    assert closed.outcome.tolist() == [COLLIDES]
    human = hands["human"]
    far, inside = np.eye(4), np.eye(4)
    far[0, 3] = 3.0
    closed = close_and_assess(problem_of("human", "cube"), np.stack([far, inside]), human.q_open[None].repeat(2, 0))
    assert closed.outcome.tolist() == [FEW_CONTACTS, COLLIDES]


def test_the_arguments_are_left_as_they_were(problem_of):
    problem = problem_of("panda", "box")
    drawn = propose_jaw(
        problem.hand, problem.obj, count=100, friction=0.6, pad_depth_m=0.01, rng=np.random.default_rng(0)
    )
    X, q = drawn.X_OH.copy(), drawn.q.copy()
    closed = close_and_assess(problem, drawn.X_OH, drawn.q)
    np.testing.assert_array_equal(drawn.X_OH, X)
    np.testing.assert_array_equal(drawn.q, q)
    np.testing.assert_array_equal(closed.q_start, q)
    assert (closed.X_OH != X).any()


def test_one_candidate_and_none_are_fine(problem_of):
    problem = problem_of("allegro", "can")
    closed = _closed(problem)
    one = closed.take(np.flatnonzero(closed.outcome == VALID)[:1])
    better = refine(problem, one, generations=2, children=4, rng=np.random.default_rng(0))
    assert len(better) == 1 and better.epsilon[0] >= one.epsilon[0]
    none = close_and_assess(problem, np.zeros((0, 4, 4)), np.zeros((0, 16)))
    assert len(none) == 0 and none.outcome.dtype == np.int8
    assert len(Candidates.join([none, one])) == 1


def test_a_batch_equals_one_by_one(problem_of):
    problem = problem_of("barrett", "box")
    drawn = propose_dexterous(problem, count=40, friction=0.6, rng=np.random.default_rng(0))
    batch = close_and_assess(problem, drawn.X_OH, drawn.q)
    for i in range(0, len(drawn.q), 7):
        single = close_and_assess(problem, drawn.X_OH[i : i + 1], drawn.q[i : i + 1])
        np.testing.assert_array_equal(single.q[0], batch.q[i])
        assert single.epsilon[0] == batch.epsilon[i] and single.outcome[0] == batch.outcome[i]


@pytest.mark.parametrize("name", ["panda", "allegro"])
def test_refinement_never_loses_what_was_better(problem_of, name):
    problem = problem_of(name, "box")
    closed = _closed(problem)
    seeds = closed.take(np.flatnonzero(closed.outcome == VALID)[:20])
    best = seeds
    for generations in (1, 2, 3):
        refined = refine(problem, seeds, generations=generations, children=5, rng=np.random.default_rng(1))
        assert len(refined) == len(seeds)
        assert (refined.epsilon >= best.epsilon).all()  # the same generator: each goes on from the last
        assert (refined.outcome == VALID).all()
        best = refined
    assert np.median(best.epsilon) > 1.1 * np.median(seeds.epsilon)
    unchanged = best.epsilon == seeds.epsilon
    np.testing.assert_array_equal(best.X_OH[unchanged], seeds.X_OH[unchanged])
    again = close_and_assess(problem, best.X_OH, best.q)  # closed hands stay closed: nothing to move
    if not problem.hand.is_jaw:
        np.testing.assert_allclose(again.q, best.q, atol=0.06)
    none = refine(problem, seeds, generations=0, children=5, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(none.epsilon, seeds.epsilon)


def test_perturbed_starts_are_near_turn_about_the_palm_and_keep_the_preshape_range(problem_of):
    problem = problem_of("human", "can")
    hand = problem.hand
    closed = _closed(problem)
    seeds = closed.take(np.arange(50))
    X_OH, q = perturb(hand, seeds, scale=0.5, children=40, rng=np.random.default_rng(0))
    assert X_OH.shape == (2000, 4, 4)
    parent = np.repeat(seeds.X_OH, 40, 0)
    shift = (X_OH @ hand.X_HP)[:, :3, 3] - (parent @ hand.X_HP)[:, :3, 3]
    np.testing.assert_allclose(shift.std(axis=0), 0.003, rtol=0.1)
    turn = X_OH[:, :3, :3] @ parent[:, :3, :3].transpose(0, 2, 1)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.sqrt((angle**2).mean()) == pytest.approx(0.05 * np.sqrt(3), rel=0.1)
    assert (q >= hand.preshape_lower).all() and (q <= hand.preshape_upper).all()
    exact, _ = perturb(hand, seeds, scale=1e-6, children=2, rng=np.random.default_rng(0))
    np.testing.assert_allclose(exact, np.repeat(seeds.X_OH, 2, 0), atol=1e-6)
