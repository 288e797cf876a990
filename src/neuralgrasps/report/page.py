"""The report page: one HTML file that holds everything it shows and loads nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from neuralgrasps.errors import InputError
from neuralgrasps.files import write_whole
from neuralgrasps.report.content import DemoReport, KeyFigure, Listing
from neuralgrasps.report.demonstration_sections import demonstration_sections
from neuralgrasps.report.execution_page import executions_section
from neuralgrasps.report.latent_section import latent_section
from neuralgrasps.report.palette import contact_gradient
from neuralgrasps.report.pose_page import frames_section
from neuralgrasps.report.sections import (
    PictureEncoder,
    contacts_section,
    grasps_section,
    hands_section,
    pose_section,
    retrieval_section,
    transfer_section,
)
from neuralgrasps.report.sheet_sections import feasibility_section, sheets_section
from neuralgrasps.report.table_sections import (
    dataset_table,
    histograms_html,
    reconstruction_table,
    retrieval_table,
    synthesis_table,
    table_html,
    times_section,
)
from neuralgrasps.report.transfer_sections import transfer_list_section

MAX_BYTES = 8_000_000
_QUALITIES = (90, 80, 65, 45)
_STYLES = ("page.css", "latent.css", "demonstration.css")

# What each section shows and means; `DemoReport.section_texts` can put other words in their place.
_TEXTS = {
    "hands": "Every hand is a kinematic tree with convex solids for links. The colours below stand for the hands"
    " everywhere on this page.",
    "grasps": "Each picture is one synthesised grasp, drawn exactly as computed. Held means that the hand kept "
    "the object throughout the physics trial. ε is the largest disturbance the contacts resist in any "
    "direction; overlap is how deep hand and object cut into each other; slip is how far the object "
    "moved in the hand.",
    "transferred": "On the left of each card the grasp, on the right how close the hand comes to every point of the "
    "object, all from the one side that shows most of the query's hand and contacts and the first grasps'. Similarity "
    "compares the contact maps over the whole surface: 1 is the same, 0 the farthest of the known grasps. Held means "
    "that the hand kept the object throughout the physics trial. ε is the largest disturbance the contacts resist in "
    "any direction; moved is how far the object went in the hand.",
    "feasibility": "Each cell shows the first grasp of a pair, how many were found of those wanted, and the share of "
    "the grasps tried in physics that held, before any was dropped.",
    "sheets": "Each sheet shows the most diverse grasps of a pair, in farthest-point order, drawn as computed from "
    "where most contacts are seen. A precision grasp touches with fingertips only, a power grasp also with the palm "
    "or inner links. ε is the largest disturbance the contacts resist in any direction; moved is how far the object "
    "went in the hand during the physics trial; overlap is how deep hand and object cut into each other.",
    "contacts": "How close the hand comes to every point of the object: 1 where it touches, falling off "
    "exponentially with distance. These maps, not the joints, say which grasps of different hands are "
    "alike.",
    "retrieval": "The framed grasp is the query. Beside it, the grasp of each hand whose latent code is nearest, and"
    " last the farthest of all. Similarity is that of the contact maps themselves: 1 is the same, 0 the"
    " most different pair.",
    "transfer": "A grasp of one hand, carried to another through the shared latent space.",
    "latent": "Every mark is one grasp, placed by t-SNE so that near codes are near. Where the colours mix, "
    "different hands hold the object in the same way; distances between far groups mean nothing. Outlined marks are "
    "grasps that training never saw. Letters stand for the pictures. Point at a mark, or walk from mark to mark with "
    "the "
    "arrow keys; the names of the hands show and hide theirs.",
    "pose": "Left, the depth image that the camera saw, near light and far dark. Right, the pose found in it: "
    "the lines of the object in colour; a white outline is the true pose. Errors are measured against it, "
    "up to the object's own symmetries.",
    "frames": "",
    "executions": "",
    "numbers": "Measured in this run, on this machine.",
    "times": "Wall-clock and processor time of every stage, and the largest memory in use.",
    "listings": "",
    "notes": "",
}


def report_html(report: DemoReport, *, max_bytes: int = MAX_BYTES) -> str:
    """The page as text; pictures are compressed harder when it would be over `max_bytes`.

    Raises:
        InputError: the page is over `max_bytes` at the lowest picture quality.
    """
    size = 0
    for quality in _QUALITIES:
        html = _page(report, PictureEncoder(quality))
        size = len(html.encode("utf-8"))
        if size <= max_bytes:
            return html
    raise InputError(
        f"the report would be {size / 1e6:.1f} MB; expected at most {max_bytes / 1e6:.1f} MB. "
        "Show fewer or smaller pictures."
    )


def write_report(report: DemoReport, path: str | Path, *, max_bytes: int = MAX_BYTES) -> Path:
    """Write the page, all or nothing: an older file stays whole when writing fails.

    Args:
        report: what to show.
        path: file to write; its folder is made when missing.
        max_bytes: largest size; pictures are compressed harder to meet it.
    Returns:
        The path written.
    Raises:
        InputError: `path` is a folder, or the page is too large.
        StorageError: the place cannot be written (read-only, full); an older page is left as it was.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(
            f"the report cannot be written to '{path}': it is a folder. Give a file name such as report.html."
        )
    return write_whole(path, report_html(report, max_bytes=max_bytes))


