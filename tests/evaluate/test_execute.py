"""Whole trials: lifted and held, or the cause that was put there on purpose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from neuralgrasps.apply.pick_up import PickUpConfig, Stage
from neuralgrasps.apply.simulated_robot import SimulatedRobot
from neuralgrasps.apply.table_scenes import TableScene
from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.evaluate import execute_bench_trials
from neuralgrasps.evaluate.execute import (
    Attempt,
    ExecuteConfig,
    Trial,
    _carried_out,
    _cause,
    _returned,
    execute_trial,
    run_trial,
)
from neuralgrasps.evaluate.execute_bench_trials import solvable_scene
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.planning.pick import PickResult
from neuralgrasps.planning.world import PlacedObject

PICK = PickUpConfig(stages=(Stage(4, None),), hold_s=1.0)
ONCE = ExecuteConfig(pose="true", retries=0, pick=PICK)


@dataclass
class Off:
    """Estimates that are off by `shift` the first `times` times; in the place of `PaperPoses`."""

    shift: tuple[float, float, float]
    times: int = 99

    def baseline(self, obj, view, sighting) -> np.ndarray:
        X_BO = sighting.X_BO.copy()
        if self.times > 0:
            X_BO[:3, 3] += self.shift
        self.times -= 1
        return X_BO


def trial_of(pick_scene, *, scene: TableScene | None = None, seed: int = 1, **more: Any) -> Trial:
    given = {"grasps": pick_scene.grasps, "config": ONCE, **more}
    return execute_trial(scene or pick_scene.scene, pick_scene.robot, seed=seed, **given)


def at(pick_scene, *placed: tuple[Any, float, float, float]) -> TableScene:
    """Objects upright at (x, y), turned by a yaw."""
    objects = []
    for obj, x, y, yaw in placed:
        X, c, s = np.eye(4), np.cos(yaw), np.sin(yaw)
        X[:2, :2] = [[c, -s], [s, c]]
        X[:3, 3] = [x, y, pick_scene.robot.arm.table_height_m - obj.mesh.bounds[0, 2]]
        objects.append(PlacedObject(obj=obj, X_BO=X))
    return TableScene(table=pick_scene.scene.table, objects=tuple(objects), seed=0)


# ------------------------------------------------------------------ success


@pytest.fixture(scope="module")
def lifted(pick_scene) -> Trial:
    config = replace(ONCE, pose="ours", recheck=True, record_every_s=0.1)
    return trial_of(pick_scene, config=config)


def test_a_box_is_lifted_and_held(lifted) -> None:
    (attempt,) = lifted.attempts
    assert (lifted.success, lifted.success_retry, lifted.cause, lifted.detail) == (True, True, "", "")
    assert (lifted.object, lifted.arm, lifted.hand, lifted.pose_method) == ("gelatin_box", "fetch", "fetch", "ours")
    assert attempt.lifted_m == pytest.approx(PICK.plan.lift_m, abs=0.01) and attempt.held and attempt.hits == ()
    assert attempt.touched and attempt.pushed_m < 0.002
    assert attempt.pose_right and attempt.pose_error_mm < 2.0 and attempt.frame is not None


def test_a_trial_says_in_a_line_what_came_of_it(lifted) -> None:
    assert repr(lifted) == f"Trial(gelatin_box by fetch: lifted {1e3 * lifted.attempts[0].lifted_m:.0f} mm)"
    failed = replace(lifted, success=False, success_retry=False, cause="slip")
    assert repr(failed) == "Trial(gelatin_box by fetch: not lifted, slip)"


def test_executed_paths_are_checked_again(lifted) -> None:
    checks = lifted.attempts[0].rechecks
    assert len(checks) == 3 and all(check.free for check in checks) and all(check.samples > 50 for check in checks)


def test_the_recording_goes_through_the_phases(lifted) -> None:
    recording = lifted.recording
    assert list(dict.fromkeys(recording.phases))[-6:] == ["open", "transfer", "approach", "close", "lift", "hold"]
    height = recording.X_BO[:, 0, 2, 3]
    holding = np.array([p == "hold" for p in recording.phases])
    assert height[holding].min() - height[0] > 0.8 * PICK.plan.lift_m


def test_the_same_seed_gives_the_same_trial(pick_scene) -> None:
    config = replace(ONCE, pose="ours", pick=replace(PICK, hold_s=0.2))
    first, again = (trial_of(pick_scene, config=config, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.attempts[0].X_BO_estimate, again.attempts[0].X_BO_estimate)
    np.testing.assert_array_equal(first.attempts[0].plan.transfer.q, again.attempts[0].plan.transfer.q)
    assert first.attempts[0].lifted_m == again.attempts[0].lifted_m != 0.0


# ------------------------------------------------------------------ causes, each forced


def test_with_too_little_force_it_slips(pick_scene) -> None:
    """2 kg, and a jaw that may use a tenth of its force: 6 N."""
    scene = at(pick_scene, (replace(pick_scene.obj, mass_kg=2.0), 0.75, 0.1, 0.0))
    trial = trial_of(pick_scene, scene=scene, config=replace(ONCE, pick=replace(PICK, force=0.1)))
    assert (trial.success, trial.cause) == (False, "slip"), trial.detail
    assert trial.attempts[0].touched and trial.attempts[0].lifted_m < 0.1 and not trial.attempts[0].held
    assert "rose by" in trial.detail


def test_a_wrong_pose_is_perception(pick_scene) -> None:
    trial = trial_of(pick_scene, config=replace(ONCE, pose="baseline"), paper=Off((0.05, 0.0, 0.0)))
    assert (trial.success, trial.cause) == (False, "perception")
    assert "the pose was 50 mm" in trial.detail and not trial.attempts[0].pose_right
    assert trial.attempts[0].pose_error_mm == pytest.approx(50.0, abs=2.0)


def test_nothing_seen_is_perception(pick_scene) -> None:
    robot = SimulatedRobot(pick_scene.robot, pick_scene.scene)
    robot.take_away(0)
    config = replace(ONCE, pose="ours")
    trial = run_trial(robot, pick_scene.scene, 0, grasps=pick_scene.grasps, paper=None, config=config, seed=0)
    assert (trial.success, trial.cause, trial.detail) == (False, "perception", "nothing stands on the table.")
    assert np.isnan(trial.attempts[0].pose_error_mm) and not trial.attempts[0].pose_right


def test_an_object_beyond_reach_is_no_plan(pick_scene) -> None:
    far = at(pick_scene, (pick_scene.obj, 1.6, 0.0, 0.0))
    X_BX = far.table.X_BX.copy()
    X_BX[0, 3] += 0.5
    far = replace(far, table=replace(far.table, X_BX=X_BX, half=far.table.half + np.array([0.5, 0.0, 0.0])))
    trial = trial_of(pick_scene, scene=far)
    assert (trial.success, trial.cause) == (False, "no plan") and "out of reach" in trial.detail
    assert trial.attempts[0].plan is None and trial.attempts[0].lifted_m == 0.0


def test_touching_what_was_not_known_to_be_there_is_a_collision(pick_scene, make_object) -> None:
    """Posts on all sides stand there in physics; the planner is told that they were taken away."""
    post = make_object("post", box_mesh([0.012, 0.012, 0.045]), cells=32)
    middle = pick_scene.scene.objects[0].X_BO[:2, 3]
    ring = [(post, *(middle + 0.062 * np.array([np.cos(a), np.sin(a)])), a) for a in np.arange(8) * np.pi / 4]
    scene = at(pick_scene, *ring)
    scene = replace(scene, objects=(*pick_scene.scene.objects, *scene.objects))
    robot = SimulatedRobot(pick_scene.robot, scene)
    robot.settle()
    robot._gone |= set(range(1, 9))
    trial = run_trial(robot, scene, 0, grasps=pick_scene.grasps, paper=None, config=ONCE, seed=1)
    attempt = trial.attempts[0]
    assert (trial.success, trial.cause) == (False, "collision") and attempt.hits
    assert "post" in trial.detail and "N" in trial.detail


def test_closing_beside_it_is_a_push_away(pick_scene) -> None:
    """Grasps that were moved aside by a hand's breadth: nothing is touched."""
    aside = pick_scene.grasps.X_OH.copy()
    aside[:, 2, 3] += 0.12
    grasps = replace(pick_scene.grasps, X_OH=aside)
    trial = trial_of(pick_scene, grasps=grasps)
    assert (trial.success, trial.cause) == (False, "push-away"), trial.detail
    assert not trial.attempts[0].touched and "the closed hand did not touch it" in trial.detail


