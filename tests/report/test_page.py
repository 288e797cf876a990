"""The report page: well-formed, complete, safe, alone, and written all or nothing."""

from __future__ import annotations

import errno
import os
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError, StorageError
from neuralgrasps.report.charts import bars_svg, histogram_svg, nice_ticks, scatter_svg, short_number
from neuralgrasps.report.content import (
    ContactFigure,
    DemoReport,
    GraspFigure,
    HandFigure,
    Histogram,
    KeyFigure,
    LatentMap,
    ModelRow,
    Neighbour,
    PoseFigure,
    RetrievalRow,
    StageTime,
    SynthesisRow,
    Table,
    TransferFigure,
)
from neuralgrasps.report.page import report_html, write_report
from neuralgrasps.report.table_sections import retrieval_table, synthesis_table, table_html

HTML = "{http://www.w3.org/1999/xhtml}"
EVIL = "<script>alert(\"1\")</script> & 'quoted'"


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (30, 40, 4), np.uint8)


def full_report(text: str = "plain") -> DemoReport:
    neighbour = Neighbour(hand="fetch", image=picture(1), similarity=0.8)
    return DemoReport(
        title=text,
        command=text,
        subtitle=text,
        machine=text,
        seed=0,
        version=text,
        created=text,
        key_figures=(KeyFigure(value=text, label=text, note=text),),
        hands=(HandFigure(hand=text, image=picture(), text=text),),
        grasps=(
            GraspFigure(hand="allegro", object="006_mustard_bottle", image=picture(), epsilon=0.1, success=True),
            GraspFigure(hand=text, object=text, image=picture(), success=False, note=text),
        ),
        contacts=(ContactFigure(hand="human", object=text, image=picture(), area_share=0.05, note=text),),
        retrieval=(RetrievalRow(object=text, query=neighbour, nearest=(neighbour,) * 5, farthest=neighbour),),
        transfers=(TransferFigure(object=text, source=neighbour, target=neighbour, text=text),),
        latent_maps=(
            LatentMap(title=text, points=np.eye(3)[:, :2], hands=("fetch", "human", text), notes=(text,), text=text),
        ),
        poses=(PoseFigure(object=text, observed=picture(), overlay=picture(), translation_error_mm=1.25, note=text),),
        synthesis=(SynthesisRow(hand="fetch", object=text, candidates=100, valid=50, validated=10, success_share=0.9),),
        dataset=((text, text),),
        model=(ModelRow(object="003_cracker_box", grasps=25, near_code=0.8, near_contact=0.9, hand_error_mm=1.0),),
        times=(StageTime(stage=text, wall_s=1.5, cpu_s=3.0, peak_memory_mib=100.0),),
        tables=(Table(title=text, columns=("a", text), rows=((text, 1.5), (None, None)), meaning=text, how=text),),
        histograms=(Histogram(title=text, unit=text, values={"fetch": np.arange(5.0), text: np.ones(3)}, limit=2.0),),
        notes=(text,),
        section_texts={"grasps": text},
    )


def body_text(root: ET.Element) -> str:
    return " ".join("".join(root.find(f"{HTML}body").itertext()).split())


def test_page_is_well_formed_and_shows_every_section():
    root = ET.fromstring(report_html(full_report()))
    sections = [s.get("id") for s in root.iter(f"{HTML}section")]
    expected = ["grasps", "hands", "contacts", "retrieval", "transfer", "latent", "pose", "numbers", "times", "notes"]
    assert sections == expected
    assert [a.get("href") for a in root.iter(f"{HTML}a")] == [f"#{name}" for name in expected]
    ids = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(ids) == len(set(ids))
    assert all(image.get("alt") is not None for image in root.iter(f"{HTML}img"))


def test_a_part_is_one_section_that_holds_those_of_its_report():
    part = DemoReport(title="Inner <1>", command="", subtitle="Why & how", notes=("a note",))
    html = report_html(
        DemoReport(title="Outer", command="c", notes=("last",), parts=(part, replace(part, title="Two")))
    )
    root = ET.fromstring(html.removeprefix("<!DOCTYPE html>\n"))
    sections = {s.get("id"): s for s in root.iter(f"{HTML}section")}
    assert list(sections) == ["part-1", "part-2", "notes"]
    inner = sections["part-1"]
    assert [(e.tag.removeprefix(HTML), e.text) for e in inner][:3] == [
        ("h2", "Inner <1>"), ("p", "Why & how"), ("h3", "Notes"),
    ]  # fmt: skip
    assert [e.text for e in inner.iter(f"{HTML}li")] == ["a note"]


def test_page_loads_nothing_from_elsewhere():
    html = report_html(full_report())
    references = re.findall(r"""(?:src|href|action|data|poster)\s*=\s*["']([^"']*)""", html)
    assert references and all(r.startswith(("data:", "#")) for r in references)
    assert re.findall(r"https?://[^\s\"'<]+", html) == ["http://www.w3.org/1999/xhtml"]  # a name, not a place
    assert not re.search(r"@import|url\(|fetch\(['\"h]|XMLHttpRequest|<link|<iframe", html)
    assert "default-src 'none'" in html


