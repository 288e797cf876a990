"""The simulator as a robot: what it measures, what it alone knows, and what counts as a hit."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.apply.robot import Robot
from neuralgrasps.apply.simulated_robot import SimulatedRobot
from neuralgrasps.apply.table_scenes import TableScene
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.planning.timing import time_path
from neuralgrasps.planning.world import PlacedObject


@pytest.fixture
def brick(make_object):
    return make_object("brick", box_mesh([0.03, 0.045, 0.06]))


def beside(pick_scene, brick, *, y: float = -0.2) -> TableScene:
    X = np.eye(4)
    X[:3, 3] = [0.75, y, pick_scene.robot.arm.table_height_m + 0.06]
    return TableScene(
        table=pick_scene.scene.table, objects=(*pick_scene.scene.objects, PlacedObject(obj=brick, X_BO=X)), seed=0
    )


def motion(robot, q: list[np.ndarray]) -> Trajectory:
    m = robot.manipulator
    return time_path(np.stack(q), joint_names=m.arm_names, velocity=m.velocity, acceleration=m.acceleration, speed=0.7)


def test_it_does_what_it_is_asked(pick_scene) -> None:
    simulated = SimulatedRobot(pick_scene.robot, pick_scene.scene)
    robot: Robot = simulated
    assert simulated.settle()
    start = robot.state()
    np.testing.assert_allclose(start.q_arm, pick_scene.q_start, atol=1e-4)
    goal = pick_scene.q_start + 0.2
    goal[0] = pick_scene.q_start[0] + 0.05
    asked = motion(robot, [pick_scene.q_start, goal])
    robot.execute(asked)
    robot.wait(0.5)
    np.testing.assert_allclose(robot.state().q_arm, goal, atol=2e-3)
    assert robot.state().time_s - start.time_s == pytest.approx(asked.duration_s + 0.5, abs=0.01)
    half = 0.5 * robot.manipulator.hand.q_open
    robot.move_hand(half, duration_s=0.5)
    robot.wait(0.3)
    np.testing.assert_allclose(robot.state().q_hand, half, atol=1e-3)
    np.testing.assert_allclose(simulated.object_pose(0), pick_scene.scene.objects[0].X_BO, atol=2e-3)


def test_a_look_is_a_depth_image_from_the_head(pick_scene) -> None:
    simulated = SimulatedRobot(pick_scene.robot, pick_scene.scene, seed=4)
    first, second = simulated.look(), simulated.look()
    np.testing.assert_allclose(first.X_WC, pick_scene.robot.camera_pose(pick_scene.q_start), atol=1e-6)
    assert not np.array_equal(first.depth, second.depth)  # every look draws its noise anew
    again = SimulatedRobot(pick_scene.robot, pick_scene.scene, seed=4)
    np.testing.assert_array_equal(again.look().depth, first.depth)
    np.testing.assert_array_equal(again.look().depth, second.depth)
    points_B = transform_points_np(first.X_WC, first.points[first.depth > 0])
    box = pick_scene.scene.objects[0]
    middle = box.obj.mesh.bounds.mean(axis=0)
    near = np.linalg.norm(points_B - transform_points_np(box.X_BO, middle[None])[0], axis=1) < 0.06
    assert near.sum() > 500


def test_an_error_of_calibration_moves_where_the_camera_is_believed_to_be(pick_scene) -> None:
    true = SimulatedRobot(pick_scene.robot, pick_scene.scene, seed=4).look()
    for off_m, off_rad in ((0.005, 0.0), (0.0, 0.02), (0.003, 0.01)):
        off = SimulatedRobot(
            pick_scene.robot, pick_scene.scene, seed=4, camera_off_m=off_m, camera_off_rad=off_rad
        ).look()
        np.testing.assert_array_equal(off.depth, true.depth)
        error = inverse_np(true.X_WC) @ off.X_WC
        assert np.linalg.norm(error[:3, 3]) == pytest.approx(off_m, abs=1e-9)
        angle = np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1))
        assert angle == pytest.approx(off_rad, abs=1e-6)


def test_what_is_taken_away_is_gone(pick_scene, brick) -> None:
    simulated = SimulatedRobot(pick_scene.robot, beside(pick_scene, brick))
    simulated.settle()
    both = simulated.true_world(0)
    assert both.target.obj.name == "gelatin_box" and [p.obj.name for p in both.objects] == ["brick"]
    np.testing.assert_allclose(both.objects[0].X_BO, simulated.object_pose(1))
    before = simulated.look()
    simulated.take_away(0)
    assert not simulated.is_on_table(0) and simulated.is_on_table(1)
    assert simulated.true_world(1).target.obj.name == "brick" and simulated.true_world(1).objects == ()
    assert [p.obj.name for p in simulated.true_world().objects] == ["brick"]
    simulated.wait(1.0)
    at = simulated.object_pose(0)[:3, 3]
    assert np.linalg.norm(at - pick_scene.scene.objects[0].X_BO[:3, 3]) > 3.0
    shown = np.abs(simulated.look().depth - before.depth) > 0.02
    assert shown.sum() > 300  # the camera sees the table where it stood
    np.testing.assert_allclose(simulated.object_pose(1), both.objects[0].X_BO, atol=1e-3)


def test_a_thing_that_floats_does_not_settle_where_it_was_put(pick_scene) -> None:
    placed = pick_scene.scene.objects[0]
    high = placed.X_BO.copy()
    high[2, 3] += 0.02
    scene = TableScene(table=pick_scene.scene.table, objects=(PlacedObject(obj=placed.obj, X_BO=high),), seed=0)
    assert not SimulatedRobot(pick_scene.robot, scene).settle()


def test_hits_are_what_should_not_touch(pick_scene, brick) -> None:
    """The arm sweeps a brick that stands where the hand goes: a hit, unless the brick is what it should pick."""
    at = pick_scene.plan.X_BH[:3, 3]
    scene = beside(pick_scene, brick, y=float(at[1]))
    scene = TableScene(table=scene.table, objects=scene.objects[1:], seed=0)
    simulated = SimulatedRobot(pick_scene.robot, scene)
    simulated.settle()
    simulated.phase("sweep")
    simulated.execute(pick_scene.plan.transfer)
    simulated.execute(pick_scene.plan.approach)
    hits = simulated.hits(-1, least_n=1.0)
    assert hits and all(hit.startswith("sweep: hand/") and "brick" in hit for hit in hits)
    assert simulated.hits(0, least_n=1.0) == ()  # the hand may touch what it picks
    assert simulated.hits(-1, least_n=1e6) == ()
    simulated.phase("after")
    assert simulated.hits(-1, least_n=1.0) == ()


def test_closing_on_nothing_is_no_hit_and_touches_nothing(pick_scene) -> None:
    simulated = SimulatedRobot(pick_scene.robot, pick_scene.scene)
    simulated.settle()
    simulated.phase("close")
    simulated.move_hand(np.zeros_like(pick_scene.plan.q_grasp), duration_s=0.5)
    assert simulated.hits(0, least_n=1.0) == () and not simulated.hand_touches(0)


def test_a_recording_has_the_phases(pick_scene) -> None:
    assert SimulatedRobot(pick_scene.robot, pick_scene.scene).recording() is None
    simulated = SimulatedRobot(pick_scene.robot, pick_scene.scene, record_every_s=0.05)
    simulated.settle()
    for name in ("one", "two"):
        simulated.phase(name)
        simulated.wait(0.5)
    recording = simulated.recording()
    assert recording.phases.count("one") == pytest.approx(10, abs=1) == recording.phases.count("two")
    np.testing.assert_allclose(np.diff(recording.t), 0.05, atol=1e-9)
