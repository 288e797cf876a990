"""The page of trials in which objects are picked up: a strip of pictures each, what moved, and why some failed."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from neuralgrasps.report.content import DemoReport, ExecutionFigure, KeyFigure, Table
from neuralgrasps.report.sections import PictureEncoder, facts_html, number_text, pretty_name

CAUSES = {
    "infeasible": "no scene was drawn that any plan solves, with the true pose and in a long run",
    "perception": "no pose was found, or a wrong one: off by more than a tenth of the object's diameter, or 1 cm on "
    "average over its surface",
    "no plan": "the pose was right, but no motion to any grasp was found",
    "collision": "the robot touched something other than the object, or the object something other than the table",
    "push-away": "the object moved more than 2 cm before the hand closed, or was not in the hand after it",
    "slip": "the object was in the hand after closing, and was lost or sank later",
}
TRIAL_TEXT = (
    "Each trial, in the order of what happened: what the depth camera saw, with the true pose in white and the pose "
    "that was used in colour; before the straight approach; the hand closed; and the end, two seconds after the lift. "
    "Robot and objects are drawn where the simulation had them."
)
NOTES = (
    "Lifted means: raised by 0.2 m at the first attempt, at least 0.16 m up after two seconds of holding, and nothing "
    "touched but the object with more than 1 N: the robot no table and no neighbour. A second attempt starts with a "
    "new look and is counted apart.",
    "The interval is Wilson's, 95 %. Scenes that no plan solves, with the true pose and in a far longer run, are drawn "
    "again; how many is said above.",
    "Simulated: MuJoCo, position control of the joints, a structured-light depth camera's noise. Real friction, real "
    "cameras and real arms differ.",
)


def execution_report(
    figures: Sequence[ExecutionFigure], records: Sequence[Mapping[str, Any]], totals: Mapping[str, Any], *,
    robot: str, command: str, machine: str = "", seed: int | None = None, version: str = "", created: str = "",
    notes: Sequence[str] = (),
) -> DemoReport:  # fmt: skip
    """The page's content.

    Args:
        figures: the trials, in their order; failures are shown first.
        records: numbers of each trial, totals: of all, as the command `execute` reports them.
        robot: name of the arm, and of the hand where it is another. notes: further ones.
    """
    objects = ", ".join(dict.fromkeys(pretty_name(str(r["object"])) for r in records))
    return DemoReport(
        title="From pose to lifted object",
        subtitle=f"{robot} picks up: {objects}.",
        command=command,
        machine=machine,
        seed=seed,
        version=version,
        created=created,
        key_figures=_key_figures(records, totals),
        executions=tuple(sorted(figures, key=lambda f: (f.success, f.retry))),
        tables=(*_cause_tables(records), _trial_table(records)),
        notes=(*NOTES, *notes),
        section_titles={"numbers": "All trials", "notes": "What this means"},
        section_texts={"executions": TRIAL_TEXT},
    )


def executions_section(figures: Sequence[ExecutionFigure], pictures: PictureEncoder) -> str:
    """A card per trial."""
    return f'<div class="grid one">{"".join(_card(f, pictures) for f in figures)}</div>'


def _card(figure: ExecutionFigure, pictures: PictureEncoder) -> str:
    shots = "".join(
        f"<div>{pictures.button(image, f'{figure.title}: {caption}')}<small>{escape(caption)}</small></div>"
        for caption, image in figure.pictures
    )
    strip = f'<div class="strip">{shots}</div>' if shots else ""
    if figure.animation:
        source = base64.b64encode(figure.animation).decode("ascii")
        moving = f'<img alt="{escape(figure.title)}, moving" src="data:image/webp;base64,{source}"/>'
        strip = f'<div class="lifting"><div class="moving">{moving}</div>{strip}</div>'
    chip = '<span class="chip good">✓ lifted</span>'
    if not figure.success:
        later = ", lifted at the second attempt" if figure.retry else ""
        chip = f'<span class="chip bad">✗ {escape(figure.cause + later)}</span>'
    note = f'<div class="note">{escape(figure.detail)}</div>' if figure.detail else ""
    title = f'<div class="top">{escape(figure.title)}{chip}</div>'
    return f"<figure>{strip}<figcaption>{title}{facts_html(figure.facts)}{note}</figcaption></figure>"


def _key_figures(records: Sequence[Mapping[str, Any]], totals: Mapping[str, Any]) -> tuple[KeyFigure, ...]:
    if not totals["count"]:
        return ()
    low, high = 100 * totals["success_low"], 100 * totals["success_high"]
    figures = [
        KeyFigure(
            value=f"{totals['lifted']} of {totals['count']}",
            label="lifted at the first attempt",
            note=f"{low:.0f} to {high:.0f} % (Wilson, 95 %)",
        )
    ]
    if totals["lifted_with_retry"] > totals["lifted"]:
        figures.append(KeyFigure(value=str(totals["lifted_with_retry"]), label="with one retry"))
    for key, label, form, unit in (
        ("plan_ms", "to a complete plan", ".0f", "ms"),
        ("pose_error_mm", "position error of the pose", ".1f", "mm"),
    ):
        values = sorted(v for r in records for a in r["attempts"][:1] if (v := a.get(key)) is not None)
        if values:
            middle = number_text(values[len(values) // 2], form, unit)
            figures.append(
                KeyFigure(value=middle, label=label, note=f"median, at most {number_text(values[-1], form, unit)}")
            )
    if totals["scenes_without_plan"]:
        figures.append(
            KeyFigure(value=str(totals["scenes_without_plan"]), label="scenes drawn again", note="no plan exists there")
        )
    return tuple(figures)


def _cause_tables(records: Sequence[Mapping[str, Any]]) -> tuple[Table, ...]:
    causes = Counter(str(r["cause"]) for r in records if r["cause"])
    if not causes:
        return ()
    rows = tuple((cause, count, CAUSES.get(cause, "")) for cause, count in causes.most_common())
    return (Table(title="Why attempts failed", columns=("cause", "trials", "meaning"), rows=rows),)


def _trial_table(records: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for record in records:
        first = record["attempts"][0] if record["attempts"] else {}
        rows.append(
            (
                pretty_name(str(record["object"])),
                int(record["trial"]) + 1,
                first.get("pose_error_mm"),
                first.get("pose_error_deg"),
                first.get("candidates_tried"),
                None if first.get("plan_ms") is None else round(first["plan_ms"]),
                first.get("motion_s"),
                "yes" if record["success"] else "2nd attempt" if record["success_retry"] else "no",
                str(record["cause"]),
            )
        )
    columns = (
        "object",
        "trial",
        "pose off, mm",
        "pose off, °",
        "grasps tried",
        "plan, ms",
        "motion, s",
        "lifted",
        "cause",
    )
    return Table(
        title="Trials",
        columns=columns,
        rows=tuple(rows),
        meaning="Of the first attempt of each trial. Planning is processor time until the first complete plan.",
    )
