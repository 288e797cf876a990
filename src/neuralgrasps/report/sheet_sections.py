"""The sections of contact sheets and of the feasibility table, from their records to HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from PIL import Image

from neuralgrasps.report.content import ContactSheet, FeasibilityCell, FeasibilityFigure, GraspFigure
from neuralgrasps.report.sections import PictureEncoder, facts_html, hand_dot, number_text, pretty_name

_THUMBNAIL = (128, 96)


def sheets_section(sheets: Sequence[ContactSheet], pictures: PictureEncoder) -> str:
    """Every sheet under its own heading, which `feasibility_section` links to."""
    parts = []
    for index, sheet in enumerate(sheets):
        name = f"{sheet.hand} on {pretty_name(sheet.object)}"
        text = f'<p class="how">{escape(sheet.text)}</p>' if sheet.text else ""
        cards = "".join(_card(grasp, pictures) for grasp in sheet.grasps)
        title = f'<h3 id="sheet-{index}">{hand_dot(sheet.hand)} {escape(name)}</h3>'
        parts.append(f'{title}{text}<div class="grid sheet">{cards}</div>')
    return "".join(parts)


def feasibility_section(figure: FeasibilityFigure, sheets: Sequence[ContactSheet], pictures: PictureEncoder) -> str:
    """Objects down, hands across; a cell shows a grasp, how many there are, or why there are none."""
    cells = {(cell.hand, cell.object): cell for cell in figure.cells}
    links = {(sheet.hand, sheet.object): (i, sheet.grasps[0].image) for i, sheet in enumerate(sheets) if sheet.grasps}
    head = "".join(
        f'<th scope="col">{_thumbnail(image, hand, pictures)}{hand_dot(hand)} {escape(hand)}</th>'
        for hand, image in figure.hands.items()
    )
    rows = []
    for name, image in figure.objects.items():
        row = "".join(_cell(cells.get((hand, name)), links.get((hand, name)), pictures) for hand in figure.hands)
        first = f'<th scope="row">{_thumbnail(image, pretty_name(name), pictures)}{escape(pretty_name(name))}</th>'
        rows.append(f"<tr>{first}{row}</tr>")
    table = f'<table class="matrix"><thead><tr><th></th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    return f'<div class="scroll" tabindex="0">{table}</div>{_reasons(figure.cells)}'


def _cell(cell: FeasibilityCell | None, sheet: tuple[int, np.ndarray] | None, pictures: PictureEncoder) -> str:
    if cell is None:
        return "<td>–</td>"
    title = f' title="{escape(cell.reason)}"' if cell.reason else ""
    notes = "".join(f"<small>{escape(note)}</small>" for note in cell.notes)
    if sheet is None:
        return f'<td class="none"{title}><b>{escape(cell.problem or cell.value)}</b>{notes}</td>'
    index, image = sheet
    picture = _thumbnail(image, f"{cell.hand} on {pretty_name(cell.object)}", pictures)
    short = ' class="short"' if cell.reason else ""
    return f'<td{title}{short}><a href="#sheet-{index}">{picture}<b>{escape(cell.value)}</b>{notes}</a></td>'


def _reasons(cells: Sequence[FeasibilityCell]) -> str:
    items = "".join(
        f"<li>{escape(f'{cell.hand} on {pretty_name(cell.object)}, {cell.value}: {cell.reason}')}</li>"
        for cell in cells
        if cell.reason
    )
    return f'<h3>Fewer than wanted</h3><ul class="notes">{items}</ul>' if items else ""


def _card(grasp: GraspFigure, pictures: PictureEncoder) -> str:
    facts = [
        ("ε", number_text(grasp.epsilon, ".3f")),
        ("moved", number_text(grasp.displacement_mm, ".1f", "mm")),
        ("overlap", number_text(grasp.penetration_mm, ".2f", "mm")),
    ]
    facts = [(label, value) for label, value in facts if value != "–"]
    name = f"{grasp.hand} on {pretty_name(grasp.object)}"
    words = ", ".join([name, *([grasp.kind] if grasp.kind else []), *(f"{k} {v}" for k, v in facts), grasp.note])
    title = f'<div class="top">{escape(grasp.kind)}{_lost(grasp.success)}</div>' if grasp.kind else ""
    return (
        f"<figure>{pictures.button(grasp.image, words.rstrip(', '))}"
        f"<figcaption>{title}{facts_html(facts)}</figcaption></figure>"
    )


def _lost(success: bool | None) -> str:
    """Sheets show what held: only what did not is marked."""
    return '<span class="chip bad">✗ lost</span>' if success is False else ""


def _thumbnail(image: np.ndarray, text: str, pictures: PictureEncoder) -> str:
    small = np.asarray(Image.fromarray(image).resize(_THUMBNAIL, Image.Resampling.LANCZOS))
    width, height = _THUMBNAIL
    return f'<img alt="{escape(text)}" width="{width}" height="{height}" src="{pictures.uri(small)}"/>'
