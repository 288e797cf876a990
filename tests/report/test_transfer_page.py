"""The section of a transfer: the query first, the grasps in their order, their figures, and what is tinted."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.regions import Side
from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.content import DemoReport
from neuralgrasps.report.page import report_html
from neuralgrasps.report.transfer_content import TransferList, TransferredGrasp
from neuralgrasps.report.transfer_page import marked_object, point_surface, transfer_list

HALF = np.array([0.02, 0.03, 0.06])
PICTURE = np.full((30, 40, 3), 120, np.uint8)


@pytest.fixture(scope="module")
def obj(make_object: Callable[..., ObjectModel]) -> ObjectModel:
    return make_object("brick", box_mesh(HALF))


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("panda")


def _beside(hand: Hand, count: int) -> GraspSet:
    """Open jaws that come along -x, each 2 mm farther than the last."""
    X_OP = np.eye(4)
    X_OP[:3, :3] = np.array([[0, 0, -1.0], [1, 0, 0], [0, -1, 0]])
    X_OH = np.stack([X_OP @ np.linalg.inv(hand.X_HP)] * count)
    X_OH[:, 0, 3] += 0.09 + 0.002 * np.arange(count)
    left, _, right = np.linalg.svd(X_OH[:, :3, :3])
    X_OH[:, :3, :3] = left @ right
    q, none = np.tile(hand.q_open, (count, 1)), np.zeros((count, 0, 3))
    grasps = GraspSet(
        hand=hand.name, object="brick", X_OH=X_OH, q=q, q_pregrasp=q, q_squeeze=q, contact_points_O=none,
        contact_normals_O=none, contact_links=np.zeros((count, 0), np.int32), epsilon=np.linspace(0.3, 0.1, count),
        penetration_m=np.zeros(count),
    )  # fmt: skip
    held = Verdict(success=np.ones(count), displacement_m=np.full(count, 0.0015), rotation_rad=np.zeros(count))
    return grasps.with_verdict("dexgraspbench", held)


def _result(hand: Hand, count: int) -> TransferResult:
    return TransferResult(
        grasps=_beside(hand, count), similarity=np.linspace(0.9, 0.5, count), map_difference=np.zeros(count),
        origin=("generated", "retrieved")[:count], source=np.zeros(count, np.int64),
        reasons=tuple(f"reason {i}" for i in range(count)), oracle=0.8, oracle_plain=0.8, scale=0.1, tried=count,
        reason="", nearest=_beside(hand, 1)[:0], nearest_similarity=float("nan"),
    )  # fmt: skip


def test_pictures_and_figures_are_those_of_the_result(hand: Hand, obj: ObjectModel) -> None:
    result = _result(hand, 2)
    X_OH, q = np.array(result.grasps.X_OH[0]), np.array(result.grasps.q[0])
    rules = GraspConstraints(obj=obj, keep_free=(Side("top", 0.1),), margin_m=0.0)
    shown = transfer_list(
        result, query_from_grasp(hand, obj, X_OH, q), hand, obj, title="grasp 0", grasp=(hand, X_OH, q),
        constraints=rules,
    )  # fmt: skip
    first, second = shown.grasps
    assert np.array_equal(first.image, shown.image) and np.array_equal(first.contacts, shown.contacts)  # the same grasp
    assert not np.array_equal(first.contacts, second.contacts)
    assert (first.similarity, first.origin, second.reason) == (0.9, "generated", "reason 1")
    assert first.success and first.displacement_mm == pytest.approx(1.5) and first.epsilon == pytest.approx(0.3)
    clearance = 1e3 * rules.clearance(hand, result.grasps.X_OH, result.grasps.q)
    assert [g.clearance_mm for g in shown.grasps] == pytest.approx(clearance.tolist())
    assert shown.query_hand == "panda"


def test_what_is_kept_free_is_red_and_what_may_be_touched_green(obj: ObjectModel) -> None:
    plain = marked_object(obj, None)
    both = GraspConstraints(obj=obj, keep_free=(Side("top", 0.2),), only_region=(Side("bottom", 0.2),))
    surface = marked_object(obj, both)
    z, off = surface.mesh.vertices[:, 2], surface.colour - plain.colour
    assert (off[z > 0.04][:, 1] < -0.1).all() and (off[z < -0.04][:, 0] < -0.1).all()
    assert (off[np.abs(z) < 0.03] == 0).all()


def test_points_are_drawn_as_balls_of_some_millimetres() -> None:
    assert len(point_surface(np.zeros((0, 3)))) == 0
    (balls,) = point_surface(np.zeros((2, 3)))
    assert balls.mesh.extents == pytest.approx([0.007] * 3, rel=0.1)


def test_the_page_shows_them_in_order() -> None:
    grasps = tuple(
        TransferredGrasp(
            image=PICTURE, contacts=PICTURE, similarity=s, origin=o, success=True, displacement_mm=1.25, epsilon=0.2,
            clearance_mm=c, reason="because <of> & that",
        )
        for s, o, c in ((0.912, "generated", 12.4), (0.5, "retrieved", None))
    )  # fmt: skip
    one = TransferList(
        object="006_mustard_bottle", hand="fetch", title="grasp 3 of the <human> hand", image=PICTURE, contacts=PICTURE,
        grasps=grasps, query_hand="human", text="as seen",
    )  # fmt: skip
    html = report_html(DemoReport(title="t", command="c", transferred=(one,)))
    page = ET.fromstring(html.removeprefix("<!DOCTYPE html>\n"))
    cards = [" ".join("".join(e.itertext()).split()) for e in page.iter() if e.tag.endswith("figure")]
    assert len(cards) == 3 and "query" in cards[0] and "grasp 3 of the <human> hand" in cards[0]
    assert "1. generated" in cards[1] and "similarity 0.912" in cards[1] and "clear by 12 mm" in cards[1]
    assert "2. retrieved" in cards[2] and "clear by" not in cards[2] and "because <of> & that" in cards[2]
    assert html.count("<img") >= 6 and "mustard bottle" in html