def _page(report: DemoReport, pictures: PictureEncoder) -> str:
    sections = _sections(report, pictures)
    links = "".join(f'<a href="#{name}">{escape(title)}</a>' for name, title, _ in sections)
    body = "".join(_section(report, *section) for section in sections)
    csp = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'"
    return (
        '<!DOCTYPE html>\n<html lang="en" xmlns="http://www.w3.org/1999/xhtml"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>'
        f'<meta http-equiv="Content-Security-Policy" content="{csp}"/>'
        f"<title>{escape(report.title)}</title><style>{_page_css()}</style></head><body>"
        f"{_hero(report)}<nav aria-label='Sections'><div>{links}</div></nav><main>{body}</main>{_footer(report)}"
        '<dialog id="zoom" aria-label="Enlarged picture"><div><img alt=""/></div><p></p></dialog>'
        # the script holds neither < nor &, so that the page is XML too
        f"<script>{_asset('page.js')}{_asset('latent.js')}</script></body></html>\n"
    )


def _page_css() -> str:
    """The style sheet, with the contact colour scale that the pictures use."""
    return f":root {{ --contact-scale: {contact_gradient()}; }}\n" + "".join(map(_asset, _STYLES))


def _asset(name: str) -> str:
    return (files("neuralgrasps") / "assets" / "report" / name).read_text(encoding="utf-8")


def _picture_sections(report: DemoReport, pictures: PictureEncoder) -> list[tuple[str, str, bool, Callable[[], str]]]:
    """Anchor, title, whether there is something to show, and what makes its HTML."""
    hands = f"{len(report.hands)} hands" if len(report.hands) != 1 else "One hand"
    return [
        (
            "transferred",
            "Query and grasps",
            bool(report.transferred),
            lambda: transfer_list_section(report.transferred, pictures),
        ),
        (
            "feasibility",
            "Feasibility",
            report.feasibility is not None,
            lambda: _feasibility(report, pictures),
        ),
        ("sheets", _sheets_title(report), bool(report.sheets), lambda: sheets_section(report.sheets, pictures)),
        ("grasps", "Grasps", bool(report.grasps), lambda: grasps_section(report.grasps, pictures)),
        ("hands", hands, bool(report.hands), lambda: hands_section(report.hands, pictures)),
        ("contacts", "Contact maps", bool(report.contacts), lambda: contacts_section(report.contacts, pictures)),
        ("retrieval", "Retrieval", bool(report.retrieval), lambda: retrieval_section(report.retrieval, pictures)),
        ("transfer", "Transfer", bool(report.transfers), lambda: transfer_section(report.transfers, pictures)),
        ("latent", "Latent space", bool(report.latent_maps), lambda: latent_section(report.latent_maps, pictures)),
        ("pose", "Object pose", bool(report.poses), lambda: pose_section(report.poses, pictures)),
        (
            "executions",
            "Trials",
            bool(report.executions),
            lambda: executions_section(report.executions, pictures),
        ),
        ("frames", "Frames", bool(report.frames), lambda: frames_section(report.frames, pictures)),
    ]


