from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import ConvexPart, Hand, PartKind
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.grasp_trial import GraspTrial, Phase, silent_engine
from neuralgrasps.sim.protocols import Actuation, Protocol, get_protocol
from neuralgrasps.sim.replay import trial_trajectory
from neuralgrasps.sim.validate import validate_grasps, verdict_parameters

from .toy import CLOSED, HALF, toy_box, toy_grasps, toy_hand

DEX = get_protocol("dexgraspbench")
CENTRED = (0.0, 0.0, 0.1)
BESIDE = (0.0, 0.05, 0.1)  # the pads close on air
FAR = (0.0, 0.0, 0.3)
IN_THE_PALM = (0.0, 0.0, 0.05)


def _grasps(hand: Hand, box: ObjectModel, *centres: tuple[float, float, float], squeeze_m: float = 0.01) -> GraspSet:
    return toy_grasps(hand, np.array(centres), obj=box, squeeze_m=squeeze_m)


def test_antipodal_holds_and_an_empty_hand_does_not(hand: Hand, box: ObjectModel) -> None:
    verdict = validate_grasps(hand, box, _grasps(hand, box, CENTRED, BESIDE, FAR))
    assert verdict.success.tolist() == [True, False, False]
    assert verdict.displacement_m[0] < 0.001
    assert (verdict.displacement_m[1:] > DEX.max_displacement_m).all()


def test_free_object_falls_as_newton_says(hand: Hand, box: ObjectModel) -> None:
    """Without contact the check that fails is the first with g t^2 / 2 > 5 cm."""
    recorded = trial_trajectory(hand, box, _grasps(hand, box, FAR))
    falling = np.flatnonzero(recorded.force_direction == 0)
    t = np.arange(1, len(falling) + 1) * DEX.timestep_s * DEX.check_every
    moved = np.linalg.norm(recorded.X_HO[falling, :3, 3] - recorded.X_HO[0, :3, 3], axis=1)
    np.testing.assert_allclose(moved, 0.5 * 10.0 * t * (t + DEX.timestep_s), rtol=1e-6)  # semi-implicit steps
    assert recorded.outcome.held == 0 and not recorded.outcome.success


@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_nothing_holds_without_friction(hand: Hand, box: ObjectModel, friction: float) -> None:
    slippery = replace(DEX, friction=friction, torsional_friction=0.0)
    assert not validate_grasps(hand, box, _grasps(hand, box, CENTRED), slippery).success.any()


def test_friction_needed_is_coulombs(box: ObjectModel) -> None:
    """1 N on two pads that press with F each holds while 2 mu F > 1 N."""
    hand = toy_hand(coupled=True, effort=2.0)  # one motor of 2 N on both pads: 1 N each
    grasps = _grasps(hand, box, CENTRED)
    for friction, holds in ((0.55, True), (0.45, False)):
        assert validate_grasps(hand, box, grasps, replace(DEX, friction=friction)).success[0] == holds


def test_turning_too_far_is_a_failure(box: ObjectModel) -> None:
    """Held weakly near its end, the box swings about the line between the pads; torsional friction stops it."""
    hand = toy_hand(coupled=True, effort=2.4)
    grasps = _grasps(hand, box, (0.0, 0.0, 0.13))
    slippery = replace(DEX, torsional_friction=0.0)
    verdict = validate_grasps(hand, box, grasps, slippery)
    assert not verdict.success[0]
    assert verdict.rotation_rad[0] > DEX.max_rotation_rad and verdict.displacement_m[0] < DEX.max_displacement_m
    assert validate_grasps(hand, box, grasps, replace(slippery, max_rotation_rad=3.0)).success[0]
    assert validate_grasps(hand, box, grasps, DEX).success[0]


def test_start_penetration_is_rejected_at_once(hand: Hand, box: ObjectModel) -> None:
    grasps = _grasps(hand, box, IN_THE_PALM)  # 20 mm inside the palm
    verdict = validate_grasps(hand, box, grasps)
    assert not verdict.success[0] and np.isnan(verdict.displacement_m[0])
    outcome = GraspTrial(hand, box, DEX).run(grasps.X_OH[0], grasps.q_pregrasp[0], grasps.q[0], grasps.q_squeeze[0])
    assert outcome.start_penetration_m == pytest.approx(0.02, abs=2e-4)


