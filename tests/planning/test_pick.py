"""From grasps to one motion: free when checked by others, straight where it should be, within limits, or a reason."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest

from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.planning.collision import CollisionChecker, CollisionConfig
from neuralgrasps.planning.path import PathConfig
from neuralgrasps.planning.pick import PickConfig, PickResult, opened_postures, plan_pick
from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld
from neuralgrasps.sim.grip import grip_target
from neuralgrasps.sim.recheck import recheck_path

FINE = CollisionConfig(
    max_step_rad=0.002, max_step_m=0.001, near_step_m=0.001, near_target_margin_m=0.0005, margin_m=0.008
)
"""Ten times denser than the planner's, with margins that leave the 1 mm that timing may take."""


def moved(world: PlanningWorld, shift: tuple[float, float, float]) -> PlanningWorld:
    assert world.target is not None
    X_BO = world.target.X_BO.copy()
    X_BO[:3, 3] += shift
    return replace(world, target=PlacedObject(obj=world.target.obj, X_BO=X_BO))


def block(name: str, centre: tuple[float, float, float], half: tuple[float, float, float]) -> BoxObstacle:
    X = np.eye(4)
    X[:3, 3] = centre
    return BoxObstacle(name=name, X_BX=X, half=np.array(half))


def every_ms(motion: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, speeds and accelerations at each millisecond; these by differences of the speeds."""
    t = np.arange(0.0, motion.duration_s + 0.001, 0.001)
    q, qd = motion.sample(t)
    return q, qd, np.diff(qd, axis=0) / 0.001


def motions(plan: Any) -> tuple[Trajectory, Trajectory, Trajectory]:
    return plan.transfer, plan.approach, plan.lift


# ------------------------------------------------------------------ the motion


def test_the_plan_is_free_for_the_physics_engine(pick_scene) -> None:
    plan, robot, world = pick_scene.plan, pick_scene.robot, pick_scene.world
    for motion in (plan.transfer, plan.approach):
        q = motion.sample(np.arange(0.0, motion.duration_s, 0.01))[0]
        found = recheck_path(robot, world, q, q_hand=plan.q_pregrasp)
        assert found.free, found.first_contact
        assert found.samples > 100
    X_HO = inverse_np(plan.X_BH) @ world.target.X_BO
    found = recheck_path(robot, world, plan.lift.q, q_hand=plan.q_grasp, carried=X_HO)
    assert found.free, found.first_contact


def test_the_plan_is_free_for_a_ten_times_finer_check(pick_scene) -> None:
    plan = pick_scene.plan
    checker = CollisionChecker(pick_scene.robot, pick_scene.world, plan.q_pregrasp, config=FINE)
    held = checker.for_lift(plan.q_grasp, inverse_np(plan.X_BH) @ pick_scene.world.target.X_BO)
    phases = (checker, checker.for_approach(), held)
    for motion, phase in zip(motions(plan), phases, strict=True):
        q = motion.sample(np.arange(0.0, motion.duration_s, 0.005))[0]
        assert phase.is_free(q).all(), next(text for row in q if (text := phase.describe(row)))
        assert all(phase.edge_is_free(a, b) for a, b in pairwise(q[::10]))


LOW = PickConfig(lift_m=0.05)


def shelved(pick_scene) -> PlanningWorld:
    """The scene with a shelf between the hand at home and the box; there is room for a low lift."""
    shelf = block("shelf", (0.86, 0.15, 0.98), (0.2, 0.3, 0.005))
    return replace(pick_scene.world, boxes=(*pick_scene.world.boxes, shelf))


def test_what_is_in_the_way_is_gone_around(pick_scene) -> None:
    robot, world = pick_scene.robot, shelved(pick_scene)
    straight = pick_scene.plan
    assert not recheck_path(robot, world, straight.transfer.q, q_hand=straight.q_pregrasp).free
    result = plan_pick(robot, pick_scene.grasps, world, pick_scene.q_start, config=LOW, seed=3)
    assert result.plan is not None, result.reason
    for motion in (result.plan.transfer, result.plan.approach):
        found = recheck_path(robot, world, motion.q, q_hand=result.plan.q_pregrasp)
        assert found.free, found.first_contact


def test_limits_hold_at_every_millisecond(pick_scene) -> None:
    robot, config = pick_scene.robot, PickConfig()
    for motion, share in zip(motions(pick_scene.plan), (config.speed, 1.0, 1.0), strict=True):
        q, qd, qdd = every_ms(motion)
        assert motion.joint_names == robot.arm_names
        assert (q >= robot.lower - 1e-9).all() and (q <= robot.upper + 1e-9).all()
        assert (np.abs(qd) <= share * robot.velocity * (1 + 1e-6)).all()
        assert (np.abs(qdd) <= share**2 * robot.acceleration * (1 + 1e-3)).all()
        np.testing.assert_allclose(qd[[0, -1]], 0.0, atol=1e-9)
    for motion, limit in ((pick_scene.plan.approach, config.approach_speed), (pick_scene.plan.lift, config.lift_speed)):
        at = robot.hand_pose(every_ms(motion)[0])[:, :3, 3]
        speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / 0.001
        assert 0.9 * limit < speed.max() < 1.05 * limit


def test_motions_join_without_a_jump(pick_scene) -> None:
    plan = pick_scene.plan
    np.testing.assert_allclose(plan.transfer.q[0], pick_scene.q_start, atol=1e-12)
    np.testing.assert_allclose(plan.transfer.q[-1], plan.approach.q[0], atol=1e-9)
    np.testing.assert_allclose(plan.approach.q[-1], plan.lift.q[0], atol=1e-9)
    for motion in motions(plan):
        assert np.abs(np.diff(every_ms(motion)[0], axis=0)).max() < 0.01


def test_the_approach_is_straight_along_the_palm(pick_scene) -> None:
    plan, robot = pick_scene.plan, pick_scene.robot
    X_BH = robot.hand_pose(every_ms(plan.approach)[0])
    np.testing.assert_allclose(X_BH[-1], plan.X_BH, atol=1e-3)
    direction = plan.X_BH[:3, :3] @ robot.hand.X_HP[:3, 2]
    way = X_BH[:, :3, 3] - plan.X_BH[:3, 3]
    along = way @ direction
    assert np.linalg.norm(way - along[:, None] * direction, axis=1).max() < 1e-3
    assert along[0] == pytest.approx(-PickConfig().standoff_m, abs=2e-4) and (np.diff(along) > -1e-6).all()
    turn = np.einsum("nij,ij->n", X_BH[:, :3, :3], plan.X_BH[:3, :3])
    assert np.rad2deg(np.arccos(np.clip((turn - 1) / 2, -1, 1))).max() < 0.5


def test_the_lift_is_vertical(pick_scene) -> None:
    plan, robot = pick_scene.plan, pick_scene.robot
    way = robot.hand_pose(every_ms(plan.lift)[0])[:, :3, 3] - plan.X_BH[:3, 3]
    assert np.linalg.norm(way[:, :2], axis=1).max() < 1e-3
    assert way[-1, 2] == pytest.approx(PickConfig().lift_m, abs=2e-4) and (np.diff(way[:, 2]) > -1e-6).all()


def test_standoff_and_lift_are_as_long_as_asked(pick_scene) -> None:
    config = PickConfig(standoff_m=0.06, lift_m=0.11, approach_speed=0.05)
    result = plan_pick(pick_scene.robot, pick_scene.grasps, pick_scene.world, pick_scene.q_start, config=config, seed=3)
    plan, robot = result.plan, pick_scene.robot
    assert plan is not None
    ends = [robot.hand_pose(q)[:3, 3] for q in (plan.approach.q[0], plan.approach.q[-1], plan.lift.q[-1])]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.06, abs=2e-4)
    np.testing.assert_allclose(ends[2] - ends[1], [0, 0, 0.11], atol=3e-4)
    assert plan.approach.duration_s > 0.06 / 0.05


def test_the_hand_goes_where_the_grasp_is(pick_scene) -> None:
    plan, world, config = pick_scene.plan, pick_scene.world, PickConfig()
    stored = pick_scene.grasps[plan.index]
    np.testing.assert_array_equal(plan.grasp.X_OH, stored.X_OH)
    target = grip_target(pick_scene.robot.hand, stored.q[0], stored.q_squeeze[0], grip=config.grip)
    np.testing.assert_array_equal(plan.q_squeeze, target)
    asked = world.target.X_BO @ stored.X_OH[0]
    back = asked[:3, 3] - plan.X_BH[:3, 3]
    np.testing.assert_allclose(plan.X_BH[:3, :3], asked[:3, :3], atol=1e-12)
    direction = asked[:3, :3] @ pick_scene.robot.hand.X_HP[:3, 2]
    assert np.linalg.norm(back - (back @ direction) * direction) < 1e-9
    assert -1e-9 <= back @ direction <= config.back_off_m + 1e-9


def test_a_hand_whose_palm_would_touch_stays_back(pick_scene) -> None:
    """All grasps pushed forward until the open hand is less than the margin off the object."""
    robot, world, plan = pick_scene.robot, pick_scene.world, pick_scene.plan
    X_OH = plan.grasp.X_OH.copy()
    ahead = X_OH[:, :3, :3] @ robot.hand.X_HP[:3, 2]
    checker = CollisionChecker(robot, world, plan.q_pregrasp, config=PickConfig().collision).for_approach()
    for step in np.arange(0.0, 0.06, 0.001):
        further = X_OH.copy()
        further[:, :3, 3] += step * ahead
        pushed = replace(plan.grasp, X_OH=further)
        found = plan_pick(robot, pushed, world, pick_scene.q_start, seed=3)
        if found.plan is None:
            assert "touches something at the grasp" in found.reason or "fell" in found.reason, found.reason
            break
        back = np.linalg.norm(found.plan.X_BH[:3, 3] - (world.target.X_BO @ pushed.X_OH[0])[:3, 3])
        if back > 1e-6:
            assert back == pytest.approx(PickConfig().back_off_m, abs=1e-9)
            assert checker.with_hand(found.plan.q_pregrasp).for_approach().is_free(found.plan.approach.q).all()
            return
    pytest.fail("no grasp was ever backed off")


# ------------------------------------------------------------------ the same again, another order


def arrays(result: PickResult) -> list[np.ndarray]:
    assert result.plan is not None
    return [result.plan.X_BH] + [a for motion in motions(result.plan) for a in (motion.t, motion.q, motion.qd)]


def test_the_same_seed_gives_the_same_bits(pick_scene) -> None:
    """Where the path planner has to draw random postures, too."""
    given = pick_scene.robot, pick_scene.grasps, shelved(pick_scene), pick_scene.q_start
    first, again, other = (plan_pick(*given, config=LOW, seed=seed) for seed in (5, 5, 6))
    assert first.counts == again.counts and first.tried == again.tried
    for a, b in zip(arrays(first), arrays(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert any(not np.array_equal(a, b) for a, b in zip(arrays(first), arrays(other), strict=True))
    assert first.seed == 5 and other.seed == 6


def test_preference_changes_which_grasp_is_taken(pick_scene) -> None:
    favoured = [k for k in range(len(pick_scene.grasps)) if k != pick_scene.plan.index]
    taken = set()
    for k in favoured[:6]:
        preference = np.full(len(pick_scene.grasps), -10.0)
        preference[[k, pick_scene.plan.index]] = 10.0, -5.0
        result = plan_pick(
            pick_scene.robot, pick_scene.grasps, pick_scene.world, pick_scene.q_start, preference=preference, seed=3
        )
        assert result.plan is not None
        taken.add(result.plan.index == k)
        if result.plan.index != k:  # the favoured one cannot be done; the one that was best without comes next
            assert result.plan.index == pick_scene.plan.index
    assert True in taken


def test_postures_to_approach_with(pick_scene) -> None:
    hand = pick_scene.robot.hand
    pregrasp = 0.4 * hand.q_open
    np.testing.assert_allclose(opened_postures(hand, pregrasp), [hand.q_open, 0.7 * hand.q_open, pregrasp])


# ------------------------------------------------------------------ no motion, and why


def test_an_object_out_of_reach_says_so(pick_scene) -> None:
    world = moved(pick_scene.world, (2.0, 0.0, 0.0))
    result = plan_pick(pick_scene.robot, pick_scene.grasps, world, pick_scene.q_start)
    assert result.plan is None and not result.blocked and result.complete
    assert "out of reach" in result.reason and result.counts["out of reach"] == result.tried > 0


def test_a_caged_object_says_what_is_in_the_way(pick_scene) -> None:
    """Walls on all sides and a lid: every posture at every grasp is blocked, or every hand."""
    x, y, z = pick_scene.world.target.X_BO[:3, 3]
    walls = [block("cage", (x + dx, y + dy, z), (0.01, 0.12, 0.2)) for dx, dy in ((-0.12, 0.0), (0.12, 0.0))]
    walls += [block("cage", (x, y + dy, z), (0.12, 0.01, 0.2)) for dy in (-0.12, 0.12)]
    world = replace(
        pick_scene.world, boxes=(*pick_scene.world.boxes, *walls, block("lid", (x, y, z + 0.2), (0.13, 0.13, 0.01)))
    )
    result = plan_pick(pick_scene.robot, pick_scene.grasps, world, pick_scene.q_start)
    assert result.plan is None and result.complete and not result.blocked
    assert sum(result.counts.values()) == len(pick_scene.grasps)
    assert result.reason.startswith(f"none of {len(pick_scene.grasps)} grasps has a complete motion: ")
    assert "hits what is around" in result.reason or "touches something" in result.reason


def test_limits_of_the_search_end_it(pick_scene) -> None:
    """The straight way is blocked and no other may be looked for."""
    path = PathConfig(max_checks=1, detours=0, shortcuts=0)

    def plan(**limits: Any) -> PickResult:
        config = replace(LOW, path=path, **limits)
        return plan_pick(
            pick_scene.robot, pick_scene.grasps, shelved(pick_scene), pick_scene.q_start, config=config, seed=3
        )

    result = plan()
    assert result.plan is None and result.complete
    assert result.counts["no path to the standoff"] > 0 and sum(result.counts.values()) == len(pick_scene.grasps)
    few = plan(max_grasps=2)
    assert few.plan is None and (few.tried, few.complete) == (2, False)
    assert "or of grasps was reached" in few.reason
    short = plan(time_limit_s=1e-9)  # the first is always tried
    assert short.plan is None and (short.tried, short.complete) == (1, False)
    assert "limit of 1e-09 s" in short.reason


def test_a_way_that_is_blocked_only_in_its_middle_is_seen(pick_scene) -> None:
    """A small post that the forearm passes on a long approach; both ends of it are free."""
    robot, config = pick_scene.robot, PickConfig(standoff_m=0.2, solutions=1)
    given = robot, pick_scene.plan.grasp
    plan = plan_pick(*given, pick_scene.world, pick_scene.q_start, config=config, seed=3).plan
    assert plan is not None
    q, blocked = plan.approach.q[[0, len(plan.approach.q) // 2, -1]], None
    middle = robot.hand_pose(q[1])[:3, 3]
    for x, y, z in product((-0.3, -0.2, -0.1, 0.0, 0.1), (-0.2, -0.1, 0.0), (0.2, 0.3)):
        post = block("post", tuple(middle + np.array([x, y, z])), (0.01, 0.01, 0.01))
        world = replace(pick_scene.world, boxes=(*pick_scene.world.boxes, post))
        checker = CollisionChecker(robot, world, plan.q_pregrasp, config=config.collision)
        ends = checker.is_free(q[:1])[0] and checker.for_approach().is_free(q)[-1]
        if (
            ends
            and not checker.for_approach().is_free(plan.approach.q).all()
            and not checker.describe(pick_scene.q_start)
        ):
            blocked = world
            break
    assert blocked is not None
    result = plan_pick(*given, blocked, pick_scene.q_start, config=config, seed=3)
    assert result.plan is None and result.counts == {"no straight approach": 1}


def test_a_start_in_collision_names_what_touches(pick_scene) -> None:
    at = pick_scene.robot.hand_pose(pick_scene.q_start)[:3, 3]
    pillar = block("pillar", tuple(at), (0.05, 0.05, 0.05))
    world = replace(pick_scene.world, boxes=(*pick_scene.world.boxes, pillar))
    result = plan_pick(pick_scene.robot, pick_scene.grasps, world, pick_scene.q_start)
    assert result.plan is None and result.blocked and result.tried == 0
    assert "start is in collision" in result.reason and "pillar" in result.reason


def test_a_start_outside_its_limits_names_the_joint(pick_scene) -> None:
    robot, q = pick_scene.robot, pick_scene.q_start.copy()
    q[3] = robot.upper[3] + 0.1 if np.isfinite(robot.upper[3]) else q[3]
    q[0] = robot.lower[0] - 0.2
    with pytest.raises(InputError, match=f"outside its joint limits: {robot.arm_names[0]}"):
        plan_pick(robot, pick_scene.grasps, pick_scene.world, q)
    with pytest.raises(InputError, match="nan"):
        plan_pick(robot, pick_scene.grasps, pick_scene.world, np.full_like(q, np.nan))
    with pytest.raises(ShapeError, match="q_start"):
        plan_pick(robot, pick_scene.grasps, pick_scene.world, q[:-1])


def test_contradictory_limits_are_refused(pick_scene) -> None:
    robot = pick_scene.robot
    lower = robot.lower.copy()
    lower[1] = robot.upper[1] + 0.5
    with pytest.raises(InputError, match=f"contradict each other: {robot.arm_names[1]} "):
        plan_pick(replace(robot, lower=lower), pick_scene.grasps, pick_scene.world, pick_scene.q_start)
    still = robot.velocity.copy()
    still[2] = 0.0
    with pytest.raises(InputError, match=f"{robot.arm_names[2]} .*velocity 0"):
        plan_pick(replace(robot, velocity=still), pick_scene.grasps, pick_scene.world, pick_scene.q_start)


def test_wrong_grasps_are_refused(pick_scene) -> None:
    def plan(**changed: Any) -> PickResult:
        given = {"grasps": pick_scene.grasps, "world": pick_scene.world, **changed}
        return plan_pick(pick_scene.robot, q_start=pick_scene.q_start, **given)

    none = empty_grasps("fetch", "gelatin_box", num_joints=pick_scene.robot.hand.num_dofs)
    with pytest.raises(InputError, match="empty"):
        plan(grasps=none)
    with pytest.raises(InputError, match="by 'panda'"):
        plan(grasps=replace(pick_scene.grasps, hand="panda"))
    with pytest.raises(InputError, match="of 'mug' by"):
        plan(grasps=replace(pick_scene.grasps, object="mug"))
    with pytest.raises(InputError, match="no target"):
        plan(world=replace(pick_scene.world, target=None))


@pytest.mark.parametrize(
    "wrong", [{"standoff_m": 0.0}, {"lift_m": -0.1}, {"time_limit_s": 0.0}, {"steps": 0}, {"speed": float("nan")}]
)
def test_wrong_settings_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        PickConfig(**wrong)


def test_a_grasp_that_is_not_proven_is_not_taken(pick_scene) -> None:
    asked: list[np.ndarray] = []

    def proof(grasp: GraspSet) -> bool:
        asked.append(grasp.X_OH[0])
        return len(asked) > 2

    given = pick_scene.robot, pick_scene.grasps, pick_scene.world, pick_scene.q_start
    result = plan_pick(*given, proof=proof, seed=3)
    assert result.plan is not None and len(asked) == 3
    assert result.counts["does not lift it in physics"] == 2
    np.testing.assert_array_equal(asked[0], pick_scene.plan.grasp.X_OH[0])
    np.testing.assert_array_equal(asked[2], result.plan.grasp.X_OH[0])
    never = plan_pick(*given, proof=lambda _: False, seed=3)
    assert never.plan is None and "does not lift it in physics" in never.reason