def _sections(report: DemoReport, pictures: PictureEncoder) -> list[tuple[str, str, str]]:
    """(anchor, title, HTML) of every section that has something to show."""
    sections = [] if report.demonstration is None else demonstration_sections(report.demonstration, pictures)
    sections += [(name, title, build()) for name, title, shown, build in _picture_sections(report, pictures) if shown]
    sections += [(f"part-{k}", part.title, _part(part, pictures)) for k, part in enumerate(report.parts, start=1)]
    numbers = _numbers(report)
    if numbers:
        sections.append(("numbers", "Measured quality", numbers))
    if report.listings:
        sections.append(("listings", "To copy", "".join(_listing(listing) for listing in report.listings)))
    if report.times:
        title = "Times and memory" if any(t.peak_memory_mib is not None for t in report.times) else "Times"
        sections.append(("times", title, times_section(report.times)))
    if report.notes:
        items = "".join(f"<li>{escape(note)}</li>" for note in report.notes)
        sections.append(("notes", "Notes", f'<ul class="notes">{items}</ul>'))
    return [(name, report.section_titles.get(name, title), content) for name, title, content in sections]


def _part(part: DemoReport, pictures: PictureEncoder) -> str:
    """A report inside another: its subtitle, and its sections one level lower."""
    lead = f"<p>{escape(part.subtitle)}</p>" if part.subtitle else ""
    return lead + "".join(_headed(part, "h3", *section) for section in _sections(part, pictures))


def _feasibility(report: DemoReport, pictures: PictureEncoder) -> str:
    return feasibility_section(report.feasibility, report.sheets, pictures) if report.feasibility else ""


def _sheets_title(report: DemoReport) -> str:
    return "Contact sheets" if len(report.sheets) > 1 else "Contact sheet"


def _numbers(report: DemoReport) -> str:
    parts = []
    if report.synthesis:
        parts.append(table_html(synthesis_table(report.synthesis)))
    parts.append(histograms_html(report.histograms))
    if report.dataset:
        parts.append(table_html(dataset_table(report.dataset)))
    if report.model:
        parts += [table_html(t) for t in (retrieval_table(report.model), reconstruction_table(report.model)) if t.rows]
    parts += [table_html(table) for table in report.tables]
    return "".join(parts)


def _listing(listing: Listing) -> str:
    meaning = f"<p>{escape(listing.meaning)}</p>" if listing.meaning else ""
    return f'<h3>{escape(listing.title)}</h3>{meaning}<pre class="listing">{escape(listing.text)}</pre>'


def _section(report: DemoReport, name: str, title: str, content: str) -> str:
    return f'<section id="{name}">{_headed(report, "h2", name, title, content)}</section>'


def _headed(report: DemoReport, level: str, name: str, title: str, content: str) -> str:
    text = report.section_texts.get(name, _TEXTS.get(name, ""))
    paragraph = f"<p>{escape(text)}</p>" if text else ""
    return f"<{level}>{escape(title)}</{level}>{paragraph}{content}"


def _hero(report: DemoReport) -> str:
    meta = [("Command", f"<code>{escape(report.command)}</code>")]
    seed = "" if report.seed is None else str(report.seed)
    for label, value in (
        ("Machine", report.machine),
        ("Seed", seed),
        ("Version", report.version),
        ("Made", report.created),
    ):
        if value:
            meta.append((label, escape(value)))
    items = "".join(f"<div><dt>{label}</dt><dd>{value}</dd></div>" for label, value in meta)
    lead = f'<p class="lead">{escape(report.subtitle)}</p>' if report.subtitle else ""
    return (
        f'<header class="hero"><p class="eyebrow">neuralgrasps</p><h1>{escape(report.title)}</h1>{lead}'
        f'<dl class="meta">{items}</dl>{_keys(report.key_figures)}</header>'
    )


def _keys(figures: Sequence[KeyFigure]) -> str:
    if not figures:
        return ""
    tiles = "".join(
        f"<div><b>{escape(f.value)}</b><span>{escape(f.label)}</span>"
        + (f"<small>{escape(f.note)}</small>" if f.note else "")
        + "</div>"
        for f in figures
    )
    return f'<div class="keys">{tiles}</div>'


def _footer(report: DemoReport) -> str:
    version = f" {escape(report.version)}" if report.version else ""
    return f"<footer>Made by neuralgrasps{version}. This file holds everything it shows and loads nothing.</footer>"