def test_verdict_does_not_depend_on_batch_order_or_history(hand: Hand, box: ObjectModel) -> None:
    centres = [CENTRED, BESIDE, (0.004, 0.01, 0.12), IN_THE_PALM, (0.0, 0.025, 0.11), (0.002, 0.0, 0.14)]
    grasps = _grasps(hand, box, *centres)
    together = validate_grasps(hand, box, grasps)
    backwards = validate_grasps(hand, box, grasps[::-1])
    for field in ("success", "displacement_m", "rotation_rad"):
        whole = getattr(together, field)
        alone = np.concatenate([getattr(validate_grasps(hand, box, grasps[i]), field) for i in range(len(grasps))])
        np.testing.assert_array_equal(whole, alone)
        np.testing.assert_array_equal(whole, getattr(backwards, field)[::-1])


def test_verdict_is_the_same_in_every_object_frame(hand: Hand) -> None:
    """Moving the origin of O (with the grasp) changes nothing: scans are often far off-centre."""
    near, far = toy_box(), toy_box(centre=(0.3, -0.2, 0.5))
    centres = (CENTRED, (0.004, 0.01, 0.12))
    a = validate_grasps(hand, near, _grasps(hand, near, *centres))
    b = validate_grasps(hand, far, _grasps(hand, far, *centres))
    np.testing.assert_array_equal(a.success, b.success)
    np.testing.assert_allclose(a.displacement_m, b.displacement_m, atol=1e-5)


def test_short_first_round_gives_the_verdict_of_forces_in_turn(box: ObjectModel) -> None:
    """Two motors without a linkage give way to the force, so the object moves and the order of forces could show."""
    hand = toy_hand(coupled=False)
    centres = [CENTRED, BESIDE, (0.0, 0.01, 0.12), (0.0, 0.035, 0.1), (0.0, 0.0, 0.145)]
    grasps = _grasps(hand, box, *centres, squeeze_m=0.002)
    verdict = validate_grasps(hand, box, grasps)
    assert verdict.success.sum() >= 2
    for i in range(len(grasps)):
        recorded = trial_trajectory(hand, box, grasps[i])  # observed trials run the forces in turn
        outcome = recorded.outcome
        assert outcome.success == verdict.success[i]
        if outcome.success:
            moved = np.linalg.norm(recorded.X_HO[:, :3, 3] - recorded.X_HO[0, :3, 3], axis=1)
            assert recorded.phases[int(moved.argmax())] == "hold"
            assert outcome.displacement_m == verdict.displacement_m[i]
            assert outcome.rotation_rad == verdict.rotation_rad[i]


def test_quick_protocol_stops_when_settled_and_agrees(hand: Hand, box: ObjectModel) -> None:
    centres = [CENTRED, BESIDE, (0.004, 0.01, 0.12), (0.0, 0.025, 0.11), FAR]
    grasps = _grasps(hand, box, *centres)
    quick = validate_grasps(hand, box, grasps, "dexgraspbench-quick")
    np.testing.assert_array_equal(quick.success, validate_grasps(hand, box, grasps).success)
    assert quick.parameters["settled_speed"] == 0.01
    lengths = [len(trial_trajectory(hand, box, grasps[0], p)) for p in ("dexgraspbench-quick", "dexgraspbench")]
    assert lengths[0] < lengths[1] / 3
    assert lengths[1] == 1 + 2 * 10 + 6 * 50


def test_ramps_end_at_the_squeeze_target(hand: Hand, box: ObjectModel) -> None:
    grasps = _grasps(hand, box, FAR)
    recorded = trial_trajectory(hand, box, grasps)
    np.testing.assert_allclose(recorded.q[-1], grasps.q_squeeze[0], atol=1e-4)


def _cage(hand: Hand, *, without: int | None) -> Hand:
    """Six fixed walls 1 mm off the faces of a centred box, in the order of the forces; the pads reach nothing."""
    walls = []
    for k in range(6):
        axis, side = k // 2, 1 - 2 * (k % 2)
        size, X_LP = HALF + 0.001, np.eye(4)
        size[axis] = 0.002
        X_LP[:3, 3] = CENTRED
        X_LP[axis, 3] += side * (HALF[axis] + 0.001 + 0.002)
        walls.append(ConvexPart(link=0, kind=PartKind.BOX, size=size, X_LP=X_LP))
    return replace(hand, parts=tuple(wall for k, wall in enumerate(walls) if k != without))


