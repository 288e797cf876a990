from dataclasses import replace

import numpy as np
import pytest
import torch

from neuralgrasps.errors import InputError, ShapeError, UnknownNameError
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.model.codes import (
    CELLS,
    CODE_SIZE,
    POSTURE_BLOCK,
    CodeBook,
    contact_blocks,
    hand_codec,
    join_codes,
    object_codec,
    palm_block,
)
from neuralgrasps.model.kinematic_field import KinematicField


def random_q(hand, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(hand.tree.lower, hand.tree.upper, (count, hand.num_dofs))


@pytest.mark.parametrize("name", hand_names())
def test_posture_block_is_lossless_and_keeps_distances(name: str) -> None:
    hand = load_hand(name)
    codec = hand_codec(hand, random_q(hand, 9))
    q = random_q(hand, 20, seed=1)
    block = codec.posture(q)
    assert codec.is_lossless
    assert np.allclose(codec.joints(block), q, atol=1e-12)
    u = 2 * (q - hand.tree.lower) / (hand.tree.upper - hand.tree.lower)
    assert np.allclose(np.linalg.norm(block[0] - block[1:], axis=1), np.linalg.norm(u[0] - u[1:], axis=1))


def test_the_strongest_synergy_comes_first_and_closes_the_hand() -> None:
    hand = load_hand("allegro")
    close = np.linspace(0, 1, 30)[:, None]
    target = np.where(
        hand.closing_rate > 0, hand.tree.upper, np.where(hand.closing_rate < 0, hand.tree.lower, hand.q_open)
    )
    q = hand.q_open + close * (target - hand.q_open)
    block = hand_codec(hand, q).posture(q)
    assert np.ptp(block[:, 0]) > 1.0 and np.abs(block[:, 1:]).max() < 1e-6
    assert (np.diff(block[:, 0]) > 0).all()


def test_joints_beyond_the_limits_are_clamped() -> None:
    hand = load_hand("fetch")
    codec = hand_codec(hand)
    closed = np.where(hand.closing_rate > 0, hand.tree.upper, hand.tree.lower)
    assert np.allclose(codec.joints(np.full((1, 23), 9.0)), closed)


def test_palm_block_by_hand() -> None:
    X_OH = np.eye(4)[None].copy()
    X_OH[0, :3, 3] = [0.1, 0.2, 0.3]
    X_HP = np.eye(4)
    X_HP[:3, 3] = [0, 0, 0.1]
    assert np.allclose(palm_block(X_OH, X_HP, np.array([0.1, 0, 0])), [[0, 2, 4, 1, 0, 0, 0, 1, 0]])


def test_cells_are_even_and_follow_the_object(make_object) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3)) * [0.05, 0.03, 0.1]
    codec = object_codec("x", points, offset_O=points.mean(axis=0), radius_m=0.01)
    assert len(set(codec.cell_of)) == CELLS
    moved = object_codec("x", points + 1.0, offset_O=points.mean(axis=0) + 1.0, radius_m=0.01)
    assert np.array_equal(moved.cell_of, codec.cell_of)
    assert np.allclose(moved.centres_O, codec.centres_O + 1.0)
    assert codec.weights.mean() == pytest.approx(1.0)
    with pytest.raises(ShapeError, match="expected"):
        object_codec("x", points[:50], offset_O=np.zeros(3), radius_m=0.01)


def book_of(values: np.ndarray, hand: str, obj: str) -> CodeBook:
    zeros = np.zeros(len(values), np.int32)
    return CodeBook(
        values=values, hands=(hand,), objects=(obj,), hand_index=zeros, object_index=zeros,
        grasp_index=np.arange(len(values), dtype=np.int32), contact_maps=np.zeros((len(values), 0), np.float32),
    )  # fmt: skip


