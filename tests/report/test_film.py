"""Films of trials: every frame shows the recorded moment that it says, and the words tell what happened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.table_scenes import draw_scene
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.evaluate.execute import Attempt, Trial
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import empty_grasps
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.pick import PickPlan, PickResult
from neuralgrasps.report.film import (
    SIZE,
    FilmConfig,
    attempt_lines,
    attempt_numbers,
    film_indices,
    key_moments,
    open_film,
    verdict_text,
)
from neuralgrasps.report.film_panel import PANEL_WIDTH, Words, words_picture
from neuralgrasps.sim.tabletop import Recording

MakeObject = Callable[..., ObjectModel]
PHASES = ("start", *2 * ("open",), *3 * ("transfer",), "approach", *2 * ("close",), "lift", *2 * ("hold",))
EVERY_S = 0.04


@pytest.fixture(scope="module")
def robot() -> Manipulator:
    return mount(load_arm("fetch"), load_hand("fetch"))


def a_plan(robot: Manipulator) -> PickPlan:
    q = robot.q_home[robot.arm_dofs]
    still = Trajectory(
        joint_names=robot.arm_names, t=np.array([0.0, 1.0]), q=np.stack([q, q]), qd=np.zeros((2, len(q)))
    )
    open_hand = robot.hand.q_open
    return PickPlan(
        grasp=empty_grasps("fetch", "red_box", num_joints=robot.hand.num_dofs),
        index=4, X_BH=np.eye(4), transfer=still, approach=still, lift=still, q_pregrasp=open_hand, q_grasp=open_hand,
        q_squeeze=open_hand, clearance_m=0.01,
    )  # fmt: skip


@pytest.fixture(scope="module")
def trial(robot: Manipulator, make_object: MakeObject) -> Trial:
    """The arm stands still while a box rises by 0.2 m: all that a film needs to know."""
    scene = draw_scene([make_object("red_box", box_mesh([0.03, 0.04, 0.06]), cells=16, points=64)], robot.arm, seed=2)
    X_BO = np.repeat(scene.objects[0].X_BO[None, None], len(PHASES), axis=0)
    X_BO[9:, 0, 2, 3] += [0.1, 0.2, 0.2]
    recording = Recording(
        t=2.0 + EVERY_S * np.arange(len(PHASES)), q=np.repeat(robot.q_home[None], len(PHASES), axis=0), X_BO=X_BO,
        phases=PHASES,
    )  # fmt: skip
    pick = PickResult(
        plan=a_plan(robot),
        reason="",
        counts={},
        blocked=False,
        tried=3,
        complete=True,
        cpu_s=0.0421,
        proof_cpu_s=0.0,
        seed=0,
    )
    attempt = Attempt(
        X_BO_true=scene.objects[0].X_BO, X_BO_estimate=scene.objects[0].X_BO, pose_right=True, pose_error_mm=1.24,
        pose_error_deg=0.31, frame=None, pick=pick, reason="", look_cpu_s=0.1, grasps_cpu_s=0.0, lifted_m=0.2,
        held=True,
    )  # fmt: skip
    return Trial(
        object="red_box", arm="fetch", hand="fetch", pose_method="true", seed=0, success=True, success_retry=True,
        cause="", detail="", attempts=(attempt,), recording=recording, scene=scene,
    )  # fmt: skip


def again(trial: Trial) -> Trial:
    """The trial with a first attempt that failed before this one."""
    first = replace(trial.attempts[0], held=False, lifted_m=0.0)
    recording = trial.recording
    assert recording is not None
    count = len(recording)
    twice = Recording(
        t=np.concatenate([recording.t, recording.t + count * EVERY_S + EVERY_S]),
        q=np.concatenate([recording.q] * 2),
        X_BO=np.concatenate([recording.X_BO] * 2),
        phases=(*PHASES[:-1], "return", *("open" if p == "start" else p for p in PHASES)),
    )
    return replace(
        trial, success=False, cause="slip", detail="lost.", attempts=(first, trial.attempts[0]), recording=twice
    )


def test_a_film_shows_title_motion_and_verdict(robot: Manipulator, trial: Trial):
    film, config = open_film(trial, robot), FilmConfig(speed=1.0, fps=25)
    frames = list(film.frames(config))
    assert len(frames) == 25 + 25 + len(PHASES) + 1 + 30  # title, look, every moment and the last once more, verdict
    assert {f.shape for f in frames} == {(SIZE[1], SIZE[0] + PANEL_WIDTH, 3)}
    large = [f[:, : SIZE[0]] for f in frames]
    assert (large[50] == film.moment(0)).all() and (large[50 + 9] == film.moment(9)).all()
    assert (large[50] != large[50 + 9]).any() and (large[0] != large[50]).any()
    assert (frames[-1] != frames[50 + len(PHASES)]).any()  # the verdict is said at the end only
    assert (frames[-1][:, : SIZE[0]] == frames[50 + len(PHASES)][:, : SIZE[0]]).all()


@pytest.mark.parametrize(
    ("speed", "indices"), [(1.0, list(range(12))), (2.0, [0, 2, 4, 6, 8, 10]), (3.0, [0, 3, 6, 9])]
)
def test_a_faster_film_leaves_moments_out(trial: Trial, speed: float, indices: list[int]):
    assert film_indices(trial, FilmConfig(speed=speed, fps=25)) == [*indices, 11]


def test_a_slower_film_repeats_moments(trial: Trial):
    shown = film_indices(trial, FilmConfig(speed=0.5, fps=25))
    assert shown[0] == 0 and np.diff(shown).max() == 1 and len(shown) == 24


def test_key_moments_are_the_ends_of_their_phases(trial: Trial):
    assert key_moments(trial) == {"standoff": 5, "grasp": 8, "lift": 11}
    assert key_moments(again(trial)) == {
        "standoff": 5,
        "grasp": 8,
        "lift": 10,
    }  # of the first attempt, not its way home


def test_every_moment_belongs_to_an_attempt(trial: Trial):
    assert attempt_numbers(trial).tolist() == [0] * 12
    assert attempt_numbers(again(trial)).tolist() == [0] * 12 + [1] * 12
    failed = replace(trial.attempts[0], pick=None, reason="no plan")
    late = replace(trial, attempts=(failed, trial.attempts[0]))
    assert attempt_numbers(late).tolist() == [1] * 12  # the first one never moved


def test_a_film_ends_where_the_simulation_broke_down(trial: Trial):
    recording = trial.recording
    assert recording is not None
    X_BO = recording.X_BO.copy()
    X_BO[7:] = np.nan
    broken = replace(trial, recording=replace(recording, X_BO=X_BO))
    assert film_indices(broken, FilmConfig(speed=1.0, fps=25))[-1] == 6
    assert key_moments(broken) == {"standoff": 5, "grasp": 6, "lift": 6}


def test_words_tell_what_happened(trial: Trial):
    assert verdict_text(trial) == "lifted"
    assert verdict_text(again(trial)) == "lifted, 2nd attempt"
    assert verdict_text(replace(again(trial), success_retry=False)) == "not lifted: slip"
    assert attempt_lines(trial, 0) == ["true pose", "planned in 42 ms"]
    blind = replace(trial, attempts=(replace(trial.attempts[0], X_BO_estimate=None, pick=None),))
    assert attempt_lines(blind, 0) == ["true pose", "no pose found"]


def test_long_words_stay_on_their_sheet():
    size = (PANEL_WIDTH, 140)
    short, long = (words_picture(Words(title=t, verdict=t), size) for t in ("box", "a very long name " * 6))
    assert short.shape == long.shape == (140, PANEL_WIDTH, 3)
    assert (long[:, -8:] == short[:, -8:]).all()  # nothing in the right margin


def test_a_trial_without_recording_has_no_film(robot: Manipulator, trial: Trial):
    with pytest.raises(ValueError, match="not recorded"):
        open_film(replace(trial, recording=None), robot)
