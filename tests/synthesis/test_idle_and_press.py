"""What idle fingers do, how hard the others press, and what counts as touching."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.grasps.penetration import self_penetration
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.sim.build import grasp_model
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.synthesis.candidates import VALID, close_and_assess
from neuralgrasps.synthesis.finish import finish_grasps, kinds_of
from neuralgrasps.synthesis.propose import propose_approach, propose_dexterous
from neuralgrasps.synthesis.settle import settle

DEXTEROUS = ("barrett", "allegro", "human")
LIMIT_SHARE = 0.9  # of its torque limit that the hardest pressing joint is asked for
FIRST_REST = 0.45  # of its way from open to closed, where an idle finger rests if there is room


@pytest.fixture(scope="module")
def made(problem_of):
    """By hand: the pair, candidates settled, their idle joints, and finished."""
    cache = {}

    def get(name):
        if name not in cache:
            problem = problem_of(name, "ball")
            drawn = propose_dexterous(problem, count=300, friction=0.6, rng=np.random.default_rng(0))
            closed = close_and_assess(problem, drawn.X_OH, drawn.q)
            closed = closed.take(closed.outcome == VALID)
            grasps = finish_grasps(problem, closed, protocol="dexgraspbench", seed=0, config={})
            cache[name] = problem, *settle(problem, closed), grasps
        return cache[name]

    return get


def _idle_of(grasps, settled, idle):
    """(N, J) idle joints of finished grasps: each is one of the settled candidates, as it was."""
    same = (grasps.q[:, None] == settled.q).all(-1) & (grasps.X_OH[:, None] == settled.X_OH).all((-2, -1))
    assert same.any(axis=1).all()
    return idle[same.argmax(axis=1)]


@pytest.mark.parametrize("name", DEXTEROUS)
def test_idle_fingers_neither_press_nor_open_and_all_others_do(made, name):
    problem, settled, idle, grasps = made(name)
    idle = _idle_of(grasps, settled, idle)
    closes = problem.hand.closing_rate != 0
    assert idle.any(axis=1).sum() >= 5 and not idle[:, ~closes].any()
    np.testing.assert_array_equal(grasps.q_squeeze[idle], grasps.q[idle])
    np.testing.assert_array_equal(grasps.q_pregrasp[idle], grasps.q[idle])
    busy = ~idle & closes
    assert (grasps.q_squeeze != grasps.q)[busy].mean() > 0.99
    assert (grasps.q_pregrasp != grasps.q)[busy].mean() > 0.8


@pytest.mark.parametrize("name", DEXTEROUS)
def test_the_servos_of_the_trial_are_asked_for_their_share_of_the_limit(made, name):
    """The stiffness of the squeeze is that of the servos in physics, read from the compiled model."""
    problem, _, _, grasps = made(name)
    model = grasp_model(problem.hand, problem.obj, get_protocol("dexgraspbench"))
    torque = model.actuator_gainprm[:, 0] * (grasps.q_squeeze - grasps.q)
    largest = np.abs(torque / problem.hand.tree.effort).max(axis=1)
    assert largest.max() <= LIMIT_SHARE + 1e-6
    assert np.median(largest) == pytest.approx(LIMIT_SHARE, abs=1e-6)


@pytest.mark.parametrize("solid", ["ball", "box"])
def test_idle_fingers_do_not_relax_into_the_rest_of_the_hand(problem_of, solid):
    problem = problem_of("human", solid)
    hand, limit = problem.hand, problem.max_penetration_m
    drawn = propose_approach(problem, count=600, rng=np.random.default_rng(0))
    closed = close_and_assess(problem, drawn.X_OH, drawn.q)
    settled, idle = settle(problem, closed)
    clear = _depths_in_itself(problem, np.where(idle, closed.q, settled.q)) <= limit  # before idle fingers moved
    closed, settled, idle = closed.take(clear), settled.take(clear), idle[clear]
    assert (_depths_in_itself(problem, settled.q) <= limit).all()
    end = np.where(hand.closing_rate > 0, hand.tree.upper, hand.tree.lower)
    first_choice = np.where(idle, hand.q_open + FIRST_REST * (end - hand.q_open), settled.q)
    assert (_depths_in_itself(problem, first_choice) > limit).any()  # there was something to run into


def _depths_in_itself(problem, q):
    return np.array([self_penetration(problem.packed, X) for X in forward_fast(problem.hand.tree, q)])


@pytest.mark.parametrize(("gap_m", "fingers"), [(0.0, 2), (0.0009, 2), (0.0011, 0), (0.003, 0)])
def test_a_link_touches_that_is_within_a_millimetre(problem_of, jaw_on_axes, gap_m, fingers):
    problem = problem_of("panda", "box")
    q = np.array([[0.02 + gap_m]])  # each pad stands at q from the middle of the 40 mm box
    kinds = kinds_of(problem, jaw_on_axes(problem.hand)[None], forward_fast(problem.hand.tree, q))
    assert kinds.finger_count.tolist() == [fingers]
