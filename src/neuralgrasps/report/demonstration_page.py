"""The page of a demonstration: what was seen of the person, what the robot makes of it, and where it failed and why."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.evaluate.demonstrate_execute import executed_place
from neuralgrasps.evaluate.execute import Trial
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.seen import HandBox, Side
from neuralgrasps.human.video.grasp_moment import touch
from neuralgrasps.human.video.watch import HandTrack
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.report.content import DemoReport, ExecutionFigure, KeyFigure, StageTime, Table
from neuralgrasps.report.demonstration_content import DemonstrationFigure, StageFigure, TrackFigure
from neuralgrasps.report.demonstration_pictures import (
    Demonstrated,
    as_person,
    close_ups,
    grasp_views,
    moving_overlay,
    strip_pictures,
)
from neuralgrasps.report.demonstration_stages import demonstration_stages
from neuralgrasps.report.hand_overlay import HandLayers
from neuralgrasps.report.pose_page import percent_text
from neuralgrasps.report.sections import number_text, pretty_name
from neuralgrasps.report.transfer_content import TransferList
from neuralgrasps.report.transfer_page import constraint_text, transfer_list

Progress = Callable[[str], None]
_EXECUTION_TEXT = (
    "The robot looks with its own depth camera, finds the object, plans with the grasps in the order above, and lifts. "
    "The object stands where the robot can reach it, on the same side as in the demonstration. Simulated: real "
    "friction, cameras and arms differ."
)
_TRANSFER_TEXT = (
    "Framed, how the person touches the object; beside it the robot's grasps that touch it most alike, best first, "
    "each tried in physics. Similarity is that of the contact maps: 1 is the same, 0 the most different pair."
)
_GRASPS_SHOWN = 7  # beside the person's own
_QUERY_TEXT = "The fitted hand; how it touches the object is what the others are compared with."
_STAGES_TEXT = "From the video to the lifted object; a stage that fails says why, and those after it are not reached."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DemonstrationStory:
    """All that the page shows.

    Attributes:
        frames: (T) of the video. demo: what came of them. obj, hand: as used.
        executed: the robot was to carry it out; trial: what came of that, None when nothing was tried.
        executions: its card.
        rules: what else was asked of the robot's grasps.
        seconds: wall time of what came after the transfer, by stage. compiled: planning time holds compiling.
        named: say frames by their names; else by their numbers.
    """

    frames: Sequence[Frame]
    demo: Demonstration
    obj: ObjectModel
    hand: Hand
    executed: bool = False
    trial: Trial | None = None
    executions: tuple[ExecutionFigure, ...] = ()
    rules: GraspConstraints | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    compiled: bool = False
    named: bool = False

    @property
    def stages(self) -> tuple[StageFigure, ...]:
        return demonstration_stages(
            self.demo, self.trial, executed=self.executed, names=self.names, compiled=self.compiled
        )

    @property
    def names(self) -> tuple[str, ...]:
        """(T,) what the frames are called."""
        return tuple(f.name if self.named and f.name else str(k) for k, f in enumerate(self.frames))


def demonstration_report(
    story: DemonstrationStory, *, robot: str, command: str, machine: str = "", seed: int | None = None,
    version: str = "", created: str = "", progress: Progress | None = None,
) -> DemoReport:  # fmt: skip
    """The page's content; drawing takes some 10 seconds.

    Args:
        robot: name of the hand, and of the arm where it is another.
        progress: called with what is drawn next.
    """
    say, begun = progress or (lambda _: None), time.perf_counter()
    demo, name = story.demo, pretty_name(story.obj.name)
    figure = demonstration_figure(story, say)
    say("the robot's grasps")
    found = demo.transfer
    lists = () if found is None or not len(found.grasps) + len(found.nearest) else (shown_transfer(story),)
    return DemoReport(
        title="Shown by a hand",
        subtitle=f"A person grasps the {name} before a depth camera; {_outcome(story, robot)}.",
        command=command,
        machine=machine,
        seed=seed,
        version=version,
        created=created,
        key_figures=_key_figures(story),
        demonstration=figure,
        transferred=lists,
        executions=story.executions,
        times=_times(story, time.perf_counter() - begun),
        tables=(_stage_table(story.stages),),
        notes=_notes(story),
        section_titles={"executions": "Execution", "numbers": "In numbers", "transferred": "Grasps of the robot"},
        section_texts={
            "executions": _EXECUTION_TEXT,
            "stages": _STAGES_TEXT,
            "transferred": _TRANSFER_TEXT,
            "times": "Wall time of each stage.",
        },
    )


def _times(story: DemonstrationStory, drawing_s: float) -> tuple[StageTime, ...]:
    """Wall time of all stages; `drawing_s` of this page, beside what was drawn for it before."""
    all_s = dict(story.demo.seconds) | dict(story.seconds)
    all_s["drawing"] = all_s.get("drawing", 0.0) + drawing_s
    return tuple(StageTime(stage=stage, wall_s=s) for stage, s in all_s.items())


def _outcome(story: DemonstrationStory, robot: str) -> str:
    stopped = next((s.name.lower() for s in story.stages if s.verdict == "failed"), "")
    if stopped:
        return f"{robot} cannot repeat it, since the stage '{stopped}' failed"
    return f"{robot} lifts it by a grasp that touches it alike" if story.executed else f"{robot} can touch it alike"


def demonstration_figure(story: DemonstrationStory, say: Progress) -> DemonstrationFigure:
    """What was seen: the strip, its film, the hand over the frames, and the grasp."""
    demo, seen = story.demo, drawn_frames(story.frames, story.demo, story.obj)
    if demo.track is None:
        say("the frame")
        shown = shown_frame(seen, demo)
        return DemonstrationFigure(stages=story.stages, close_ups=close_ups(story.frames[shown], seen.layers[shown]))
    say("the video")
    several = len(story.frames) > 1
    track = track_figure(demo, story.obj, story.names)
    moment = shown_frame(seen, demo)
    figure = DemonstrationFigure(
        stages=story.stages,
        frames=strip_pictures(seen, None if track is None else track.gap_mm, names=story.names) if several else (),
        animation=moving_overlay(seen) if several else b"",
        track=track if several else None,
        close_ups=close_ups(story.frames[moment], seen.layers[moment]),
    )
    if demo.X_OH is None or demo.q is None or demo.human is None:
        return figure
    say("the grasp")
    up_O = up_in_object(demo)
    return DemonstrationFigure(
        stages=figure.stages, frames=figure.frames, animation=figure.animation, track=figure.track,
        close_ups=figure.close_ups, views=grasp_views(demo.human, story.obj, demo.X_OH, demo.q, up_O=up_O),
        facts=_grasp_facts(demo),
    )  # fmt: skip


def drawn_frames(frames: Sequence[Frame], demo: Demonstration, obj: ObjectModel) -> Demonstrated:
    """The frames with what was seen in each; at the moment of the grasp the fit to all its still frames."""
    track, followed = demo.track, demo.followed
    layers = []
    for index in range(len(frames)):
        X_CO = None if followed is None else followed.X_CO[index]
        known = X_CO is not None and np.isfinite(X_CO).all()
        fitted = None if track is None else track.frames[index]
        if track is not None and index == track.moment:
            fitted = track.grasp
        layers.append(
            HandLayers(
                box=None if track is None else _decided(track.boxes[index], track.side),
                joints=None if track is None else track.seen[index],
                fitted=fitted,
                mesh=obj.mesh if known else None,
                X_CO=X_CO if known else None,
                name=pretty_name(obj.name),
            )
        )
    looked = frozenset(range(len(frames)) if track is None else track.looked)
    return Demonstrated(frames=frames, layers=layers, moment=-1 if track is None else track.moment, looked=looked)


def _decided(box: HandBox | None, side: Side | None) -> HandBox | None:
    """The box with the side that the whole video was decided for, not the frame's own guess."""
    return replace(box, side=side, side_score=1.0) if box is not None and side else box


