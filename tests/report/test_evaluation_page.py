"""The evaluation page: what it must show, and latent maps that work without a mouse and without a network."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import neuralgrasps
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.evaluate.run_evaluate import evaluate_run
from neuralgrasps.evaluate.run_pairs import MeasureConfig
from neuralgrasps.evaluate.run_scores import KNOWN
from neuralgrasps.model.reconstruct import surface_errors
from neuralgrasps.model.train import TrainResult
from neuralgrasps.report.charts import legend_html, scatter_svg
from neuralgrasps.report.content import DemoReport, LatentMap
from neuralgrasps.report.evaluation_page import counted, key_figures, write_evaluation
from neuralgrasps.report.evaluation_tables import (
    beside_paper,
    chamfer_table,
    small,
    summary_table,
    surface_matrix,
    surface_table,
)
from neuralgrasps.report.latent_section import letter_of
from neuralgrasps.report.page import report_html
from neuralgrasps.report.table_sections import table_html

HTML = "{http://www.w3.org/1999/xhtml}"


@pytest.fixture(scope="module")
def page(small_run: TrainResult, small_dataset: GraspDataset, tmp_path_factory: pytest.TempPathFactory) -> ET.Element:
    grasps = {pair: small_dataset.grasps(*pair) for pair in small_dataset.pairs}
    config = MeasureConfig(queries=2000, points=100, observed=False)
    scores = evaluate_run(small_run.field, small_run.codebook, grasps, config=config, workers=1)
    path: Path = tmp_path_factory.mktemp("page") / "evaluation.html"
    given = {"command": "neuralgrasps evaluate run --report page.html", "workers": 1}
    write_evaluation(path, scores, small_run.field, small_run.codebook, grasps, **given)  # type: ignore[arg-type]
    return ET.fromstring(path.read_text(encoding="utf-8"))


def words_of(element: ET.Element) -> str:
    return " ".join("".join(element.itertext()).split())


def with_class(root: ET.Element, name: str) -> list[ET.Element]:
    return [e for e in root.iter() if name in (e.get("class") or "").split()]


def test_page_holds_tables_examples_and_maps(page: ET.Element) -> None:
    assert [s.get("id") for s in page.iter(f"{HTML}section")] == ["retrieval", "latent", "numbers"]
    text = words_of(page)
    for shown in ("KinematicField", "protocol, not of data", "nothing is inferred", "F at 1 mm", "Near Z", "2,000 per"):
        assert shown in text
    assert "2 hands, 2 objects, 48 grasps" in text and counted(1, "object") == "1 object"
    assert len(with_class(page, "query")) == len(with_class(page, "far")) == 2  # one example per object


def test_maps_mark_unseen_grasps_and_letter_those_with_pictures(page: ET.Element) -> None:
    cards = with_class(page, "latent")
    assert len(cards) == 3  # all objects, ball, brick
    for card, grasps, pictures in zip(cards, (48, 24, 24), (24, 12, 12), strict=True):
        marks = with_class(card, "mark")
        assert len(marks) == grasps and len(with_class(card, "unseen")) == grasps // 6
        letters = [m.get("data-letter") for m in marks if m.get("data-letter")]
        (strip,) = with_class(card, "thumbs")
        assert sorted(letters) == sorted(d.get("data-letter") for d in strip) and len(letters) == pictures
        assert all(i.get("src", "").startswith("data:image/") for i in strip.iter(f"{HTML}img"))
        titles = [m.find(f"{HTML}title") for m in marks]
        assert all(
            t is not None and re.search(r"(allegro|fetch): .*grasp \d+, (unseen|training)", t.text or "")
            for t in titles
        )
        (plot,) = with_class(card, "plot")
        assert plot.get("tabindex") == "0" and "Arrow keys" in next(plot.iter(f"{HTML}svg")).get("aria-label", "")


def test_hands_are_toggled_by_buttons(page: ET.Element) -> None:
    (legend,) = with_class(page, "toggles")
    buttons = list(legend.iter(f"{HTML}button"))
    assert [(b.get("data-hand"), b.get("aria-pressed")) for b in buttons] == [("fetch", "true"), ("allegro", "true")]
    script = "".join(s.text or "" for s in page.iter(f"{HTML}script"))
    assert "aria-pressed" in script and "ArrowLeft" in script and "fetch(" not in script
    assert "<" not in script and "&" not in script  # or the page would be no XML


def test_a_map_without_pictures_or_notes_is_still_a_map() -> None:
    plain = LatentMap(title="x", points=np.eye(3)[:, :2], hands=("fetch", "human", "<b>"))
    root = ET.fromstring(report_html(DemoReport(title="t", command="c", latent_maps=(plain,))))
    assert len(with_class(root, "latent")) == 1 and not with_class(root, "thumbs")
    assert [b.get("data-hand") for b in with_class(root, "toggles")[0]] == ["fetch", "human", "<b>"]
    assert [letter_of(i) for i in (0, 25, 26, 52)] == ["A", "Z", "A1", "A2"]


def test_scatter_outlines_letters_and_fills_its_frame() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 4.0]])
    svg = ET.fromstring(scatter_svg(points, ["fetch"] * 3, ["a", "b", "c"], unseen=[1], letters={2: "A"}))
    marks = with_class(svg, "mark")
    assert ["unseen" in (m.get("class") or "") for m in marks] == [False, True, False]
    assert [m.get("data-letter") for m in marks] == [None, None, "A"] and len(with_class(svg, "letter")) == 1
    at = np.array([[float(v) for v in (m.get("data-at") or "").split()] for m in marks])
    assert at[1, 0] > at[0, 0] and at[2, 1] < at[0, 1]  # y points up
    assert np.ptp(at[:, 1]) == pytest.approx(460 - 44, abs=1)
    pressed = ET.fromstring(legend_html(["fetch"], toggles=True))
    assert [e.tag for e in pressed] == ["button"] and [e.tag for e in ET.fromstring(legend_html(["fetch"]))] == ["span"]


def test_tables_say_how_columns_stand_to_the_paper() -> None:
    from tests.evaluate.test_run_evaluate import three_columns  # noqa: PLC0415 - constructed scores of known answers

    table = chamfer_table(three_columns(0.0021), "test", KNOWN)
    assert table.rows == (("cracker box", "1.00 ×2.000 (1.33)", "2.10 ×1.050 (1.44)", "6.00 ×6.000 (5.52)"),)
    said = (
        "Of the paper's Chamfer figures, 3 can be compared: ours is at or below it in 1; above it in 1; above it in 1"
    )
    assert f"{said} where a perfect field is above it too." in table.meaning
    named = beside_paper(three_columns(0.0021), "test", KNOWN, names=True)
    assert "above it in 1 (003_cracker_box: barrett)" in named and "1 (003_cracker_box: fetch) where" in named
    assert "KinematicField" in table.title and KNOWN in table.title
    assert summary_table(three_columns(0.002)).rows[0][0] == "Unseen grasps, known"


def test_rounding_reads_as_such_and_headers_are_narrow() -> None:
    from tests.evaluate.test_run_evaluate import three_columns  # noqa: PLC0415

    assert [small(v) for v in (None, 0.0, 1.64e-6, 0.02)] == [None, 0.0, "< 0.001", 0.02]
    assert np.isnan(small(np.nan))  # type: ignore[arg-type]
    too_few = three_columns(np.inf)
    assert chamfer_table(too_few, "test", KNOWN).rows[0][2] == "– (1.44)"
    assert [c.label for c in key_figures(too_few)] == ["retrieval gap"]
    table = summary_table(three_columns(0.002))
    assert "re-ranked: after the first 20 by code were put in order by contact map" in table.meaning
    # At 1400 px the page is 1,150 px wide: headers may wrap at spaces, cells may not, and each column has 16 px of air.
    widths = [
        max(*(len(word) for word in head.split()), len(str(cell)))
        for head, cell in zip(table.columns, table.rows[0], strict=True)
    ]
    assert 8 * sum(widths) + 16 * len(widths) < 1150 and 'class="scroll tight"' in table_html(table)
    css = (Path(neuralgrasps.__file__).parent / "assets" / "report" / "page.css").read_text()
    assert re.search(r"^th {[^}]*white-space: normal", css, re.MULTILINE)


def test_headline_figures_lead_with_what_was_inferred() -> None:
    from neuralgrasps.evaluate.run_scores import ALL_OVER, ONE_VIEW  # noqa: PLC0415
    from tests.evaluate.test_run_evaluate import three_columns  # noqa: PLC0415

    known = three_columns(0.002)
    scores = replace(
        known,
        hands=tuple(replace(r, input=given) for given in (KNOWN, ALL_OVER, ONE_VIEW) for r in known.hands),
        similarities=tuple(replace(known.similarities[0], input=given) for given in (KNOWN, ALL_OVER, ONE_VIEW)),
        pooled={("test", g): surface_errors(np.array([1e-3, 2e-3, 6e-3])) for g in (KNOWN, ALL_OVER, ONE_VIEW)},
    )
    cards = key_figures(scores)
    assert [c.note.rsplit("grasps, ")[-1] for c in cards] == [
        *[ONE_VIEW] * 2, *[ALL_OVER] * 2, *["known: by construction, nothing is inferred"] * 2,
    ]  # fmt: skip
    assert cards[0].value == "2.00 mm" and cards[0].note.startswith("mean 3.00 mm, p95 5.60 mm; unseen grasps")


def test_rounding_errors_of_known_grasps_make_no_table() -> None:
    from neuralgrasps.evaluate.run_scores import ONE_VIEW  # noqa: PLC0415
    from tests.evaluate.test_run_evaluate import three_columns  # noqa: PLC0415

    scores = three_columns(0.002)
    assert surface_table(scores, "test", KNOWN).rows == surface_matrix(scores, "test", KNOWN).rows == ()
    seen = replace(scores, hands=tuple(replace(r, input=ONE_VIEW, surface_mean_mm=0.5) for r in scores.hands))
    assert [row[:3] for row in surface_table(seen, "test", ONE_VIEW).rows] == [
        ("fetch", 1, "0.500"),
        ("barrett", 1, "0.500"),
    ]
    assert surface_matrix(seen, "test", ONE_VIEW).rows == (("cracker box", "0.50 / 0.00", "0.50 / 0.00"),)