@pytest.mark.parametrize("missing", [None, *range(6)])
@pytest.mark.parametrize("protocol", ["dexgraspbench", "shake"])
def test_a_cage_that_is_open_on_one_side_fails_under_the_pull_to_that_side(
    hand: Hand, box: ObjectModel, missing: int | None, protocol: str
) -> None:
    cage = _cage(hand, without=missing)
    grasps = _grasps(cage, box, CENTRED)
    outcome = GraspTrial(cage, box, protocol).run(
        grasps.X_OH[0], grasps.q_pregrasp[0], grasps.q[0], grasps.q_squeeze[0]
    )
    assert outcome.success == (missing is None)
    assert outcome.held == (6 if missing is None else missing)
    assert validate_grasps(cage, box, grasps, protocol).success[0] == (missing is None)


def test_the_six_forces_are_along_the_axes_of_the_object(hand: Hand, box: ObjectModel) -> None:
    turn = np.eye(4)
    turn[:3, :3] = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]  # R_HO
    turn[:3, 3] = FAR
    forces: dict[int, np.ndarray] = {}
    trial = GraspTrial(hand, box, replace(DEX, max_displacement_m=1e3, max_rotation_rad=4.0))

    def observe(phase: Phase, direction: int, data: Any) -> None:
        applied = data.xfrc_applied[data.body("object").id]
        if phase is Phase.HOLD:
            np.testing.assert_array_equal(applied, forces.setdefault(direction, applied.copy()))  # constant
        else:
            assert not applied.any()

    q = np.full(1, CLOSED)
    trial.run(np.linalg.inv(turn), q, q, q, observe=observe)
    along = {k: turn[:3, :3].T @ force[:3] for k, force in forces.items()}
    expected = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]  # N, on 0.1 kg at 10 m/s^2
    assert sorted(along) == list(range(6))
    np.testing.assert_allclose([along[k] for k in range(6)], expected, atol=1e-12)
    assert not any(force[3:].any() for force in forces.values())


