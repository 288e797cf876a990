import numpy as np
import pytest

from neuralgrasps.errors import ShapeError
from tests.model.plain_draw import balanced_draw, sign_lists


def test_lists_of_a_scene_worked_out_by_hand() -> None:
    #         both +, object only inside, hand only inside, both inside, on the object and outside the hand
    sdf_object = np.array([[0.1, -0.1, 0.2, -0.3, 0.0], [1.0, 1.0, -1.0, 1.0, -1.0]])
    sdf_hand = np.array([[0.2, 0.3, -0.1, -0.2, 0.5], [1.0, -1.0, -1.0, 1.0, -1.0]])
    lists = sign_lists(sdf_object, sdf_hand)
    assert lists.positive_count.tolist() == [4, 3] and lists.non_positive_count.tolist() == [4, 3]
    assert lists.positive.tolist() == [[0, 1, 2, 4, 3], [0, 1, 3, 2, 4]]
    assert lists.non_positive.tolist() == [[1, 2, 3, 4, 0], [1, 2, 4, 0, 3]]
    assert lists.positive.dtype == lists.positive_count.dtype == np.int32


def test_a_draw_is_half_and_half_and_reaches_every_point() -> None:
    rng = np.random.default_rng(0)
    sdf_object, sdf_hand = rng.normal(size=(2, 3, 40)) + 0.8
    drawn = balanced_draw(sign_lists(sdf_object, sdf_hand), rng.random((3, 4000)))
    rows = np.arange(3)[:, None]
    outside = (sdf_object > 0) | (sdf_hand > 0)
    inside = (sdf_object <= 0) | (sdf_hand <= 0)
    assert outside[rows, drawn[:, :2000]].all() and inside[rows, drawn[:, 2000:]].all()
    for row in range(3):
        assert set(drawn[row, :2000]) == set(np.flatnonzero(outside[row]))
        counts = np.bincount(drawn[row, 2000:], minlength=40)[inside[row]]
        assert counts.min() > 0.5 * counts.mean() and counts.max() < 1.5 * counts.mean()


def test_a_scene_with_one_kind_alone_is_drawn_from_it() -> None:
    outside = np.ones((1, 6))
    lists = sign_lists(outside, outside)
    assert lists.non_positive_count.tolist() == [0]
    drawn = balanced_draw(lists, np.linspace(0, 1, 12, endpoint=False)[None])
    assert drawn.max() == 5 and set(drawn[0, 6:]) <= set(range(6))
    last = balanced_draw(lists, np.full((1, 3), np.nextafter(1.0, 0.0)))
    assert last.tolist() == [[5, 5, 5]]


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ShapeError, match=r"\(2, 3\).*\(3, 2\)"):
        sign_lists(np.zeros((2, 3)), np.zeros((3, 2)))
    with pytest.raises(ShapeError, match="a row per scene"):
        balanced_draw(sign_lists(np.zeros((2, 3)), np.zeros((2, 3))), np.zeros((3, 4)))
