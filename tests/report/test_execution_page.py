"""The page of trials: every trial with its pictures and verdict, failures first, shares with their interval."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from neuralgrasps.report.content import ExecutionFigure
from neuralgrasps.report.execution_page import CAUSES, execution_report
from neuralgrasps.report.page import report_html
from neuralgrasps.report.video import animation

PICTURE = np.full((30, 40, 3), 120, np.uint8)
STRIP = tuple((caption, PICTURE) for caption in ("seen", "before", "closed", "the end"))
MOVING = animation([PICTURE, PICTURE // 2], fps=8, size=(40, 30))
FIGURES = (
    ExecutionFigure(title="can, trial 1", success=True, pictures=STRIP, animation=MOVING, facts=(("plan", "42 ms"),)),
    ExecutionFigure(
        title="<b>box</b>, trial 1", success=False, cause="slip", detail="it rose by 30 mm & fell.", pictures=STRIP
    ),
    ExecutionFigure(title="can, trial 2", success=False, retry=True, cause="push-away", pictures=STRIP[:2]),
)


def record(name: str, trial: int, cause: str, **attempt: float) -> dict[str, object]:
    return {
        "object": name, "trial": trial, "success": not cause, "success_retry": not cause or cause == "push-away",
        "cause": cause, "attempts": [attempt] if attempt else [],
    }  # fmt: skip


RECORDS = (
    record("can", 0, "", pose_error_mm=1.0, pose_error_deg=0.5, candidates_tried=2, plan_ms=40.0, motion_s=6.0),
    record("<b>box</b>", 0, "slip", pose_error_mm=3.0, pose_error_deg=0.7, candidates_tried=1, plan_ms=60.0),
    record("can", 1, "push-away", pose_error_mm=9.0, pose_error_deg=2.0, candidates_tried=5, plan_ms=90.0),
    record("can", 2, "infeasible"),
)
TOTALS = {
    "count": 3, "lifted": 1, "lifted_with_retry": 2, "success": 1 / 3, "success_low": 0.0615, "success_high": 0.7923,
    "scenes_without_plan": 4,
}  # fmt: skip


@pytest.fixture(scope="module")
def page() -> ET.Element:
    report = execution_report(FIGURES, RECORDS, TOTALS, robot="fetch", command="neuralgrasps execute", notes=["More."])
    return ET.fromstring(report_html(report).removeprefix("<!DOCTYPE html>\n"))


def text_of(element: ET.Element) -> str:
    return " ".join("".join(element.itertext()).replace("\u202f", " ").split())


def cards(page: ET.Element) -> list[ET.Element]:
    return [e for e in page.iter() if e.tag.endswith("figure")]


def test_failures_come_first_each_with_its_cause(page: ET.Element):
    titles = [text_of(c) for c in cards(page)]
    assert ["trial" in t for t in titles] == [True] * 3
    assert "<b>box</b>, trial 1✗ slip" in titles[0] and "it rose by 30 mm & fell." in titles[0]  # text, never markup
    assert "can, trial 2✗ push-away, lifted at the second attempt" in titles[1]
    assert "can, trial 1✓ lifted" in titles[2] and "plan 42 ms" in titles[2]


def test_every_picture_is_there_and_one_card_moves(page: ET.Element):
    sources = [[e.get("src", "") for e in c.iter() if e.tag.endswith("img")] for c in cards(page)]
    assert [len(s) for s in sources] == [4, 2, 5]
    moving = [s for s in sources[2] if s.startswith("data:image/webp") and len(s) != len(sources[2][-1])]
    assert len(moving) == 1
    assert all(s.startswith("data:image/") for own in sources for s in own)  # nothing is loaded from elsewhere


def test_the_figures_say_how_sure_they_are(page: ET.Element):
    keys = text_of(next(e for e in page.iter() if e.get("class") == "keys"))
    assert "1 of 3" in keys and "6 to 79 % (Wilson, 95 %)" in keys and "2with one retry" in keys
    assert "60 ms" in keys and "at most 90 ms" in keys and "4scenes drawn again" in keys


def test_the_tables_hold_every_trial_and_every_cause(page: ET.Element):
    rows = [[text_of(c) for c in e] for e in page.iter() if e.tag.endswith("tr")]
    assert ["can", "1", "1.00", "0.500", "2", "40", "6.00", "yes", ""] in rows
    assert any(r[0] == "can" and r[1] == "2" and r[-2:] == ["2nd attempt", "push-away"] for r in rows)
    assert any(r[0] == "can" and r[1] == "3" and r[2] == "–" and r[-1] == "infeasible" for r in rows)
    assert ["slip", "1", CAUSES["slip"]] in rows


def test_without_any_plan_there_is_no_share():
    totals = {**TOTALS, "count": 0, "success_low": math.nan, "success_high": math.nan}
    report = execution_report((), RECORDS[3:], totals, robot="fetch", command="x")
    assert report.key_figures == () and "nan" not in report_html(report)
