"""The compiled steps of a transfer against plain references."""

import numpy as np
import pytest

from neuralgrasps.apply.transfer_descent import descend, evaluate_descent, map_problem, new_descent
from neuralgrasps.apply.transfer_kernels import FAR, Sturdy, map_differences, margins, search_starts, weakness
from neuralgrasps.apply.transfer_pair import known_maps, target_of, transfer_pair
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.apply.transfer_search import SearchConfig, rank_known, search
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.epsilon import epsilon
from neuralgrasps.grasps.force_qp import contact_forces
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.hands.least_squares import moved_pose
from neuralgrasps.seeds import child_rng
from neuralgrasps.synthesis.candidates import CONE_EDGES, VALID
from tests.apply.conftest import BoxWorld


@pytest.fixture(scope="module")
def asked(box_world: BoxWorld):
    pair = transfer_pair(box_world.hand, box_world.obj, "dexgraspbench")
    query = query_from_grasp(box_world.hand, box_world.obj, box_world.grasps.X_OH[0], box_world.grasps.q[0])
    return pair, query, target_of(query), target_of(query, pair.sparse)


def moved(X_OH: np.ndarray, shift_m: float, turn_rad: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    way, axis = rng.standard_normal(3), rng.standard_normal(3)
    X = X_OH.copy()
    X[:3, :3] = axis_angle_matrix(axis / np.linalg.norm(axis), turn_rad) @ X[:3, :3]
    X[:3, 3] += shift_m * way / np.linalg.norm(way)
    return X


def test_differences_of_maps_are_those_of_the_maps(box_world: BoxWorld, asked) -> None:
    pair, query, full, _ = asked
    known = known_maps(pair, box_world.grasps, query.radius_m)
    fast = map_differences(pair.problem.packed, full, box_world.grasps.X_OH, box_world.grasps.q)
    assert np.allclose(fast, np.abs(known.maps - query.contact_map).mean(axis=1), atol=1e-6)
    apart = np.abs(known.maps[:, None] - known.maps[None]).mean(axis=2)
    assert known.widest == pytest.approx(float(apart.max()), abs=1e-6)


def test_the_descent_knows_its_gradient(box_world: BoxWorld, asked) -> None:
    pair, _, _, sparse = asked
    problem = map_problem(box_world.hand, box_world.obj, sparse)
    X, q = moved(box_world.grasps.X_OH[0], 0.006, 0.1, seed=3), box_world.grasps.q[0] + 0.001
    size = 6 + len(q)

    def cost(X_OH: np.ndarray, joints: np.ndarray) -> tuple[float, np.ndarray]:
        b, work, start = np.empty(size), new_descent(pair.probes, problem), box_world.grasps.q[0]
        total = evaluate_descent(pair.probes, problem, X_OH, joints, start, work, np.empty((size, size)), b)
        return total, 2.0 * b

    _, gradient = cost(X, q)
    h = 1e-7
    for i in range(size):
        values = []
        for sign in (1.0, -1.0):
            step, X_new = np.zeros(6), X.copy()
            joints = q.copy()
            if i < 6:
                step[i] = sign * h
                moved_pose(X, step, X_new)
            else:
                joints[i - 6] += sign * h
            values.append(cost(X_new, joints)[0])
        slope = (values[0] - values[1]) / (2.0 * h)
        assert gradient[i] == pytest.approx(slope, rel=0.03, abs=0.03 * np.abs(gradient[:6]).max())


def test_the_descent_finds_back_to_the_map_it_is_asked_for(box_world: BoxWorld, asked) -> None:
    pair, _, full, sparse = asked
    X = np.stack([moved(box_world.grasps.X_OH[0], 0.01, 0.2, seed) for seed in range(6)])
    q = np.repeat(box_world.grasps.q[:1], 6, axis=0)
    before = map_differences(pair.problem.packed, full, X, q)
    problem = map_problem(box_world.hand, box_world.obj, sparse)
    descend(pair.probes, problem, X, q, 15, np.empty(6))
    after = map_differences(pair.problem.packed, full, X, q)
    assert (after < before).all() and np.median(after) < 0.35 * np.median(before)
    assert np.allclose(X[:, :3, :3] @ X[:, :3, :3].transpose(0, 2, 1), np.eye(3), atol=1e-9)


def test_starts_that_close_farther_than_the_limit_are_not_judged(box_world: BoxWorld, asked) -> None:
    pair, _, _, sparse = asked
    difference, weak, outcome = np.empty(8), np.empty(8), np.empty(8, np.int8)
    limit, sturdy = np.inf, Sturdy(pair.slippery, 0.05, 0.0, 0.0)
    for _ in range(2):
        X, q = box_world.grasps.X_OH.copy(), box_world.grasps.q.copy()
        search_starts(
            pair.searching.arrays, sparse, pair.hands, sturdy, np.full(1, limit), False, X, q, difference, weak, outcome
        )  # fmt: skip
        assert outcome[0] == VALID and difference[0] < 0.02
        far = difference >= limit
        limit = float(np.median(difference))
        assert ((outcome == FAR) == far).all()
    assert far.sum() == 4  # of the second round; some lie less than twice the limit away
    assert (difference[far] < 1.9 * difference[~far].max()).any()


def test_known_grasps_are_ranked_by_their_maps(box_world: BoxWorld, asked) -> None:
    pair, query, full, _ = asked
    known = known_maps(pair, box_world.grasps, query.radius_m)
    ranked = rank_known(
        pair, query, full, known, count=5, turn=True, allows=lambda _, rows: rows != 0
    )  # fmt: skip
    by_hand = np.abs(known.maps - query.contact_map).mean(axis=1)
    assert 0 not in ranked.row and len(ranked.row) == 5
    assert np.allclose(ranked.difference, by_hand[ranked.row], atol=1e-6)
    assert (np.diff(ranked.difference) >= 0).all() and ranked.row[0] == 1 + by_hand[1:].argmin()


def test_a_search_starts_anywhere_and_obeys_its_rules(box_world: BoxWorld, asked) -> None:
    pair, _, _, sparse = asked
    X, q = box_world.grasps.X_OH[4:7], box_world.grasps.q[4:7]
    sturdy = Sturdy(pair.slippery, 0.05, 0.0, 0.02)

    def found(config: SearchConfig, rule) -> np.ndarray:
        return search(
            pair, sparse, X, q, config=config, sturdy=sturdy, allows=rule, keep=10, rng=child_rng(0, "test")
        ).difference  # fmt: skip

    def everything(X_OH: np.ndarray, joints: np.ndarray) -> np.ndarray:
        return np.ones(len(joints), bool)

    short, long = (found(SearchConfig(generations=g), everything) for g in (0, 2))
    start = map_differences(pair.problem.packed, sparse, X, q)
    assert long.min() <= short.min() < start.min()
    assert (np.diff(long) >= 0).all()
    assert np.array_equal(found(SearchConfig(closed=16), None)[:10], long[:10])  # none of the best is dropped
    assert len(found(SearchConfig(), lambda X_OH, joints: np.zeros(len(joints), bool))) == 0


def test_settings_without_sense_are_refused() -> None:
    for wrong in ({"starts": 0}, {"children": 0}, {"shift_m": -1.0}, {"shrink": float("nan")}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            SearchConfig(**wrong)


def test_margins_are_epsilon_or_what_is_left_unbalanced(box_world: BoxWorld, asked) -> None:
    pair, grasps = asked[0], box_world.grasps
    cone = pair.slippery
    found = margins(cone, grasps.contact_points_O, grasps.contact_normals_O, grasps.contact_links)
    alone = grasps.contact_links.copy()
    alone[:, 1:] = -1  # one contact squeezes nothing
    slips = margins(cone, grasps.contact_points_O, grasps.contact_normals_O, alone)
    for i in range(len(grasps)):
        count = int((grasps.contact_links[i] >= 0).sum())
        points, normals = grasps.contact_points_O[i, :count], grasps.contact_normals_O[i, :count]
        friction = cone.friction, CONE_EDGES, cone.torsion, cone.length
        assert found[i] == pytest.approx(epsilon(grasp_wrenches(points, normals, cone.com, *friction)), abs=1e-9)
        left = contact_forces(points[:1], normals[:1], cone.com, *friction).residual
        assert slips[i] == pytest.approx(-left, abs=1e-9) and slips[i] < -0.5 < 0.0 < found[i]
    sturdy = Sturdy(cone, usual=0.1, give=0.02, least_epsilon=0.0)
    worth = [weakness(sturdy, margin) for margin in (0.2, 0.1, 0.05, 0.0, -1.0)]
    assert worth == pytest.approx([0.0, 0.0, 0.01, 0.02, 0.04])
