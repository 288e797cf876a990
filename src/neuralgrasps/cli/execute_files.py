"""The film and the page of `execute`, from what its trials left in their folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.execute_trial import FILM_FILE, LOOP_FILE, PICTURES, TrialTask
from neuralgrasps.cli.outputs import make_parent

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.report.content import ExecutionFigure

_PAGE_BYTES = 24_000_000
_SHOWN = 60  # trials on the page, all failures first
_CAPTIONS = {
    "seen": "what the camera saw, and the pose",
    "standoff": "before the approach",
    "grasp": "the hand closed",
    "lift": "the end",
}


def join_films(video: Path, tasks: Sequence[TrialTask]) -> int:
    """One film of all trials that moved, in their order; returns how many."""
    from neuralgrasps.report.video import join_videos

    parts = [task.folder / FILM_FILE for task in tasks if (task.folder / FILM_FILE).exists()]
    if parts:
        join_videos(video, parts)
    return len(parts)


def write_execution_page(
    page: Path, tasks: Sequence[TrialTask], records: Sequence[Mapping[str, Any]], totals: Mapping[str, Any], *,
    command: str,
) -> None:  # fmt: skip
    """The page with a strip of pictures per trial."""
    from neuralgrasps.cli.grasp_page import about_this_run
    from neuralgrasps.report.execution_page import execution_report
    from neuralgrasps.report.page import write_report

    order = sorted(range(len(tasks)), key=lambda k: (records[k]["success"], k))[:_SHOWN]
    figures = [_figure(tasks[k], records[k]) for k in sorted(order)]
    left_out = len(tasks) - len(figures)
    arm, hand = Path(totals["arm"]).stem, Path(totals["hand"]).stem
    report = execution_report(
        figures, records, totals,
        robot=arm if arm == hand else f"{arm} with {hand}",
        notes=[f"{left_out} of {len(tasks)} trials, all lifted, have no pictures here."] if left_out else [],
        **about_this_run(command, totals["seed"]),
    )  # fmt: skip
    make_parent(page)
    write_report(report, page, max_bytes=_PAGE_BYTES)


def _figure(task: TrialTask, record: Mapping[str, Any]) -> ExecutionFigure:
    from neuralgrasps.report.content import ExecutionFigure
    from neuralgrasps.report.sections import number_text, pretty_name

    attempts = record["attempts"]
    moved = next((k for k, a in enumerate(attempts) if a["candidate"] is not None), None)
    first = attempts[0] if attempts else {}
    names = PICTURES[:2] if moved is None else PICTURES
    captions = dict(_CAPTIONS) if moved is not None else _CAPTIONS | {"standoff": "the scene"}
    if moved:
        captions |= {name: f"{captions[name]} (attempt {moved + 1})" for name in names[1:]}
    loop = task.folder / LOOP_FILE
    raised = None if first.get("candidate") is None else 1e3 * first["lifted_m"]
    facts = (
        ("pose off", f"{number_text(first.get('pose_error_mm'), '.1f', 'mm')}, "
         f"{number_text(first.get('pose_error_deg'), '.1f', '°')}"),
        ("grasps tried", number_text(first.get("candidates_tried"), ".0f")),
        ("plan", number_text(first.get("plan_ms"), ".0f", "ms")),
        ("motion", number_text(first.get("motion_s"), ".1f", "s")),
        ("raised by", number_text(raised, ".0f", "mm")),
    )  # fmt: skip
    return ExecutionFigure(
        title=f"{pretty_name(str(record['object']))}, trial {int(record['trial']) + 1}",
        success=bool(record["success"]),
        retry=bool(record["success_retry"]),
        cause=str(record["cause"]),
        detail=str(record["detail"]),
        pictures=tuple(
            (captions[n], image) for n in names if (image := _picture(task.folder / f"{n}.png")) is not None
        ),
        animation=loop.read_bytes() if loop.exists() and moved is not None else b"",
        facts=tuple((name, value) for name, value in facts if not value.startswith("–")),
    )


def _picture(path: Path) -> np.ndarray | None:
    import numpy as np
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")) if path.exists() else None
