"""The page of `transfer --report`: the query beside the grasps of the target hand, in their order."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.cli.grasp_page import about_this_run, trial_table
from neuralgrasps.cli.progress import ProgressBar
from neuralgrasps.cli.terminal import counted
from neuralgrasps.cli.transfer_query import Asked, TransferTask
from neuralgrasps.report.content import DemoReport, KeyFigure
from neuralgrasps.report.page import write_report
from neuralgrasps.report.sections import pretty_name
from neuralgrasps.report.transfer_page import constraint_text, transfer_list


def write_transfer_page(
    path: Path,
    task: TransferTask,
    result: TransferResult,
    record: Mapping[str, Any],
    *,
    command: str,
    progress: ProgressBar,
) -> Path:
    """Write the page of one transfer; `record` is its JSON result."""
    asked, hand, constraints = task.asked, task.hand, task.constraints
    shown = transfer_list(
        result, asked.query, hand, asked.obj, title=asked.title, text=_query_text(asked, constraints),
        grasp=asked.grasp, points_O=asked.points_O, constraints=constraints, progress=progress,
    )  # fmt: skip
    source = pretty_name(asked.grasp[0].name) if asked.grasp else asked.query.source
    protocol = result.grasps.protocol
    report = DemoReport(
        title=f"{pretty_name(asked.obj.name).capitalize()}, from {source} to {pretty_name(hand.name)}",
        subtitle=f"{counted(len(result.grasps), 'grasp')} of the {pretty_name(hand.name)} hand for {asked.title}, the "
        f"most alike first, each held by the physics protocol '{protocol}'.",
        **about_this_run(command, task.seed),
        key_figures=_key_figures(result, record),
        transferred=(shown,),
        tables=(trial_table(protocol, result.grasps.verdicts[protocol].parameters),),
        notes=tuple(_notes(record)),
    )
    return write_report(report, path)


def _key_figures(result: TransferResult, record: Mapping[str, Any]) -> tuple[KeyFigure, ...]:
    generated = sum(o == "generated" for o in result.origin)
    known = (
        f"best of {counted(record['known'], 'known grasp')}: {result.oracle:.3f}" if np.isfinite(result.oracle) else ""
    )
    return (
        KeyFigure(value=f"{result.similarity.max():.3f}", label="contact similarity of the best", note=known),
        KeyFigure(value=str(len(result.grasps)), label="grasps held in physics", note=f"{record['tried']} tried anew"),
        KeyFigure(value=str(generated), label="of these found by search", note="the others were known"),
    )


def _query_text(asked: Asked, constraints: GraspConstraints) -> str:
    what = "its contact map" if asked.grasp is not None else "the closeness of its surface to these points"
    text = f"On {pretty_name(asked.obj.name)}; {what} is what the grasps are compared with."
    return f"{text} {constraint_text(constraints)}".rstrip()


def _notes(record: Mapping[str, Any]) -> list[str]:
    notes = [f"Constraint: {name}." for name in record["constraints"]]
    if record["note"]:
        notes.append(record["note"].removeprefix("warning: "))
    if record["reason"]:
        notes.append(record["reason"])
    if record["constraints_on_known"]:
        notes.append(f"Known grasps: {record['constraints_on_known']}.")
    return notes
