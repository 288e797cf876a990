"""The page of found poses: every frame with the models drawn over it, its depth, the numbers, and what they mean."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from html import escape

from neuralgrasps.report.content import DemoReport, FoundObject, FrameFigure, KeyFigure
from neuralgrasps.report.sections import PictureEncoder, facts_html, number_text, pretty_name

CONFIDENT, DOUBTFUL = 0.9, 0.5
_GREY = "opacity:.6"
_RESIDUAL_NOTE = "median distance of the measured points to the model (not accuracy)"

_COLUMNS = (
    "object",
    "confidence",
    "x, y, z, m",
    "quaternion w, x, y, z",
    "off the model, mm",
    "explained",
    "±\u202fmm",
    "±\u202f°",
    "other poses",
)
_FRAMES_TEXT = (
    "Left, the camera's picture with the lines of every found model; lines hidden behind something measured are faint, "
    "and a question mark stands on a pose that is less likely right than wrong. "
    "Right, the measured depth: near light, far dark, plain grey where nothing was measured. Look at the pictures: "
    "lines that do not meet the object's edges say more than any number below them."
)
NOTES = (
    "Confidence is an estimate of the probability that it is this object in this pose; an object is accepted from 50 % "
    "on. A pose is right with the model's "
    "surface within 1 cm of the object's on average, and no point of it off by more than a tenth of the object's "
    "diameter, up to the object's own symmetries. It was calibrated on simulated depth images. A real camera, a "
    "reflecting object, or one that resembles none of the models can break it: there, take it as a ranking, and look "
    "at the picture.",
    "Off the model is the median distance of the object's measured points to the model; explained is the share of them "
    "within tolerance. Both say how well the seen side fits. They cannot say that the unseen side is right.",
    "± is one standard deviation in the least certain direction: the spread of the fit and an assumed sensor error. A "
    "larger bias of the depth camera (3 to 8 mm at 0.7 m is usual) or a model of another size is not in it.",
    "Other poses fit the view too, with the share given of the chance that one of these is right; they differ from the "
    "best by the angle and distance given. Colour was not used: a box and its flipped self look the "
    "same to a depth camera.",
    "Positions are of the origin of the model's file, in the camera frame: x right, y down, z forward.",
)


def pose_report(
    frames: Sequence[FrameFigure], *, command: str, wanted: Sequence[str], machine: str = "", seed: int | None = None,
    version: str = "", created: str = "", notes: Sequence[str] = (),
) -> DemoReport:  # fmt: skip
    """The page's content.

    Args:
        frames: what was found in each; command: as typed; wanted: names of the objects looked for.
        notes: further ones, after those on the meaning of the numbers.
    """
    found = [o for f in frames for o in _accepted(f.found)]
    names = ", ".join(pretty_name(name) for name in wanted)
    where = "one frame" if len(frames) == 1 else f"{len(frames)} frames"
    return DemoReport(
        title="Where the objects are",
        subtitle=f"Looked for in {where}: {names}.",
        command=command,
        machine=machine,
        seed=seed,
        version=version,
        created=created,
        key_figures=_key_figures(frames, found),
        frames=tuple(frames),
        notes=(*NOTES, *notes),
        section_titles={"notes": "What the numbers mean"},
        section_texts={"frames": _FRAMES_TEXT},
    )


def _key_figures(frames: Sequence[FrameFigure], found: Sequence[FoundObject]) -> tuple[KeyFigure, ...]:
    sure = sum(o.confidence >= CONFIDENT for o in found)
    figures = [
        KeyFigure(
            value=str(len(found)),
            label="object found" if len(found) == 1 else "objects found",
            note=f"{sure} of them at least {percent_text(CONFIDENT)} sure",
        )
    ]
    residuals = [o.residual_mm for o in found if o.residual_mm is not None]
    if residuals:
        value = number_text(statistics.median(residuals), ".1f", "mm")
        figures.append(KeyFigure(value=value, label="off the model", note=_RESIDUAL_NOTE))
    times = [f.wall_s for f in frames if f.wall_s is not None]
    if times:
        value = number_text(statistics.median(times), ".2f", "s")
        figures.append(KeyFigure(value=value, label="per frame", note="median; all objects together"))
    return tuple(figures)


def frames_section(frames: Sequence[FrameFigure], pictures: PictureEncoder) -> str:
    """A card per frame: overlay beside depth, then a table of what was found."""
    cards = []
    for f in frames:
        names = ", ".join(pretty_name(o.object) for o in _accepted(f.found)) or "nothing"
        buttons = pictures.button(f.overlay, f"Frame {f.name}: found {names}")
        buttons += pictures.button(f.observed, f"Frame {f.name}: measured depth")
        time = facts_html([("time", number_text(f.wall_s, ".2f", "s"))] if f.wall_s is not None else [])
        caption = (
            f'<figcaption><div class="top">{escape(f.name)}</div>{time}{_table(f.found)}{_missing(f)}</figcaption>'
        )
        cards.append(f'<figure><div class="pair">{buttons}</div>{caption}</figure>')
    return f'<div class="grid one">{"".join(cards)}</div>'


def _missing(frame: FrameFigure) -> str:
    lines = []
    if frame.missing:
        lines.append("Not found: " + ", ".join(pretty_name(name) for name in frame.missing) + ".")
    if frame.note:
        lines.append(frame.note)
    return "".join(f'<div class="note">{escape(line)}</div>' for line in lines)


def _table(found: Sequence[FoundObject]) -> str:
    if not found:
        return ""
    head = "".join(f'<th scope="col"{_num(i)}>{escape(c)}</th>' for i, c in enumerate(_COLUMNS))
    body = "".join(f"<tr>{_row(o)}</tr>" for o in _accepted(found))
    rejected = "".join(f'<tr style="{_GREY}">{_row(o)}</tr>' for o in found if o.confidence < DOUBTFUL)
    if rejected:
        body += f'<tr style="{_GREY}"><td colspan="{len(_COLUMNS)}">not accepted</td></tr>{rejected}'
    return (
        f'<div class="scroll tight" tabindex="0"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _accepted(found: Sequence[FoundObject]) -> list[FoundObject]:
    return [o for o in found if o.confidence >= DOUBTFUL]


def _num(column: int) -> str:
    last = len(_COLUMNS) - 1
    return ' class="num"' if 0 < column < last else ' class="words"' if column == last else ""


def _row(o: FoundObject) -> str:
    kind = " good" if o.confidence >= CONFIDENT else " bad" if o.confidence < DOUBTFUL else ""
    cells = (
        f'<span class="dot" style="--c:{o.colour}"></span>{escape(pretty_name(o.object))}',
        f'<span class="chip{kind}">{percent_text(o.confidence)}</span>',
        _numbers(o.position_m, ".3f"),
        _numbers(o.quaternion_wxyz, ".3f"),
        number_text(o.residual_mm, ".1f"),
        "–" if o.explained_share is None else percent_text(o.explained_share),
        number_text(o.position_sigma_mm, ".1f"),
        number_text(o.rotation_sigma_deg, ".1f"),
        escape(o.others or "none").replace(" mm", "&#160;mm").replace(" %", "&#160;%"),
    )
    return "".join(f"<td{_num(i)}>{cell}</td>" for i, cell in enumerate(cells))


def _numbers(values: Sequence[float], form: str) -> str:
    return "&#160; ".join(format(v, form).replace("-", "−") for v in values)


def percent_text(share: float) -> str:
    """A share as whole percent that never reads 100 or 0 unless it is: "> 99 %", "< 1 %"."""
    if 0.995 <= share < 1.0:
        return "> 99 %"
    if 0.0 < share < 0.005:
        return "< 1 %"
    return f"{100 * share:.0f} %"
