"""The sections of the report page, each from its records to HTML. Every text goes through `escape`."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from PIL import Image, features

from neuralgrasps.report.charts import short_number
from neuralgrasps.report.content import (
    ContactFigure,
    GraspFigure,
    HandFigure,
    Neighbour,
    PoseFigure,
    RetrievalRow,
    TransferFigure,
)
from neuralgrasps.report.palette import hand_colour


class PictureEncoder:
    """Turns uint8 arrays into data URIs: WebP of one quality, or PNG where this Pillow has no WebP."""

    def __init__(self, quality: int) -> None:
        self.quality = quality

    def uri(self, image: np.ndarray) -> str:
        stream = io.BytesIO()
        if features.check("webp"):
            Image.fromarray(image).save(stream, "WEBP", quality=self.quality, method=4)
            kind = "webp"
        else:
            Image.fromarray(image).save(stream, "PNG", optimize=True)
            kind = "png"
        return f"data:image/{kind};base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"

    def button(self, image: np.ndarray, text: str) -> str:
        """The picture as a button that enlarges it; `text` is read aloud and shown under the large picture."""
        height, width = image.shape[:2]
        return (
            f'<button type="button" aria-label="Enlarge: {escape(text)}"><img alt="{escape(text)}" width="{width}" '
            f'height="{height}" decoding="async" src="{self.uri(image)}"/></button>'
        )


def hands_section(hands: Sequence[HandFigure], pictures: PictureEncoder) -> str:
    cards = [
        f"<figure>{pictures.button(h.image, f'{h.hand}. {h.text}')}<figcaption>{_hand_title(h.hand)}"
        f'<div class="note">{escape(h.text)}</div></figcaption></figure>'
        for h in hands
    ]
    return grid(cards)


def grasps_section(grasps: Sequence[GraspFigure], pictures: PictureEncoder) -> str:
    parts = []
    for name in _unique(g.object for g in grasps):
        cards = [_grasp_card(g, pictures) for g in grasps if g.object == name]
        parts.append(f"<h3>{escape(pretty_name(name))}</h3>{grid(cards)}")
    return "".join(parts)


def contacts_section(contacts: Sequence[ContactFigure], pictures: PictureEncoder) -> str:
    parts = ['<div class="scale"><span>no contact</span><i></i><span>touching</span></div>']
    for name in _unique(c.object for c in contacts):
        cards = []
        for c in (c for c in contacts if c.object == name):
            share = [("within 4 mm", f"{100 * c.area_share:.1f} % of surface")] if c.area_share is not None else []
            words = f"Contact map of {c.hand} on {pretty_name(c.object)}."
            caption = f"<figcaption>{_hand_title(c.hand)}{facts_html(share)}{_note(c.note)}</figcaption>"
            cards.append(f"<figure>{pictures.button(c.image, words)}{caption}</figure>")
        parts.append(f"<h3>{escape(pretty_name(name))}</h3>{grid(cards)}")
    return "".join(parts)


def retrieval_section(rows: Sequence[RetrievalRow], pictures: PictureEncoder) -> str:
    parts = []
    for row in rows:
        cards = [_neighbour_card(row.query, "query", "query", row.object, pictures)]
        cards += [_neighbour_card(n, "", "", row.object, pictures) for n in row.nearest]
        if row.farthest is not None:
            cards.append(_neighbour_card(row.farthest, "far", "farthest", row.object, pictures))
        parts.append(f'<h3>{escape(pretty_name(row.object))}</h3><div class="row">{"".join(cards)}</div>')
    return "".join(parts)


def transfer_section(transfers: Sequence[TransferFigure], pictures: PictureEncoder) -> str:
    cards = []
    for t in transfers:
        buttons = "".join(
            pictures.button(n.image, f"{n.hand} on {pretty_name(t.object)}") for n in (t.source, t.target)
        )
        title = f"{hand_dot(t.source.hand)}{escape(t.source.hand)} → {hand_dot(t.target.hand)}{escape(t.target.hand)}"
        facts = facts_html(
            [("contact similarity", number_text(t.target.similarity, ".2f"))] if t.target.similarity is not None else []
        )
        caption = f'<figcaption><div class="top">{title}</div>{facts}{_note(t.text)}</figcaption>'
        cards.append(f'<figure><div class="pair">{buttons}</div>{caption}</figure>')
    return grid(cards, wide=True)


def pose_section(poses: Sequence[PoseFigure], pictures: PictureEncoder) -> str:
    cards = []
    for p in poses:
        name = pretty_name(p.object)
        buttons = pictures.button(p.observed, f"What the camera saw: {name}")
        buttons += pictures.button(p.overlay, f"Pose found for {name}, drawn over the image")
        facts = [
            ("rotation", number_text(p.rotation_error_deg, ".2f", "°")),
            ("translation", number_text(p.translation_error_mm, ".2f", "mm")),
            ("ADD-S", number_text(p.add_s_mm, ".2f", "mm")),
            ("time", number_text(p.wall_s, ".2f", "s")),
        ]
        facts = [(label, value) for label, value in facts if value != "–"]
        caption = f'<figcaption><div class="top">{escape(name)}</div>{facts_html(facts)}{_note(p.note)}</figcaption>'
        cards.append(f'<figure><div class="pair">{buttons}</div>{caption}</figure>')
    return grid(cards, wide=True)


def _grasp_card(grasp: GraspFigure, pictures: PictureEncoder) -> str:
    facts = [
        ("ε", number_text(grasp.epsilon, ".3f")),
        ("overlap", number_text(grasp.penetration_mm, ".2f", "mm")),
        ("slip", number_text(grasp.displacement_mm, ".1f", "mm")),
    ]
    facts = [(label, value) for label, value in facts if value != "–"]
    words = ", ".join([f"{grasp.hand} on {pretty_name(grasp.object)}", *(f"{k} {v}" for k, v in facts)])
    caption = f"{_hand_title(grasp.hand, held_chip(grasp.success))}{facts_html(facts)}{_note(grasp.note)}"
    return f"<figure>{pictures.button(grasp.image, words)}<figcaption>{caption}</figcaption></figure>"


def _neighbour_card(item: Neighbour, css: str, tag: str, name: str, pictures: PictureEncoder) -> str:
    label = f'<span class="tag">{tag}</span>' if tag else ""
    words = f"{tag or 'nearest'}: {item.hand} on {pretty_name(name)}"
    similarity = ""
    if item.similarity is not None:
        share = 100 * min(max(item.similarity, 0.0), 1.0)
        similarity = (
            f"{facts_html([('similarity', f'{item.similarity:.2f}')])}"
            f'<span class="meter" style="--c:{hand_colour(item.hand)}"><i style="width:{share:.0f}%"></i></span>'
        )
        words += f", contact similarity {item.similarity:.2f}"
    caption = f"<figcaption>{_hand_title(item.hand)}{similarity}</figcaption>"
    return f'<figure class="{css}">{label}{pictures.button(item.image, words)}{caption}</figure>'


def held_chip(success: bool | None) -> str:
    """Whether a grasp held in its physics trial."""
    if success is None:
        return '<span class="chip">not tried</span>'
    return '<span class="chip good">✓ held</span>' if success else '<span class="chip bad">✗ lost</span>'


def _hand_title(hand: str, after: str = "") -> str:
    return f'<div class="top">{hand_dot(hand)}{escape(hand)}{after}</div>'


def hand_dot(hand: str) -> str:
    """A dot in the hand's colour."""
    return f'<span class="dot" style="--c:{hand_colour(hand)}"></span>'


def facts_html(facts: Iterable[tuple[str, str]]) -> str:
    """Names and values in a line."""
    parts = "".join(f"<span><i>{escape(label)}</i> {escape(value)}</span>" for label, value in facts)
    return f'<div class="facts">{parts}</div>' if parts else ""


def _note(text: str) -> str:
    return f'<div class="note">{escape(text)}</div>' if text else ""


def number_text(value: float | None, form: str = "", unit: str = "") -> str:
    """A number with its unit; a dash for what was not measured."""
    if value is None or not np.isfinite(value):
        return "–"
    text = format(value, form) if form else short_number(value)
    gap = "" if unit in ("", "°", "%") else "\u202f"
    return f"{text}{gap}{unit}"


def grid(cards: Sequence[str], *, wide: bool = False) -> str:
    """Cards in columns; three wide ones stand side by side where there is room, so that none is left alone."""
    css = "grid" if not wide else "grid wide three" if len(cards) == 3 else "grid wide"
    return f'<div class="{css}">{"".join(cards)}</div>'


def pretty_name(name: str) -> str:
    """'006_mustard_bottle' -> 'mustard bottle'."""
    head, _, tail = name.partition("_")
    return (tail if head.isdigit() and tail else name).replace("_", " ")


def _unique(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