def track_figure(demo: Demonstration, obj: ObjectModel, names: Sequence[str] = ()) -> TrackFigure | None:
    """The hand over the frames (T), with their names where given, in numbers; None where it was fitted in none."""
    track = demo.track
    if track is None or demo.followed is None or not any(fitted is not None for fitted in track.frames):
        return None
    count = len(track.frames)
    gap, moved, residual = (np.full(count, np.nan) for _ in range(3))
    before: np.ndarray | None = None
    last = -1
    for index, fitted in enumerate(track.frames):
        if fitted is None:
            continue
        X_CO = demo.followed.X_CO[index]
        if np.isfinite(X_CO).all():
            gap[index] = 1e3 * max(touch(fitted, obj, X_CO).nearest_m, 0.0)
        residual[index] = 1e3 * fitted.cloud_rms_m
        if before is not None:
            step = np.linalg.norm(fitted.joints_C - before, axis=1).mean() / (index - last)
            moved[index] = 1e3 * float(step)
        before, last = fitted.joints_C, index
    named = names[track.moment] if names and track.moment >= 0 else ""
    span = (min(track.still), max(track.still)) if len(track.still) > 1 else None
    return TrackFigure(gap_mm=gap, moved_mm=moved, residual_mm=residual, moment=track.moment, span=span, named=named)


