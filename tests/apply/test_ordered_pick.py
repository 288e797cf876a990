"""Picks with grasps in a given order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.ordered_pick import ordered_planner, place_of
from neuralgrasps.apply.pick_up import PickUpConfig
from neuralgrasps.apply.table_scenes import scene_world, table_plane
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.grasp_set import concatenate
from neuralgrasps.planning.lift_proof import lift_proof

CONFIG = PickUpConfig()


@pytest.fixture(scope="module")
def ready(pick_scene):
    """The robot, the world, the table, and the arm's home; `plan(grasps)`."""
    world = scene_world(pick_scene.scene, 0)
    q = pick_scene.robot.q_home[pick_scene.robot.arm_dofs]

    def plan(grasps, *, table=None, seed=0):
        planner = ordered_planner(grasps)
        return planner(pick_scene.robot, world, table or table_plane(pick_scene.scene), q, CONFIG, seed)

    return plan


def _in_the_table(grasp, X_BO):
    """The same grasp, moved down through the table."""
    down_O = X_BO[:3, :3].T @ np.array([0.0, 0.0, -0.3])
    X = grasp.X_OH.copy()
    X[:, :3, 3] += down_O
    return replace(grasp, X_OH=X)


def _able(pick_scene, ready):
    """Some stored grasps that lead to a plan as they are, and lift the object with less friction too."""
    placed = pick_scene.scene.objects[0]
    plane_O = table_plane(pick_scene.scene).moved(np.linalg.inv(placed.X_BO))
    proof = lift_proof(pick_scene.robot.hand, placed.obj, plane_O, friction_scale=0.75, grip=1.0)
    found = []
    for k in range(len(pick_scene.grasps)):
        one = pick_scene.grasps[[k]]
        result, _, _ = ready(one)
        if result is not None and result.plan is not None and result.plan.index == 0 and proof(one):
            found.append(k)
        if len(found) == 3:
            break
    return found


def test_the_first_that_can_be_done_is_taken_in_any_order(pick_scene, ready):
    able = _able(pick_scene, ready)
    assert len(able) == 3
    for order in (able, able[::-1], able[1:] + able[:1]):
        result, reason, _ = ready(pick_scene.grasps[order])
        assert reason == "" and result.plan.index == 0
        np.testing.assert_allclose(result.plan.grasp.q, pick_scene.grasps.q[[order[0]]], atol=1e-12)


def test_what_cannot_be_done_is_passed_over(pick_scene, ready):
    grasps = pick_scene.grasps
    able = _able(pick_scene, ready)[0]
    X_BO = pick_scene.scene.objects[0].X_BO
    bad = _in_the_table(grasps[[able]], X_BO)
    result, _, _ = ready(concatenate([bad, bad, grasps[[able]]]))
    assert place_of(result.plan.index, 3) == 2
    level = table_plane(pick_scene.scene)
    none, reason, _ = ready(bad, table=Plane(level.normal, level.offset_m - 0.8))  # above all of them
    assert none is None and "none of the 1 transferred grasps clears the table" in reason


def test_no_grasps_and_an_object_out_of_reach_are_said(pick_scene, ready):
    _, reason, _ = ready(pick_scene.grasps[:0])
    assert reason == "no grasp was transferred."
    world = scene_world(pick_scene.scene, 0)
    X = world.target.X_BO.copy()
    X[0, 3] += 3.0
    far = replace(world, target=replace(world.target, X_BO=X))
    q = pick_scene.robot.q_home[pick_scene.robot.arm_dofs]
    result, reason, _ = ordered_planner(pick_scene.grasps)(
        pick_scene.robot, far, table_plane(pick_scene.scene), q, CONFIG, 0
    )
    assert result is None and "out of reach" in reason


def test_the_same_seed_gives_the_same_plan(pick_scene, ready):
    a, b = (ready(pick_scene.grasps, seed=3)[0].plan for _ in range(2))
    assert a.index == b.index
    np.testing.assert_array_equal(a.transfer.q, b.transfer.q)


def test_copies_by_symmetry_are_asked_when_nothing_given_can_be_done(pick_scene, ready):
    """Grasps that only a turned copy of makes reachable: the box cannot be told from its turned self."""
    obj = pick_scene.scene.objects[0].obj
    assert len(obj.symmetry) > 1
    indices = [ready(pick_scene.grasps[[k]])[0] for k in range(25)]
    places = [r.plan.index for r in indices if r is not None and r.plan is not None]
    assert set(places) == {0, 1}  # one grasp was given: 1 is a copy of it
    assert {place_of(k, 1) for k in places} == {0}


def test_a_tilted_table_needs_no_proof(pick_scene, ready):
    tilt = axis_angle_matrix(np.array([1.0, 0.0, 0.0]), np.radians(12.0))
    level = table_plane(pick_scene.scene)
    point = pick_scene.scene.objects[0].X_BO[:3, 3]
    normal = tilt @ level.normal
    leaning = Plane(normal, float(-(normal @ (point - level.height(point) * level.normal))))
    result, _, _ = ready(pick_scene.grasps, table=leaning)
    assert result is None or result.proof_cpu_s == 0.0
