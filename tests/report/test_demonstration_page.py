"""The page of a demonstration: stages with the one that failed, frames up to the grasp, the hand over the frames."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.video.grasp_moment import touch
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.content import DemoReport
from neuralgrasps.report.demonstration_content import DemonstrationFigure, StageFigure, TrackFigure
from neuralgrasps.report.demonstration_page import (
    DemonstrationStory,
    demonstration_report,
    shown_frame,
    shown_order,
    track_figure,
)
from neuralgrasps.report.demonstration_page import drawn_frames as frames_of
from neuralgrasps.report.demonstration_pictures import strip_indices, upright
from neuralgrasps.report.demonstration_stages import STAGES, TITLES, demonstration_stages
from neuralgrasps.report.page import report_html
from neuralgrasps.report.track_chart import track_svg
from tests.human.shown import ShownVideo
from tests.report.conftest import GAPS, MOMENT


def parsed(report: DemoReport) -> ET.Element:
    return ET.fromstring(report_html(report).removeprefix("<!DOCTYPE html>\n"))


def text_of(element: ET.Element) -> str:
    return " ".join("".join(element.itertext()).replace("\u202f", " ").split())


def with_class(page: ET.Element, name: str) -> list[ET.Element]:
    return [e for e in page.iter() if name in e.get("class", "").split()]


@pytest.mark.parametrize("stage", STAGES[:6])
def test_the_stage_that_failed_says_why_and_none_after_it_is_reached(demo: Demonstration, stage: str):
    stages = demonstration_stages(replace(demo, stage=stage, reason="because"), None, executed=True)
    at = STAGES.index(stage)
    assert [s.name for s in stages] == [TITLES[name] for name in STAGES]
    assert [s.verdict for s in stages] == ["ok"] * at + ["failed"] + ["not reached"] * (len(STAGES) - at - 1)
    assert [s.reason for s in stages] == [""] * at + ["because"] + [""] * (len(STAGES) - at - 1)


def test_stages_of_the_robot_are_left_out_where_nothing_was_to_be_carried_out(demo: Demonstration):
    stages = demonstration_stages(demo, None, executed=False)
    assert [s.name for s in stages] == [TITLES[name] for name in STAGES[:6]]
    assert {s.verdict for s in stages} == {"ok"}


def test_stages_say_what_they_came_to(demo: Demonstration):
    texts = {s.name: s.text for s in demonstration_stages(demo, None, executed=False)}
    assert texts["Object"] == "97 % sure, in frame 0"
    assert texts["Hand"] == "right, found in 4 of 6 frames"
    assert texts["Joints"] == "21, mean weight 1.00, by the test"
    assert texts["Fit"] == "hand of 202 mm, 2.0 mm off the points"  # 252 mm at scale 1
    assert texts["Grasp"] == "in frame 4, 2 frames fused; palm, thumb touch"


def test_what_is_less_than_sure_is_doubtful_and_frames_are_named(demo: Demonstration):
    assert demo.followed is not None and demo.followed.pose is not None
    unsure = replace(demo.followed, pose=replace(demo.followed.pose, confidence=0.7))
    named = [f"shot{k:02d}" for k in range(len(GAPS))]
    first = demonstration_stages(replace(demo, followed=unsure), None, executed=False, names=named)[0]
    assert (first.verdict, first.text) == ("doubtful", "70 % sure, in frame shot00")


def test_the_side_drawn_is_the_one_decided(demo: Demonstration, obj: ObjectModel, video: ShownVideo):
    assert demo.track is not None
    boxes = tuple(None if box is None else replace(box, side="left", side_score=0.5) for box in demo.track.boxes)
    seen = frames_of(video.frames, replace(demo, track=replace(demo.track, boxes=boxes)), obj)
    assert {layer.box.side for layer in seen.layers if layer.box is not None} == {"right"}


def test_an_object_that_was_not_found_is_not_said_to_be(demo: Demonstration):
    assert demo.followed is not None
    lost = replace(demo.followed, reason="it is another thing.")
    first = demonstration_stages(replace(demo, followed=lost, stage="object", reason="x"), None, executed=False)[0]
    assert first.text == "at most 97 % sure"


def test_the_strip_begins_before_the_hand_comes_and_ends_at_the_grasp():
    has_hand = np.array([False] * 10 + [True] * 20)
    assert strip_indices(has_hand, 24, 6) == [9, 12, 15, 18, 21, 24]
    assert strip_indices(has_hand, -1, 3) == [9, 19, 29]  # no grasp: to the last frame with a hand
    assert strip_indices(np.zeros(4, bool), -1, 6) == [0, 1, 2, 3]
    assert strip_indices(np.array([True]), 0, 6) == [0]


def test_the_hand_over_the_frames_comes_nearer_and_stops(demo: Demonstration, obj: ObjectModel, video: ShownVideo):
    track = track_figure(demo, obj)
    assert track is not None
    missing = [gap is None for gap in GAPS]
    assert np.isnan(track.gap_mm).tolist() == missing
    assert np.isnan(track.residual_mm).tolist() == missing
    fitted = video.fits[3]
    assert fitted is not None
    assert track.gap_mm[3] == pytest.approx(1e3 * touch(fitted, obj, video.X_CO).nearest_m)
    # 70 mm in two frames, then 40 mm in one, then none
    np.testing.assert_allclose(track.moved_mm[3:], [35.0, 40.0, 0.0], atol=1e-6)
    assert (track.moment, track.span) == (4, (4, 5))


def test_the_chart_leaves_gaps_where_no_hand_was_found():
    track = TrackFigure(
        gap_mm=np.array([50, 40, np.nan, 20, 10.0]), moved_mm=np.full(5, np.nan), residual_mm=np.full(5, np.nan),
        moment=3,
    )  # fmt: skip
    chart = ET.fromstring(track_svg(track))
    lines = [e for e in chart.iter() if e.get("class") == "line"]
    assert [len((line.get("points") or "").split()) for line in lines] == [2, 2]  # one lane with numbers, two runs
    start = [float((line.get("points") or "").split()[0].split(",")[1]) for line in lines]
    assert start[0] < start[1]  # farther away is higher up
    marker = next(e for e in chart.iter() if e.get("class") == "moment")
    assert marker.get("x1") == (lines[1].get("points") or "").split()[0].split(",")[0]


def test_the_grasp_that_was_carried_out_has_a_card():
    assert shown_order(3, None) == [0, 1, 2]
    assert shown_order(40, 2) == [0, 1, 2, 3, 4, 5, 6]
    assert shown_order(40, 31) == [0, 1, 2, 3, 4, 5, 31]


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -0.5, 0.2)])
def test_upright_turns_the_object_so_that_up_is_up(up: tuple[float, ...]):
    X = upright(np.array(up, float))
    np.testing.assert_allclose(X[:3, :3] @ np.array(up) / np.linalg.norm(up), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)


def test_the_frame_shown_is_the_grasps_or_the_last_with_most(demo: Demonstration, obj: ObjectModel, video: ShownVideo):
    seen = frames_of(video.frames, demo, obj)
    assert shown_frame(seen, demo) == MOMENT
    assert demo.track is not None
    fits = (*demo.track.frames[:4], None, None)
    failed = replace(demo, track=replace(demo.track, moment=-1, grasp=None, frames=fits))
    assert shown_frame(frames_of(video.frames, failed, obj), failed) == 3


def test_the_page_shows_everything_and_escapes_what_it_is_told(
    demo: Demonstration, obj: ObjectModel, video: ShownVideo
):
    failed = replace(demo, stage="transfer", reason="no <grasp> holds.")
    story = DemonstrationStory(frames=video.frames, demo=failed, obj=obj, hand=load_hand("fetch"))
    steps: list[str] = []
    page = parsed(demonstration_report(story, robot="fetch", command="demonstrate", progress=steps.append))
    tiles = [e for e in page.iter() if e.tag.endswith("li") and e.get("class")]
    assert [tile.get("class") for tile in tiles] == ["ok"] * 5 + ["failed"]
    stopped = with_class(page, "stopped")
    assert [text_of(e) for e in stopped] == ["Stopped at: Transfer. no <grasp> holds."]
    captions = [text_of(e) for e in page.iter() if e.tag.endswith("small")]
    assert "frame 4: the grasp" in captions
    assert "frame 0: no hand found" in captions
    assert "fitted hand and object" in captions
    assert "from the other side" in captions
    assert len(with_class(page, "moving")) == 1
    assert len(with_class(page, "track")) == 1
    assert "The thumb is <hidden> & far." in text_of(page)
    assert steps[0] == "the video"


def test_a_page_without_an_object_shows_the_frame_and_no_more(demo: Demonstration, obj: ObjectModel, video: ShownVideo):
    assert demo.followed is not None
    nowhere = replace(demo.followed, X_CO=np.full((len(GAPS), 4, 4), np.nan), pose=None, reason="no table.")
    failed = Demonstration(object="brick", hand="fetch", seed=0, stage="object", reason="no table.", followed=nowhere)
    story = DemonstrationStory(frames=video.frames, demo=failed, obj=obj, hand=load_hand("fetch"), executed=True)
    page = parsed(demonstration_report(story, robot="fetch", command="demonstrate"))
    sections = [e.get("id") for e in page.iter() if e.tag.endswith("section")]
    assert sections == ["stages", "moment", "numbers", "times"]
    captions = [text_of(e) for e in page.iter() if e.tag.endswith("small")]
    assert captions == ["what the camera saw"]


def test_a_page_needs_no_pictures():
    figure = DemonstrationFigure(stages=(StageFigure(name="Object", text="found"),))
    page = parsed(DemoReport(title="t", command="c", demonstration=figure))
    assert [e.get("id") for e in page.iter() if e.tag.endswith("section")] == ["stages"]


def test_a_reason_of_many_words_is_wrapped_in_the_table_of_stages(demo, obj, video):
    failed = replace(demo, stage="transfer", reason="no grasp holds, " * 20)
    story = DemonstrationStory(frames=video.frames, demo=failed, obj=obj, hand=load_hand("fetch"))
    page = parsed(demonstration_report(story, robot="fetch", command="demonstrate"))
    assert len(with_class(page, "words")) == 1
    assert text_of(with_class(page, "words")[0]).startswith("no grasp holds, no grasp holds")
    assert "fetch cannot repeat it, since the stage 'transfer' failed." in text_of(page)
