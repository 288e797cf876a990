from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.evaluate.inference_bench import Condition, observe
from neuralgrasps.evaluate.observe import view_hand, with_outliers
from neuralgrasps.model.infer import (
    InferConfig,
    encode_points,
    gallery_grasps,
    infer_grasps,
    infer_hand,
    one_view_config,
)
from neuralgrasps.model.infer_contacts import encode_contacts
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import hand_surface_distances


def clouds_of(field, grasps, chosen, count: int = 600, noise: float = 0.0) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    packed = field.packed[grasps.hand]
    clouds = [sample_posed_surface(packed, grasps.X_OH[i], grasps.q[i], count, rng) for i in chosen]
    return [cloud + rng.normal(scale=noise, size=cloud.shape) for cloud in clouds]


def gallery_of(run):
    return run.codebook[~run.codebook.is_test]


@pytest.mark.parametrize("pair", [0, 3])
def test_unseen_grasps_are_found_from_points(small_run, small_world, small_dataset, pair: int) -> None:
    grasps = small_world.grasp_sets[pair]
    test = small_dataset.split(grasps.hand, grasps.object).test
    clouds = clouds_of(small_run.field, grasps, test)
    result = infer_grasps(clouds, small_run.field, gallery_of(small_run), hand=grasps.hand, object_name=grasps.object)
    errors = hand_surface_distances(
        small_run.field.packed[grasps.hand], result.X_OH, result.q, grasps.X_OH[test], grasps.q[test], seed=0
    )
    assert all("inside the object" in reason for reasons in result.reasons for reason in reasons)  # as the truth is
    assert errors.mean() < 0.0005
    assert (result.residual_m < 0.0005).all()


def test_the_noise_is_estimated(small_run, small_world) -> None:
    grasps = small_world.grasp_sets[3]
    clouds = clouds_of(small_run.field, grasps, range(3), count=1000, noise=0.002)
    found = infer_grasps(clouds, small_run.field, gallery_of(small_run), hand="fetch", object_name="ball")
    np.testing.assert_allclose(found.noise_m, 0.002, rtol=0.2)
    assert found.converged.all()


def test_inference_repeats_exactly_and_says_when_it_failed(small_run) -> None:
    nonsense = [np.random.default_rng(0).uniform(-0.1, 0.1, (200, 3))]
    config = InferConfig(rounds=2, starts=3, finalists=1)
    a, b = (
        infer_grasps(nonsense, small_run.field, gallery_of(small_run), hand="fetch", object_name="ball", config=config)
        for _ in range(2)
    )
    assert np.array_equal(a.q, b.q) and np.array_equal(a.X_OH, b.X_OH)
    assert a.suspect[0] and a.residual_m[0] > 0.003
    assert any("not explained" in reason for reason in a.reasons[0])


def test_the_cloud_of_another_hand_is_suspected(small_run, small_world) -> None:
    cloud = clouds_of(small_run.field, small_world.grasp_sets[0], [0], noise=0.001)
    config = InferConfig(rounds=2)
    as_itself, as_other = (
        infer_grasps(cloud, small_run.field, gallery_of(small_run), hand=hand, object_name="brick", config=config)
        for hand in ("allegro", "fetch")
    )
    assert not as_itself.suspect[0] and as_other.suspect[0]


def test_wrong_clouds_are_suspected_and_why(small_run, small_world) -> None:
    """A mirrored hand is another hand; half a cloud is no whole one, unless it is said to be one view."""
    cloud = clouds_of(small_run.field, small_world.grasp_sets[1], [0], count=1000, noise=0.001)[0]
    fitted = partial(
        infer_grasps, field=small_run.field, gallery=gallery_of(small_run), hand="allegro", object_name="ball"
    )
    config = InferConfig(rounds=2)
    assert not fitted([cloud], config=config).suspect[0]
    (reasons,) = fitted([cloud * [-1.0, 1.0, 1.0]], config=config).reasons
    assert any("points are" in reason for reason in reasons)
    middle = np.median(cloud[:, 2])
    half = cloud[cloud[:, 2] > middle]
    (reasons,) = fitted([half], config=config).reasons
    assert any("has none" in reason for reason in reasons)
    assert not any("has none" in reason for reason in fitted([half], config=one_view_config(0.001)).reasons[0])


def test_a_camera_says_what_it_should_have_seen(small_run, small_world) -> None:
    """From where the removed half must have been seen, it is missed; from the other side it is not."""
    hand, ball, grasps = small_world.hands["allegro"], small_world.objects["ball"], small_world.grasp_sets[1]
    view = view_hand(hand, ball, grasps.X_OH[0], grasps.q[0], seed=3, noise_m=0.0005, points=2000)
    seen = view.points_O
    across = seen @ np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[2][0]
    clouds = [seen, seen[across > np.quantile(across, 0.4)]]
    found = infer_grasps(
        clouds, small_run.field, gallery_of(small_run), hand="allegro", object_name="ball",
        config=one_view_config(), viewpoints_O=np.tile(view.viewpoint_O, (2, 1)),
    )  # fmt: skip
    assert [any("has none" in reason for reason in reasons) for reasons in found.reasons] == [False, True]