def shown_transfer(story: DemonstrationStory) -> TransferList:
    """The robot's grasps beside the person's; where none holds, the nearest that does not."""
    demo = story.demo
    assert demo.transfer is not None and demo.query is not None and demo.human is not None
    assert demo.X_OH is not None and demo.q is not None
    result = demo.transfer
    if not len(result.grasps) and len(result.nearest):
        result = replace(
            result, grasps=result.nearest, similarity=np.array([result.nearest_similarity]), origin=("the nearest",),
            reasons=("it touches the object most alike, and does not hold",),
        )  # fmt: skip
    place = None if story.trial is None else executed_place(story.trial, demo)
    order = shown_order(len(result.grasps), place)
    at = None if place is None else order.index(place)
    text = " ".join(_sentences(result.reason or _QUERY_TEXT, constraint_text(story.rules)))
    shown = transfer_list(
        _picked(result, order), demo.query, story.hand, story.obj,
        title="shown by the person", text=text,
        grasp=(as_person(demo.human), demo.X_OH, demo.q), constraints=story.rules, up_O=up_in_object(demo),
    )  # fmt: skip
    cards = [replace(grasp, number=k + 1) for k, grasp in zip(order, shown.grasps, strict=True)]
    if at is not None:
        cards[at] = replace(cards[at], reason=f"Carried out, no. {order[at] + 1}: {cards[at].reason}")
    return replace(shown, grasps=tuple(cards))


def _sentences(*texts: str) -> list[str]:
    return [text[:1].upper() + text[1:].rstrip(".") + "." for text in texts if text]


def up_in_object(demo: Demonstration) -> np.ndarray:
    """(3,) what is up in the video, object frame; z where no table was seen."""
    return np.array([0.0, 0.0, 1.0]) if demo.table_O is None else demo.table_O.normal


def shown_order(count: int, place: int | None) -> list[int]:
    """Places of the grasps that get a card, of `count`: the first ones, and the one that was carried out."""
    order = list(range(min(_GRASPS_SHOWN, count)))
    return order if place is None or place in order else [*order[:-1], place]


def _picked(result: TransferResult, indices: Sequence[int]) -> TransferResult:
    """Some grasps of a result, in this order."""
    chosen = np.asarray(indices, int)
    return replace(
        result, grasps=result.grasps[chosen], similarity=result.similarity[chosen],
        origin=tuple(result.origin[i] for i in indices), reasons=tuple(result.reasons[i] for i in indices),
    )  # fmt: skip


