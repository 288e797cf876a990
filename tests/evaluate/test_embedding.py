"""t-SNE: what it is made from, and which grasps are shown."""

import numpy as np
import pytest

from neuralgrasps.errors import ShapeError
from neuralgrasps.evaluate.embedding import contact_directions, embed_book, spread_points
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.train import TrainResult


def sphere(count: int = 2000) -> np.ndarray:
    p = np.random.default_rng(0).normal(size=(count, 3))
    return p / np.linalg.norm(p, axis=1, keepdims=True)


def test_contact_from_above_is_read_above_on_any_object() -> None:
    """A cap touched from above: the directions that see it are the upper ones, for a small ball and a large one."""
    points = sphere()
    maps = (points[:, 2] > 0.9).astype(np.float64)[None]
    seen = contact_directions(maps, 0.03 * points, np.zeros(3))
    assert seen.shape == (1, 64) and seen[0, 0] > 0.5 and seen[0, 0] > 20 * seen[0, 63]
    assert (np.diff(seen[0, :20:4]) < 0).all()  # directions go from the top to the bottom
    moved = contact_directions(maps, np.array([1.0, 2.0, 3.0]) + 0.5 * points, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(moved, seen, atol=1e-9)
    everywhere = contact_directions(np.full((2, len(points)), 0.7), points, np.zeros(3))
    np.testing.assert_allclose(everywhere, 0.7)  # no direction counts more than another
    below = contact_directions((points[:, 2] < -0.9).astype(np.float64)[None], points, np.zeros(3))
    assert np.abs(below - seen).sum() > 5 * np.abs(contact_directions(0.9 * maps, points, np.zeros(3)) - seen).sum()
    with pytest.raises(ShapeError, match="points_O"):
        contact_directions(maps, points[:10], np.zeros(3))


def test_shown_points_are_far_apart() -> None:
    line = np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [10, 0]])
    assert spread_points(line, 3).tolist() == [3, 4, 0]  # nearest to the mean (3.2), then the two ends
    assert sorted(spread_points(line, 9).tolist()) == [0, 1, 2, 3, 4]
    with pytest.raises(ShapeError, match="at least 1"):
        spread_points(line, 0)


def test_pictures_of_objects_and_of_all(small_run: TrainResult) -> None:
    book = small_run.codebook
    places = {name: (c.points_O, c.offset_O) for name, c in small_run.field.object_codecs.items()}
    whole, ball, brick = embed_book(book, places, seed=3)
    assert [m.title for m in (whole, ball, brick)] == ["all objects", "ball", "brick"]
    for m, name in ((ball, "ball"), (brick, "brick")):
        assert {book.objects[i] for i in book.object_index[m.rows]} == {name} and len(m.points) == len(m.rows) == 24
        assert len(set(m.pictured.tolist())) == 12
    assert sorted(whole.rows.tolist()) == list(range(48))
    drawn = {*ball.rows[ball.pictured], *brick.rows[brick.pictured]}
    assert set(whole.rows[whole.pictured]) <= drawn and len(whole.pictured) == 24  # no picture for this map alone
    again = embed_book(book, places, seed=3)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(again, (whole, ball, brick), strict=True))
    assert [m.title for m in embed_book(book, seed=3)] == ["ball", "brick"]


def test_too_few_codes_make_no_picture(small_run: TrainResult) -> None:
    few: CodeBook = small_run.codebook[:9]
    assert embed_book(few, seed=0) == ()
