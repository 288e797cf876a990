"""Label errors of cases worked out by hand, and of the labels that a dataset holds."""

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.errors import ShapeError
from neuralgrasps.evaluate.label_error import (
    exact_hand_distance,
    exact_object_distance,
    hand_depth_bound,
    label_error,
)
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand


def test_errors_of_four_labels() -> None:
    found = label_error(np.array([0.001, -0.002, 0.003, 1e-7]), np.array([0.001, 0.002, 0.002, -1e-7]))
    assert found.samples == 4
    assert found.mean_mm == pytest.approx((0 + 4 + 1 + 2e-4) / 4) and found.max_mm == pytest.approx(4)
    assert found.wrong_signs == pytest.approx(1 / 3)  # the last is on the surface
    with pytest.raises(ShapeError, match=r"\(2,\).*\(3,\)"):
        label_error(np.zeros(2), np.zeros(3))


def test_labels_of_a_dataset_are_exact(small_world, small_dataset: GraspDataset) -> None:
    for hand, name in small_dataset.pairs:
        samples, grasps = small_dataset.samples(hand, name, [0, 7]), small_dataset.grasps(hand, name)
        for i, k in enumerate((0, 7)):
            points = samples.points_O[i].astype(np.float64)
            on_object = label_error(
                samples.sdf_object[i], exact_object_distance(small_dataset.object(name).mesh, points)
            )
            exact = exact_hand_distance(small_world.hands[hand], grasps.X_OH[k], grasps.q[k], points)
            on_hand = label_error(samples.sdf_hand[i], exact)
            assert on_object.max_mm < 1e-4 and on_hand.max_mm < 1e-4
            assert on_object.wrong_signs == on_hand.wrong_signs == 0


def test_the_depth_in_two_boxes_end_to_end_falls_short_as_much_as_reckoned() -> None:
    """Two cubes of 4 cm that share a face: at the middle of that face both are 0 deep and their union 2 cm."""
    hand = load_hand("fetch")
    parts = []
    for x in (-0.02, 0.02):
        X = np.eye(4)
        X[0, 3] = x
        parts.append(ConvexPart(link=0, kind=PartKind.BOX, size=np.full(3, 0.02), X_LP=X))
    packed = pack_hand(replace(hand, parts=tuple(parts)), spacing=0.01)
    points = np.array([[-0.005, 0.0, 0.0], [0.03, 0.0, 0.0], [0.02, 0.015, 0.0], [0.1, 0.0, 0.0]])
    found = hand_depth_bound(packed, np.eye(4), hand.q_open, points)
    assert (found.inside, found.short) == (3, 1)  # the second is nearest to an end, the third to a side
    assert found.max_mm == pytest.approx(15, abs=0.2)
    alone = pack_hand(replace(hand, parts=tuple(parts[:1])), spacing=0.01)
    found = hand_depth_bound(alone, np.eye(4), hand.q_open, points)
    assert (found.inside, found.short, found.max_mm) == (1, 0, 0)
