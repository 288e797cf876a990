"""Picking up with any robot: the order of its motions, none of them without a plan, and the way home."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from neuralgrasps.apply.pick_up import (
    PickUpConfig,
    Stage,
    carry_out,
    go_home,
    pick_steps,
    pick_up,
    plan_in,
    propose_pick,
    set_down,
    within_limits,
)
from neuralgrasps.apply.robot import RobotState
from neuralgrasps.apply.simulated_robot import SimulatedRobot
from neuralgrasps.apply.table_scenes import TableScene, scene_world, table_plane
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.pick import PickConfig
from neuralgrasps.planning.world import BoxObstacle, PlacedObject

CONFIG = PickUpConfig(stages=(Stage(4, None),), hold_s=0.5)
"""Stored grasps only, none proven: what they lift is asked of the simulator here."""


@dataclass
class Watched:
    """A robot that keeps what it was asked to do; `frame` in place of what its camera sees."""

    robot: SimulatedRobot
    frame: Frame | None = None
    asked: list[tuple[str, Any]] = field(default_factory=list)

    @property
    def manipulator(self) -> Manipulator:
        return self.robot.manipulator

    def state(self) -> RobotState:
        return self.robot.state()

    def look(self) -> Frame:
        self.asked.append(("look", None))
        return self.frame or self.robot.look()

    def execute(self, trajectory: Trajectory) -> None:
        self.asked.append(("execute", trajectory))
        self.robot.execute(trajectory)

    def move_hand(self, q_hand: np.ndarray, *, duration_s: float, force: float = 1.0) -> None:
        self.asked.append(("hand", (q_hand, force)))
        self.robot.move_hand(q_hand, duration_s=duration_s, force=force)

    def wait(self, duration_s: float) -> None:
        self.asked.append(("wait", duration_s))
        self.robot.wait(duration_s)

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.asked]


def robot_at(pick_scene, *objects: PlacedObject, seed: int = 0) -> Watched:
    scene = TableScene(table=pick_scene.scene.table, objects=objects or pick_scene.scene.objects, seed=0)
    robot = SimulatedRobot(pick_scene.robot, scene, seed=seed)
    robot.settle()
    return Watched(robot=robot)


def shifted(placed: PlacedObject, shift: tuple[float, float, float]) -> PlacedObject:
    X_BO = placed.X_BO.copy()
    X_BO[:3, 3] += shift
    return PlacedObject(obj=placed.obj, X_BO=X_BO)


def check_nothing_moved(watched: Watched, pick_scene) -> None:
    assert watched.names == ["look"]
    np.testing.assert_allclose(watched.state().q_arm, pick_scene.q_start, atol=1e-3)


def test_an_object_is_picked_up_step_by_step(pick_scene) -> None:
    watched = robot_at(pick_scene)
    proposal = pick_up(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG, seed=1)
    plan = proposal.plan
    assert plan is not None and proposal.reason == ""
    assert watched.names == ["look", "hand", "execute", "execute", "wait", "hand", "execute", "wait"]
    asked = [what for _, what in watched.asked]
    assert (asked[2], asked[3], asked[6]) == (plan.transfer, plan.approach, plan.lift)
    np.testing.assert_array_equal(asked[1][0], plan.q_pregrasp)
    np.testing.assert_array_equal(asked[5][0], plan.q_squeeze)
    assert (asked[4], asked[5][1], asked[7]) == (CONFIG.settle_s, CONFIG.force, CONFIG.hold_s)
    risen = watched.robot.object_pose(0)[2, 3] - pick_scene.scene.objects[0].X_BO[2, 3]
    assert risen == pytest.approx(CONFIG.plan.lift_m, abs=0.01)
    assert [step.name for step in pick_steps(plan, CONFIG)] == [
        "open", "transfer", "approach", "close", "lift", "hold",
    ]  # fmt: skip
    true = pick_scene.scene.objects[0].X_BO
    assert np.linalg.norm(proposal.X_BO[:3, 3] - true[:3, 3]) < 0.003
    np.testing.assert_array_equal(proposal.world.target.X_BO, proposal.X_BO)

    # and home again; what it held is let go
    world = watched.robot.true_world()
    watched.robot.take_away(0)
    assert go_home(watched, watched.robot.true_world()) == "" and len(world.objects) == 1
    watched.wait(0.5)
    np.testing.assert_allclose(watched.state().q_arm, pick_scene.q_start, atol=2e-3)
    np.testing.assert_allclose(watched.state().q_hand, pick_scene.robot.hand.q_open, atol=2e-3)


def test_proposing_moves_nothing(pick_scene) -> None:
    watched = robot_at(pick_scene)
    first = propose_pick(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG, seed=1)
    assert first.plan is not None and first.look_cpu_s > 0
    check_nothing_moved(watched, pick_scene)
    again = propose_pick(robot_at(pick_scene), pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG, seed=1)
    np.testing.assert_array_equal(first.X_BO, again.X_BO)
    np.testing.assert_array_equal(first.plan.transfer.q, again.plan.transfer.q)
    grasp = first.plan.grasp
    assert f"{grasp.hand} takes {grasp.object} by grasp {first.plan.index}, " in repr(first)


def test_without_a_table_it_says_so_and_stays(pick_scene) -> None:
    watched = robot_at(pick_scene)
    frame = watched.robot.look()
    watched.frame = replace(frame, depth=np.full_like(frame.depth, 1.2))  # a wall
    proposal = pick_up(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG)
    assert proposal.plan is None and proposal.view is None and "level" in proposal.reason
    assert repr(proposal) == f"PickProposal(no plan: {proposal.reason})"
    check_nothing_moved(watched, pick_scene)


def test_on_an_empty_table_it_says_so_and_stays(pick_scene) -> None:
    watched = robot_at(pick_scene)
    watched.robot.take_away(0)
    proposal = pick_up(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG)
    assert proposal.plan is None and proposal.reason == "nothing stands on the table." and proposal.view is not None
    check_nothing_moved(watched, pick_scene)


def test_what_is_out_of_reach_is_left(pick_scene) -> None:
    """It is seen, at the far corner of a long table."""
    far, table = shifted(pick_scene.scene.objects[0], (0.3, 0.4, 0.0)), pick_scene.scene.table
    long = replace(table, half=table.half + np.array([0.6, 0.3, 0.0]))
    watched = Watched(robot=SimulatedRobot(pick_scene.robot, TableScene(table=long, objects=(far,), seed=0)))
    proposal = pick_up(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG)
    assert proposal.X_BO is not None and np.linalg.norm(proposal.X_BO[:3, 3] - far.X_BO[:3, 3]) < 0.01
    assert proposal.plan is None and "out of reach" in proposal.reason
    check_nothing_moved(watched, pick_scene)


def test_an_object_too_wide_for_the_hand_is_left(pick_scene, make_object) -> None:
    slab = make_object("slab", box_mesh([0.09, 0.08, 0.03]))
    at = pick_scene.scene.objects[0].X_BO.copy()
    at[2, 3] = pick_scene.robot.arm.table_height_m + 0.03
    watched = robot_at(pick_scene, PlacedObject(obj=slab, X_BO=at))
    proposal = pick_up(watched, slab, grasps=None, config=CONFIG)
    assert proposal.plan is None and proposal.reason.startswith("no grasp clears the table: too wide")
    check_nothing_moved(watched, pick_scene)


def test_wrong_grasps_and_settings_raise_before_anything_moves(pick_scene) -> None:
    watched = robot_at(pick_scene)
    with pytest.raises(InputError, match="expected hand 'fetch' on object 'gelatin_box'"):
        pick_up(watched, pick_scene.obj, grasps=replace(pick_scene.grasps, object="mug"), config=CONFIG)
    check_nothing_moved(watched, pick_scene)
    with pytest.raises(InputError, match="stages is empty"):
        pick_up(robot_at(pick_scene), pick_scene.obj, grasps=pick_scene.grasps, config=PickUpConfig(stages=()))


def test_another_estimate_takes_the_place_of_ours(pick_scene) -> None:
    seen: list[np.ndarray] = []
    shift = np.array([0.0, 0.03, 0.0])

    def estimator(obj, view, sighting):
        X_BO = sighting.X_BO.copy()
        X_BO[:3, 3] += shift
        return X_BO

    def refiner(obj, view, sighting, X_BH):
        seen.append(X_BH)
        return sighting.X_BO

    given = {"grasps": pick_scene.grasps, "config": CONFIG, "seed": 1}
    other = propose_pick(robot_at(pick_scene), pick_scene.obj, estimator=estimator, **given)
    np.testing.assert_allclose(other.X_BO[:3, 3] - other.sighting.X_BO[:3, 3], shift, atol=1e-12)
    np.testing.assert_array_equal(other.world.target.X_BO, other.X_BO)
    ours = propose_pick(robot_at(pick_scene), pick_scene.obj, **given)
    both = propose_pick(robot_at(pick_scene), pick_scene.obj, estimator=estimator, refiner=refiner, **given)
    np.testing.assert_array_equal(seen, [other.plan.X_BH])  # asked once, with the grasp that the first led to
    np.testing.assert_array_equal(both.X_BO, ours.X_BO)
    np.testing.assert_array_equal(both.plan.transfer.q, ours.plan.transfer.q)


def test_further_stages_are_taken_only_when_needed(pick_scene) -> None:
    """The first stage plans; with an object out of reach, all are tried and their time adds up."""
    robot, world = pick_scene.robot, pick_scene.world
    given = table_plane(pick_scene.scene), pick_scene.q_start, pick_scene.grasps
    one = plan_in(robot, world, *given, replace(CONFIG, stages=(Stage(4, None), Stage(8, None))), 0)
    assert one[0] is not None and one[0].plan is not None and one[1] == ""
    assert world.target is not None
    far = replace(world, target=shifted(world.target, (0.5, 0.0, 0.0)))
    short, none = (
        plan_in(robot, far, *given, replace(CONFIG, stages=stages), 0)[0]
        for stages in ((Stage(4, None),), (Stage(4, None), Stage(30, None)))
    )
    assert short is not None and none is not None and short.plan is None and none.plan is None
    assert none.counts["out of reach"] > short.counts["out of reach"]


def test_a_way_home_that_is_blocked_is_said_and_not_gone(pick_scene) -> None:
    watched = robot_at(pick_scene)
    watched.execute(pick_scene.plan.transfer)
    at = watched.state().q_arm
    home = pick_scene.robot.hand_pose(pick_scene.q_start)
    X = np.eye(4)
    X[:3, 3] = home[:3, 3]
    block = BoxObstacle(name="shelf", X_BX=X, half=np.full(3, 0.05))
    world = watched.robot.true_world()
    reason = go_home(watched, replace(world, boxes=(*world.boxes, block)))
    assert "goal is in collision" in reason and "shelf" in reason
    assert watched.names == ["execute", "hand"]  # the hand was opened, the arm stays
    np.testing.assert_allclose(watched.state().q_arm, at, atol=2e-3)


def test_a_joint_measured_a_little_beyond_its_limit_is_at_it(pick_scene) -> None:
    robot, q = pick_scene.robot, pick_scene.q_start.copy()
    q[0] = robot.upper[0] + 3e-4
    expected = q.copy()
    expected[0] = robot.upper[0]
    np.testing.assert_array_equal(within_limits(robot, q), expected)
    q[0] = robot.upper[0] + 0.05
    np.testing.assert_array_equal(within_limits(robot, q), q)
    raised = pick_scene.q_start.copy()
    raised[0] = robot.upper[0] + 3e-4
    given = table_plane(pick_scene.scene), raised, pick_scene.grasps
    result, _, _ = plan_in(robot, pick_scene.world, *given, CONFIG, 0)
    assert result is not None and result.plan is not None
    with pytest.raises(InputError, match="outside its joint limits"):
        plan_in(robot, pick_scene.world, given[0], q, given[2], CONFIG, 0)


def test_a_wished_force_reaches_the_hand(pick_scene) -> None:
    watched = robot_at(pick_scene)
    carry_out(watched, pick_scene.plan, config=replace(CONFIG, force=0.25, plan=PickConfig()))
    assert [what[1] for name, what in watched.asked if name == "hand"] == [1.0, 0.25]


def test_a_plan_from_elsewhere_is_refused(pick_scene) -> None:
    watched = robot_at(pick_scene)
    proposal = propose_pick(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG, seed=1)
    assert proposal.plan is not None
    with pytest.raises(InputError, match="plan anew"):
        watched.robot.execute(proposal.plan.lift)
    carry_out(watched, proposal.plan, config=CONFIG)
    with pytest.raises(InputError, match="plan anew"):
        carry_out(watched, proposal.plan, config=CONFIG)


def test_a_lifted_object_is_set_down_where_it_was(pick_scene) -> None:
    watched = robot_at(pick_scene)
    before = watched.robot.object_pose(0)
    proposal = pick_up(watched, pick_scene.obj, grasps=pick_scene.grasps, config=CONFIG, seed=1)
    assert proposal.plan is not None and proposal.world is not None
    assert watched.robot.object_pose(0)[2, 3] > before[2, 3] + 0.15
    set_down(watched, proposal.plan)
    np.testing.assert_allclose(watched.robot.object_pose(0)[:3, 3], before[:3, 3], atol=0.01)
    assert not watched.robot.hand_touches(0)
    assert go_home(watched, proposal.world, seed=2) == ""


def test_further_obstacles_are_planned_around_or_named(pick_scene) -> None:
    watched = robot_at(pick_scene)
    X = np.eye(4)
    X[:3, 3] = watched.robot.object_pose(0)[:3, 3] + [0.0, 0.0, 0.12]
    lid = BoxObstacle(name="lid", X_BX=X, half=np.array([0.4, 0.4, 0.01]))
    proposal = propose_pick(watched, pick_scene.obj, grasps=pick_scene.grasps, obstacles=[lid], config=CONFIG, seed=1)
    assert proposal.plan is None and "none of" in proposal.reason
    check_nothing_moved(watched, pick_scene)


def test_an_object_far_away_is_out_of_reach_at_once(pick_scene) -> None:
    world = scene_world(pick_scene.scene, 0)
    far = shifted(pick_scene.scene.objects[0], (3.0, 0.0, 0.0))
    result, reason, spent = plan_in(
        pick_scene.robot, replace(world, target=far), table_plane(pick_scene.scene), pick_scene.q_start, None, CONFIG, 0
    )
    assert result is None and "out of reach" in reason and spent == 0.0


@pytest.mark.parametrize("half", [(-1.0, 1.0, 1.0), (1.0, 1.0, np.nan), (900.0, 600.0, 40.0)])
def test_boxes_that_are_none_are_refused(half: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="half extents"):
        BoxObstacle(name="box", X_BX=np.eye(4), half=np.array(half))
    with pytest.raises(InputError, match="rigid"):
        BoxObstacle(name="box", X_BX=3.0 * np.eye(4), half=np.ones(3))
