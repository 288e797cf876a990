"""The section of a transfer, from its records to HTML: the query, then the grasps in their order, with contact maps."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from neuralgrasps.report.sections import PictureEncoder, facts_html, hand_dot, held_chip, number_text, pretty_name
from neuralgrasps.report.transfer_content import TransferList


def transfer_list_section(lists: Sequence[TransferList], pictures: PictureEncoder) -> str:
    """Cards of two pictures each: the query first, framed, then the grasps in their order."""
    scale = '<div class="scale"><span>no contact</span><i></i><span>touching</span></div>'
    parts = [scale]
    for one in lists:
        cards = [_query_card(one, pictures), *(_card(one, i, pictures) for i in range(len(one.grasps)))]
        title = f"{hand_dot(one.hand)} {escape(one.hand)} on {escape(pretty_name(one.object))}"
        parts.append(f'<h3>{title}</h3><div class="grid wide">{"".join(cards)}</div>')
    return "".join(parts)


def _query_card(one: TransferList, pictures: PictureEncoder) -> str:
    dot = hand_dot(one.query_hand) if one.query_hand else ""
    note = f'<div class="note">{escape(one.text)}</div>' if one.text else ""
    pair = _pair(one.image, one.contacts, f"query: {one.title}", pictures)
    caption = f'<figcaption><div class="top">{dot}{escape(one.title)}</div>{note}</figcaption>'
    frame = "border:2px solid var(--accent);position:relative"
    return f'<figure style="{frame}"><span class="tag">query</span>{pair}{caption}</figure>'


def _card(one: TransferList, index: int, pictures: PictureEncoder) -> str:
    grasp = one.grasps[index]
    facts = [
        ("similarity", number_text(grasp.similarity, ".3f")),
        ("ε", number_text(grasp.epsilon, ".3f")),
        ("moved", number_text(grasp.displacement_mm, ".1f", "mm")),
        ("clear by", number_text(grasp.clearance_mm, ".0f", "mm")),
        ("drawn points touched", grasp.touched or "–"),
        ("off them", number_text(grasp.points_off_mm, ".1f", "mm")),
    ]
    facts = [(label, value) for label, value in facts if value != "–"]
    number = index + 1 if grasp.number is None else grasp.number
    words = ", ".join([f"{number}: {one.hand}, {grasp.origin}", *(f"{k} {v}" for k, v in facts)])
    title = f"{hand_dot(one.hand)}{number}. {escape(grasp.origin)}{held_chip(grasp.success)}"
    note = f'<div class="note">{escape(grasp.reason)}</div>' if grasp.reason else ""
    share = 100 * min(max(grasp.similarity, 0.0), 1.0)
    meter = f'<span class="meter"><i style="width:{share:.0f}%"></i></span>'
    caption = f'<figcaption><div class="top">{title}</div>{facts_html(facts)}{meter}{note}</figcaption>'
    return f"<figure>{_pair(grasp.image, grasp.contacts, words, pictures)}{caption}</figure>"


def _pair(image: np.ndarray, contacts: np.ndarray, words: str, pictures: PictureEncoder) -> str:
    buttons = pictures.button(image, words) + pictures.button(contacts, f"{words}: contact map")
    return f'<div class="pair">{buttons}</div>'
