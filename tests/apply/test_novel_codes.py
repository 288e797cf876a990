import numpy as np
import pytest

from neuralgrasps.apply.novel_codes import (
    gaussian_codes,
    interpolate_codes,
    kernel_codes,
    midpoint_codes,
    nearer_side,
    noisy_codes,
    palm_rotations,
    with_rotations,
)
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.model.codes import CODE_SIZE, CONTACT_BLOCK, PALM_BLOCK, POSTURE_BLOCK


def known_codes(count: int, seed: int = 0) -> np.ndarray:
    """Codes with random closeness and palms, 3 of 23 posture columns in use."""
    rng = np.random.default_rng(seed)
    values = np.zeros((count, CODE_SIZE))
    values[:, CONTACT_BLOCK] = rng.uniform(0, 1.3, (count, CONTACT_BLOCK.stop))  # a large cell holds more than 1
    values[:, PALM_BLOCK.start : PALM_BLOCK.start + 3] = rng.normal(size=(count, 3))
    values[:, POSTURE_BLOCK.start : POSTURE_BLOCK.start + 3] = rng.normal(size=(count, 3))
    return with_rotations(values, axis_angle_matrix(rng.normal(size=(count, 3)), rng.uniform(0, 3, count)))


def check_codes(values: np.ndarray) -> None:
    columns = values[:, PALM_BLOCK][:, 3:].reshape(-1, 2, 3)
    assert np.allclose(columns @ columns.swapaxes(1, 2), np.eye(2), atol=1e-12)
    assert values[:, CONTACT_BLOCK].min() >= 0


def test_no_noise_gives_the_known_codes_each_once() -> None:
    known = known_codes(7)
    codes = noisy_codes(known, count=7, spread=0.0, seed=1)
    assert sorted(codes.source) == list(range(7)) and (codes.neighbour == -1).all()
    assert np.allclose(codes.values, known[codes.source], atol=1e-12)


def test_noise_is_in_proportion_to_each_component() -> None:
    known = known_codes(40)
    known[:, POSTURE_BLOCK.start] *= 5.0
    codes = noisy_codes(known, count=4000, spread=0.1, seed=0)
    moved = (codes.values - known[codes.source]).std(axis=0)
    used = [*range(PALM_BLOCK.start, PALM_BLOCK.start + 3), *range(POSTURE_BLOCK.start, POSTURE_BLOCK.start + 3)]
    assert np.allclose(moved[used], 0.1 * known.std(axis=0)[used], rtol=0.06)
    assert (moved[POSTURE_BLOCK.start + 3 :] == 0).all()  # columns that no known code uses
    check_codes(codes.values)


def test_all_kinds_are_codes_and_longer_draws_begin_like_shorter_ones() -> None:
    known = known_codes(12)
    features = known[:, PALM_BLOCK]
    for draw in (
        lambda n, s: noisy_codes(known, count=n, spread=0.5, seed=s),
        lambda n, s: midpoint_codes(known, features, count=n, seed=s),
        lambda n, s: kernel_codes(known, features, count=n, seed=s, is_jaw=True),
        lambda n, s: gaussian_codes(known, count=n, seed=s),
    ):
        long, short = draw(20, 3), draw(8, 3)
        check_codes(long.values)
        assert len(long) == 20 and np.array_equal(long.values[:8], short.values)
        assert np.array_equal(long.source[:8], short.source)
        assert not np.allclose(long.values, draw(20, 4).values)


def test_midpoint_of_a_code_with_itself_is_itself() -> None:
    known = known_codes(5)
    assert np.allclose(interpolate_codes(known, known), known, atol=1e-12)


def test_interpolation_turns_along_the_geodesic_and_ends_at_both_codes() -> None:
    first, second = known_codes(6), known_codes(6, seed=1)
    assert np.allclose(interpolate_codes(first, second, 0.0), first, atol=1e-12)
    assert np.allclose(interpolate_codes(first, second, 1.0), second, atol=1e-9)
    quarter = palm_rotations(interpolate_codes(first, second, 0.25))
    whole = np.einsum("nii->n", palm_rotations(first).swapaxes(1, 2) @ palm_rotations(second))
    part = np.einsum("nii->n", palm_rotations(first).swapaxes(1, 2) @ quarter)
    angles = [np.arccos(np.clip((t - 1) / 2, -1, 1)) for t in (part, whole)]
    assert np.allclose(angles[0], 0.25 * angles[1], atol=1e-9)


def test_a_jaw_turned_by_half_a_turn_is_the_same_grasp() -> None:
    known = known_codes(3)
    turned = with_rotations(known, palm_rotations(known) * np.array([-1.0, -1.0, 1.0]))
    assert np.allclose(nearer_side(known, turned), known, atol=1e-12)
    assert np.allclose(nearer_side(known, known), known, atol=1e-12)


def test_neighbours_are_the_nearest_and_no_pair_comes_twice() -> None:
    known = known_codes(6)
    line = np.array([0.0, 1.0, 3.0, 6.0, 10.0, 15.0])[:, None]
    codes = midpoint_codes(known, line, count=15, seed=0)
    pairs = [tuple(sorted(p)) for p in zip(codes.source, codes.neighbour, strict=True)]
    assert set(pairs[:5]) == {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)} and len(set(pairs)) == 15
    middle = interpolate_codes(known[codes.source], known[codes.neighbour])
    assert np.allclose(codes.values, middle, atol=1e-12)
    with pytest.raises(InputError, match="count is 16; 6 known codes have 15 pairs"):
        midpoint_codes(known, line, count=16, seed=0)
