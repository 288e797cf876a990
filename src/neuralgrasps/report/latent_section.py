"""The latent maps of the page: each t-SNE with pictures of some of its grasps, and a panel for the mark pointed at."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from neuralgrasps.report.charts import legend_html, scatter_svg
from neuralgrasps.report.content import LatentMap
from neuralgrasps.report.palette import hand_colour
from neuralgrasps.report.sections import PictureEncoder, grid, pretty_name

MANY = 600  # marks from which on they are drawn smaller


def latent_section(maps: Sequence[LatentMap], pictures: PictureEncoder) -> str:
    """All maps under one legend, whose names show and hide the hands in every map."""
    cards = [_map_card(m, pictures) for m in maps]
    legend = legend_html([hand for m in maps for hand in m.hands], toggles=True)
    pictured = any(m.pictures for m in maps)
    return legend + (f'<div class="maps">{"".join(cards)}</div>' if pictured else grid(cards, wide=True))


def _map_card(m: LatentMap, pictures: PictureEncoder) -> str:
    letters = {point: letter_of(place) for place, point in enumerate(m.pictures)}
    label = f"t-SNE of {pretty_name(m.title)}. Arrow keys walk from mark to mark."
    svg = scatter_svg(
        m.points,
        m.hands,
        m.notes,
        label=label,
        unseen=m.unseen,
        letters=letters,
        size=0.72 if len(m.hands) > MANY else 1.0,
    )
    note = f"<span>{escape(m.text)}</span>" if m.text else ""
    count = f'<span class="chip">{len(m.hands):,} grasps</span>'
    head = f"<header><b>{escape(pretty_name(m.title))}</b>{note}{count}</header>"
    thumbs = "".join(_thumb(m, point, letters[point], pictures) for point in m.pictures)
    strip = f'<div class="thumbs">{thumbs}</div>' if thumbs else ""
    words = '<p class="said" aria-live="polite">Point at a mark.</p>'
    many = " many" if len(m.hands) > MANY else ""
    return (
        f'<figure class="latent">{head}<div class="map{many}"><div class="plot" tabindex="0">{svg}</div>'
        f'<div class="peek"><div class="shown"></div>{words}</div></div>{strip}</figure>'
    )


def _thumb(m: LatentMap, point: int, letter: str, pictures: PictureEncoder) -> str:
    hand = m.hands[point]
    note = m.notes[point] if point < len(m.notes) else hand
    button = pictures.button(m.pictures[point], f"{letter}: {note}")
    return f'<div data-letter="{letter}" style="--c:{hand_colour(hand)}"><b>{letter}</b>{button}</div>'


def letter_of(place: int) -> str:
    """A, B, ..., Z, A1, B1, ..."""
    turn, letter = divmod(place, 26)
    return chr(ord("A") + letter) + (str(turn) if turn else "")