def shown_frame(seen: Demonstrated, demo: Demonstration) -> int:
    """The frame of the grasp; without one the last of those in which most was seen."""
    if demo.track is not None and demo.track.moment >= 0:
        return demo.track.moment
    score = [(layer.fitted is not None) + (layer.joints is not None) + (layer.box is not None) for layer in seen.layers]
    if max(score):
        return max(k for k, value in enumerate(score) if value == max(score))
    return 0 if demo.followed is None else max(demo.followed.found_in, 0)


def _key_figures(story: DemonstrationStory) -> tuple[KeyFigure, ...]:
    demo, figures = story.demo, []
    track, found = demo.track, demo.transfer
    if track is not None:
        figures.append(_hand_figure(track))
        if track.grasp is not None:
            sure = percent_text(track.grasp.confidence)
            figures.append(
                KeyFigure(value=sure, label="sure of the fitted grasp", note=_off_text(track.grasp.cloud_rms_m))
            )
    if found is not None and len(found.grasps):
        figures.append(_similarity_figure(story, found))
    if story.trial is not None:
        done = "lifted" if story.trial.success_retry else "not lifted"
        figures.append(KeyFigure(value=done, label="in simulation", note=story.trial.cause))
    return tuple(figures)


def _hand_figure(track: HandTrack) -> KeyFigure:
    """In how many of the frames that were looked at a hand was found, and how many were not."""
    found, looked, count = len(track.found), len(track.looked), len(track.boxes)
    said = [track.side] * bool(found) + [f"{count - looked} of {count} not looked at"] * (looked < count)
    return KeyFigure(value=f"{found} of {looked}", label="frames with a hand", note="; ".join(said))


def _similarity_figure(story: DemonstrationStory, found: TransferResult) -> KeyFigure:
    """How alike the grasp is that was carried out; else the best of all."""
    place = None if story.trial is None else executed_place(story.trial, story.demo)
    best = float(np.max(found.similarity))
    if place is not None:
        rest = f"; best of all {best:.2f}" if found.similarity[place] < best else ""
        note = f"grasp no. {place + 1} of {len(found.grasps)}, carried out{rest}"
        return KeyFigure(value=f"{found.similarity[place]:.2f}", label="contact similarity", note=note)
    known = "" if not np.isfinite(found.oracle) else f"best known grasp {found.oracle:.2f}"
    return KeyFigure(value=f"{best:.2f}", label="contact similarity", note=known)


def _off_text(rms_m: float) -> str:
    return f"{1e3 * rms_m:.1f} mm off the points" if np.isfinite(rms_m) else ""


def _grasp_facts(demo: Demonstration) -> tuple[tuple[str, str], ...]:
    assert demo.track is not None and demo.track.grasp is not None
    track, grasp = demo.track, demo.track.grasp
    facts = (
        ("hand", track.side),
        ("size", f"{track.scale:.2f} of the model"),
        ("confidence", percent_text(grasp.confidence)),
        ("points off", number_text(1e3 * grasp.cloud_rms_m, ".1f", "mm")),
        ("joints off", number_text(1e3 * grasp.joint_rms_m, ".1f", "mm")),
        ("into the object", number_text(1e3 * grasp.penetration_m, ".1f", "mm")),
        ("touching", ", ".join(track.contacts) or "–"),
    )
    return tuple((name, value) for name, value in facts if not value.startswith("–"))


def _stage_table(stages: Sequence[StageFigure]) -> Table:
    words = {"ok": "OK", "doubtful": "doubtful", "failed": "FAILED", "not reached": "not reached"}
    rows = tuple((s.name, words[s.verdict], s.reason or s.text) for s in stages)
    return Table(title="Stages", columns=("stage", "verdict", "what it came to"), rows=rows)


def _notes(story: DemonstrationStory) -> tuple[str, ...]:
    notes = [] if story.demo.track is None else list(dict.fromkeys(story.demo.track.reasons))
    if story.demo.transfer is not None and story.demo.transfer.reason:
        notes.append(story.demo.transfer.reason)
    notes += [f"Constraint: {name}." for name in (story.rules.names if story.rules is not None else ())]
    return tuple(notes)