def test_books_join_by_name() -> None:
    a, b = (book_of(np.full((n, CODE_SIZE), n, np.float32), hand, "box") for n, hand in ((2, "panda"), (3, "allegro")))
    joined = join_codes([a, b])
    assert joined.hands == ("allegro", "panda")
    assert joined.where(hand="panda").tolist() == [True, True, False, False, False]
    assert len(joined[joined.where(hand="allegro")]) == 3 and len(joined[0]) == 1
    with pytest.raises(UnknownNameError, match="Did you mean 'panda'"):
        joined.where(hand="pandas")
    with pytest.raises(InputError, match="expected 0 to 0"):
        CodeBook(**{n: getattr(a, n) for n in ("values", "hands", "objects", "grasp_index", "contact_maps")},
                 hand_index=np.array([0, 1]), object_index=np.zeros(2, int))  # fmt: skip


@pytest.mark.parametrize("pair", range(4))
def test_encode_then_decode_gives_the_grasp_back(small_world, pair: int) -> None:
    grasps = small_world.grasp_sets[pair]
    field = KinematicField(hands=small_world.hands, objects=small_world.objects)
    book = field.encode(grasps.X_OH, grasps.q, hand=grasps.hand, object_name=grasps.object)
    back = field.decode(torch.as_tensor(book.values), hand=grasps.hand, object_name=grasps.object)
    assert np.abs(back.X_OH.numpy() - grasps.X_OH).max() < 1e-6
    assert np.abs(back.q.numpy() - grasps.q).max() < 1e-6
    assert np.abs(book.values[:, POSTURE_BLOCK]).max() <= 2.0


def test_codes_move_with_hand_and_object_together(small_world, make_object) -> None:
    """Only the palm's rotation columns and nothing else may change when everything is turned."""
    grasps, brick = small_world.grasp_sets[0], small_world.objects["brick"]
    field = KinematicField(hands=small_world.hands, objects=small_world.objects)
    maps = field.encode(grasps.X_OH, grasps.q, hand="allegro", object_name="brick").contact_maps
    turn = np.array([[0, -1, 0, 0.3], [1, 0, 0, -0.1], [0, 0, 1, 0.2], [0, 0, 0, 1.0]])
    from neuralgrasps.dataset.samples import contact_maps  # noqa: PLC0415

    moved = brick.points_O @ turn[:3, :3].T + turn[:3, 3]
    radius = field.object_codecs["brick"].radius_m
    again = contact_maps(field.packed["allegro"], turn @ grasps.X_OH, grasps.q, moved, radius_m=radius)
    assert np.allclose(again, maps, atol=1e-5)


def test_contact_blocks_bound_the_distance_of_maps() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (600, 3)) * [0.05, 0.03, 0.1]
    codec = object_codec("x", points, offset_O=points.mean(axis=0), radius_m=0.01)
    maps = rng.random((2, 600)).astype(np.float32)
    first, second = contact_blocks(maps, codec)
    by_hand = [maps[0][codec.cell_of == k].sum() * CELLS / 600 for k in range(CELLS)]
    assert np.allclose(first, by_hand, atol=1e-5)
    assert np.abs(first - second).mean() <= np.abs(maps[0] - maps[1]).mean()
    # where one map is above the other everywhere nothing cancels: the distances are equal
    higher = maps[0] + 0.25
    assert np.abs(contact_blocks(higher[None], codec)[0] - first).mean() == pytest.approx(0.25, abs=1e-5)
    with pytest.raises(ShapeError, match="600 contact points"):
        contact_blocks(maps[:, :500], codec)
    sizes = np.bincount(codec.cell_of, minlength=CELLS)
    assert sizes.min() >= 1 and sizes.max() <= 4 * sizes.mean()


def test_a_joint_that_cannot_move_gives_numbers() -> None:
    codec = replace(hand_codec(load_hand("barrett")))
    upper = codec.upper.copy()
    upper[2] = codec.lower[2]
    still = replace(codec, upper=upper)
    q = np.clip(np.full((1, codec.num_joints), 0.5), still.lower, still.upper)
    assert np.isfinite(still.posture(q)).all() and np.allclose(still.joints(still.posture(q)), q)


def test_a_code_book_is_told_in_a_line(small_run) -> None:
    book = small_run.codebook
    assert repr(book) == "CodeBook(allegro, fetch on ball, brick: 48 codes, 8 unseen)"
    assert repr(book[~book.is_test][:1]) == "CodeBook(allegro, fetch on ball, brick: 1 code)"
