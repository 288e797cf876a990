import numpy as np
import pytest

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.samples import (
    ball_points,
    contact_maps,
    hand_distances,
    normalisation_of,
    sample_scenes,
)
from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.hands.zoo import load_hand


@pytest.fixture(scope="module")
def packed() -> PackedHand:
    return pack_hand(load_hand("allegro"), spacing=0.009)


def samples_of(small_world, packed: PackedHand, which=slice(0, 3)):
    grasps, brick = small_world.grasp_sets[0], small_world.objects["brick"]
    return grasps, brick, sample_scenes(
        brick.mesh, packed, grasps.X_OH[which], grasps.q[which], hand="allegro", object_name="brick",
        normalisation=normalisation_of(brick.points_O), config=small_world.config,
    )  # fmt: skip


def test_normalisation_puts_the_object_in_a_third_of_the_ball(small_world) -> None:
    for obj in small_world.objects.values():
        frame = normalisation_of(obj.points_O)
        unit = frame.to_unit(obj.points_O)
        assert np.linalg.norm(unit, axis=1).max() == pytest.approx(1 / 3)
        assert np.allclose(unit.mean(axis=0), 0, atol=1e-12)
        assert np.allclose(frame.to_object(unit), obj.points_O)


def test_distances_are_exact_at_the_stored_points(small_world, packed: PackedHand) -> None:
    grasps, brick, samples = samples_of(small_world, packed)
    for i in range(len(samples)):
        points = samples.points_O[i].astype(np.float64)
        assert np.allclose(samples.sdf_object[i], signed_distance(brick.mesh, points), rtol=0, atol=1e-7)
        assert np.allclose(
            samples.sdf_hand[i], hand_distances(packed, grasps.X_OH[i : i + 1], grasps.q[i : i + 1], points)[0],
            rtol=0, atol=1e-7,
        )  # fmt: skip


def test_queries_lie_where_the_method_says(small_world, packed: PackedHand) -> None:
    _, brick, samples = samples_of(small_world, packed)
    scale, half = normalisation_of(brick.points_O).scale_m, small_world.config.queries_per_scene // 2
    near = round(half * small_world.config.surface_share)
    for sdf, first in ((samples.sdf_object, 0), (samples.sdf_hand, half)):
        unit = np.abs(sdf[:, first : first + near]) / scale
        assert np.quantile(unit[:, 1::2], 0.99) < 4 * small_world.config.noise_narrow
        assert 0.3 * small_world.config.noise_wide < unit[:, 0::2].mean() < 1.1 * small_world.config.noise_wide
    rest = normalisation_of(brick.points_O).to_unit(samples.points_O[:, near:half])
    assert np.linalg.norm(rest, axis=2).max() <= 1 + 1e-6


def test_a_scene_does_not_depend_on_its_neighbours(small_world, packed: PackedHand) -> None:
    _, _, together = samples_of(small_world, packed)
    _, _, alone = samples_of(small_world, packed, slice(2, 3))
    assert np.array_equal(together.points_O[2], alone.points_O[0])
    assert np.array_equal(together.sdf_hand[2], alone.sdf_hand[0])


@pytest.mark.parametrize("name", ["fetch", "barrett", "human"])
def test_hand_surface_points_are_on_the_outside_and_even(name: str) -> None:
    hand = load_hand(name)
    packed = pack_hand(hand, spacing=0.009)
    X_OH = np.eye(4)
    points = sample_posed_surface(packed, X_OH, hand.q_open, 4000, np.random.default_rng(0))
    distance = hand_distances(packed, X_OH[None], hand.q_open[None], points)[0]
    assert np.abs(distance).max() < 2e-6
    # Two halves of the draw have the same mean position: no part is favoured.
    assert np.linalg.norm(points[:2000].mean(axis=0) - points[2000:].mean(axis=0)) < 0.008


def test_ball_points_are_uniform() -> None:
    radius = np.linalg.norm(ball_points(20_000, np.random.default_rng(0)), axis=1)
    assert radius.max() <= 1
    assert (radius < 0.5).mean() == pytest.approx(0.125, abs=0.01)


def test_contact_map_is_one_in_contact_and_decays(small_world, packed: PackedHand) -> None:
    grasps, brick, _ = samples_of(small_world, packed)
    maps = contact_maps(packed, grasps.X_OH, grasps.q, brick.points_O, radius_m=0.01)
    distance = hand_distances(packed, grasps.X_OH, grasps.q, brick.points_O)
    assert np.allclose(maps, np.exp(-np.maximum(distance, 0) / 0.01), atol=1e-6)
    inside = sample_posed_surface(packed, grasps.X_OH[0], grasps.q[0], 50, np.random.default_rng(0))
    assert np.allclose(contact_maps(packed, grasps.X_OH[:1], grasps.q[:1], inside, radius_m=0.01), 1, atol=1e-3)