def test_a_cloud_is_fitted_alike_in_any_batch_on_any_threads(small_run, small_world) -> None:
    clouds = clouds_of(small_run.field, small_world.grasp_sets[0], range(3), count=200, noise=0.004)
    config = InferConfig(rounds=2, starts=2, finalists=1, variations=8, points=100, coarse_points=50, good=0.01)

    def fitted(some: list[np.ndarray], threads: int = 1) -> np.ndarray:
        return infer_grasps(
            some, small_run.field, gallery_of(small_run), hand="allegro", object_name="brick", config=config,
            threads=threads,
        ).q  # fmt: skip

    together = fitted(clouds)
    np.testing.assert_array_equal(fitted(clouds[::-1])[::-1], together)
    np.testing.assert_array_equal(np.concatenate([fitted([cloud]) for cloud in clouds]), together)
    np.testing.assert_array_equal(fitted(clouds, threads=2), together)


def test_the_right_hand_is_recognised(small_run, small_world) -> None:
    cloud = clouds_of(small_run.field, small_world.grasp_sets[0], [0], noise=0.0005)[0]
    config = InferConfig(rounds=2, starts=6, finalists=2)
    name, result = infer_hand(cloud, small_run.field, gallery_of(small_run), object_name="brick", config=config)
    assert name == "allegro" and result.q.shape == (1, 16)


def test_contact_block_straight_from_points(small_run, small_world) -> None:
    grasps = small_world.grasp_sets[0]
    dense = clouds_of(small_run.field, grasps, range(4), count=20_000)
    seen = encode_points(dense, small_run.field, object_name="brick")
    known = small_run.field.encode(grasps.X_OH[:4], grasps.q[:4], hand="allegro", object_name="brick")
    outside = known.contact_maps < 0.95  # object points inside the hand are at its surface for the points
    error = np.abs(seen.contact_maps - known.contact_maps)[outside]
    assert error.max() < 0.2 and error.mean() < 0.005  # sampling only
    assert np.isnan(seen.values[:, 96:]).all()


def test_bad_clouds_are_refused(small_run) -> None:
    with pytest.raises(InputError, match="cloud 0 has 3"):
        encode_points([np.zeros((3, 3))], small_run.field, object_name="brick")
    with pytest.raises(InputError, match="at least 1"):
        InferConfig(starts=0)
    with pytest.raises(InputError, match="noise_m"):
        one_view_config(-0.1)
    with pytest.raises(ShapeError, match="viewpoints_O"):
        infer_grasps(
            [np.zeros((20, 3))], small_run.field, gallery_of(small_run), hand="fetch", object_name="ball",
            viewpoints_O=np.zeros((2, 3)),
        )  # fmt: skip


def faulty_observation(small_run, small_world, small_dataset, how: Condition):
    """(field, hand, object, clouds, true X_OH, q) of the gripper's and the hand's unseen grasps on the ball."""
    for grasps in (small_world.grasp_sets[1], small_world.grasp_sets[3]):
        test = small_dataset.split(grasps.hand, grasps.object).test
        some = grasps[np.asarray(test)]
        yield some, observe(small_run.field, some, np.asarray(test), how, 0)[0]


@pytest.mark.parametrize("fault", [{"outliers": 0.05}, {"spill": 0.1}])
def test_outliers_and_a_wide_mask_are_set_aside(small_run, small_world, small_dataset, fault) -> None:
    how = Condition(one_view=True, noise_m=0.001, **fault)
    for grasps, clouds in faulty_observation(small_run, small_world, small_dataset, how):
        found = infer_grasps(
            clouds, small_run.field, gallery_of(small_run), hand=grasps.hand, object_name="ball",
            config=one_view_config(),
        )  # fmt: skip
        errors = hand_surface_distances(
            small_run.field.packed[grasps.hand], found.X_OH, found.q, grasps.X_OH, grasps.q, seed=0
        )
        assert np.median(errors) < 0.0005
        assert not any("rms" in reason or "not explained" in reason for r in found.reasons for reason in r)
        assert (found.noise_m < 0.0015).all() and (found.outliers > 0.02).all() and (found.outliers < 0.12).all()


