"""What `demonstrate` writes: the page, the film, and the folder with numbers, grasps, pictures and the plan."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.outputs import make_parent
from neuralgrasps.cli.terminal import Terminal, plain
from neuralgrasps.files import write_whole

if TYPE_CHECKING:
    from neuralgrasps.arms.manipulator import Manipulator
    from neuralgrasps.report.content import ExecutionFigure
    from neuralgrasps.report.demonstration_page import DemonstrationStory
    from neuralgrasps.report.film import Film

NUMBERS_FILE, GRASPS_FILE, PLAN_FILE = "demonstration.json", "grasps.safetensors", "plan.yaml"
_PAGE_BYTES = 24_000_000
_FILM_SPEED = 2.0
_STEPS = 3  # that drawing a page has


def write_demonstrated(
    terminal: Terminal, story: DemonstrationStory, record: Mapping[str, Any], manipulator: Manipulator | None, *,
    sources: tuple[str, str], report: Path | None, video: Path | None, out: Path | None,
) -> dict[str, str]:  # fmt: skip
    """Whatever was asked for; returns what was written, by kind. `sources`: hand and object as typed."""
    written: dict[str, str] = {}
    film = _open_film(story, manipulator) if report is not None or video is not None or out is not None else None
    if out is not None:
        _write_folder(out, story, record, manipulator, sources)
        written["folder"] = str(out)
        terminal.say(f"Numbers, grasps and pictures: {out}")
    if video is not None:
        if film is None:
            terminal.say("No video was written: nothing moved.")
        else:
            _write_film(video, film)
            written["video"] = str(video)
            terminal.say(f"Video: {video}")
    if report is not None:
        with terminal.progress("drawing") as bar:
            _write_page(terminal, report, story, record, film, bar)
        written["report"] = str(report)
        terminal.say(f"Page: {report}")
    return written


def _open_film(story: DemonstrationStory, manipulator: Manipulator | None) -> Film | None:
    from neuralgrasps.report.film import open_film

    trial = story.trial
    if trial is None or manipulator is None or trial.recording is None or len(trial.recording) < 2:
        return None
    return open_film(trial, manipulator)


def _write_film(video: Path, film: Film) -> None:
    from neuralgrasps.report.film import FilmConfig
    from neuralgrasps.report.video import write_video

    config = FilmConfig(speed=_FILM_SPEED)
    write_video(video, film.frames(config), fps=config.fps)


def _write_page(
    terminal: Terminal, page: Path, story: DemonstrationStory, record: Mapping[str, Any], film: Film | None, bar: Any
) -> None:
    from neuralgrasps.cli.grasp_page import about_this_run
    from neuralgrasps.report.demonstration_page import demonstration_report
    from neuralgrasps.report.page import write_report

    begun = time.perf_counter()
    executions = _executions(record, film)
    seconds = dict(story.seconds) | {"drawing": time.perf_counter() - begun}
    story = replace(story, executions=executions, seconds=seconds)
    hand, arm = story.hand.name, record["arm"]
    done = iter(range(_STEPS))

    def steps(text: str) -> None:
        bar(next(done, _STEPS), _STEPS, text)

    content = demonstration_report(
        story,
        robot=hand if arm in (None, hand) else f"{arm} with {hand}",
        progress=steps,
        **about_this_run(terminal.command, int(record["seed"])),
    )
    make_parent(page)
    write_report(content, page, max_bytes=_PAGE_BYTES)


def _executions(record: Mapping[str, Any], film: Film | None) -> tuple[ExecutionFigure, ...]:
    from neuralgrasps.report.sections import pretty_name
    from neuralgrasps.report.trial_pictures import moving_picture, strip_pictures, trial_figure

    trial = record["execution"]
    if trial is None:
        return ()
    pictures = {} if film is None else strip_pictures(film)
    moving = b"" if film is None else moving_picture(film)
    title = f"{pretty_name(str(record['object']))}, by {record['arm']}"
    card = trial_figure(trial, pictures, number=0, moving=moving)
    facts = tuple(("plan, with compiling" if k == "plan" and trial["compiled"] else k, v) for k, v in card.facts)
    return (replace(card, title=title, facts=facts),)


def _write_folder(
    out: Path, story: DemonstrationStory, record: Mapping[str, Any], manipulator: Manipulator | None,
    sources: tuple[str, str],
) -> None:  # fmt: skip
    """Numbers, the robot's grasps, the moment of the grasp in pictures, and the plan."""
    from neuralgrasps.cli.execute_trial import write_plan
    from neuralgrasps.report.demonstration_page import drawn_frames, shown_frame
    from neuralgrasps.report.demonstration_pictures import close_ups
    from neuralgrasps.report.figures import save_picture

    out.mkdir(parents=True, exist_ok=True)
    _write_grasps(out / GRASPS_FILE, story, sources)
    seen = drawn_frames(story.frames, story.demo, story.obj)
    index = shown_frame(seen, story.demo)
    for number, (_, picture) in enumerate(close_ups(story.frames[index], seen.layers[index]), start=1):
        save_picture(out / f"grasp_{number}.png", picture)
    if story.trial is not None and manipulator is not None:
        write_plan(out / PLAN_FILE, story.trial, manipulator)
    write_whole(out / NUMBERS_FILE, json.dumps(plain(record), indent=1, allow_nan=False) + "\n")


def _write_grasps(path: Path, story: DemonstrationStory, sources: tuple[str, str]) -> None:
    from neuralgrasps.cli.models import source_text
    from neuralgrasps.dataset.collect import object_fingerprint
    from neuralgrasps.grasps.grasp_io import save_grasps

    grasps = story.demo.grasps
    if grasps is None or not len(grasps):
        return
    grasps = grasps.with_config(
        hand_source=source_text(sources[0]), object_source=source_text(sources[1]), transferred_from="a demonstration"
    )
    save_grasps(path, grasps, hand=story.hand, object_fingerprint=object_fingerprint(story.obj))
