import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.model.infer import map_of_points
from neuralgrasps.model.infer_contacts import encode_contacts, hand_contacts


@pytest.fixture(scope="module")
def touching(small_run, small_world):
    """(gallery rows, their contact points) of allegro's training grasps that touch the brick."""
    book, grasps = small_run.codebook, small_world.grasp_sets[0]
    packed, sdf = small_run.field.packed["allegro"], small_world.objects["brick"].sdf
    rows = np.flatnonzero(book.where(hand="allegro", object_name="brick", is_test=False))
    points = [
        hand_contacts(packed, sdf, np.array(grasps.X_OH[i]), np.array(grasps.q[i])) for i in book.grasp_index[rows]
    ]
    kept = [k for k, p in enumerate(points) if len(p) >= 3]
    assert len(kept) >= 5
    return rows[kept], [points[k] for k in kept]


def test_contacts_lie_on_the_object_and_the_hand(small_run, small_world, touching) -> None:
    brick = small_world.objects["brick"]
    for points in touching[1]:
        outside = np.abs(points) - 0.5 * brick.mesh.extents
        assert np.median(np.abs(outside.max(axis=1))) < 1e-6  # deep ones end up near, not on the surface


def test_known_contacts_find_their_grasp(small_run, touching) -> None:
    book, (rows, points) = small_run.codebook, touching
    found = encode_contacts(points, small_run.field, book, hand="allegro", object_name="brick", refine=False)
    assert (found.rows[:, 0] == rows).mean() >= 0.7
    assert found.X_OH.shape == (len(rows), 5, 4, 4)
    raw = np.stack([map_of_points(small_run.field, "brick", p) for p in points])
    true = book.contact_maps[rows]
    assert np.abs(found.codes.contact_maps - true).mean() < 0.6 * np.abs(raw - true).mean()
    assert np.isnan(found.codes.values[:, 96:]).all() and not np.isnan(found.codes.contact_block).any()
    alone = encode_contacts(points[1:2], small_run.field, book, hand="allegro", object_name="brick", refine=False)
    np.testing.assert_allclose(alone.codes.values[:, :96], found.codes.values[1:2, :96], atol=1e-6)


def test_refined_candidates_meet_the_contacts(small_run, touching) -> None:
    book, (_, points) = small_run.codebook, touching
    at_rest, moved = (
        encode_contacts(points, small_run.field, book, hand="allegro", object_name="brick", refine=refine)
        for refine in (False, True)
    )
    assert moved.miss_m[:, 0].mean() < 0.5 * at_rest.miss_m[:, 1:].mean()
    lower, upper = (getattr(small_run.field.packed["allegro"], n) for n in ("lower", "upper"))
    assert (moved.q >= lower).all() and (moved.q <= upper).all()


def test_bad_contacts_are_refused(small_run) -> None:
    def encoded(points, hand="allegro", book=small_run.codebook):
        return encode_contacts([np.array(points)], small_run.field, book, hand=hand, object_name="brick")

    with pytest.raises(ShapeError, match=r"\(C, 3\)"):
        encoded([0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="no finite point"):
        encoded(np.full((2, 3), np.nan))
    with pytest.raises(InputError, match="by hand 'allegro'"):
        encoded(np.zeros((1, 3)), book=small_run.codebook[small_run.codebook.where(hand="fetch")])
