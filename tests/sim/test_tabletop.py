"""The physics of the table top: the arm goes where it is sent, grasps that are sound lift, others do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator, mount_at
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.camera import back_project
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.hands.parts import part_distances
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthView
from neuralgrasps.sim.contact_log import Thing
from neuralgrasps.sim.grip import grip_target
from neuralgrasps.sim.tabletop import TableTop
from neuralgrasps.sim.tabletop_model import TableTopConfig

from .tabletop_scene import ABOVE, box_in_jaw, fetch_above, lift, scene, smooth, table_under, translation
from .toy import HALF, toy_box

CLOSED = 0.02  # jaw travel at which the pads touch the box


@pytest.fixture(scope="module")
def robot() -> Manipulator:
    return fetch_above()


@pytest.fixture(scope="module")
def heavy() -> ObjectModel:
    return toy_box(mass_kg=0.5)


def close_and_lift(top: TableTop, *, grip: float) -> float:
    """Height that the box gained after closing, lifting and holding for a second."""
    top.settle()
    start = top.object_pose(0)[2, 3]
    hand = top.manipulator.hand
    top.begin("close")
    if grip > 0:
        q = np.full(hand.num_dofs, CLOSED)
        top.move_hand(q, 0.3)
        top.move_hand(grip_target(hand, q, q, grip=grip), 0.3, force=grip)
    top.begin("lift")
    top.run(lift(top.manipulator))
    top.begin("hold")
    top.wait(1.0)
    return float(top.object_pose(0)[2, 3] - start)


def seen_points(view: DepthView, mask: np.ndarray) -> np.ndarray:
    """(M, 3) points of B behind the pixels of a mask."""
    return transform_points_np(view.X_WC, back_project(view.depth, view.intrinsics, mask=mask))


def test_arm_holds_its_home(robot: Manipulator, heavy: ObjectModel) -> None:
    top = scene(robot, heavy)
    motion = top.wait(2.0)
    assert motion.tracking_error.max() < 1e-3 and not motion.diverged
    assert top.time_s == pytest.approx(2.0)
    np.testing.assert_allclose(top.q, robot.q_home, atol=1e-3)


def test_arm_sinks_without_compensation_of_gravity(robot: Manipulator, heavy: ObjectModel) -> None:
    """The check above can fail: gravity does act."""
    top = scene(robot, heavy)
    top.model.body_gravcomp[:] = 0.0
    assert top.wait(0.5).tracking_error.max() > 2e-3


def test_arm_follows_a_trajectory_within_5_mrad(robot: Manipulator, heavy: ObjectModel) -> None:
    """A swing at up to 1 rad/s; only with speeds fed forward does it stay that close."""
    top = TableTop(robot, [(heavy, translation(0.5, -0.5, 0.4 + HALF[2]))], table_under(translation(0.5, -0.5, 0.45)))
    change = np.array([0.1, 1.0, -0.4, 0.8, 0.5, 0.8, 0.5, 1.0])
    motion = top.run(smooth(robot, ABOVE, change, 2.0))
    assert motion.tracking_error.max() < 5e-3
    assert motion.end_error.max() < 5e-4
    np.testing.assert_allclose(top.q_arm, ABOVE + change, atol=5e-4)
    np.testing.assert_allclose(top.q_hand, robot.hand.q_open, atol=5e-4)
    assert not top.hits(0)
    top.reset()
    top._lead[:] = 0.0
    assert top.run(smooth(robot, ABOVE, change, 2.0)).tracking_error.max() > 0.02


def test_other_joints_are_refused(robot: Manipulator, heavy: ObjectModel) -> None:
    top = scene(robot, heavy)
    with pytest.raises(InputError, match="moves joints"):
        top.run(replace(lift(robot), joint_names=tuple(f"j{i}" for i in range(8))))
    with pytest.raises(ShapeError, match="1 joints"):
        top.move_hand(np.zeros(3), 0.1)
    with pytest.raises(InputError, match="share of the effort"):
        top.move_hand(np.zeros(1), 0.1, force=0.0)


def test_object_settles_where_resting_poses_says(robot: Manipulator) -> None:
    box = toy_box(centre=(0.01, 0.02, 0.03))
    poses, _ = resting_poses(box.mesh.vertices, box.com_O)
    at = box_in_jaw(robot) + translation(0.3, 0.3, 0.0) - np.eye(4)
    table = table_under(at)
    height = table.X_BX[2, 3] + table.half[2]
    for pose in poses[:3]:
        X_BO = translation(at[0, 3], at[1, 3], height) @ pose
        settled = (top := TableTop(robot, [(box, X_BO)], table)).settle()
        assert settled.still and not settled.moved()
        np.testing.assert_allclose(top.object_pose(0), X_BO, atol=1e-3)
    dropped = TableTop(robot, [(box, translation(0, 0, 0.01) @ X_BO)], table)
    settled = dropped.settle()
    assert settled.moved() and settled.moved_m[0] == pytest.approx(0.01, abs=1e-3)
    np.testing.assert_allclose(dropped.object_pose(0), X_BO, atol=1e-3)


def test_sound_grasp_lifts_and_holds(robot: Manipulator, heavy: ObjectModel) -> None:
    top = scene(robot, heavy)
    assert close_and_lift(top, grip=0.5) == pytest.approx(0.2, abs=0.003)
    assert not top.hits(0)
    touched = {(t.phase, t.a.kind, t.b.kind) for t in top.touches()}
    assert ("close", Thing.HAND, Thing.OBJECT) in touched and ("close", Thing.OBJECT, Thing.TABLE) in touched
    assert ("hold", Thing.OBJECT, Thing.TABLE) not in touched
    pressing = [t for t in top.touching() if t.a.kind is Thing.HAND]
    effort = float(robot.hand.tree.effort[0])
    assert sum(t.max_force_n for t in pressing) == pytest.approx(0.5 * effort, rel=0.05)  # both pads share the motor


def test_open_hand_lifts_nothing(robot: Manipulator, heavy: ObjectModel) -> None:
    assert abs(close_and_lift(scene(robot, heavy), grip=0.0)) < 1e-3


def test_weak_grip_drops_a_heavy_box(robot: Manipulator) -> None:
    """2 pads x 0.6 x 3 N cannot carry 10 N."""
    assert close_and_lift(scene(robot, toy_box(mass_kg=1.0)), grip=0.1) < 0.1


def test_contact_log_sees_a_hit_on_the_table(robot: Manipulator, heavy: ObjectModel) -> None:
    X_BO = box_in_jaw(robot)
    top = TableTop(robot, [(heavy, X_BO + translation(0.0, -1.0, 0.0) - np.eye(4))], table_under(X_BO))
    top.begin("transfer")
    top.run(smooth(robot, ABOVE, -0.05 * np.eye(8)[0], 1.0))  # fingertips end 50 - 39 mm inside the table
    hits = top.hits(0)
    assert {t.a.kind for t in hits} == {Thing.HAND} and {t.b.name for t in hits} == {"table"}
    assert all(t.phase == "transfer" and t.max_force_n > 5.0 for t in hits)
    assert "touches table" in str(hits[0])
    assert top.hits(0, phases=["start"]) == ()


def test_neighbours_are_hits_and_the_target_is_not(robot: Manipulator, heavy: ObjectModel) -> None:
    X_BO = box_in_jaw(robot)
    top = TableTop(robot, [(heavy, X_BO)], table_under(X_BO))
    top.begin("close")
    top.move_hand(np.zeros(1), 0.3, force=0.3)
    assert top.hits(0) == ()
    assert {t.b.name for t in top.hits(1)} == {"box"}


def test_same_inputs_give_the_same_bits(robot: Manipulator, heavy: ObjectModel) -> None:
    def states(top: TableTop) -> bytes:
        top.record(0.05)
        top.move_hand(np.zeros(1), 0.2)
        top.run(smooth(robot, ABOVE, 0.2 * np.ones(8) * [0.5, 1, -1, 1, 1, 1, 1, 1], 0.5), settle_s=0.1)
        recording = top.recording()
        return recording.q.tobytes() + recording.X_BO.tobytes() + top.data.qvel.tobytes()

    top = scene(robot, heavy)
    first = states(top)
    top.reset()
    assert states(top) == first
    assert states(scene(robot, heavy)) == first


def test_recording_holds_states_and_phases(robot: Manipulator, heavy: ObjectModel) -> None:
    top = scene(robot, heavy)
    top.begin("one")
    top.record(0.02)
    top.wait(0.1)
    top.begin("two")
    top.wait(0.1)
    recording = top.recording()
    assert len(recording) == 11 and recording.phases == ("one",) * 6 + ("two",) * 5
    np.testing.assert_allclose(recording.t, np.arange(11) * 0.02, atol=1e-9)
    np.testing.assert_array_equal(recording.q[-1], top.q)
    np.testing.assert_array_equal(recording.X_BO[-1, 0], top.object_pose(0))


def test_objects_can_be_placed_and_taken_away(robot: Manipulator, heavy: ObjectModel) -> None:
    top = scene(robot, heavy)
    start = top.object_pose(0)
    top.take_away(0)
    far = top.object_pose(0)
    top.log.clear()
    top.begin("without")
    top.move_hand(np.zeros(1), 0.3)
    assert top.touches(["without"]) == () or {t.b.kind for t in top.touches(["without"])} == {Thing.HAND}
    np.testing.assert_array_equal(top.object_pose(0), far)
    top.move_hand(robot.hand.q_open, 0.3)
    top.place(0, start)
    np.testing.assert_allclose(top.object_pose(0), start, atol=1e-12)
    assert not top.settle().moved() and any(t.a.kind is Thing.OBJECT for t in top.touching())
    top.take_away(0)
    top.reset()
    assert not top.settle().moved()


def test_a_broken_simulation_is_never_a_success(robot: Manipulator, heavy: ObjectModel) -> None:
    top = scene(robot, heavy)
    top.data.qvel[:] = 1e12
    assert top.wait(0.1).diverged and top.diverged
    assert np.isnan(top.object_poses()).all()
    assert not top.object_pose(0)[2, 3] > -1e9
    top.reset()
    assert not top.wait(0.1).diverged


def test_camera_sees_the_object_where_it_is(robot: Manipulator, heavy: ObjectModel) -> None:
    X_BO = translation(0.8, 0.1, 0.6)
    top = TableTop(robot, [(heavy, X_BO)], table_under(X_BO))
    view = top.depth_view()
    np.testing.assert_allclose(view.X_WC, robot.camera_pose(top.q_arm))
    seen = view.mesh_index == 0
    assert seen.sum() > 200
    points_B = seen_points(view, seen)
    points_O = points_B - X_BO[:3, 3]
    outside = np.abs(points_O) - HALF
    assert np.abs(outside.max(axis=1)).max() < 1e-3  # every pixel lies on the box's surface
    own = seen_points(view, view.mesh_index >= 3)[::50]  # after the object, the table and the floor: the robot
    X_LB = inverse_np(forward_numpy(robot.tree, top.q))
    gaps = [part_distances(p, transform_points_np(X_LB[p.link], own)) for p in robot.parts]
    assert len(own) > 20 and np.abs(np.min(gaps, axis=0)).max() < 3e-3  # of 24-sided cylinders
    noisy = top.depth_view(STRUCTURED_LIGHT, seed=3)
    np.testing.assert_array_equal(noisy.depth, top.depth_view(STRUCTURED_LIGHT, seed=3).depth)
    assert (noisy.depth != view.depth).any()


def test_grip_of_a_many_fingered_hand_keeps_the_balance() -> None:
    hand = load_hand("allegro")
    q = hand.q_open
    squeeze = q + np.linspace(-0.01, 0.02, hand.num_dofs)
    torque = 20.0 * (grip_target(hand, q, squeeze, grip=0.5) - q)
    assert np.abs(torque / hand.tree.effort).max() == pytest.approx(0.5)
    np.testing.assert_allclose(torque / np.abs(torque).max(), (squeeze - q) / np.abs(squeeze - q).max(), atol=1e-12)
    np.testing.assert_array_equal(grip_target(hand, q, squeeze, grip=0.0), q)
    with pytest.raises(InputError, match="grip"):
        grip_target(hand, q, squeeze, grip=1.5)


def test_no_link_hangs_in_its_neighbour(heavy: ObjectModel) -> None:
    """Every hand of the zoo on the arm: nothing of the robot touches itself at home, and it stays there."""
    base = fetch_above()
    for name in ("panda", "barrett", "allegro", "human"):
        X_FH = base.arm.X_FM.copy()
        X_FH[:3, 3] += 0.15 * X_FH[:3, 2]
        robot = mount_at(base.arm, load_hand(name), X_FH)
        X_BO = translation(0.9, -0.6, 0.5)
        top = TableTop(robot, [(heavy, X_BO)], table_under(X_BO))
        motion = top.wait(0.2)
        assert not [t for t in top.touches() if t.b.kind in (Thing.ARM, Thing.HAND)], name
        assert motion.tracking_error.max() < 1e-3
        np.testing.assert_allclose(top.q_hand, robot.hand.q_open, atol=2e-3)


def test_bad_settings_are_refused(robot: Manipulator, heavy: ObjectModel) -> None:
    with pytest.raises(InputError, match="timestep_s"):
        TableTopConfig(timestep_s=0.0)
    with pytest.raises(ShapeError, match="X_BO"):
        TableTop(robot, [(heavy, np.eye(3))], table_under(np.eye(4)))
