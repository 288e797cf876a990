"""The page of `novel --report`: the new grasps in pictures, what became of every code, and how new they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.apply.novel import NovelResult
from neuralgrasps.cli.grasp_page import SHOWN, about_this_run, trial_table
from neuralgrasps.cli.progress import ProgressBar
from neuralgrasps.cli.terminal import counted
from neuralgrasps.report.contact_sheet import SheetPair, contact_sheets
from neuralgrasps.report.content import ContactSheet, DemoReport, Histogram, KeyFigure, Table
from neuralgrasps.report.page import write_report
from neuralgrasps.report.sections import pretty_name


def write_novel_page(
    path: Path,
    pair: SheetPair,
    result: NovelResult,
    figures: Mapping[str, Any],
    *,
    command: str,
    workers: int | None,
    progress: ProgressBar,
) -> Path:
    """Write the page of one call: the grasps that hold, but no more than `SHOWN`; `figures` are the JSON result."""
    grasps = pair.grasps
    sheets = contact_sheets([pair], shown=SHOWN, workers=workers, progress=progress)
    held = result.code
    report = DemoReport(
        title=f"New grasps: {pretty_name(grasps.hand)} on {pretty_name(grasps.object)}",
        subtitle=f"{counted(len(result.outcome), 'code')} ({figures['from']}), decoded, closed and tried once each.",
        **about_this_run(command, result.seed),
        key_figures=_key_figures(figures),
        sheets=tuple(_with_novelty(sheet, result) for sheet in sheets),
        tables=(_outcome_table(result), trial_table(grasps.protocol, grasps.verdicts[grasps.protocol].parameters)),
        histograms=(
            Histogram(
                title="From the nearest known grasp",
                unit="mm",
                values={grasps.hand: 1e3 * result.novelty_m[held]},
                meaning="Palm and joints together; a turn of 1 rad counts as 5 cm, a joint over its whole range too.",
            ),
            Histogram(
                title="Largest disturbance resisted", unit="epsilon", values={grasps.hand: np.array(grasps.epsilon)}
            ),
        ),
        section_texts={
            "sheets": "Grasps that were in no data set, in the order of their codes, drawn as computed. ε is the "
            "largest disturbance the contacts resist in any direction; moved is how far the object went in the hand "
            "during the physics trial; overlap is how deep hand and object cut into each other."
        },
    )
    return write_report(report, path)


def _key_figures(figures: Mapping[str, Any]) -> tuple[KeyFigure, ...]:
    search, novelty = figures["search"], f"{figures['novelty_median_mm']:.1f} mm"
    how = f"best of up to {search + 1} closings per code" if search else "one closing per code"
    held, closed = (f"{100 * figures[key]:.0f} %" for key in ("held_share", "force_closure_share"))
    return (
        KeyFigure(value=str(figures["held"]), label="new grasps held in physics", note=f"of {figures['codes']} codes"),
        KeyFigure(value=held, label="of the codes held", note=f"{how}, one trial each"),
        KeyFigure(value=closed, label="of the codes closed to force closure"),
        KeyFigure(value=novelty, label="from the nearest known grasp", note="median of those held"),
    )


def _with_novelty(sheet: ContactSheet, result: NovelResult) -> ContactSheet:
    notes = [f"code {int(c)}, {1e3 * result.novelty_m[c]:.0f} mm from a known grasp" for c in result.code]
    drawn = tuple(replace(grasp, note=note) for grasp, note in zip(sheet.grasps, notes, strict=False))
    return replace(sheet, grasps=drawn)


def _outcome_table(result: NovelResult) -> Table:
    total = len(result.outcome)
    rows = tuple((name, count, f"{100 * count / total:.0f} %") for name, count in result.counts.items())
    return Table(
        title="What became of the codes",
        columns=("outcome", "codes", "share"),
        rows=rows,
        meaning="In the order of the obstacles: overlap that opening the fingers and drawing back does not end; fewer "
        "than two links that touch; contacts that do not resist every disturbance; lost in the physics trial.",
    )
