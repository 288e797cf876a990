"""`neuralgrasps execute`: objects looked at, grasped and lifted in simulation, with films of it."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.execute_show import show_trials, success_figures
from neuralgrasps.cli.models import open_objects, source_text, warn_of_damage, warn_of_stand_ins
from neuralgrasps.cli.options import OptionalFile, OptionalFolder, OptionalText, Workers, check_seed
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError, NeuralGraspsError

if TYPE_CHECKING:
    from neuralgrasps.cli.execute_trial import TrialTask
    from neuralgrasps.evaluate.pose_bench_methods import Library
    from neuralgrasps.objects.object_model import ObjectModel

ObjectNames = Annotated[tuple[str, ...], tyro.conf.arg(name="object", metavar="NAME|FILE|DIR ...")]
_LOOPS = 6  # trials whose animation is on the page
_SLOWEST, _FASTEST = 0.1, 20.0


def execute(
    terminal: Terminal,
    *,
    objects: ObjectNames,
    arm: str = "fetch",
    hand: OptionalText = None,
    flange: OptionalText = None,
    missing_meshes: Literal["error", "skip"] = "error",
    trials: int = 10,
    pose: Literal["ours", "true", "baseline", "contact"] = "ours",
    clutter: int = 0,
    grasps: OptionalFile = None,
    retry: bool = True,
    seed: int = 0,
    workers: Workers = None,
    video: OptionalFile = None,
    speed: float = 2.0,
    report: OptionalFile = None,
    out: OptionalFolder = None,
) -> Outcome:
    """Lift objects from a table in simulation: look, find the pose, plan, move, close, lift, hold.

    Each trial puts the object on the table at random; scenes that no plan solves even with the true pose are drawn
    again and counted. Lifted means: 0.2 m up at the first attempt, still there after 2 s, nothing else touched.
    Exit code 1 when nothing was lifted.

    Example: neuralgrasps execute --object mustard_bottle --trials 10 --video out.mp4

    Args:
        objects: names of objects, groups such as ycb7, mesh files or folders of them.
        arm: fetch, panda, or a URDF file.
        hand: name or file; default the arm's own.
        flange: link of the arm's file that carries the hand, where it is not found.
        missing_meshes: skip: leave out shapes whose mesh files are not there.
        trials: per object.
        pose: ours: from the depth camera; true: the simulator's; baseline, contact: the published estimates.
        clutter: further objects on the table.
        grasps: grasp file of this hand and object; default the shipped grasps, and new ones where these do not fit.
        retry: look again and try once more when the object is not held; reported apart.
        seed: the same seed gives the same trials.
        workers: trials at the same time.
        video: film of all trials, .mp4.
        speed: of the film; 1 is real time.
        report: HTML page with pictures of every trial.
        out: folder for numbers, pictures and plans (YAML) of every trial; a run that was stopped goes on from there.
    """
    from neuralgrasps.cli.execute_trial import RobotChoice

    check_seed(seed)
    _check_numbers(trials, clutter, speed, workers)
    _check_places(video, report, out)
    begun = time.perf_counter()
    hand = _default_hand(arm) if hand is None else source_text(hand)
    robot = RobotChoice(arm=source_text(arm), hand=hand, flange=flange, missing_meshes=missing_meshes)
    with terminal.progress("reading the robot and the objects"):
        robot.open()  # refuse what cannot be opened before the work
        library, models = _open(terminal, objects, clutter)
    if grasps is not None:
        _check_grasps(grasps, hand, models)
    _check_pose(pose, library, models)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if out is None else out
        tasks = _tasks(
            folder, library, models, robot=robot, trials=trials, pose=pose, clutter=clutter, grasps=grasps,
            retries=int(retry), seed=seed, pictures=report is not None or out is not None, film=video is not None,
            loop=report is not None, speed=speed,
        )  # fmt: skip
        records = _run(terminal, tasks, workers, kept=out is not None)
        result: dict[str, Any] = success_figures(records) | {
            "arm": robot.arm, "hand": hand, "pose": pose, "clutter": clutter, "seed": seed, "trials": records,
            "wall_s": time.perf_counter() - begun,
        }  # fmt: skip
        show_trials(terminal, records, result)
        result |= _write(terminal, tasks, records, result, video=video, report=report, out=out)
    return Outcome(result=result, exit_code=0 if result["lifted_with_retry"] else 1)


def _check_numbers(trials: int, clutter: int, speed: float, workers: int | None) -> None:
    if trials < 1:
        raise InputError(f"--trials is {trials}; expected at least 1.")
    if clutter < 0:
        raise InputError(f"--clutter is {clutter}; expected 0 or more further objects.")
    if not (math.isfinite(speed) and _SLOWEST <= speed <= _FASTEST):
        raise InputError(f"--speed is {speed:g}; expected {_SLOWEST:g} to {_FASTEST:g}, 1 for real time.")
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}; expected at least 1.")


def _check_places(video: Path | None, report: Path | None, out: Path | None) -> None:
    if video is not None:
        if video.suffix.lower() != ".mp4":
            raise InputError(f"--video is '{video}'; expected a file ending in .mp4.")
        check_writable(video)
    if report is not None:
        check_writable(report)
    if out is not None:
        check_writable(out, folder=True)


def _default_hand(arm: str) -> str:
    """The hand that comes with a built-in arm.

    Raises:
        InputError: another arm, whose hand must be given.
    """
    from neuralgrasps.arms.zoo import arm_names, load_arm
    from neuralgrasps.hands.zoo import hand_names

    if arm in hand_names() and arm in arm_names():
        return arm
    if not Path(arm).exists():
        load_arm(arm)  # says what is wrong with it first
    raise InputError(
        f"--hand is missing: arm '{arm}' comes with none. Give a name ({', '.join(hand_names())}) or a file."
    )


def _open(terminal: Terminal, objects: ObjectNames, clutter: int) -> tuple[Library, dict[str, ObjectModel]]:
    """The library, its first objects the ones asked for; the rest may stand around them."""
    from neuralgrasps.cli.bench_library import library_of, paper_objects
    from neuralgrasps.objects.zoo import object_sources

    sources = tuple(source_text(source) for source in object_sources(objects))
    models = open_objects(sources)
    warn_of_damage(terminal, models.values())
    warn_of_stand_ins(terminal, dict(zip(models, sources, strict=True)), models)
    everything = dict(models)
    if clutter:
        for source, model in zip(paper_objects(()), open_objects(paper_objects(())).values(), strict=True):
            if model.name not in everything:
                everything[model.name], sources = model, (*sources, source)
        if clutter > len(everything) - 1:
            raise InputError(f"--clutter is {clutter}; there are {len(everything) - 1} other objects to put around.")
    return _with_usable_run(terminal, library_of(sources, everything)), models


def _with_usable_run(terminal: Terminal, library: Library) -> Library:
    """The library without its run where that cannot be opened: grasps are then made on the spot."""
    from neuralgrasps.evaluate.pose_bench_methods import open_library_run

    if library.run is None:
        return library
    try:
        open_library_run(library)
    except NeuralGraspsError as error:
        terminal.complain(f"note: shipped grasps are not used, new ones are made: {error}")
        return replace(library, run=None, run_sources=())
    return library


def _check_grasps(path: Path, hand: str, models: dict[str, ObjectModel]) -> None:
    from neuralgrasps.grasps.grasp_io import load_grasps
    from neuralgrasps.hands.zoo import load_hand

    found, name = load_grasps(path), load_hand(hand).name
    if len(found) == 0:
        raise InputError(f"grasp file '{path}' holds no grasp; expected at least one.")
    if found.hand != name:
        raise InputError(
            f"grasp file '{path}' is of hand '{found.hand}', but the robot has '{name}'; make grasps for it."
        )
    if list(models) != [found.object]:
        raise InputError(
            f"grasp file '{path}' is of object '{found.object}'; expected of {', '.join(models)}. "
            "Give --object the object of the file, and no other."
        )


def _check_pose(pose: str, library: Library, models: dict[str, ObjectModel]) -> None:
    """The published estimates need a trained field of every object.

    Raises:
        InputError: there is none.
    """
    from neuralgrasps.evaluate.pose_bench_methods import open_library_run

    if pose not in ("baseline", "contact"):
        return
    known = () if library.run is None else open_library_run(library).field.objects
    missing = [name for name in models if name not in known]
    if missing:
        raise InputError(
            f"--pose {pose} needs a trained field of {', '.join(missing)}, and no shipped run has one; use --pose ours."
        )


def _tasks(
    folder: Path, library: Library, models: dict[str, ObjectModel], *, trials: int, grasps: Path | None, **options: Any
) -> list[TrialTask]:
    """All trials, object by object."""
    import hashlib

    import neuralgrasps
    from neuralgrasps.cli.execute_trial import TrialTask
    from neuralgrasps.hands.fingerprint import fingerprint
    from neuralgrasps.objects.zoo import load_object

    made = "" if grasps is None else hashlib.sha256(grasps.read_bytes()).hexdigest()
    decide: dict[str, Any] = {k: options[k] for k in ("robot", "pose", "clutter", "retries", "seed")}
    opened = options["robot"].open()
    shape = fingerprint((opened.tree, opened.parts, opened.q_home, opened.velocity, opened.acceleration))
    around = [load_object(s).content_hash for s in library.sources] if options["clutter"] else []
    tasks: list[TrialTask] = []
    for target, (name, obj) in enumerate(models.items()):
        for index in range(trials):
            about = (neuralgrasps.__version__, name, obj.content_hash, index, made, library.run, around, shape, decide)
            own: dict[str, Any] = options | {"loop": options["loop"] and len(tasks) < _LOOPS}
            tasks.append(
                TrialTask(
                    key=hashlib.sha256(repr(about).encode()).hexdigest()[:24],
                    folder=folder / "trials" / f"{name}_{index:03d}",
                    library=library,
                    target=target,
                    index=index,
                    total=trials,
                    grasps=grasps,
                    **own,
                )
            )
    return tasks


def _run(terminal: Terminal, tasks: list[TrialTask], workers: int | None, *, kept: bool) -> list[dict[str, Any]]:
    """The records of all trials in their order; those of an earlier run are taken over."""
    from neuralgrasps.cli.execute_trial import kept_record, run_task
    from neuralgrasps.parallel import run_tasks

    records: list[dict[str, Any] | None] = [kept_record(task) for task in tasks]
    waiting = [k for k, record in enumerate(records) if record is None]
    if len(waiting) < len(tasks):
        terminal.say(f"{counted(len(tasks) - len(waiting), 'trial')} of an earlier run kept.")
    if kept:
        terminal.kept = "Finished trials are kept; run the same command again to go on."
    with terminal.progress("trials", "trials") as bar:
        bar(len(tasks) - len(waiting), len(tasks))
        for done, (slot, record) in enumerate(run_tasks(run_task, [(tasks[k],) for k in waiting], workers=workers)):
            records[waiting[slot]] = record
            outcome = "lifted" if record["success_retry"] else record["cause"]
            bar(len(tasks) - len(waiting) + done + 1, len(tasks), f"{record['object']}: {outcome}")
    return [record for record in records if record is not None]


def _write(
    terminal: Terminal, tasks: list[TrialTask], records: list[dict[str, Any]], result: dict[str, Any], *,
    video: Path | None, report: Path | None, out: Path | None,
) -> dict[str, str]:  # fmt: skip
    """Film, page and folder, as asked for; returns what was written, by kind."""
    written: dict[str, str] = {}
    if video is not None:
        from neuralgrasps.cli.execute_files import join_films

        shown = join_films(video, tasks)
        if shown:
            written["video"] = str(video)
            terminal.say(f"Video: {video} ({counted(shown, 'trial')})")
        else:
            terminal.say("No video was written: nothing moved in any trial.")
    if report is not None:
        from neuralgrasps.cli.execute_files import write_execution_page

        write_execution_page(report, tasks, records, result, command=terminal.command)
        written["report"] = str(report)
        terminal.say(f"Page: {report}")
    if out is not None:
        written["folder"] = str(out)
        terminal.say(f"Numbers, pictures and plans: {out}")
    return written
