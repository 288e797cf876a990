from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.samples import hand_distances
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.hands.least_squares import moved_pose
from neuralgrasps.model.fit_config import InferConfig
from neuralgrasps.model.fit_kernels import fit_cost, fit_gradient
from neuralgrasps.model.fit_prior import grasp_prior, posed_points
from neuralgrasps.model.fit_search import CloudSearch
from neuralgrasps.model.fit_solver import fit_hand, score_starts


@pytest.fixture(scope="module", params=["allegro", "fetch"])
def case(request, small_run, small_world):
    """(packed hand, search of a cloud of its first grasp on the ball, X_OH, q)."""
    grasps = next(g for g in small_world.grasp_sets if (g.hand, g.object) == (request.param, "ball"))
    packed, sdf = small_run.field.packed[request.param], small_world.objects["ball"].sdf
    X, q = np.array(grasps.X_OH[0]), np.array(grasps.q[0])
    cloud = sample_posed_surface(packed, X, q, 500, np.random.default_rng(0))
    prior = grasp_prior(packed, sdf, grasps.X_OH, grasps.q)
    prior = replace(prior, touch_sd=np.full_like(prior.touch_sd, 0.001))
    search = CloudSearch(packed, sdf, prior, cloud, config=InferConfig(noise_m=0.001), rng=np.random.default_rng(0))
    return packed, search, X, q


def off(packed, X, q, size: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    out = X.copy()
    moved_pose(X, size * rng.normal(size=6), out)
    span = packed.upper - packed.lower
    return out, np.clip(q + size * span * rng.normal(size=q.shape), packed.lower + 1e-4, packed.upper - 1e-4)


@pytest.mark.parametrize("term", ["points", "coverage", "object", "posture"])
def test_gradient_is_that_of_the_cost(case, term: str) -> None:
    packed, search, X, q = case
    problem = search.problem(search.even[:64], search.object_even_m[:64], 0.01, 1.0 if term == "coverage" else 0.0)
    if term not in ("points", "coverage"):
        problem = problem._replace(
            points_O=problem.points_O[:1] + 10.0, object_weight=np.zeros(1), width=1e-9
        )  # too far to matter
    if term != "object":
        problem = problem._replace(touch_weight=0.0 * problem.touch_weight, depth_weight=0.0)
    if term == "object":
        X = X.copy()
        X[:3, 3] *= 0.7  # into the ball
    if term != "posture":
        problem = problem._replace(q_unit=0.0)
    X, q = off(packed, X, q, 0.02)
    got, step = fit_gradient(packed, problem, X, q), 1e-7
    expected = np.empty_like(got)
    for i, e in enumerate(np.eye(len(got))):
        costs = []
        for sign in (1.0, -1.0):
            moved = X.copy()
            moved_pose(X, sign * step * e, moved)
            costs.append(fit_cost(packed, problem, moved, q + sign * step * e[6:]))
        expected[i] = (costs[0] - costs[1]) / (2 * step)
    assert np.abs(expected).max() > 1e-7
    np.testing.assert_allclose(got, expected, atol=2e-3 * np.abs(expected).max())


def test_cost_of_points_is_the_mean_squared_distance(case) -> None:
    packed, search, X, q = case
    problem = search.problem(search.cloud, search.object_m, 1.0, 0.0)._replace(q_unit=0.0, depth_weight=0.0)
    X, q = off(packed, X, q, 0.02)
    expected = (hand_distances(packed, X[None], q[None], search.cloud)[0] ** 2).mean()
    assert fit_cost(packed, problem, X, q) == pytest.approx(expected, rel=1e-9)
    out = np.empty(1)
    score_starts(packed, problem, X[None], q[None], out)
    assert out[0] == pytest.approx(expected, rel=1e-9)


def test_a_clean_cloud_gives_the_pose_back(case) -> None:
    packed, search, X, q = case
    problem = search.problem(search.cloud, search.object_m, 0.01, 0.0)._replace(q_unit=0.0, depth_weight=0.0)
    X_found, q_found = off(packed, X, q, 0.02)
    before = fit_cost(packed, problem, X_found, q_found)
    cost, _, stopped = fit_hand(packed, problem, X_found, q_found, 80)
    assert stopped and cost < 1e-4 * before
    assert np.abs(X_found - X).max() < 1e-3
    assert np.linalg.norm(X_found[:3, :3] @ X_found[:3, :3].T - np.eye(3)) < 1e-9
    assert (q_found >= packed.lower).all() and (q_found <= packed.upper).all()


def test_the_hand_is_kept_out_of_the_object_where_nothing_is_seen(case) -> None:
    """One point only: the object terms decide the rest."""
    packed, search, X, q = case
    if len(q) == 1:
        pytest.skip("a gripper with one joint stays where it is: touching outweighs its depth")
    deep = X.copy()
    hand = posed_points(packed, deep, q, search.prior.probe)
    deep[:3, 3] -= 0.7 * hand.mean(axis=0) + 0.3 * hand[np.linalg.norm(hand, axis=1).argmin()]  # around the ball
    problem = search.problem(search.cloud[:1], search.object_m[:1], 0.01, 0.0)

    def depth(q: np.ndarray) -> float:
        return -float(query_grid_numpy(search.sdf, posed_points(packed, deep, q, search.prior.probe)).min())

    moved = q.copy()
    assert depth(q) > 0.008
    fit_hand(packed, problem, deep, moved, 60)
    assert depth(moved) < 0.004
