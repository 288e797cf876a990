"""The stages of a demonstration in words: what each came to, or why it failed."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.apply.ordered_pick import place_of
from neuralgrasps.evaluate.execute import Attempt, Trial
from neuralgrasps.report.demonstration_content import StageFigure, Verdict
from neuralgrasps.report.pose_page import percent_text

_NUMBERED = re.compile(r"\b(frames?) (\d+)(?: to (\d+))?\b")
SURE = 0.9  # a confidence below is a doubt
_LENGTH_M = 0.252  # of the hand model at scale 1, wrist to middle fingertip

STAGES = ("object", "detect", "joints", "size", "grasp", "transfer", "plan", "lift")
"""In their order, as `Demonstration.stage` names them; the last two are of the robot."""
TITLES = {
    "object": "Object", "detect": "Hand", "joints": "Joints", "size": "Fit", "grasp": "Grasp",
    "transfer": "Transfer", "plan": "Plan", "lift": "Lift",
}  # fmt: skip


class Frames:
    """What frames are called: "frame 12", by their names (T,) where given."""

    def __init__(self, names: Sequence[str] | None) -> None:
        self._names = names

    def __call__(self, index: int) -> str:
        return f"frame {index if self._names is None else self._names[index]}"


def with_names(text: str, names: Sequence[str]) -> str:
    """A text with "frame 3" and "frames 3 to 5" by the names (T,) of these frames."""

    def called(number: str) -> str:
        return names[int(number)] if int(number) < len(names) and names[int(number)] else number

    def renamed(match: re.Match[str]) -> str:
        last = f" to {called(match[3])}" if match[3] else ""
        return f"{match[1]} {called(match[2])}{last}"

    return _NUMBERED.sub(renamed, text)


def demonstration_stages(
    demo: Demonstration, trial: Trial | None, *, executed: bool, names: Sequence[str] | None = None,
    compiled: bool = False,
) -> tuple[StageFigure, ...]:  # fmt: skip
    """Every stage up to the lift, or to the transfer when nothing was to be carried out.

    Args:
        trial: the robot's, or None when it came to none. executed: it was asked for.
        names: (T,) what the frames are called; their numbers when None. compiled: planning time holds compiling.
    """
    failed, reason = failed_stage(demo, trial, executed=executed)
    called = Frames(names)
    stages = STAGES if executed else STAGES[: STAGES.index("transfer") + 1]
    at = stages.index(failed) if failed in stages else len(stages)
    out = []
    for number, name in enumerate(stages):
        if number > at:
            out.append(StageFigure(name=TITLES[name], verdict="not reached"))
            continue
        text = _TEXTS[name](demo, called) if name in _TEXTS else _robot_text(name, demo, trial, compiled)
        if number == at:
            out.append(StageFigure(name=TITLES[name], text=text, verdict="failed", reason=reason))
        else:
            verdict: Verdict = "doubtful" if _confidence(name, demo) < SURE else "ok"
            out.append(StageFigure(name=TITLES[name], text=text, verdict=verdict))
    return tuple(out)


def _confidence(name: str, demo: Demonstration) -> float:
    """How sure a stage is of what it came to, 0 to 1; 1 where it does not say."""
    if name == "object" and demo.followed is not None and demo.followed.pose is not None:
        return float(demo.followed.pose.confidence)
    if name == "size" and demo.track is not None and demo.track.grasp is not None:
        return float(demo.track.grasp.confidence)
    return 1.0


def failed_stage(demo: Demonstration, trial: Trial | None, *, executed: bool) -> tuple[str, str]:
    """The stage that failed and why; both "" when none did."""
    if demo.stage:
        return demo.stage if demo.stage in STAGES else "detect", demo.reason
    if not executed:
        return "", ""
    if trial is None:
        return "plan", "nothing was tried."
    first = trial.attempts[0]
    if first.plan is None:
        return "plan", first.reason or trial.detail
    return ("", "") if trial.success_retry else ("lift", f"{trial.cause}: {trial.detail}")


def _object_text(demo: Demonstration, called: Frames) -> str:
    followed = demo.followed
    if followed is None or followed.pose is None:
        return "not found"
    if followed.reason:
        return f"at most {percent_text(followed.pose.confidence)} sure"
    text = f"{percent_text(followed.pose.confidence)} sure, in {called(followed.found_in)}"
    return text if followed.lost_from is None else f"{text}; lost from {called(followed.lost_from)}"


def _hand_text(demo: Demonstration, _: Frames) -> str:
    track = demo.track
    if track is None:
        return "not found"
    count, looked, found = len(track.boxes), len(track.looked), len(track.found)
    frames = f"{looked} frame{'s' if looked != 1 else ''}"
    of = frames if looked == count else f"{frames} looked at (of {count})"
    return f"{track.side}, found in {found} of {of}" if found else f"in none of {of}"


def _joints_text(demo: Demonstration, _: Frames) -> str:
    track = demo.track
    seen = [] if track is None else [s for s in track.seen if s is not None]
    if not seen:
        return "not read"
    weight = float(np.median([s.weight.mean() for s in seen]))
    return f"21, mean weight {weight:.2f}, by {seen[0].source}"


def _fit_text(demo: Demonstration, _: Frames) -> str:
    track = demo.track
    if track is None or not np.isfinite(track.scale):
        return "not fitted"
    fits = [f.cloud_rms_m for f in track.frames if f is not None and np.isfinite(f.cloud_rms_m)]
    off = track.grasp.cloud_rms_m if track.grasp is not None else float(np.median(fits)) if fits else np.nan
    near = f", {1e3 * off:.1f} mm off the points" if np.isfinite(off) else ""
    if track.grasp is not None and track.grasp.confidence < SURE:
        near += f", {percent_text(track.grasp.confidence)} sure"
    return f"hand of {1e3 * _LENGTH_M * track.scale:.0f} mm{near}"


def _grasp_text(demo: Demonstration, called: Frames) -> str:
    track = demo.track
    if track is None or track.grasp is None:
        return ""
    touching = f"; {', '.join(track.contacts)} touch" if track.contacts else ""
    fused = f", {len(track.still)} frames fused" if len(track.still) > 1 else ""
    return f"in {called(track.moment)}{fused}{touching}"


def _transfer_text(demo: Demonstration, _: Frames) -> str:
    found = demo.transfer
    if found is None or not len(found.grasps):
        return "no grasp"
    count = len(found.grasps)
    best = float(np.max(found.similarity))
    return f"{count} grasp{'s, best' if count > 1 else ','} similarity {best:.2f}"


_TEXTS = {
    "object": _object_text, "detect": _hand_text, "joints": _joints_text, "size": _fit_text, "grasp": _grasp_text,
    "transfer": _transfer_text,
}  # fmt: skip


def _robot_text(name: str, demo: Demonstration, trial: Trial | None, compiled: bool) -> str:
    attempt = None if trial is None else trial.attempts[0]
    if trial is None or attempt is None or attempt.plan is None or attempt.pick is None:
        return ""
    if name == "plan":
        took = f"in {1e3 * attempt.pick.cpu_s:.0f} ms{' with compiling' if compiled else ''}"
        return f"{_chosen_text(demo, attempt)}, {took}{_passed_text(demo, attempt)}"
    if trial.success_retry:
        lifted = next(a for a in trial.attempts if a.success)
        later = "" if trial.success else f", at the second attempt, by {_chosen_text(demo, lifted)}"
        return f"raised by {1e3 * lifted.lifted_m:.0f} mm and held{later}"
    return f"raised by {1e3 * attempt.lifted_m:.0f} mm"


def _chosen(demo: Demonstration, attempt: Attempt) -> int | None:
    """Place (0 = first) of the grasp that an attempt chose among the transferred ones."""
    if attempt.plan is None or demo.grasps is None or not len(demo.grasps):
        return None
    return place_of(attempt.plan.index, len(demo.grasps))


def _chosen_text(demo: Demonstration, attempt: Attempt) -> str:
    place = _chosen(demo, attempt)
    if place is None or demo.transfer is None:
        return "no grasp"
    return f"grasp no. {place + 1} of similarity {demo.transfer.similarity[place]:.2f}"


def _passed_text(demo: Demonstration, attempt: Attempt) -> str:
    """Why the grasps before the chosen one were passed over, in the planner's words."""
    place = _chosen(demo, attempt)
    if not place or attempt.pick is None:
        return ""
    said = [f"{count} {what}" for what, count in attempt.pick.counts.items() if count]
    why = ", ".join(said) or "they do not clear the table"
    return f"; those before it, as they are or turned: {why}"
