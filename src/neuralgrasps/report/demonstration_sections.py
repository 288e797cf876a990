"""The sections of the page that shows a human demonstration, from its records to HTML."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from neuralgrasps.report.demonstration_content import DemonstrationFigure, Picture, StageFigure
from neuralgrasps.report.sections import PictureEncoder, facts_html
from neuralgrasps.report.track_chart import track_svg

Section = tuple[str, str, str]
_CHIPS = {"ok": "✓ OK", "doubtful": "? DOUBTFUL", "failed": "✗ FAILED", "not reached": "not reached"}
_TRACK_TEXT = (
    "How far the hand is from the object, how far it moves from frame to frame, and how well the hand model fits the "
    "measured points. The grasp is where the hand touches and rests; gaps are frames that were not looked "
    "at, or in which no hand was found."
)
_VIEWS_TEXT = "The fitted hand and the object in their measured places, coloured by closeness to the hand."


def demonstration_sections(figure: DemonstrationFigure, pictures: PictureEncoder) -> list[Section]:
    """(anchor, title, HTML) of every section that has something to show."""
    sections = [("stages", "Stage by stage", _stages(figure.stages))]
    if figure.frames or figure.animation:
        sections.append(("shown", "What was shown", _shown(figure, pictures)))
    if figure.close_ups or figure.views:
        title = "The grasp" if figure.views else "The frame"
        sections.append(("moment", title, _moment(figure, pictures)))
    return sections


def _stages(stages: Sequence[StageFigure]) -> str:
    tiles = "".join(
        f'<li class="{stage.verdict.replace(" ", "-")}"><b>{escape(stage.name)}</b>'
        f'<span class="chip{_tone(stage)}">{_CHIPS[stage.verdict]}</span><span>{escape(stage.text)}</span></li>'
        for stage in stages
    )
    stopped = "".join(
        f'<p class="stopped"><b>Stopped at: {escape(stage.name)}.</b> {escape(stage.reason)}</p>'
        for stage in stages
        if stage.verdict == "failed"
    )
    return f'<ol class="stages">{tiles}</ol>{stopped}'


def _tone(stage: StageFigure) -> str:
    return {"ok": " good", "doubtful": " doubt", "failed": " bad", "not reached": ""}[stage.verdict]


def _shown(figure: DemonstrationFigure, pictures: PictureEncoder) -> str:
    strip = "".join(_shot(picture, pictures) for picture in figure.frames)
    strip = f'<div class="strip six">{strip}</div>' if strip else ""
    if figure.animation:
        source = base64.b64encode(figure.animation).decode("ascii")
        moving = f'<img alt="The demonstration, moving" src="data:image/webp;base64,{source}"/>'
        strip = f'<div class="lifting watch"><div class="moving">{moving}</div>{strip}</div>'
    parts = [f"<figure>{strip}</figure>"]
    if figure.track is not None:
        chart = f'<div class="plot">{track_svg(figure.track)}</div>'
        parts.append(f'<figure>{chart}<figcaption><div class="note">{_TRACK_TEXT}</div></figcaption></figure>')
    return f'<div class="grid one">{"".join(parts)}</div>'


def _moment(figure: DemonstrationFigure, pictures: PictureEncoder) -> str:
    cards = []
    if figure.close_ups:
        shots = "".join(_shot(picture, pictures) for picture in figure.close_ups)
        cards.append(f'<figure><div class="strip shots-{len(figure.close_ups)}">{shots}</div></figure>')
    if figure.views:
        shots = "".join(_shot(picture, pictures) for picture in figure.views)
        scale = '<div class="scale"><span>no contact</span><i></i><span>touching</span></div>'
        note = f'<div class="note">{_VIEWS_TEXT}</div>'
        caption = f"<figcaption>{facts_html(figure.facts)}{note}{scale}</figcaption>"
        cards.append(f'<figure><div class="strip shots-{len(figure.views)}">{shots}</div>{caption}</figure>')
    return f'<div class="grid one">{"".join(cards)}</div>'


def _shot(picture: Picture, pictures: PictureEncoder) -> str:
    caption, image = picture
    return f'<div class="shot">{pictures.button(image, caption)}<small>{escape(caption)}</small></div>'