def test_a_hopeless_grasp_is_dropped_in_the_short_first_round(
    hand: Hand, box: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = []
    advance = GraspTrial._advance
    monkeypatch.setattr(GraspTrial, "_advance", lambda self, *a: checks.append(a[0]) or advance(self, *a))
    cage = _cage(hand, without=5)  # only the last force can fail
    assert not validate_grasps(cage, box, _grasps(cage, box, CENTRED)).success[0]
    assert checks.count(Phase.HOLD) <= 6 * 5  # 0.2 s of 40 ms checks for each force; 2 s are 50


def test_half_the_timestep_agrees(hand: Hand, box: ObjectModel) -> None:
    centres = [CENTRED, BESIDE, (0.004, 0.01, 0.12), (0.0, 0.03, 0.11), FAR]
    grasps = _grasps(hand, box, *centres)
    fine = replace(DEX, timestep_s=0.002, check_every=20)
    np.testing.assert_array_equal(
        validate_grasps(hand, box, grasps).success, validate_grasps(hand, box, grasps, fine).success
    )


def test_stop_after_returns_the_tried_prefix(hand: Hand, box: ObjectModel) -> None:
    grasps = _grasps(hand, box, BESIDE, CENTRED, FAR, CENTRED, CENTRED)
    verdict = validate_grasps(hand, box, grasps, stop_after=2)
    assert verdict.success.tolist() == [False, True, False, True]
    assert len(validate_grasps(hand, box, grasps, stop_after=0)) == 0
    assert len(validate_grasps(hand, box, grasps[:0])) == 0


@pytest.mark.parametrize("stop_after", [None, 1, 3])
def test_threads_change_nothing(hand: Hand, box: ObjectModel, stop_after: int | None) -> None:
    rng = np.random.default_rng(1)
    centres = [tuple(c) for c in rng.uniform([-0.004, -0.05, 0.09], [0.004, 0.05, 0.15], (9, 3))]
    grasps = _grasps(hand, box, *centres)
    alone = validate_grasps(hand, box, grasps, stop_after=stop_after)
    for threads in (2, 4, 20):
        beside = validate_grasps(hand, box, grasps, stop_after=stop_after, threads=threads)
        for name in ("success", "displacement_m", "rotation_rad"):
            np.testing.assert_array_equal(getattr(beside, name), getattr(alone, name))


def test_verdict_states_its_conditions(hand: Hand, box: ObjectModel) -> None:
    def parameters(protocol: str | Protocol) -> dict[str, float]:
        return dict(validate_grasps(hand, box, _grasps(hand, box, FAR), protocol).parameters)

    assert parameters("dexgraspbench")["force_n"] == 1.0
    assert parameters("dexgraspbench-hard")["friction"] == pytest.approx(0.3)
    shaken = parameters("shake")
    assert shaken["mass_kg"] == box.mass_kg and shaken["min_joint_effort"] == 20.0


def _numbers() -> list[tuple[str, int]]:
    """Every number of a protocol: its field, and its place in it."""
    sizes = {f.name: _size(getattr(DEX, f.name)) for f in fields(Protocol) if f.name != "name"}
    return [(name, k) for name, size in sizes.items() for k in range(size)]


def _size(value: object) -> int:
    if isinstance(value, tuple):
        return len(value)
    return len(fields(value)) if isinstance(value, Actuation) else 1


def _raised(value: Any, k: int) -> Any:
    if isinstance(value, tuple):
        return (*value[:k], 1.5 * value[k], *value[k + 1 :])
    if isinstance(value, Actuation):
        name = fields(value)[k].name
        return replace(value, **{name: 1.5 * getattr(value, name)})
    return (not value) if isinstance(value, bool) else type(value)(2 * value + 1)


@pytest.mark.parametrize(("name", "k"), _numbers())
def test_every_number_of_the_protocol_is_in_the_verdict(hand: Hand, box: ObjectModel, name: str, k: int) -> None:
    before = verdict_parameters(hand, box, DEX)
    after = verdict_parameters(hand, box, replace(DEX, **{name: _raised(getattr(DEX, name), k)}))
    assert list(after) == list(before) and all(isinstance(v, float) for v in after.values())
    changed = {key for key in after if after[key] != before[key]}
    key = {"object_mass_kg": "mass_kg"}.get(name, name)
    assert any(c.startswith(key) for c in changed), changed


@pytest.mark.parametrize("cause", ["target is not a number", "servo too stiff for the timestep"])
def test_a_diverged_trial_fails_and_leaves_no_trace(
    cause: str,
    hand: Hand,
    box: ObjectModel,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    grasps = _grasps(hand, box, CENTRED)
    X_OH, q_pregrasp, q, q_squeeze = grasps.X_OH[0], grasps.q_pregrasp[0], grasps.q[0], grasps.q_squeeze[0]
    trial = GraspTrial(hand, box, DEX)
    with silent_engine():
        if cause == "target is not a number":
            outcome = trial.run(X_OH, q_pregrasp, q, np.full(1, np.nan))
        else:
            stiff = replace(DEX, prismatic=Actuation(kp=1e12, kv=0.0, armature=0.0))
            outcome = GraspTrial(toy_hand(coupled=True, effort=1e15), box, stiff).run(X_OH, q_pregrasp, q, q_squeeze)
    assert not outcome.success
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")
    after = trial.run(X_OH, q_pregrasp, q, q_squeeze)
    assert after.displacement_m == validate_grasps(hand, box, grasps).displacement_m[0]


def test_grasps_of_another_hand_or_object_are_refused(hand: Hand, box: ObjectModel) -> None:
    grasps = _grasps(hand, box, CENTRED)
    with pytest.raises(InputError, match="hand 'other'"):
        validate_grasps(hand, box, replace(grasps, hand="other"))


def test_trajectory_starts_at_the_pregrasp_and_closes(hand: Hand, box: ObjectModel) -> None:
    grasps = _grasps(hand, box, CENTRED)
    recorded = trial_trajectory(hand, box, grasps)
    np.testing.assert_allclose(recorded.X_HO[0] @ grasps.X_OH[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(recorded.q[0], CLOSED + 0.01)
    squeezed = recorded.phases.index("hold") - 1
    np.testing.assert_allclose(recorded.q[squeezed], CLOSED, atol=5e-4)
    per_force = round(DEX.hold_s / (DEX.timestep_s * DEX.check_every))
    assert [(recorded.force_direction == i).sum() for i in range(6)] == [per_force] * 6
    assert recorded.outcome.success and len(recorded) == len(recorded.time_s)
    with pytest.raises(InputError, match="expected one"):
        trial_trajectory(hand, box, _grasps(hand, box, CENTRED, CENTRED))
