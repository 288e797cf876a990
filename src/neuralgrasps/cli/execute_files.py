"""The film and the page of `execute`, from what its trials left in their folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.execute_trial import FILM_FILE, LOOP_FILE, TrialTask
from neuralgrasps.cli.outputs import make_parent

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.report.content import ExecutionFigure

_PAGE_BYTES = 24_000_000
_SHOWN = 60  # trials on the page, all failures first


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
    from neuralgrasps.report.trial_pictures import PICTURES, trial_figure

    found = {name: _picture(task.folder / f"{name}.png") for name in PICTURES}
    loop = task.folder / LOOP_FILE
    return trial_figure(
        record,
        {name: picture for name, picture in found.items() if picture is not None},
        number=int(record["trial"]),
        moving=loop.read_bytes() if loop.exists() else b"",
    )


def _picture(path: Path) -> np.ndarray | None:
    import numpy as np
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")) if path.exists() else None