ATTEMPT = Attempt(
    X_BO_true=np.eye(4), X_BO_estimate=np.eye(4), pose_right=True, pose_error_mm=1.0, pose_error_deg=2.0, frame=None,
    pick=None, reason="", look_cpu_s=0.0, grasps_cpu_s=0.0, touched=True,
)  # fmt: skip


def test_causes_in_their_order(pick_scene) -> None:
    """What came first is the cause: no pose, no plan, a wrong pose, a hit, a push, and slipping last."""
    planned = PickResult(
        plan=pick_scene.plan, reason="", counts={}, blocked=False, tried=1, complete=True, cpu_s=0.0, proof_cpu_s=0.0,
        seed=0,
    )  # fmt: skip
    done = replace(ATTEMPT, pick=planned)
    pushed = replace(done, pushed_m=0.03)
    cases = [
        (replace(done, held=True), ""),
        (replace(done, held=True, hits=("x",)), "collision"),
        (replace(ATTEMPT, X_BO_estimate=None, reason="nothing"), "perception"),
        (replace(ATTEMPT, reason="far"), "no plan"),
        (replace(ATTEMPT, pose_right=False, reason="far"), "perception"),
        (replace(pushed, pose_right=False, hits=("x",)), "perception"),
        (replace(pushed, hits=("x",)), "collision"),
        (pushed, "push-away"),
        (replace(done, touched=False), "push-away"),
        (replace(done, pushed_m=0.019), "slip"),
        (replace(done, lifted_m=float("nan")), "slip"),
    ]
    assert [_cause(attempt)[0] for attempt, _ in cases] == [cause for _, cause in cases]
    assert all(bool(_cause(attempt)[1]) == bool(cause) for attempt, cause in cases)


