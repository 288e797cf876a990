from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.retrieve import retrieve, retrieve_symmetric, rotated_maps
from neuralgrasps.dataset.samples import contact_maps
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.model.codes import CODE_SIZE, CodeBook
from neuralgrasps.model.kinematic_field import KinematicField


def book(first_numbers, hands=("a",), hand_index=None, maps=None) -> CodeBook:
    """Codes that differ in their first number only."""
    count = len(first_numbers)
    values = np.zeros((count, CODE_SIZE), np.float32)
    values[:, 0] = first_numbers
    values[:, 100:] = 1000.0 * np.arange(count)[:, None]  # must not matter: outside the contact block
    zeros = np.zeros(count, np.int32)
    return CodeBook(
        values=values, hands=hands, objects=("box",), object_index=zeros, grasp_index=zeros,
        hand_index=zeros if hand_index is None else np.asarray(hand_index, np.int32),
        contact_maps=np.zeros((count, 0), np.float32) if maps is None else np.asarray(maps, np.float32),
    )  # fmt: skip


def test_nearest_and_farthest_by_hand() -> None:
    gallery = book([0.0, 0.4, 0.9, 0.5])
    near = retrieve(book([0.52]), gallery, object_name="box", count=3)
    assert near.index.tolist() == [[3, 1, 2]]
    assert near.code_distance[0, 0] == pytest.approx(0.02 / 96, rel=1e-3)
    assert np.isnan(near.map_distance).all()
    far = retrieve(book([0.52]), gallery, object_name="box", count=2, farthest=True)
    assert far.index.tolist() == [[0, 2]]


def test_only_the_asked_hand_is_searched_and_missing_places_are_marked() -> None:
    gallery = book([0.0, 0.4, 0.9, 0.5], hands=("a", "b"), hand_index=[0, 0, 1, 0])
    result = retrieve(book([0.5]), gallery, object_name="box", hand="b", count=2)
    assert result.index.tolist() == [[2, -1]]
    assert result.code_distance[0, 1] == np.inf


def test_test_grasps_are_searched_only_when_asked_for() -> None:
    gallery = replace(book([0.0, 0.5, 0.9]), is_test=np.array([False, True, False]))
    assert retrieve(book([0.5]), gallery, object_name="box", count=3).index.tolist() == [[2, 0, -1]]
    assert retrieve(book([0.5]), gallery, object_name="box", count=1, include_test=True).index.tolist() == [[1]]
    with pytest.raises(InputError, match="no training grasps"):
        retrieve(book([0.5]), gallery[1], object_name="box")


def test_maps_put_the_best_in_order() -> None:
    gallery = book([0.1, 0.2, 0.3], maps=[[0.9], [0.1], [0.5]])
    query = book([0.0], maps=[[0.0]])
    by_code = retrieve(query, gallery, object_name="box", count=3, rerank=0)
    assert by_code.index.tolist() == [[0, 1, 2]]
    assert np.allclose(by_code.map_distance, [[0.9, 0.1, 0.5]])
    assert retrieve(query, gallery, object_name="box", count=3).index.tolist() == [[1, 2, 0]]
    assert retrieve(query, gallery, object_name="box", count=3, rerank=2).index.tolist() == [[1, 0, 2]]
    assert retrieve(query, gallery, object_name="box", count=1, rerank=2).index.tolist() == [[1]]


def test_ranking_equals_brute_force() -> None:
    rng = np.random.default_rng(0)
    values = rng.random((60, CODE_SIZE)).astype(np.float32)
    gallery, query = book(np.zeros(50)), book(np.zeros(10))
    gallery, query = (
        CodeBook(values=v, **{n: getattr(b, n) for n in ("hands", "objects", "hand_index", "object_index",
                                                         "grasp_index", "contact_maps")})
        for v, b in ((values[:50], gallery), (values[50:], query))
    )  # fmt: skip
    distance = np.abs(values[50:, None, :96].astype(float) - values[None, :50, :96]).mean(axis=2)
    assert np.array_equal(retrieve(query, gallery, object_name="box").index, np.argsort(distance, axis=1)[:, :5])


def test_a_turned_copy_is_found_through_the_symmetry(small_world, make_object) -> None:
    """The query is a gallery grasp turned by a quarter turn of the square brick: only the symmetric search finds it."""
    brick = make_object("brick", box_mesh([0.04, 0.04, 0.08]), cells=48, points=1024, symmetry=True)
    turns = [k for k, X in enumerate(brick.symmetry.rotations) if not np.allclose(X @ X, np.eye(4), atol=1e-3)]
    assert len(brick.symmetry.rotations) == 8 and len(turns) == 2
    grasps = small_world.grasp_sets[0]
    field = KinematicField(hands=small_world.hands, objects={"brick": brick})
    gallery = field.encode(grasps.X_OH, grasps.q, hand="allegro", object_name="brick")
    S = brick.symmetry.rotations[turns[0]]
    query = field.encode(S @ grasps.X_OH[5:6], grasps.q[5:6], hand="allegro", object_name="brick")
    arguments = {"symmetry": brick.symmetry, "codec": field.object_codecs["brick"]}
    plain = retrieve(query, gallery, object_name="brick", count=1)
    found = retrieve_symmetric(query, gallery, count=1, **arguments)
    assert found.index[0, 0] == 5 and found.symmetry[0, 0] == turns[0]
    assert found.map_distance[0, 0] < 0.02 < plain.map_distance[0, 0]
    moved = brick.symmetry.rotations[found.symmetry[0, 0]] @ grasps.X_OH[5]
    assert np.allclose(moved, S @ grasps.X_OH[5])


def test_rotated_maps_are_those_of_the_moved_grasp(small_world, make_object) -> None:
    brick = make_object("brick", box_mesh([0.04, 0.04, 0.08]), cells=48, points=1024, symmetry=True)
    grasps = small_world.grasp_sets[0]
    field = KinematicField(hands=small_world.hands, objects={"brick": brick})
    packed = field.packed["allegro"]
    maps = contact_maps(packed, grasps.X_OH, grasps.q, brick.points_O, radius_m=0.02)
    turned = rotated_maps(maps, brick.points_O, brick.symmetry)
    for s, S in enumerate(brick.symmetry.rotations):
        moved = contact_maps(packed, np.linalg.inv(S) @ grasps.X_OH, grasps.q, brick.points_O, radius_m=0.02)
        assert np.abs(turned[:, s] - moved).mean() < 0.02


def test_questions_without_an_answer_are_refused() -> None:
    gallery = book([0.0], hands=("a", "b"))
    with pytest.raises(InputError, match="no training grasps of 'box' by hand 'b'"):
        retrieve(book([0.0]), gallery, object_name="box", hand="b")
    with pytest.raises(InputError, match="count is 0"):
        retrieve(book([0.0]), gallery, object_name="box", count=0)


def test_results_are_told_in_a_line() -> None:
    gallery = book([0.0, 0.25, 1.0])
    assert repr(retrieve(book([0.0]), gallery, object_name="box", count=2)) == (
        "RetrieveResult(1 query, 2 grasps each, code distance 0.000-0.003)"
    )
