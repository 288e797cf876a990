"""The page of found poses."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.report.content import FoundObject, FrameFigure
from neuralgrasps.report.page import report_html
from neuralgrasps.report.pose_page import NOTES, percent_text, pose_report

PICTURE = np.full((30, 40, 3), 120, np.uint8)
CAN = FoundObject(
    object="005_tomato_soup_can",
    colour="#37d3ff",
    confidence=0.973,
    position_m=(0.1234, -0.05, 0.9),
    quaternion_wxyz=(0.5, -0.5, 0.5, 0.5),
    residual_mm=1.44,
    explained_share=0.91,
    position_sigma_mm=0.8,
    rotation_sigma_deg=None,
    others="12 % turned 180°, moved 3 mm",
)
BOX = replace(CAN, object="<b>box</b>", colour="#ff7ad9", confidence=0.31, residual_mm=4.0, others="")
FRAMES = (
    FrameFigure(name="000001", overlay=PICTURE, observed=PICTURE, found=(CAN, BOX), wall_s=0.2),
    FrameFigure(
        name="000002", overlay=PICTURE, observed=PICTURE, found=(replace(CAN, residual_mm=2.0),), missing=("drill",),
        note="The table takes 41 % of the measured pixels.", wall_s=0.4,
    ),
    FrameFigure(name="000003", overlay=PICTURE, observed=PICTURE, missing=("drill", "005_tomato_soup_can")),
)  # fmt: skip


def page(*frames: FrameFigure) -> ET.Element:
    report = pose_report(
        frames, command="neuralgrasps pose can", wanted=["005_tomato_soup_can", "drill"], notes=["More."]
    )
    return ET.fromstring(report_html(report).removeprefix("<!DOCTYPE html>\n"))


def text_of(element: ET.Element) -> str:
    return " ".join("".join(element.itertext()).replace("\xa0", " ").split())


def with_class(root: ET.Element, name: str) -> list[ET.Element]:
    return [e for e in root.iter() if name in e.get("class", "").split()]


def test_every_frame_has_its_two_pictures_and_its_rows():
    cards = [e for e in page(*FRAMES).iter() if e.tag.endswith("figure")]
    assert [len([e for e in card.iter() if e.tag.endswith("img")]) for card in cards] == [2, 2, 2]
    rows = [[text_of(c) for c in e] for e in cards[0].iter() if e.tag.endswith("tr")][1:]
    assert rows[0] == [
        "tomato soup can", "97 %", "0.123 −0.050 0.900", "0.500 −0.500 0.500 0.500", "1.4", "91 %", "0.8", "–",
        "12 % turned 180°, moved 3 mm",
    ]  # fmt: skip
    assert rows[1] == ["not accepted"]
    assert rows[2][0] == "<b>box</b>" and rows[2][-1] == "none"  # names are text, never markup
    assert "Not found: drill." in text_of(cards[1]) and "41 % of the measured pixels" in text_of(cards[1])
    assert "Not found: drill, tomato soup can." in text_of(cards[2])
    assert not [e for e in cards[2].iter() if e.tag.endswith("table")]


def test_what_was_not_accepted_is_grey_and_not_named_as_found():
    card = next(e for e in page(*FRAMES).iter() if e.tag.endswith("figure"))
    words = [e.get(k, "") for e in card.iter() for k in ("alt", "aria-label", "data-caption", "title")]
    assert any("found tomato soup can" in w for w in words) and not any("box" in w for w in words)
    styles = [e.get("style", "") for e in card.iter() if e.tag.endswith("tr")][1:]
    assert [("opacity" in s) for s in styles] == [False, True, True]


def test_confidence_is_shown_as_good_or_bad():
    chips = {text_of(c): c.get("class") for c in with_class(page(*FRAMES), "chip")}
    assert chips == {"97 %": "chip good", "31 %": "chip bad"}


def test_key_figures_count_what_was_found_and_its_medians():
    keys = text_of(with_class(page(*FRAMES), "keys")[0])
    assert "2 objects found" in keys.replace("2objects", "2 objects") and "2 of them at least 90 % sure" in keys
    assert "1.7" in keys and "0.30" in keys  # medians of 1.44 and 2.0 mm, of 0.2 and 0.4 s
    assert "median distance of the measured points to the model (not accuracy)" in keys
    nothing = text_of(with_class(page(FRAMES[2]), "keys")[0])
    assert nothing.startswith("0") and "off the model" not in nothing


def test_the_page_says_what_confidence_means_and_loads_nothing():
    root = page(*FRAMES)
    words = text_of(root)
    for note in (*NOTES, "More."):
        assert note.replace("\xa0", " ") in words
    sources = [e.get("src", "") for e in root.iter() if e.tag.endswith("img")]
    assert all(s.startswith("data:image/") for s in sources if s)
    assert "calibrated on simulated" in words and "cannot say that the unseen side is right" in words


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (0.003, "< 1 %"),
        (0.014, "1 %"),
        (0.5, "50 %"),
        (0.9949, "99 %"),
        (0.9951, "> 99 %"),
        (1.0, "100 %"),
    ],
)
def test_percent_never_claims_certainty(share: float, text: str):
    assert percent_text(share) == text