# ------------------------------------------------------------------ retries


def test_a_second_look_makes_up_for_a_wrong_first_one(pick_scene) -> None:
    config = replace(ONCE, pose="baseline", retries=1)
    trial = trial_of(pick_scene, config=config, paper=Off((0.0, 0.07, 0.0), times=1))
    assert len(trial.attempts) == 2
    assert (trial.success, trial.success_retry, trial.cause) == (False, True, "perception")
    first, second = trial.attempts
    assert not first.held and second.held and second.lifted_m == pytest.approx(PICK.plan.lift_m, abs=0.02)
    assert second.pose_error_mm < 3.0 < first.pose_error_mm


def test_retries_end(pick_scene) -> None:
    far = at(pick_scene, (pick_scene.obj, 1.6, 0.0, 0.0))
    for retries in (0, 2):
        trial = trial_of(pick_scene, scene=far, config=replace(ONCE, retries=retries))
        assert len(trial.attempts) == 1 + retries and not trial.success_retry


def test_a_simulation_that_broke_down_is_a_failure_and_not_retried(pick_scene, monkeypatch) -> None:
    """As in the lift of the first attempt; a second look would find nothing."""
    robot = SimulatedRobot(pick_scene.robot, pick_scene.scene)
    robot.settle()
    execute = robot.execute

    def breaks_down(trajectory) -> None:
        execute(trajectory)
        robot.table_top.diverged = robot.table_top.phase == "lift"

    monkeypatch.setattr(robot, "execute", breaks_down)
    config = replace(ONCE, pose="ours", retries=1)
    trial = run_trial(robot, pick_scene.scene, 0, grasps=pick_scene.grasps, paper=None, config=config, seed=0)
    assert not trial.success and not trial.success_retry and len(trial.attempts) == 1
    assert np.isnan(trial.attempts[0].lifted_m) and not trial.attempts[0].held


def test_success_needs_no_retry(pick_scene) -> None:
    trial = trial_of(pick_scene, config=replace(ONCE, retries=2))
    assert trial.success and len(trial.attempts) == 1


# ------------------------------------------------------------------ scenes for the benchmark


def test_scenes_that_nothing_solves_are_counted_with_their_reasons(pick_scene, make_object, monkeypatch) -> None:
    monkeypatch.setattr(execute_bench_trials, "_DRAWS", 3)
    block = make_object("block", box_mesh([0.08, 0.08, 0.08]), cells=32)  # no jaw of 100 mm spans it
    scene, record = solvable_scene(pick_scene.robot, block, None, 0, 0)
    assert scene is None and not record.found and record.draws == 3 == len(record.reasons)
    assert all("too wide" in reason for reason in record.reasons)


def test_a_scene_that_can_be_solved_is_given_with_its_record(pick_scene) -> None:
    scene, record = solvable_scene(pick_scene.robot, pick_scene.obj, pick_scene.grasps, 0, 0)
    assert scene is not None and record.found and record.draws == len(record.reasons) + 1
    assert record.pair == "fetch+fetch" and record.tried >= 1 and record.plan_cpu_s > 0.0
    again, _ = solvable_scene(pick_scene.robot, pick_scene.obj, pick_scene.grasps, 0, 0)
    np.testing.assert_array_equal(scene.objects[0].X_BO, again.objects[0].X_BO)


def test_wrong_settings_are_refused(pick_scene) -> None:
    with pytest.raises(UnknownNameError, match="pose method 'true_pose'"):
        ExecuteConfig(pose="true_pose")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="retries is -1"):
        ExecuteConfig(retries=-1)
    with pytest.raises(InputError, match="'contact' needs a trained field"):
        trial_of(pick_scene, config=replace(ONCE, pose="contact"))


def test_an_arm_that_is_held_up_ends_the_trial_and_says_where(pick_scene) -> None:
    """The next motion would begin elsewhere: the robot refuses it, the trial goes on to its verdict."""
    robot = SimulatedRobot(pick_scene.robot, pick_scene.scene)
    robot.settle()
    planned = PickResult(
        plan=pick_scene.plan, reason="", counts={}, blocked=False, tried=1, complete=True, cpu_s=0.0, proof_cpu_s=0.0,
        seed=0,
    )  # fmt: skip
    attempt = replace(ATTEMPT, X_BO_true=robot.object_pose(0), pick=planned, world=pick_scene.world)
    assert not _returned(robot, attempt, 0)
    robot.execute(pick_scene.plan.transfer)
    done = _carried_out(robot, attempt, pick_scene.plan, 0, PICK)
    assert not done.success and done.hits[-1].startswith("transfer: the trajectory begins at")
    assert _cause(done)[0] == "collision"
