"""The measured numbers of the report page: tables with what each means, histograms, times."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from neuralgrasps.evaluate.published import PUBLISHED_RETRIEVAL, plain_name
from neuralgrasps.report.charts import bars_svg, histogram_svg, legend_html, short_number
from neuralgrasps.report.content import Histogram, ModelRow, StageTime, SynthesisRow, Table
from neuralgrasps.report.palette import HAND_COLOURS, hand_colour
from neuralgrasps.report.sections import grid, pretty_name

Cell = str | float | int | None
_LINE = 60  # characters of a cell that stay on one line


def synthesis_table(rows: Sequence[SynthesisRow]) -> Table:
    """Counts and quality per hand and object, with a row of totals."""
    columns = (
        "hand",
        "object",
        "candidates",
        "valid",
        "tried",
        "held",
        "success",
        "overlap p95, mm",
        "ε median",
        "CPU s",
    )
    body: list[tuple[Cell, ...]] = [
        (
            *(r.hand, pretty_name(r.object), r.candidates, r.valid, _tried(r), r.validated),
            *(_percent(r.success_share), r.penetration_p95_mm, r.epsilon_median, r.cpu_s),
        )
        for r in rows
    ]
    if len(rows) > 1:
        body.append(_synthesis_totals(rows))
    return Table(
        title="Grasp synthesis",
        columns=columns,
        rows=tuple(body),
        strong_rows=(len(rows),) if len(rows) > 1 else (),
        meaning="Valid grasps passed every geometric test; tried ones went through the physics trial, and held "
        "ones kept the object." + (" The last row adds up, and shows the largest p95." if len(rows) > 1 else ""),
        how="Overlap is how deep hand and object cut into each other, its 95th percentile over the kept "
        "grasps. ε is the radius of the largest ball of wrenches that the contacts resist.",
    )


def _synthesis_totals(rows: Sequence[SynthesisRow]) -> tuple[Cell, ...]:
    counts = (sum(r.candidates for r in rows), sum(r.valid for r in rows))
    known = [(tried, r.validated) for r in rows if (tried := _tried(r)) is not None]
    tried, held = sum(t for t, _ in known), sum(h for _, h in known)
    worst = max((r.penetration_p95_mm for r in rows if r.penetration_p95_mm is not None), default=None)
    cpu = [r.cpu_s for r in rows if r.cpu_s is not None]
    share = _percent(held / tried) if tried else None
    validated = sum(r.validated for r in rows)
    return ("all", "", *counts, tried or None, validated, share, worst, None, sum(cpu) if cpu else None)


def _tried(row: SynthesisRow) -> int | None:
    if row.tried is not None or not row.success_share:
        return row.tried
    return round(row.validated / row.success_share)


def retrieval_table(rows: Sequence[ModelRow]) -> Table:
    """Nearest and farthest grasps found by code, the published figures beside ours."""
    near_columns = ("near, by code", "best possible", "gap", "paper near / best")
    far_columns = ("far, by code", "lowest possible", "paper far / lowest")
    body = []
    for r in rows:
        paper = PUBLISHED_RETRIEVAL.get(plain_name(r.object)) if r.is_scan else None
        gap = r.near_contact - r.near_code if r.near_contact is not None and r.near_code is not None else None
        near_paper = f"{paper[0]:.2f} / {paper[1]:.2f}" if paper else None
        far_paper = f"{paper[2]:.2f} / {paper[3]:.2f}" if paper else None
        near = (_fixed(r.near_code), _fixed(r.near_contact), _fixed(gap, 3), near_paper)
        body.append((pretty_name(r.object), r.grasps, *near, _fixed(r.far_code), _fixed(r.far_contact), far_paper))
    return Table(
        title="Retrieval through the latent space",
        columns=("object", "grasps", *near_columns, *far_columns),
        rows=tuple(body),
        meaning="Near is the contact-map similarity of the grasp that the code finds nearest, against the best "
        "that any grasp in the set offers; the gap is what the code loses. Far is the same for the "
        "least similar grasp: lower is better.",
        how="Queries are held-out grasps whose hand is seen in one noisy depth view. Distance between contact maps "
        "is L1 over the largest query-to-gallery distance; similarity is one minus that. The paper's figures are "
        "for its own grasps, hands and gallery sizes.",
    )


def reconstruction_table(rows: Sequence[ModelRow]) -> Table:
    """Errors of the shapes decoded from codes, beside what a perfect decoder would score."""
    shown = [r for r in rows if any(v is not None for v in (r.hand_error_mm, r.object_error_mm, r.chamfer_e3))]
    return Table(
        title="Reconstruction of unseen grasps",
        columns=("object", "grasps", "hand surface, mm", "object surface, mm", "Chamfer ×10⁻³", "a perfect one scores"),
        rows=tuple(
            (pretty_name(r.object), r.grasps, r.hand_error_mm, r.object_error_mm, r.chamfer_e3, r.chamfer_oracle_e3)
            for r in shown
        ),
        meaning="How far the decoded surfaces lie from the true ones, in millimetres. The published Chamfer "
        "measure compares a filled shape with a surface, so even a perfect reconstruction scores above "
        "zero: see the last column.",
        how="Held-out grasps, inferred from 1,024 unlabelled points of the hand. Mean distance between the hands' "
        "surfaces, both ways; the object's is its distance grid against the mesh.",
    )


def times_section(times: Sequence[StageTime]) -> str:
    """A table and a chart; processor time and memory only where some stage has them."""
    cpu = [t.cpu_s for t in times if t.cpu_s is not None]
    peaks = [t.peak_memory_mib for t in times if t.peak_memory_mib is not None]
    columns = ("stage", "wall s", *(("CPU s",) if cpu else ()), *(("peak memory, MiB",) if peaks else ()))

    def row(stage: str, wall_s: float, cpu_s: float | None, peak: float | None) -> tuple[Cell, ...]:
        measured: tuple[Cell, ...] = (None if cpu_s is None else float(cpu_s),) if cpu else ()
        return (stage, float(wall_s), *measured, *((_whole(peak),) if peaks else ()))

    rows = [row(t.stage, t.wall_s, t.cpu_s, t.peak_memory_mib) for t in times]
    total = row("all", sum(t.wall_s for t in times), sum(cpu), max(peaks, default=None))
    chart = bars_svg([t.stage for t in times], [t.wall_s for t in times], "s", label="wall time of each stage")
    table = Table(title="", columns=columns, rows=(*rows, total), strong_rows=(len(rows),))
    return (
        f'<div class="grid wide"><figure><div class="plot">{chart}</div></figure><div>{table_html(table)}</div></div>'
    )


def dataset_table(facts: Sequence[tuple[str, str]]) -> Table:
    return Table(
        title="Data set",
        columns=("what", "value"),
        rows=tuple(facts),
        meaning="What the latent space was trained on, built in this run.",
    )


def table_html(table: Table) -> str:
    """A table with its title before and its meaning behind."""
    numeric = [_is_numeric([row[i] for row in table.rows]) for i in range(len(table.columns))]
    head = "".join(f'<th{_num(n)} scope="col">{escape(c)}</th>' for c, n in zip(table.columns, numeric, strict=True))
    body = []
    for index, row in enumerate(table.rows):
        cells = "".join(
            f"<td{_words(value) or _num(n)}>{_cell(value)}</td>" for value, n in zip(row, numeric, strict=True)
        )
        strong = ' class="strong"' if index in table.strong_rows else ""
        body.append(f"<tr{strong}>{cells}</tr>")
    title = f"<h3>{escape(table.title)}</h3>" if table.title else ""
    words = (("What it means.", table.meaning), ("How it was measured.", table.how))
    text = "".join(f'<p class="how"><b>{label}</b> {escape(value)}</p>' for label, value in words if value)
    small = " small" if len(table.columns) <= 3 else " tight" if len(table.columns) >= 7 else ""
    content = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    return f'{title}<div class="scroll{small}" tabindex="0">{content}</div><div class="explain">{text}</div>'


def histograms_html(histograms: Sequence[Histogram]) -> str:
    cards = []
    for h in histograms:
        svg = histogram_svg(h.values, h.unit, limit=h.limit, label=h.title)
        note = f'<div class="note">{escape(h.meaning)}</div>' if h.meaning else ""
        caption = (
            f'<figcaption><div class="top">{escape(h.title)}</div>{legend_html(list(h.values))}{note}</figcaption>'
        )
        cards.append(f'<figure><div class="plot">{svg}</div>{caption}</figure>')
    return grid(cards, wide=True) if cards else ""


def _cell(value: Cell) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        dot = f'<span class="dot" style="--c:{hand_colour(value)}"></span>' if value in HAND_COLOURS else ""
        return dot + escape(value)
    if isinstance(value, int | np.integer):
        return f"{int(value):,}"
    return escape(short_number(float(value)))


def _is_numeric(values: Sequence[Cell]) -> bool:
    """Whether a column holds numbers, or text made of digits such as '96 %'."""
    shown = [v for v in values if v is not None and v != ""]
    return bool(shown) and all(not isinstance(v, str) or v[:1].isdigit() or v[:1] in "-–<" for v in shown)


def _num(numeric: bool) -> str:
    return ' class="num"' if numeric else ""


def _words(value: Cell) -> str:
    """The class of a cell whose text is so long that it needs more than one line."""
    return ' class="words"' if isinstance(value, str) and len(value) > _LINE else ""


def _percent(share: float | None) -> str | None:
    return None if share is None else f"{100 * share:.1f} %"


def _fixed(value: float | None, digits: int = 2) -> str | None:
    return None if value is None else f"{value:.{digits}f}"


def _whole(value: float | None) -> int | None:
    return None if value is None else round(value)
