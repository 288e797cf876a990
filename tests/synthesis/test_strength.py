"""Heavy things on a table: grasps that lift them are searched for; light things, and those in the air, as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import array_fields
from neuralgrasps.grasps.lift_capacity import edge_torques, joints_of
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.sim.table_lift import LiftConfig, try_lifts
from neuralgrasps.synthesis.candidates import VALID, Candidates, make_problem
from neuralgrasps.synthesis.contacts import contacts_of
from neuralgrasps.synthesis.propose import propose_dexterous
from neuralgrasps.synthesis.refine import assess_all
from neuralgrasps.synthesis.strength import (
    ENOUGH,
    GRAVITY,
    few_lift,
    grasp_strengths,
    is_heavy,
    lift_strengths,
    lift_torques,
    strengthen,
)
from neuralgrasps.synthesis.support import Support
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

SMALL = SynthesisConfig(count=6, batch=300, draws=2, max_rounds=2, spare=1.0, generations=1, children=3)
UP = np.array([0.0, 0.0, 1.0])
STANDING = Support(plane=Plane(UP, 0.08), clearance_m=0.004)


@pytest.fixture(scope="module")
def bottle(make_object):
    """65 x 75 x 160 mm, 100 g."""
    return make_object("bottle", box_mesh([0.0325, 0.0375, 0.08]))


def problem_with(hand, obj, mass_kg):
    return make_problem(
        hand, replace(obj, mass_kg=mass_kg), friction=0.6, torsion=0.02, contact_threshold_m=2.5e-3,
        max_penetration_m=0.5e-3, support=STANDING,
    )  # fmt: skip


@pytest.fixture(scope="module")
def drawn(hands, bottle) -> Candidates:
    problem = problem_with(hands["allegro"], bottle, 0.1)
    start = propose_dexterous(problem, count=400, friction=0.6, rng=np.random.default_rng(0))
    closed = assess_all(problem, start.X_OH, start.q)
    return closed.take(closed.outcome == VALID)


def test_strength_falls_with_the_weight(hands, bottle, drawn):
    light, heavy = (lift_strengths(problem_with(hands["allegro"], bottle, m), drawn.X_OH, drawn.q) for m in (0.6, 1.2))
    below = light < ENOUGH
    assert below.any() and light.max() > 0.2
    np.testing.assert_allclose(heavy[below], 0.5 * light[below], atol=1e-9)


def test_an_object_is_heavy_when_few_grasps_lift_it(hands, bottle, drawn):
    assert not is_heavy(problem_with(hands["allegro"], bottle, 0.05), drawn)
    assert is_heavy(problem_with(hands["allegro"], bottle, 1.2), drawn)
    assert not is_heavy(replace(problem_with(hands["allegro"], bottle, 1.2), support=None), drawn)
    assert not few_lift(np.zeros(0)) and few_lift(np.array([0.5, 0.9, 1.1])) and not few_lift(np.array([0.9, 1.1]))


def test_the_search_makes_grasps_stronger_and_keeps_them_valid(hands, bottle, drawn):
    problem = problem_with(hands["allegro"], bottle, 1.2)
    found = strengthen(problem, drawn, niches=6, rng=np.random.default_rng(1))
    strength = lift_strengths(problem, found.X_OH, found.q)
    before = np.sort(lift_strengths(problem, drawn.X_OH, drawn.q))[-6:]
    assert len(found) == 6 and (found.outcome == VALID).all() and (np.diff(strength) <= 0.0).all()
    assert np.median(strength) > 1.15 * np.median(before)
    few = strengthen(problem, drawn.take(np.arange(1)), niches=6, rng=np.random.default_rng(1))
    assert len(few) == 3  # not as many copies of one as were wanted


def test_a_squeeze_for_lifting_carries_the_weight_within_the_limits(hands, bottle, drawn):
    hand = hands["allegro"]
    problem = problem_with(hand, bottle, 0.4)
    best = int(lift_strengths(problem, drawn.X_OH, drawn.q).argmax())
    X_OH, q = drawn.X_OH[best : best + 1], drawn.q[best : best + 1]
    X_HL = forward_fast(hand.tree, q)
    points, normals, links = (a[0] for a in contacts_of(problem, X_OH, X_HL))
    touch = links >= 0
    points, normals, links = points[touch], normals[touch], links[touch]
    torques = lift_torques(problem, X_OH[0], X_HL[0], points, normals, links)
    assert (np.abs(torques) <= hand.tree.effort + 1e-7).all()
    wrenches, length = grasp_wrenches(points, normals, bottle.com_O, 0.6, 8, 0.02, problem.length), problem.length
    exerted = np.empty((len(wrenches), hand.num_dofs))
    edge_torques(joints_of(hand.tree), X_HL[0], X_OH[0], points, links, wrenches, bottle.com_O, length, 10, exerted)
    lifting = np.append(1.2 * 0.4 * GRAVITY * UP, np.zeros(3))
    # forces within the cones that these very torques exert, and whose wrench is 1.2 weights upwards
    found = linprog(
        np.ones(len(wrenches)), A_eq=np.concatenate([wrenches.T, exerted.T]), b_eq=np.append(lifting, torques)
    )
    assert found.success
    none = linprog(
        np.ones(len(wrenches)), A_eq=np.concatenate([wrenches.T, exerted.T]), b_eq=np.append(lifting, 0.5 * torques)
    )
    assert not none.success


def test_heavy_things_are_lifted(hands, bottle):
    heavy = replace(bottle, mass_kg=0.7)
    grasps = synthesise(hands["allegro"], heavy, config=SMALL, seed=0, support=STANDING).grasps
    assert len(grasps) == SMALL.count
    held = try_lifts(hands["allegro"], heavy, grasps, STANDING.plane, config=LiftConfig(friction_scale=1.0)).success
    as_light = synthesise(hands["allegro"], bottle, config=SMALL, seed=0, support=STANDING).grasps
    before = try_lifts(hands["allegro"], heavy, as_light, STANDING.plane, config=LiftConfig(friction_scale=1.0)).success
    assert held.sum() >= 4 and held.sum() > before.sum()
    strong, weak = (grasp_strengths(hands["allegro"], heavy, g, UP) for g in (grasps, as_light))
    assert np.median(strong) > np.median(weak)


@pytest.mark.parametrize("support", [None, STANDING])
def test_light_things_and_those_in_the_air_stay_as_they_are(hands, bottle, support):
    """The search for strength must not touch them: the mass changes nothing, since the protocol has its own."""
    masses = (0.02, 5.0) if support is None else (0.02, 0.05)
    one, other = (
        synthesise(hands["allegro"], replace(bottle, mass_kg=m), config=SMALL, seed=2, support=support).grasps
        for m in masses
    )
    assert len(one) == SMALL.count
    for name in array_fields():
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
