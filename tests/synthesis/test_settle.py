"""Settling: overlap goes, fingers that touch stay, idle ones half curl and stay clear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.grasps.penetration import mesh_depths, object_depths, self_penetration
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.synthesis.candidates import VALID, close_and_assess
from neuralgrasps.synthesis.finish import kinds_of
from neuralgrasps.synthesis.propose import propose_dexterous, propose_jaw
from neuralgrasps.synthesis.settle import TOLERANCE_M, settle


def _closed(problem, count=80, seed=0):
    rng = np.random.default_rng(seed)
    if problem.hand.is_jaw:
        drawn = propose_jaw(problem.hand, problem.obj, count=count, friction=0.6, pad_depth_m=0.012, rng=rng)
    else:
        drawn = propose_dexterous(problem, count=count, friction=0.6, rng=rng)
    closed = close_and_assess(problem, drawn.X_OH, drawn.q)
    return closed.take(closed.outcome == VALID)


def _overlap(problem, X_OH, q):
    """Both ways at 2 mm, on the true mesh."""
    inside = mesh_depths(problem.hand_probe, problem.obj.mesh, problem.obj.sdf, X_OH=X_OH, q=q)
    return np.maximum(inside, object_depths(problem.hand_probe, problem.probe, X_OH=X_OH, q=q))


@pytest.mark.parametrize("name", ["panda", "barrett", "allegro", "human"])
@pytest.mark.parametrize("solid", ["box", "can"])
def test_little_overlap_is_left_and_the_hand_hardly_moves(problem_of, name, solid):
    problem = problem_of(name, solid)
    closed = _closed(problem)
    assert len(closed) > 5
    settled, _ = settle(problem, closed)
    before, after = _overlap(problem, closed.X_OH, closed.q), _overlap(problem, settled.X_OH, settled.q)
    assert before.max() > 2 * TOLERANCE_M  # there was something to mend
    assert np.percentile(after, 90) < TOLERANCE_M + 1.5e-4  # the grid is that near to the mesh
    assert np.abs(settled.X_OH - closed.X_OH).max() < 5e-3


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
def test_idle_fingers_rest_half_curled_clear_of_everything(problem_of, name):
    problem = problem_of(name, "ball")
    hand = problem.hand
    settled, idle = settle(problem, _closed(problem, count=200))
    assert idle.any() and not idle.all()
    X_HL = forward_fast(hand.tree, settled.q)
    for i in np.flatnonzero(idle.any(axis=1)):
        room = hand.tree.num_links * 3
        points, normals, links = np.empty((room, 3)), np.empty((room, 3)), np.empty(room, np.int32)
        count = find_contacts(
            *problem.sdf_arrays, problem.packed, settled.X_OH[i], X_HL[i], 1.5e-3, 3, points, normals, links
        )
        moved_by = (hand.tree.coupling[links[:count]] != 0) & idle[i]
        assert not moved_by.any()
        if self_penetration(problem.packed, X_HL[i]) <= problem.max_penetration_m:
            closing = idle[i] & (hand.closing_rate != 0)
            end = np.where(hand.closing_rate > 0, hand.tree.upper, hand.tree.lower)
            share = (settled.q[i] - hand.q_open)[closing] / (end - hand.q_open)[closing]
            assert (share <= 0.61).all()  # not a fist


@pytest.mark.parametrize("name", ["fetch", "panda"])
@pytest.mark.parametrize("solid", ["box", "can", "ball"])
def test_both_pads_of_a_jaw_stay_on_the_object(problem_of, name, solid):
    problem = problem_of(name, solid)
    settled, _ = settle(problem, _closed(problem, count=150))
    kinds = kinds_of(problem, settled.X_OH, forward_fast(problem.hand.tree, settled.q))
    assert (kinds.finger_count == 2).mean() > 0.97


def test_what_does_not_overlap_is_left_alone(problem_of):
    problem = problem_of("panda", "box")
    apart = _closed(problem).take(np.arange(3))
    apart = replace(apart, q=np.repeat(problem.hand.q_open[None], 3, axis=0))
    settled, idle = settle(problem, apart)
    np.testing.assert_array_equal(settled.q, apart.q)
    np.testing.assert_array_equal(settled.X_OH, apart.X_OH)
    assert settled.penetration_m.max() <= TOLERANCE_M and not idle.any()


def test_threads_change_nothing(problem_of):
    problem = problem_of("human", "can")
    closed = _closed(problem, count=40)
    alone, beside = settle(problem, closed), settle(problem, closed, threads=3)
    np.testing.assert_array_equal(alone[0].q, beside[0].q)
    np.testing.assert_array_equal(alone[0].X_OH, beside[0].X_OH)
    np.testing.assert_array_equal(alone[1], beside[1])
