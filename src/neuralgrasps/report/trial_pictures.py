"""One trial for a page: its numbers, a strip of pictures, a small animation, and the card made of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from neuralgrasps.evaluate.execute import Attempt, Trial
from neuralgrasps.report.content import ExecutionFigure
from neuralgrasps.report.film import Film, FilmConfig, film_indices, key_moments
from neuralgrasps.report.sections import number_text, pretty_name
from neuralgrasps.report.video import animation

PICTURES = ("seen", "standoff", "grasp", "lift")
_CAPTIONS = {
    "seen": "what the camera saw, and the pose",
    "standoff": "before the approach",
    "grasp": "the hand closed",
    "lift": "the end",
}
_LOOP_FPS, _LOOP_SPEED = 8, 3.0


def trial_record(trial: Trial) -> dict[str, Any]:
    """The numbers of a trial, by names with their units; without recording and scene."""
    return {
        "object": trial.object,
        "success": trial.success,
        "success_retry": trial.success_retry,
        "cause": trial.cause,
        "detail": trial.detail,
        "recorded": trial.recording is not None and len(trial.recording) > 1,
        "attempts": [_attempt_record(attempt) for attempt in trial.attempts],
    }


def _attempt_record(attempt: Attempt) -> dict[str, Any]:
    plan, pick = attempt.plan, attempt.pick
    motions = () if plan is None else (plan.transfer, plan.approach, plan.lift)
    return {
        "pose_error_mm": attempt.pose_error_mm,
        "pose_error_deg": attempt.pose_error_deg,
        "pose_right": attempt.pose_right,
        "candidate": None if plan is None else plan.index,
        "candidates_tried": None if pick is None else pick.tried,
        "plan_ms": None if pick is None else 1e3 * pick.cpu_s,
        "look_ms": 1e3 * attempt.look_cpu_s,
        "motion_s": sum(motion.duration_s for motion in motions) if motions else None,
        "reason": attempt.reason,
        "lifted_m": attempt.lifted_m,
        "held": attempt.held,
        "hits": list(attempt.hits),
        "X_BO_true": attempt.X_BO_true,
        "X_BO_estimate": attempt.X_BO_estimate,
    }


def strip_pictures(film: Film) -> dict[str, np.ndarray]:
    """Pictures (h, w, 3) by the names in `PICTURES`; what the camera saw is missing where it was not asked."""
    key, seen = key_moments(film.trial), film.seen_large(0)
    found = {} if seen is None else {"seen": seen}
    return found | {n: (film.close_up if n == "grasp" else film.moment)(key[n]) for n in PICTURES[1:]}


def moving_picture(film: Film, size: tuple[int, int] = (480, 360)) -> bytes:
    """The trial as a looping WebP at three times its speed, a second of rest at its end."""
    frames = [film.moment(i) for i in film_indices(film.trial, FilmConfig(speed=_LOOP_SPEED, fps=_LOOP_FPS))]
    return animation([*frames, *frames[-1:] * _LOOP_FPS], fps=_LOOP_FPS, size=size)


def trial_figure(
    record: Mapping[str, Any], pictures: Mapping[str, np.ndarray], *, number: int, moving: bytes = b""
) -> ExecutionFigure:
    """The card of a trial.

    Args:
        record: as from `trial_record`; pictures: as from `strip_pictures`. number: of the trial, from 0.
        moving: an animation of it, or b"".
    """
    attempts = record["attempts"]
    first = attempts[0] if attempts else {}
    moved = next((k for k, a in enumerate(attempts) if a["candidate"] is not None), None)
    names = PICTURES[:2] if moved is None else PICTURES
    captions = _CAPTIONS | ({"standoff": "the scene"} if moved is None else {})
    if moved:
        captions |= {name: f"{captions[name]} (attempt {moved + 1})" for name in names[1:]}
    return ExecutionFigure(
        title=f"{pretty_name(str(record['object']))}, trial {number + 1}",
        success=bool(record["success"]),
        retry=bool(record["success_retry"]),
        cause=str(record["cause"]),
        detail=str(record["detail"]),
        pictures=tuple((captions[name], pictures[name]) for name in names if name in pictures),
        animation=b"" if moved is None else moving,
        facts=_facts(first),
    )


def _facts(first: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Of the first attempt; what was not measured is left out."""
    raised = None if first.get("candidate") is None else 1e3 * first["lifted_m"]
    off = (first.get("pose_error_mm"), ".1f", "mm"), (first.get("pose_error_deg"), ".1f", "°")
    facts = (
        ("pose off", ", ".join(number_text(*part) for part in off)),
        ("grasps tried", number_text(first.get("candidates_tried"), ".0f")),
        ("plan", number_text(first.get("plan_ms"), ".0f", "ms")),
        ("motion", number_text(first.get("motion_s"), ".1f", "s")),
        ("raised by", number_text(raised, ".0f", "mm")),
    )
    return tuple((name, value) for name, value in facts if not value.startswith("–"))
