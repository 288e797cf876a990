"""The demo's demonstration: which object is shown, to which hand, and what is said when there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.demo.data import _shown_figures, _shown_line
from neuralgrasps.demo.demonstration import ShownByHand, show_by_hand
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.report.content import DemoReport
from neuralgrasps.report.page import report_html


def grasps_of(hand: str, name: str) -> GraspSet:
    return empty_grasps(hand, name, num_joints=load_hand(hand).num_dofs, seed=0)


def test_without_a_robot_hand_the_page_says_why():
    shown = show_by_hand({"human": load_hand("human")}, {}, [grasps_of("human", "box")], 0)
    assert shown.stage == "Video" and shown.object == "" and "no robot hand" in shown.reason
    page = report_html(DemoReport(title="T", command="c", parts=(shown.page,)))
    assert '<section id="part-1"><h2>Shown by a hand</h2><p>Nothing is shown here: no robot hand' in page
    assert _shown_figures(shown) == {} and "no demonstration was recorded: no robot" in _shown_line(shown)


def test_objects_too_large_for_a_person_are_named_with_the_reason(make_object):
    walls = {name: make_object(name, box_mesh(np.full(3, side))) for name, side in (("wall", 0.3), ("pile", 0.25))}
    shown = show_by_hand({"fetch": load_hand("fetch")}, walls, [grasps_of("fetch", name) for name in walls], 0)
    assert shown.stage == "Video" and shown.lifted is None
    assert shown.reason.index("wall: ") < shown.reason.index("pile: ")
    assert "too wide" in shown.reason


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "fetch touches it alike (contact similarity 0.90), and lifts it"),
        ({"lifted": None}, "fetch touches it alike (contact similarity 0.90)"),
        ({"stage": "Lift", "reason": "slip: it fell", "lifted": False}, "stopped at lift: slip: it fell"),
    ],
)
def test_one_line_tells_what_came_of_it(changes, words):
    page = DemoReport(title="T", command="")
    shown = ShownByHand(page=page, object="can", hand="fetch", similarity=0.9, lifted=True)
    assert _shown_line(replace(shown, **changes)).endswith(words)
    assert _shown_figures(shown) == {"demonstration_similarity": 0.9, "demonstration_lifted": 1.0}
