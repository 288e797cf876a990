"""Where cards of grasps are seen from: the hand before the object, what it touches turned to the camera."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import KDTree

from neuralgrasps.apply.transfer_query import query_from_contacts
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.seen_view import _beside, _mapped, seen_direction
from neuralgrasps.report.views import upright

HALF = np.array([0.02, 0.03, 0.06])


@pytest.fixture(scope="module")
def obj(make_object: Callable[..., ObjectModel]) -> ObjectModel:
    return make_object("brick", box_mesh(HALF))


@pytest.fixture(scope="module")
def flat(obj: ObjectModel) -> np.ndarray:
    """Nothing is touched."""
    return np.zeros(len(obj.points_O))


@pytest.fixture(scope="module")
def jaw() -> tuple[Hand, np.ndarray, np.ndarray]:
    """An open jaw on the object's +x side."""
    hand = load_hand("panda")
    X_OP = np.eye(4)
    X_OP[:3, :3] = np.array([[0, 0, -1.0], [1, 0, 0], [0, -1, 0]])
    X_OP[0, 3] = 0.09
    return hand, X_OP @ np.linalg.inv(hand.X_HP), hand.q_open


def turned(quarters: int) -> np.ndarray:
    angle = quarters * math.pi / 2
    X = np.eye(4)
    X[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    return X


def touched(obj: ObjectModel, side: float) -> np.ndarray:
    """The contact map of two points on the +x or -x side."""
    return query_from_contacts(obj, np.array([[side * HALF[0], 0, z] for z in (0.01, -0.01)])).contact_map


def test_nothing_to_see_is_seen_from_a_pleasing_height(obj: ObjectModel, flat: np.ndarray) -> None:
    assert math.degrees(math.asin(seen_direction(obj, [(flat, None)])[2])) == pytest.approx(30)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_contacts_are_seen_from_their_side(obj: ObjectModel, flat: np.ndarray, side: float) -> None:
    one, other = (touched(obj, side), None), (touched(obj, -side), None)
    assert side * seen_direction(obj, [one])[0] > 0.9
    assert side * seen_direction(obj, [one, other])[0] > 0.9  # the query counts most
    assert side * seen_direction(obj, [(flat, None), one])[0] > 0.9  # but not alone
    assert side * seen_direction(obj, [(flat, None), other])[0] < -0.9


@pytest.mark.parametrize("quarters", range(4))
def test_hand_and_object_turned_together_turn_the_view(obj, flat, jaw, quarters: int) -> None:
    hand, X_OH, q = jaw
    X = turned(quarters)
    first = seen_direction(obj, [(flat, jaw)])
    assert first[0] > 0.8  # the hand is on the +x side
    expected = X[:3, :3] @ first
    np.testing.assert_allclose(seen_direction(obj, [(flat, jaw)], X), expected, atol=1e-9)
    np.testing.assert_allclose(seen_direction(obj, [(flat, (hand, X @ X_OH, q))]), expected, atol=1e-9)
    np.testing.assert_allclose(
        seen_direction(obj, [(touched(obj, 1.0), None)], X),
        X[:3, :3] @ seen_direction(obj, [(touched(obj, 1.0), None)]),
        atol=1e-9,
    )


def test_the_view_stays_above_the_table(obj: ObjectModel, flat: np.ndarray, jaw) -> None:
    X_UO = upright(np.array([1.0, 0.0, 0.0]))  # +x is up: nothing hides the hand
    assert seen_direction(obj, [(flat, jaw)], X_UO)[2] > 0.2


def test_what_is_counted_is_what_the_camera_sees() -> None:
    """Two plates, one before the other: from before it the hand hides the object, from behind it is hidden."""
    plate = box_mesh(np.array([0.001, 0.03, 0.03]))
    hand, front = plate.transformed(_moved(0.02)), np.array([1.0, 0.0, 0.0])
    points = np.array([[0.001, 0.0, 0.0], [-0.001, 0.0, 0.0]])  # the front is touched, the back is not
    values, tree = np.array([1.0, 0.0]), KDTree(points)
    (before,) = _mapped(plate, [values], tree, front)
    (behind,) = _mapped(plate, [values], tree, -front)
    assert before > 500 and behind == 0
    seen, share, mapped = _beside([hand], plate, values, tree, front)
    assert seen > 500 and share == 1.0 and mapped < 0.1 * before
    seen, share, mapped = _beside([hand], plate, 1 - values, tree, -front)
    assert share < 0.1 and seen < 0.1 * before and mapped > 500
    seen, share, _ = _beside([hand], plate, values, tree, np.array([0.0, 1.0, 0.0]))
    assert share == 1.0 and seen > 10  # edge on: both


def _moved(x: float) -> np.ndarray:
    X = np.eye(4)
    X[0, 3] = x
    return X