def test_a_cloud_of_many_outliers_is_suspected(small_run, small_world) -> None:
    cloud = clouds_of(small_run.field, small_world.grasp_sets[3], [0], count=1000, noise=0.001)[0]
    cloud = with_outliers(cloud, 0.32, seed=0)
    found = infer_grasps([cloud], small_run.field, gallery_of(small_run), hand="fetch", object_name="ball")
    assert any("outliers" in reason or "not explained" in reason for reason in found.reasons[0])


def test_a_hand_that_touches_nothing_is_suspected(small_run, small_world) -> None:
    cloud = clouds_of(small_run.field, small_world.grasp_sets[1], [0], count=1000, noise=0.001)[0]
    away = cloud + 0.3 * cloud.mean(axis=0) / np.linalg.norm(cloud.mean(axis=0))
    found = infer_grasps(
        [cloud, away], small_run.field, gallery_of(small_run), hand="allegro", object_name="ball",
        config=InferConfig(rounds=2),
    )  # fmt: skip
    assert [any("touches nothing" in reason for reason in r) for r in found.reasons] == [False, True]


def test_codes_use_the_contact_points_of_the_run(small_run, small_world) -> None:
    """The same object with its points in another order gives the same codes."""
    field, brick = small_run.field, small_world.objects["brick"]
    other = KinematicField(
        hands=field.hands, hand_codecs=field.hand_codecs, object_codecs=field.object_codecs,
        objects={**field.objects, "brick": replace(brick, points_O=brick.points_O[::-1].copy())},
    )  # fmt: skip
    clouds = clouds_of(field, small_world.grasp_sets[0], range(2))
    a, b = (encode_points(clouds, f, object_name="brick") for f in (field, other))
    np.testing.assert_array_equal(a.values, b.values)
    a, b = (
        encode_contacts(clouds, f, gallery_of(small_run), hand="allegro", object_name="brick", refine=False).codes
        for f in (field, other)
    )
    np.testing.assert_array_equal(a.values, b.values)


def test_test_grasps_are_no_start_unless_asked_for(small_run) -> None:
    book = small_run.codebook
    fitted = partial(gallery_grasps, small_run.field, book, hand="fetch", object_name="ball")
    every, tests = (book.where(hand="fetch", object_name="ball", is_test=t).sum() for t in (None, True))
    assert tests > 0 and len(fitted()) == every - tests and len(fitted(include_test=True)) == every
    with pytest.raises(InputError, match="include_test"):
        gallery_grasps(small_run.field, book[book.is_test], hand="fetch", object_name="ball")
    with pytest.raises(InputError, match="include_test"):
        encode_contacts([np.zeros((1, 3))], small_run.field, book[book.is_test], hand="fetch", object_name="ball")


def test_a_hand_whose_codes_are_lossy_is_fitted(small_run, small_world, small_dataset) -> None:
    """Codes that keep 4 of 16 synergies start the search off the known grasps; the fit finds all joints."""
    field, grasps = small_run.field, small_world.grasp_sets[1]
    codec = field.hand_codecs["allegro"]
    basis = codec.basis.copy()
    basis[:, 4:] = 0.0
    lossy = KinematicField(
        hands={"allegro": field.hands["allegro"]}, objects=field.objects, object_codecs=field.object_codecs,
        hand_codecs={"allegro": replace(codec, basis=basis)},
    )  # fmt: skip
    split = small_dataset.split("allegro", "ball")
    X, q = grasps.X_OH[split.train], grasps.q[split.train]
    gallery = lossy.encode(X, q, hand="allegro", object_name="ball")
    start = gallery_grasps(lossy, gallery, hand="allegro", object_name="ball")
    assert np.abs(start.q - q).mean() > 0.05
    clouds = clouds_of(field, grasps, split.test, noise=0.001)
    found = infer_grasps(clouds, lossy, gallery, hand="allegro", object_name="ball")
    errors = hand_surface_distances(
        field.packed["allegro"], found.X_OH, found.q, grasps.X_OH[split.test], grasps.q[split.test], seed=0
    )
    assert errors.mean() < 0.001


def test_free_codes_and_no_clouds_are_refused(small_run) -> None:
    free = replace(gallery_of(small_run), metric_size=128)
    with pytest.raises(InputError, match="KinematicField"):
        infer_grasps([np.zeros((20, 3))], small_run.field, free, hand="fetch", object_name="ball")
    with pytest.raises(InputError, match="KinematicField"):
        encode_contacts([np.zeros((2, 3))], small_run.field, free, hand="fetch", object_name="ball")
    for call in (
        lambda: infer_grasps([], small_run.field, gallery_of(small_run), hand="fetch", object_name="ball"),
        lambda: encode_points([], small_run.field, object_name="ball"),
        lambda: encode_contacts([], small_run.field, gallery_of(small_run), hand="fetch", object_name="ball"),
    ):
        with pytest.raises(InputError, match="at least one"):
            call()
