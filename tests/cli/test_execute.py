"""The `execute` verb: one real trial, what it prints and writes, and what it refuses before any work."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

import neuralgrasps
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.cli.execute_show import success_figures, summary_lines
from neuralgrasps.export.pick_plan import load_pick_plan
from neuralgrasps.grasps.grasp_io import save_grasps
from neuralgrasps.grasps.grasp_set import empty_grasps
from neuralgrasps.hands.zoo import load_hand
from tests.cli.conftest import Ended

Call = Callable[..., Ended]
OBJECT = "tomato_soup_can"


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """A run with one trial, and where it wrote."""

    ended: Ended
    folder: Path
    args: tuple[object, ...]

    @property
    def trial(self) -> Path:
        return self.folder / "trials" / f"{OBJECT}_000"


@pytest.fixture
def done(ng: Call, tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Done:
    """Run once; every test looks at the same files."""
    kept = request.config.stash.setdefault(_KEPT, {})
    if "done" not in kept:
        folder = tmp_path_factory.mktemp("execute")
        args = (
            "execute", "--object", OBJECT, "--trials", 1, "--workers", 1, "--pose", "true", "--seed", 3, "--speed", 8,
            "--out", folder, "--video", folder / "all.mp4", "--report", folder / "page.html",
        )  # fmt: skip
        kept["done"] = Done(ended=ng(*args), folder=folder, args=args)
    return kept["done"]


_KEPT = pytest.StashKey[dict[str, Done]]()


def test_a_trial_lifts_the_object_and_says_so(done: Done):
    ended, result = done.ended, done.ended.result
    assert ended.code == 0, ended.err
    assert (result["count"], result["lifted"], result["lifted_with_retry"]) == (1, 1, 1)
    assert result["success_low"] == pytest.approx(0.2065, abs=1e-3)  # Wilson's interval of 1 of 1
    (record,) = result["trials"]
    assert (record["object"], record["arm"], record["pose"], record["cause"]) == (OBJECT, "fetch", "true", "")
    assert record["attempts"][0]["lifted_m"] > 0.16 and record["attempts"][0]["pose_error_mm"] < 1e-6
    row = next(line for line in ended.out.splitlines() if line.strip().startswith(OBJECT))
    assert "yes" in row.split()
    assert "Lifted at the first attempt: 1 of 1 (100 %; 95 % interval 21 to 100 %, Wilson)." in ended.out


def test_the_folder_holds_numbers_pictures_and_the_plan(done: Done):
    record = json.loads((done.trial / "trial.json").read_text())
    assert record == done.ended.result["trials"][0]
    plan = load_pick_plan(done.trial / "plan.yaml")
    robot = mount(load_arm("fetch"), load_hand("fetch"))
    assert (plan.arm, plan.hand, plan.object) == ("fetch", "fetch", OBJECT)
    lift = next(step for step in plan.steps if step.name == "lift").trajectory(robot.arm_names)
    rise = robot.hand_pose(lift.q[-1])[2, 3] - robot.hand_pose(lift.q[0])[2, 3]
    assert rise == pytest.approx(0.2, abs=0.005)
    pictures = {name: np.asarray(Image.open(done.trial / f"{name}.png")) for name in ("standoff", "grasp", "lift")}
    assert {p.shape for p in pictures.values()} == {(480, 640, 3)}
    assert (pictures["standoff"] != pictures["lift"]).mean() > 0.01


def test_the_film_and_the_page_show_the_trial(done: Done):
    with av.open(str(done.folder / "all.mp4")) as container:
        shown = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(shown) > 80 and shown[0].shape == (480, 848, 3)
    assert np.abs(shown[30].astype(int) - shown[-1]).mean() > 1.0
    page = (done.folder / "page.html").read_text()
    assert "tomato soup can, trial 1" in page and "✓ lifted" in page and "data:image/webp" in page


def test_a_second_run_goes_on_where_the_first_ended(ng: Call, done: Done):
    before = (done.trial / "trial.json").stat().st_mtime_ns
    again = ng(*done.args)
    assert again.code == 0 and "1 trial of an earlier run kept" in again.out
    assert (done.trial / "trial.json").stat().st_mtime_ns == before
    assert again.result["trials"] == done.ended.result["trials"]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--object", "mustrad_bottle"), "mustard_bottle"),
        (("--object", OBJECT, "--arm", "fetsch"), "Did you mean 'fetch'"),
        (("--object", OBJECT, "--arm", "fetch", "--hand", "alegro"), "Did you mean 'allegro'"),
        (("--object", OBJECT, "--trials", 0), "--trials is 0; expected at least 1"),
        (("--object", OBJECT, "--workers", 0), "--workers is 0"),
        (("--object", OBJECT, "--seed", -1), "--seed is -1"),
        (("--object", OBJECT, "--clutter", -1), "--clutter is -1"),
        (("--object", OBJECT, "--clutter", 50), "there are"),
        (("--object", OBJECT, "--speed", 0), "--speed is 0"),
        (("--object", OBJECT, "--video", "film.avi"), "ending in .mp4"),
        (("--object", OBJECT, "--grasps", "none.safetensors"), "cannot read grasps"),
    ],
)
def test_bad_options_are_refused_with_a_reason(ng: Call, tmp_path: Path, args: tuple[object, ...], message: str):
    ended = ng("execute", *args, "--out", tmp_path / "out")
    assert ended.code == 2 and message in ended.err, ended.err
    assert not (tmp_path / "out").exists()


def test_a_place_that_cannot_be_written_is_refused_before_the_work(ng: Call, tmp_path: Path):
    (tmp_path / "file").write_text("")
    for option, name in (("--video", "a.mp4"), ("--report", "a.html"), ("--out", "folder")):
        ended = ng("execute", "--object", OBJECT, option, tmp_path / "file" / name)
        assert ended.code == 2 and "is a file, not a folder" in ended.err


@pytest.mark.parametrize(
    ("hand", "name", "message"),
    [
        ("allegro", OBJECT, "is of hand 'allegro', but the robot has 'fetch'"),
        ("fetch", "mug", "is of object 'mug'"),
        ("fetch", OBJECT, "holds no grasp"),
    ],
)
def test_grasps_that_do_not_fit_are_refused(ng: Call, tmp_path: Path, hand: str, name: str, message: str):
    joints = load_hand(hand).num_dofs
    grasps = empty_grasps(hand, name, num_joints=joints)
    if message != "holds no grasp":
        one = {f.name: getattr(grasps, f.name) for f in fields(grasps)}
        grown = {
            k: np.zeros((1, *v.shape[1:]), v.dtype) if isinstance(v, np.ndarray) and v.shape[:1] == (0,) else v
            for k, v in one.items()
        }
        grown["X_OH"] = np.eye(4)[None]
        grasps = type(grasps)(**grown)
    save_grasps(tmp_path / "g.safetensors", grasps)
    ended = ng("execute", "--object", OBJECT, "--grasps", tmp_path / "g.safetensors")
    assert ended.code == 2 and message in ended.err, ended.err


def test_an_arm_without_a_hand_asks_for_one(ng: Call):
    file = Path(neuralgrasps.__file__).parent / "assets" / "arms" / "panda" / "arm.xml"
    ended = ng("execute", "--object", OBJECT, "--arm", file)
    assert ended.code == 2 and "--hand is missing" in ended.err, ended.err


def record(cause: str, *, later: bool = False, drawn: int = 0) -> dict[str, object]:
    return {
        "success": not cause, "success_retry": later or not cause, "cause": cause, "scenes_without_plan": drawn,
        "attempts": [],
    }  # fmt: skip


def test_trials_that_nothing_could_solve_are_counted_apart():
    figures = success_figures([record(""), record("slip", later=True), record("infeasible", drawn=30), record("")])
    assert (figures["count"], figures["lifted"], figures["lifted_with_retry"], figures["infeasible"]) == (3, 2, 3, 1)
    assert figures["success"] == pytest.approx(2 / 3) and figures["causes"] == {"slip": 1, "infeasible": 1}
    text = " ".join(summary_lines(figures))
    assert "2 of 3 (67 %; 95 % interval 21 to 94 %, Wilson)" in text and "With one retry: 3 of 3." in text
    assert "30 scenes drawn again" in text
    assert summary_lines(success_figures([record("infeasible")])) == ["No trial had a plan to carry out."]
