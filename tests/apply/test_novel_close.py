import numpy as np
import pytest

from neuralgrasps.apply.novel_align import turn_flush
from neuralgrasps.apply.novel_close import best_variation, free_and_close, free_hands, vary
from neuralgrasps.apply.novel_trial import novel_problem
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.synthesis.candidates import VALID
from neuralgrasps.synthesis.settle import TOLERANCE_M
from tests.apply.conftest import BoxWorld


def turned(X_OH: np.ndarray, about_O: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """A pose turned about a point of the object frame."""
    R, X = axis_angle_matrix(axis, angle), X_OH.copy()
    X[:3, :3], X[:3, 3] = R @ X_OH[:3, :3], R @ (X_OH[:3, 3] - about_O) + about_O
    return X


def test_hands_that_do_not_overlap_are_not_changed(box_world: BoxWorld) -> None:
    problem = novel_problem(box_world.hand, box_world.obj, "dexgraspbench")
    X_OH, q, left = free_hands(problem, box_world.grasps.X_OH, box_world.grasps.q)
    assert np.array_equal(X_OH, box_world.grasps.X_OH) and np.array_equal(q, box_world.grasps.q)
    assert (left <= TOLERANCE_M).all()


@pytest.mark.parametrize("name", ["panda", "allegro"])
def test_overlap_is_opened_and_drawn_back(name: str, box_world: BoxWorld) -> None:
    hand = load_hand(name)
    problem = novel_problem(hand, box_world.obj, "dexgraspbench")
    rng = np.random.default_rng(0)
    X_OP = np.tile(np.eye(4), (6, 1, 1))
    X_OP[:, :3, :3] = axis_angle_matrix(rng.normal(size=(6, 3)), rng.uniform(0, 3, 6))
    X_OP[:, :3, 3] = -0.03 * X_OP[:, :3, 2]  # the box is in the palm
    X_OH, q, left = free_hands(problem, X_OP @ np.linalg.inv(hand.X_HP), np.tile(hand.q_open, (6, 1)))
    assert (left <= TOLERANCE_M).mean() > 0.6
    back = np.einsum("ni,ni->n", (X_OH @ hand.X_HP)[:, :3, 3] - X_OP[:, :3, 3], X_OP[:, :3, 2])
    assert back.min() < -0.003 and (q >= hand.tree.lower).all() and (q <= hand.tree.upper).all()


def test_known_grasps_close_to_themselves(box_world: BoxWorld) -> None:
    problem = novel_problem(box_world.hand, box_world.obj, "dexgraspbench")
    closed, _ = free_and_close(problem, box_world.grasps.X_OH, box_world.grasps.q)
    assert (closed.outcome == VALID).all()
    assert np.abs(closed.X_OH - box_world.grasps.X_OH).max() < 1e-3
    assert np.abs(closed.q - box_world.grasps.q).max() < 1e-3


def test_a_tilted_jaw_is_turned_flush(box_world: BoxWorld) -> None:
    problem = novel_problem(box_world.hand, box_world.obj, "dexgraspbench")
    tilts = np.empty((8, 2))
    for i in range(8):
        X_OH, q = box_world.grasps.X_OH[i], box_world.grasps.q[i]
        X_OP = X_OH @ box_world.hand.X_HP
        normal = np.eye(3)[np.abs(X_OP[:3, 0]).argmax()]  # the box's face it presses on
        tilted = turned(X_OH, box_world.grasps.contact_points_O[i, 0], X_OP[:3, 1], 0.1)
        closed, _ = free_and_close(problem, tilted[None], q[None])
        flush = turn_flush(problem, closed.X_OH[0], closed.q[0])
        assert np.allclose(flush[:3, :3].T @ flush[:3, :3], np.eye(3), atol=1e-12)
        for k, X in enumerate((closed.X_OH[0], flush)):
            tilts[i, k] = np.arccos(np.abs((X @ box_world.hand.X_HP)[:3, 0] @ normal))
    assert np.median(tilts[:, 0]) > 0.1
    assert tilts[:, 1].max() < 0.06 and np.median(tilts[:, 1]) < 0.03


def test_variations_are_about_the_palm_and_within_the_limits(box_world: BoxWorld) -> None:
    hand, X_OH = box_world.hand, box_world.grasps.X_OH[0]
    X, q = vary(hand, X_OH, hand.tree.upper, scale=1.0, rng=np.random.default_rng(0), count=500)
    shift = (X @ hand.X_HP)[:, :3, 3] - (X_OH @ hand.X_HP)[:3, 3]
    assert np.allclose(shift.std(axis=0), 0.006, rtol=0.1)
    assert (q <= hand.tree.upper).all() and (q >= hand.tree.lower).all()


def test_search_stops_where_a_hand_closes_well_and_helps_where_not(box_world: BoxWorld) -> None:
    problem = novel_problem(box_world.hand, box_world.obj, "dexgraspbench")
    X_OH, q = box_world.grasps.X_OH[0], box_world.grasps.q[0]
    plain, _ = best_variation(problem, X_OH, q, search=0, enough=0.0, rng=np.random.default_rng(0))
    kept, _ = best_variation(problem, X_OH, q, search=16, enough=0.5 * plain.epsilon[0], rng=np.random.default_rng(0))
    assert np.array_equal(kept.X_OH, plain.X_OH)
    tilted = turned(X_OH, box_world.grasps.contact_points_O[0, 0], np.array([0.3, 0.5, 0.8]), 0.2)
    poor, _ = best_variation(problem, tilted, q, search=0, enough=0.0, rng=np.random.default_rng(0))
    better, _ = best_variation(problem, tilted, q, search=24, enough=1.0, rng=np.random.default_rng(0))
    assert better.epsilon[0] > 1.2 * poor.epsilon[0]
