"""`neuralgrasps demonstrate`: a person grasps an object before a depth camera, and a robot does the same."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from neuralgrasps.cli.demonstrate_input import Shown, ShownOptions, ShownSource, check_shown, read_shown
from neuralgrasps.cli.models import source_text, warn_of_damage, warn_of_stand_ins
from neuralgrasps.cli.options import Cone, OptionalFile, OptionalFolder, OptionalText, check_seed, read_cone
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.cli.transfer import Regions
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.apply.constraints import GraspConstraints
    from neuralgrasps.apply.demonstrate import Demonstration
    from neuralgrasps.apply.demonstrate_rules import TextRules
    from neuralgrasps.apply.transfer import TransferConfig
    from neuralgrasps.arms.manipulator import Manipulator
    from neuralgrasps.evaluate.execute import Trial
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.synthesis.support import Support

Name = Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
Rgbd = Annotated[Path, tyro.conf.arg(metavar="DIR|FILE")]
_NOTHING_GIVEN = ShownSource()
_RECORD_EVERY_S = 0.04
_RETRIES = 1
_LEAST_TRIALS = 24  # in physics, however few grasps are wanted


def demonstrate(
    terminal: Terminal,
    *,
    rgbd: Rgbd,
    object_name: Annotated[str, tyro.conf.arg(name="object", metavar="NAME|FILE")],
    hand: Name = "fetch",
    arm: OptionalText = None,
    execute: bool = False,
    source: ShownOptions = _NOTHING_GIVEN,
    count: int = 40,
    method: Literal["both", "retrieve", "generate"] = "both",
    only_region: Regions = (),
    keep_free: Regions = (),
    approach: Cone = (),
    grasps: OptionalFile = None,
    flange: OptionalText = None,
    missing_meshes: Literal["error", "skip"] = "error",
    seed: int = 0,
    report: OptionalFile = None,
    video: OptionalFile = None,
    out: OptionalFolder = None,
) -> Outcome:
    """Watch a person grasp an object, and find how a robot hand grasps it alike; with --execute, do it in simulation.

    The object is found and followed, the hand found, its joints read and the hand model fitted; the grasp, in the
    object's frame, is carried over to the robot's hand, and each of its grasps tried in physics. Every stage can fail,
    and says why. Exit code 1 when one does.

    Example: neuralgrasps demonstrate --rgbd video --object mustard_bottle --hand fetch --execute --report page.html

    Args:
        rgbd: folder of frames: NAME-depth and NAME-color files, or depth/ and rgb/; or one depth image.
        object_name: the object that is grasped: a name, or a mesh file.
        hand: of the robot: a name, or a URDF or MJCF file.
        arm: fetch, panda, or a URDF file, to carry the hand with --execute; default the hand's own.
        execute: the robot looks, plans, and lifts the object in simulation.
        source: what was filmed.
        count: grasps wanted; with more of them it is likelier that the robot reaches one.
        method: retrieve: known grasps; generate: new ones, searched; or both.
        only_region: the robot touches the object only there; a REGION is as in `transfer`.
        keep_free: no part of the robot's hand comes near the object there.
        approach: the palm comes along this axis of the object, at most so far off it; down is straight down onto the
            table.
        grasps: known grasps of this hand and object; default the shipped ones, else some are made and kept.
        flange: link of the arm's file that carries the hand, where it is not found.
        missing_meshes: skip: leave out shapes whose mesh files are not there.
        seed: the same seed gives the same result.
        report: HTML page: the video with what was seen, the grasp, the robot's grasps, and the execution.
        video: film of the execution, .mp4.
        out: folder for numbers (JSON), grasps, pictures, and the robot's plan (YAML).
    """
    from neuralgrasps.apply.demonstrate_rules import rules_from_text
    from neuralgrasps.cli.compiling import WORTH_SAYING_S
    from neuralgrasps.cli.demonstrate_files import write_demonstrated
    from neuralgrasps.cli.demonstrate_show import demonstration_record, show_demonstration
    from neuralgrasps.report.demonstration_page import DemonstrationStory

    check_seed(seed)
    check_shown(source)
    _check_options(count, execute=execute, arm=arm, video=video, report=report, out=out)
    begun = time.perf_counter()
    manipulator, robot_hand = _open_robot(hand, arm, flange, missing_meshes, execute=execute)
    obj = _open_object(terminal, object_name)
    rules = rules_from_text(obj, only_region=only_region, keep_free=keep_free, approach=read_cone(approach))
    shown = read_shown(terminal, rgbd, source)
    known = _known(terminal, obj, robot_hand, grasps)
    task = _Task(obj=obj, hand=robot_hand, known=known, rules=rules, config=_wanted(count, method), seed=seed)
    demo = _watched(terminal, shown, task, side=source.side)
    carried = time.perf_counter()
    pictured = report is not None or video is not None or out is not None
    trial, compile_s = _executed(terminal, demo, obj, manipulator, seed=seed, pictured=pictured)
    story = DemonstrationStory(
        frames=shown.frames, demo=demo, obj=obj, hand=robot_hand, executed=execute, trial=trial, rules=task.bound(demo),
        seconds=_robot_seconds(trial, time.perf_counter() - carried), compiled=compile_s >= WORTH_SAYING_S,
        named=shown.named,
    )  # fmt: skip
    result = demonstration_record(story, shown.numbers) | {
        "rgbd": str(rgbd), "arm": None if manipulator is None else manipulator.arm.name, "seed": seed,
        "constraints": [] if rules is None else list(rules.names), "wall_s": time.perf_counter() - begun,
    }  # fmt: skip
    show_demonstration(terminal, result)
    result |= write_demonstrated(
        terminal, story, result, manipulator, sources=(hand, object_name), report=report, video=video, out=out
    )
    return Outcome(result=result, exit_code=0 if not result["stage"] else 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Task:
    """The object shown, the robot's hand with its known grasps, and what is wanted of the transfer."""

    obj: ObjectModel
    hand: Hand
    known: GraspSet | None
    rules: TextRules | None
    config: TransferConfig
    seed: int

    def bound(self, demo: Demonstration) -> GraspConstraints | None:
        """The constraints over the table that was seen; None without any, or where nothing was to be carried over."""
        return None if self.rules is None or demo.transfer is None else self.rules(demo.table_O)


