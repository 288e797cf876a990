"""The feasibility table: its numbers, its files, and its section on the page."""

from __future__ import annotations

import csv
import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.dataset.collect import PairRecord
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.report.content import ContactSheet, DemoReport, FeasibilityFigure, GraspFigure
from neuralgrasps.report.feasibility import (
    feasibility_cell,
    feasibility_matrix,
    summarise_pair,
    write_feasibility,
)
from neuralgrasps.report.page import report_html

HTML = "{http://www.w3.org/1999/xhtml}"
RECORD = PairRecord(
    hand="panda", object="ball", wanted=4, validated=4, proposals=2048, valid=90, tried=5, physics_success=0.8,
    cpu_s=1.5, reason="",
)  # fmt: skip
WIDE = replace(
    RECORD, object="wall", validated=0, proposals=2048, valid=0, tried=0, physics_success=math.nan,
    reason="too wide: narrowest graspable width 600 mm, aperture 80 mm",
)  # fmt: skip


def _grasps(count: int) -> GraspSet:
    none = np.zeros((count, 0, 3))
    return GraspSet(
        hand="panda", object="ball", X_OH=np.tile(np.eye(4), (count, 1, 1)), q=np.zeros((count, 1)),
        q_pregrasp=np.zeros((count, 1)), q_squeeze=np.zeros((count, 1)), contact_points_O=none, contact_normals_O=none,
        contact_links=np.zeros((count, 0)), epsilon=np.arange(count) / 10, penetration_m=np.zeros(count),
        force_residual=np.array([0.1, 0.3, np.nan, 0.5])[:count], palm_contact=np.zeros(count, bool),
        finger_count=np.array([2, 2, 2, -1])[:count], precision=np.array([True, True, False, False])[:count],
    )  # fmt: skip


@pytest.fixture
def pairs():
    return [
        summarise_pair(_grasps(4), RECORD, np.array([0.0, 1.0, 2.0, 3.0]) * 1e-4),
        summarise_pair(_grasps(0), WIDE, np.zeros(0)),
        summarise_pair(_grasps(3), replace(RECORD, hand="human", validated=3, reason="slips: 9 of 10"), np.zeros(3)),
    ]


def test_numbers_of_a_pair(pairs):
    pair = pairs[0]
    assert (pair.precision, pair.power) == (2, 1)  # the fourth has no label
    assert pair.epsilon_median == pytest.approx(0.15) and pair.force_residual_median == pytest.approx(0.3)
    assert pair.penetration_p95_mm == pytest.approx(0.285) and pair.penetration_max_mm == pytest.approx(0.3)
    assert (pair.shortfall, pair.reason, pair.held_text) == ("", "", "80 % held")


def test_a_pair_without_grasps_has_a_reason_and_no_numbers(pairs):
    pair = pairs[1]
    assert pair.shortfall == "too wide" and pair.held_text == "" and pair.validated == 0
    assert all(math.isnan(v) for v in (pair.epsilon_median, pair.penetration_max_mm, pair.force_residual_median))
    assert summarise_pair(_grasps(0), replace(WIDE, reason="older words"), np.zeros(0)).shortfall == "fewer than wanted"


def test_files(pairs, tmp_path):
    table, sheet = write_feasibility(tmp_path, pairs, {"seed": 3})
    record = json.loads(table.read_text())
    assert record["seed"] == 3 and [p["validated"] for p in record["pairs"]] == [4, 0, 3]
    assert record["pairs"][1]["epsilon_median"] is None
    rows = list(csv.DictReader(sheet.read_text().splitlines()))
    assert [r["shortfall"] for r in rows] == ["", "too wide", "slips"]
    assert rows[1]["penetration_p95_mm"] == "" and float(rows[0]["penetration_p95_mm"]) == pytest.approx(0.285)
    assert rows[1]["reason"] == WIDE.reason  # a comma inside stays inside


def test_matrix(pairs):
    columns, rows = feasibility_matrix(pairs)
    assert columns == ("object", "panda", "human")
    assert rows == [("ball", "4/4 80 %", "3/4 80 %"), ("wall", "too wide", "-")]


def _page(pairs, name: str = "ball") -> str:
    image = np.full((30, 40, 4), 200, np.uint8)
    grasp = GraspFigure(hand="panda", object=name, image=image, epsilon=0.1, success=True, kind=f"power, {name}")
    figure = FeasibilityFigure(
        hands={"panda": image, "human": image}, objects={"ball": image, "wall": image},
        cells=tuple(feasibility_cell(p) for p in pairs),
    )  # fmt: skip
    sheets = tuple(
        ContactSheet(hand=hand, object="ball", grasps=(replace(grasp, hand=hand),) * 3, text=name)
        for hand in ("panda", "human")
    )
    return report_html(DemoReport(title="t", command="c", feasibility=figure, sheets=sheets))


def test_page_links_each_cell_to_its_sheet(pairs):
    root = ET.fromstring(_page(pairs))
    table = next(t for t in root.iter(f"{HTML}table") if t.get("class") == "matrix")
    targets = {a.get("href") for a in table.iter(f"{HTML}a")}
    headings = {f"#{h.get('id')}": "".join(h.itertext()) for h in root.iter(f"{HTML}h3") if h.get("id")}
    assert targets == set(headings) and {h.strip() for h in headings.values()} == {"panda on ball", "human on ball"}
    text = " ".join("".join(table.itertext()).split())
    assert "too wide" in text and "4 of 4" in text and "80 % held" in text and "2 precision, 1 power" in text
    cells = [td for td in table.iter(f"{HTML}td") if td.get("title")]
    assert [td.get("title") for td in cells] == [WIDE.reason, "slips: 9 of 10"] or len(cells) == 2
    assert "slips: 9 of 10" in "".join(root.itertext())


def test_texts_are_escaped(pairs):
    evil = "<script>alert(\"1\")</script> & 'quoted'"
    bad = [replace(pairs[1], reason=f"too wide: {evil}", shortfall=evil), pairs[0]]
    root = ET.fromstring(_page(bad, evil))
    assert len(list(root.iter(f"{HTML}script"))) == 1 and evil in "".join(root.itertext())