def test_every_text_is_escaped():
    html = report_html(full_report(EVIL))
    root = ET.fromstring(html)
    assert len(list(root.iter(f"{HTML}script"))) == 1
    plain = report_html(full_report("plain"))
    assert [e.tag for e in root.iter()] == [e.tag for e in ET.fromstring(plain).iter()]
    assert EVIL in body_text(root)


def test_numbers_and_verdicts_are_shown():
    text = body_text(ET.fromstring(report_html(full_report())))
    for shown in (
        "✓ held",
        "✗ lost",
        "ε 0.100",
        "mustard bottle",
        "5.0 % of surface",
        "1.25\u202fmm",
        "90.0 %",
        "0.80",
    ):
        assert " ".join(shown.split()) in text
    assert "0.81 / 0.88" in text  # the paper's figures for the cracker box


def test_an_empty_report_is_still_a_page():
    root = ET.fromstring(report_html(DemoReport(title="t", command="c")))
    assert not list(root.iter(f"{HTML}section"))


def test_synthesis_totals_weigh_by_trials():
    row = SynthesisRow(hand="fetch", object="a", candidates=10, valid=5, validated=10, success_share=1.0, cpu_s=1.0)
    other = replace(row, object="b", validated=15, success_share=0.5, penetration_p95_mm=0.7, cpu_s=None)
    untried = replace(row, object="c", validated=0, success_share=None, cpu_s=None)
    none_held = replace(row, object="d", validated=0, tried=10, success_share=0.0, cpu_s=None)
    rows = synthesis_table((row, other, untried, none_held)).rows
    assert [r[4] for r in rows] == [10, 30, None, 10, 50]
    assert rows[-1] == ("all", "", 40, 20, 50, 25, "50.0 %", 0.7, None, 1.0)


def test_gap_is_best_minus_found_and_unknown_objects_have_no_paper_figures():
    rows = (ModelRow(object="teapot", grasps=3, near_code=0.7, near_contact=0.75), ModelRow(object="cup", grasps=1))
    first, second = retrieval_table(rows).rows
    assert first[:6] == ("teapot", 3, "0.70", "0.75", "0.050", None)
    assert second[2:] == (None,) * 7
    assert table_html(retrieval_table(rows)).count("–") == 4 + 7


def test_pictures_are_compressed_until_the_page_is_small_enough():
    report = full_report()
    best = report_html(report)
    smaller = report_html(report, max_bytes=len(best.encode()) - 1)
    assert len(smaller.encode()) < len(best.encode())
    with pytest.raises(InputError, match="fewer or smaller pictures"):
        report_html(report, max_bytes=10_000)


def test_report_is_written_in_a_new_folder(tmp_path):
    path = write_report(full_report(), tmp_path / "out" / "report.html")
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("code", "says"), [(errno.ENOSPC, "disk is full"), (errno.EROFS, "choose a folder you may write to")]
)
def test_a_failed_write_keeps_the_old_page_and_leaves_nothing_behind(tmp_path, monkeypatch, code, says):
    path = tmp_path / "report.html"
    path.write_text("old")

    def fail(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StorageError, match=says):
        write_report(full_report(), path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_impossible_places_are_explained(tmp_path):
    with pytest.raises(InputError, match="is a folder"):
        write_report(full_report(), tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="choose another path"):
        write_report(full_report(), tmp_path / "file" / "report.html")


def test_charts_are_well_formed_and_hold_all_data():
    rng = np.random.default_rng(0)
    scatter = ET.fromstring(
        scatter_svg(rng.normal(size=(25, 2)), ["fetch", "panda", "barrett", "allegro", "human"] * 5)
    )
    assert sum(e.get("class") == "mark" for e in scatter.iter()) == 25
    values = {"fetch": rng.random(100), "human": np.append(rng.random(50), np.nan)}
    histogram = ET.fromstring(histogram_svg(values, "mm", limit=0.5))
    counts = [int(t.text.split(": ")[1]) for t in histogram.iter("title")]
    assert sum(counts) == 150
    bars = ET.fromstring(bars_svg(["a", "b"], [1.0, 4.0], "s"))
    widths = [float(r.get("width")) for r in bars.iter("rect")]
    assert widths[1] == pytest.approx(4 * widths[0], rel=0.01)
    assert histogram_svg({"fetch": np.zeros(0)}, "mm") == ""
    ET.fromstring(scatter_svg(np.zeros((0, 2)), []))
    ET.fromstring(histogram_svg({"fetch": np.zeros(3)}, "mm"))


@pytest.mark.parametrize(("low", "high"), [(0, 1), (0, 0.037), (-3.2, 17), (0, 1e-9), (0, 12345)])
def test_ticks_enclose_the_data_in_round_steps(low, high):
    ticks = nice_ticks(low, high, 6)
    assert ticks[0] <= low + 1e-12 and ticks[-1] >= high * (1 - 1e-9)
    assert 2 <= len(ticks) <= 9
    np.testing.assert_allclose(np.diff(ticks), ticks[1] - ticks[0], rtol=1e-3)


def test_short_numbers():
    shown = {
        0.0: "0",
        0.012345: "0.0123",
        1.2345: "1.23",
        12.345: "12.3",
        123.45: "123",
        1234.5: "1,234",
        -0.5: "-0.500",
    }
    assert {value: short_number(value) for value in shown} == shown
    assert short_number(3.2e-6) == "3.2e-06" and short_number(float("nan")) == "–"