def _wanted(count: int, method: Literal["both", "retrieve", "generate"]) -> TransferConfig:
    from neuralgrasps.apply.demonstrate import DemonstrateConfig

    trials = max(3 * count // 2, _LEAST_TRIALS)
    return replace(DemonstrateConfig().transfer, count=count, trials=trials, method=method)


def _check_options(
    count: int, *, execute: bool, arm: str | None, video: Path | None, report: Path | None, out: Path | None
) -> None:
    if count < 1:
        raise InputError(f"--count is {count}; expected at least 1.")
    if arm is not None and not execute:
        raise InputError("--arm carries the hand in the execution; add --execute, or leave it out.")
    if video is not None and not execute:
        raise InputError("--video films the execution; add --execute, or leave it out.")
    if video is not None and video.suffix.lower() != ".mp4":
        raise InputError(f"--video is '{video}'; expected a file ending in .mp4.")
    for path in (video, report):
        if path is not None:
            check_writable(path)
    if out is not None:
        check_writable(out, folder=True)


def _open_robot(
    hand: str, arm: str | None, flange: str | None, missing_meshes: Literal["error", "skip"], *, execute: bool
) -> tuple[Manipulator | None, Hand]:
    """The robot's hand, and its arm where it is to move."""
    from neuralgrasps.cli.execute_trial import RobotChoice
    from neuralgrasps.hands.zoo import load_hand

    if not execute:
        return None, load_hand(hand, missing_meshes=missing_meshes)
    chosen = _own_arm(hand) if arm is None else source_text(arm)
    robot = RobotChoice(arm=chosen, hand=source_text(hand), flange=flange, missing_meshes=missing_meshes).open()
    return robot, robot.hand


def _own_arm(hand: str) -> str:
    """The arm that a built-in hand belongs to.

    Raises:
        InputError: another hand, whose arm must be given.
    """
    from neuralgrasps.arms.zoo import arm_names
    from neuralgrasps.hands.zoo import load_hand

    if hand in arm_names():
        return hand
    load_hand(hand)  # says what is wrong with it first
    names = ", ".join(arm_names())
    raise InputError(
        f"--arm is missing: hand '{hand}' comes with none. Give a name ({names}) or a URDF file.{_whole_robot(hand)}"
    )


def _whole_robot(hand: str) -> str:
    """What to do where the file of the hand is one of a whole robot."""
    if Path(hand).suffix.lower() != ".urdf":
        return ""
    return f" Is '{Path(hand).name}' the whole robot? Then it is the arm too: --arm {hand}."


def _open_object(terminal: Terminal, spec: str) -> ObjectModel:
    from neuralgrasps.objects.zoo import load_object

    with terminal.progress("reading the object"):
        obj = load_object(spec)
    warn_of_damage(terminal, [obj])
    warn_of_stand_ins(terminal, {obj.name: spec}, {obj.name: obj})
    return obj


def _known(terminal: Terminal, obj: ObjectModel, hand: Hand, file: Path | None) -> GraspSet | None:
    """Grasps of the file, else of a shipped run; None: they are made on the spot."""
    from neuralgrasps.errors import NeuralGraspsError
    from neuralgrasps.grasps.grasp_io import load_grasps
    from neuralgrasps.model.checkpoint import run_grasps
    from neuralgrasps.model.run_notes import shipped_runs

    if file is not None:
        found = load_grasps(file)
        if (found.hand, found.object) != (hand.name, obj.name) or not len(found):
            raise InputError(
                f"grasp file '{file}' holds {len(found)} grasps of '{found.hand}' on '{found.object}'; expected some "
                f"of '{hand.name}' on '{obj.name}'."
            )
        return found
    try:
        sets = (run_grasps(run, hand, obj) for run in shipped_runs())
        return next((found for found in sets if found is not None), None)
    except NeuralGraspsError as error:
        terminal.complain(f"note: shipped grasps are not used, new ones are made: {error}")
        return None


def _watched(terminal: Terminal, shown: Shown, task: _Task, *, side: Literal["right", "left"] | None) -> Demonstration:
    """What was seen and carried over; where constraints left no grasp, the reason says what they took."""
    from neuralgrasps.apply.demonstrate import DemonstrateConfig
    from neuralgrasps.apply.demonstrate import demonstrate as watch
    from neuralgrasps.cli.compiling import BEGINS, compile_clock

    with terminal.progress("watching"), compile_clock(lambda: terminal.complain(BEGINS)):
        demo = watch(
            shown.frames, task.obj, task.hand, joints=shown.joints, side=side, known=task.known,
            constraints=task.rules, seed=task.seed, config=DemonstrateConfig(transfer=task.config),
        )  # fmt: skip
    if shown.named:
        demo = _by_name(demo, [frame.name for frame in shown.frames])
    bound = task.bound(demo)
    if demo.stage != "transfer" or bound is None:
        return demo
    return replace(demo, reason=_reason_with(terminal, demo, task, bound))


def _by_name(demo: Demonstration, names: Sequence[str]) -> Demonstration:
    """The same with frames called by the names of their files in all that is said."""
    from neuralgrasps.report.demonstration_stages import with_names

    track = demo.track
    if track is not None:
        reasons = tuple(with_names(reason, names) for reason in track.reasons)
        track = replace(track, reason=with_names(track.reason, names), reasons=reasons)
    return replace(demo, reason=with_names(demo.reason, names), track=track)


def _reason_with(terminal: Terminal, demo: Demonstration, task: _Task, rules: GraspConstraints | None) -> str:
    """Why no grasp was found under the constraints: what each takes, and what would hold without them."""
    from neuralgrasps.apply.demonstrate import demonstration_support
    from neuralgrasps.apply.transfer import transfer

    assert demo.query is not None
    support = demonstration_support(task.obj, demo.table_O)
    parts = [_what_was_taken(task, rules, support) or demo.reason.rstrip(".")]
    with terminal.progress("without the constraints"):
        free = transfer(
            demo.query, task.hand, task.obj, known=task.known, config=replace(task.config, count=1, robust=0.0),
            seed=demo.seed, support=support,
        )  # fmt: skip
    if len(free.grasps):
        parts.append(f"without the constraints one of similarity {free.similarity[0]:.2f} holds")
    return "; ".join(parts) + "."


def _what_was_taken(task: _Task, rules: GraspConstraints | None, support: Support | None) -> str:
    """What each condition takes of all grasps there were, where it leaves none; else ""."""
    from neuralgrasps.apply.demonstrate_rules import known_under

    if rules is None:
        return ""
    all_of_them = known_under(
        task.hand, task.obj, known=task.known, config=task.config, support=support, constraints=rules, seed=task.seed
    )
    if all_of_them is None or not len(all_of_them):
        return ""
    X_OH, q, q_pregrasp = all_of_them.X_OH, all_of_them.q, all_of_them.q_pregrasp
    if (rules.allows(task.hand, X_OH, q, q_pregrasp) & _clear(task.hand, all_of_them, support)).any():
        return ""
    known = 0 if task.known is None else len(task.known)
    said = rules.describe(task.hand, X_OH, q, q_pregrasp, support=support)
    made = len(all_of_them) - known
    return f"no grasp of hand '{task.hand.name}' meets all conditions ({known} known, {made} made for this): {said}"


def _clear(hand: Hand, grasps: GraspSet, support: Support | None) -> np.ndarray:
    import numpy as np

    if support is None:
        return np.ones(len(grasps), np.bool_)
    return support.allows(hand, grasps.X_OH, grasps.q, grasps.q_pregrasp)


def _executed(
    terminal: Terminal, demo: Demonstration, obj: ObjectModel, manipulator: Manipulator | None, *, seed: int,
    pictured: bool,
) -> tuple[Trial | None, float]:  # fmt: skip
    """What came of carrying it out, None when nothing was transferred; and how long that compiled, seconds."""
    from neuralgrasps.cli.compiling import BEGINS, compile_clock
    from neuralgrasps.evaluate.demonstrate_execute import execute_demonstration
    from neuralgrasps.evaluate.execute import ExecuteConfig

    if demo.stage or manipulator is None:
        return None, 0.0
    config = ExecuteConfig(retries=_RETRIES, record_every_s=_RECORD_EVERY_S if pictured else None)
    with terminal.progress("the robot picks it up"), compile_clock(lambda: terminal.complain(BEGINS)) as clock:
        trial = execute_demonstration(demo, obj, manipulator, config=config, seed=seed)
    return trial, clock.seconds


def _robot_seconds(trial: Trial | None, all_s: float) -> dict[str, float]:
    """What the robot took, planning apart from the rest."""
    if trial is None:
        return {}
    planning = sum(attempt.pick.cpu_s for attempt in trial.attempts if attempt.pick is not None)
    return {"planning": planning, "execution": max(all_s - planning, 0.0)}
