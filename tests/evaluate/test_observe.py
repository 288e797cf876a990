from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.dataset.samples import hand_distances
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.observe import (
    DISTANCE_M,
    observe_hand,
    observe_hand_one_view,
    view_hand,
    with_outliers,
    with_pose_error,
)
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.model.infer import infer_grasps, one_view_config
from neuralgrasps.model.reconstruct import hand_surface_distances


def test_the_whole_surface_with_and_without_noise(small_run, small_world) -> None:
    grasps, packed = small_world.grasp_sets[0], small_run.field.packed["allegro"]
    X_OH, q = grasps.X_OH[0], grasps.q[0]
    exact = observe_hand(packed, X_OH, q, seed=0, points=400)
    assert exact.shape == (400, 3)
    assert np.abs(hand_distances(packed, X_OH[None], q[None], exact)).max() < 2e-6
    noisy = observe_hand(packed, X_OH, q, seed=0, points=400, noise_m=0.002)
    assert (noisy - exact).std() == pytest.approx(0.002, rel=0.1)
    np.testing.assert_array_equal(exact, observe_hand(packed, X_OH, q, seed=0, points=400))
    assert not np.array_equal(exact, observe_hand(packed, X_OH, q, seed=1, points=400))


def test_one_view_sees_a_side_of_the_hand(small_run, small_world) -> None:
    hand, ball, packed = small_world.hands["allegro"], small_world.objects["ball"], small_run.field.packed["allegro"]
    grasps = small_world.grasp_sets[1]
    X_OH, q = grasps.X_OH[0], grasps.q[0]
    seen = observe_hand_one_view(hand, ball, X_OH, q, seed=2, noise_m=0.0, points=4000)
    assert 200 <= len(seen) <= 4000
    assert np.abs(hand_distances(packed, X_OH[None], q[None], seen)).max() < 2e-4  # the mesh has flat facets
    whole = observe_hand(packed, X_OH, q, seed=2, points=2000)
    unseen = np.linalg.norm(whole[:, None] - seen[None], axis=2).min(axis=1) > 0.01
    assert 0.1 < unseen.mean() < 0.9
    noisy = observe_hand_one_view(hand, ball, X_OH, q, seed=2, noise_m=0.003, points=4000)
    off = np.linalg.norm(noisy - seen, axis=1)
    assert np.sqrt((off**2).mean()) == pytest.approx(0.003, rel=0.1)
    rays = (noisy - seen)[off > 1e-4] / off[off > 1e-4, None]
    assert np.abs(rays @ rays[0]).min() > np.cos(2 * np.arctan(0.25 / DISTANCE_M))  # all from one eye


def test_a_view_tells_where_its_camera_stood(small_run, small_world) -> None:
    hand, ball, grasps = small_world.hands["allegro"], small_world.objects["ball"], small_world.grasp_sets[1]
    X_OH, q = grasps.X_OH[0], grasps.q[0]
    clear, noisy = (view_hand(hand, ball, X_OH, q, seed=2, noise_m=noise) for noise in (0.0, 0.003))
    np.testing.assert_array_equal(clear.viewpoint_O, noisy.viewpoint_O)
    rays = clear.points_O - clear.viewpoint_O
    assert np.linalg.norm(rays, axis=1).mean() == pytest.approx(DISTANCE_M, rel=0.3)
    off = np.cross(noisy.points_O - clear.points_O, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    assert np.abs(off).max() < 1e-9  # noise lies along the rays from the viewpoint


def test_the_object_is_in_the_way(small_world) -> None:
    """The same views of the same hand: with the ball some of the points are missing, and none is new."""
    hand, grasps = small_world.hands["fetch"], small_world.grasp_sets[3]
    X_OH, q = grasps.X_OH[0], grasps.q[0]
    balls = [replace(small_world.objects["ball"], mesh=sphere_mesh(radius)) for radius in (0.0005, 0.04, 0.5)]
    hidden = 0
    for seed in range(6):
        free, behind = (
            {tuple(p) for p in observe_hand_one_view(hand, ball, X_OH, q, seed=seed, noise_m=0.0, points=10**6)}
            for ball in balls[:2]
        )
        assert behind <= free
        hidden += len(free - behind)
    assert hidden > 1000
    with pytest.raises(InputError, match="hidden"):
        observe_hand_one_view(hand, balls[2], X_OH, q, seed=5)


def test_a_grasp_is_found_from_one_view(small_run, small_world, small_dataset) -> None:
    grasps = small_world.grasp_sets[3]
    test = small_dataset.split("fetch", "ball").test
    hand, ball = small_world.hands["fetch"], small_world.objects["ball"]
    clouds = [observe_hand_one_view(hand, ball, grasps.X_OH[i], grasps.q[i], seed=0) for i in test]
    gallery = small_run.codebook[~small_run.codebook.is_test]
    found = infer_grasps(
        clouds, small_run.field, gallery, hand="fetch", object_name="ball", config=one_view_config(0.001)
    )
    errors = hand_surface_distances(
        small_run.field.packed["fetch"], found.X_OH, found.q, grasps.X_OH[test], grasps.q[test], seed=0
    )
    assert found.converged.all() and errors.mean() < 0.002


def test_faults_are_as_asked_for(small_run, small_world) -> None:
    """Outliers and object points in the share asked for; a pose error moves all points alike."""
    hand, ball, packed = small_world.hands["allegro"], small_world.objects["ball"], small_run.field.packed["allegro"]
    X_OH, q = small_world.grasp_sets[1].X_OH[0], small_world.grasp_sets[1].q[0]
    seen = view_hand(hand, ball, X_OH, q, seed=2, noise_m=0.0, points=1000, spill=0.1).points_O
    off = np.abs(hand_distances(packed, X_OH[None], q[None], seen))[0] > 2e-4
    assert off.sum() == pytest.approx(100, abs=15)
    assert np.abs(np.linalg.norm(seen[off], axis=1) - 0.04).max() < 1e-3  # on the ball
    cloud = observe_hand(packed, X_OH, q, seed=0, points=1000)
    assert (with_outliers(cloud, 0.05, seed=0) != cloud).any(axis=1).sum() == 50
    moved, X = with_pose_error(cloud, 0.005, 0.05, centre_O=np.full(3, 0.01), seed=0)
    np.testing.assert_allclose(moved, cloud @ X[:3, :3].T + X[:3, 3], atol=1e-12)
    assert np.linalg.norm(X[:3, :3] @ np.full(3, 0.01) + X[:3, 3] - 0.01) == pytest.approx(0.005)
    assert np.arccos(0.5 * (np.trace(X[:3, :3]) - 1.0)) == pytest.approx(0.05)
