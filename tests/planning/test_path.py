"""Joint paths: mazes in the plane and an arm of spheres, against dense checks that are written here."""

from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.planning.path import PathConfig, PathResult, plan_path
from neuralgrasps.planning.path_shape import round_corners, shorten
from neuralgrasps.planning.timing import time_path, timed_is_free


def _limits(lower: np.ndarray, upper: np.ndarray, velocity: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(lower=lower, upper=upper, velocity=velocity, continuous=np.zeros(len(lower), bool))


@dataclass
class Disc:
    """A disc of radius 0.05 in a room of 2 x 2 with boxes (centre x, y, half x, y)."""

    boxes: np.ndarray
    radius: float = 0.05
    manipulator: SimpleNamespace = field(
        default_factory=lambda: _limits(np.zeros(2), np.full(2, 2.0), np.array([1.0, 0.5]))
    )

    def gap(self, q: np.ndarray) -> np.ndarray:
        away = np.maximum(np.abs(q[:, None] - self.boxes[:, :2]) - self.boxes[:, 2:], 0.0)
        return np.linalg.norm(away, axis=-1).min(axis=1) - self.radius

    def is_free(self, q: np.ndarray) -> np.ndarray:
        return self.gap(q) > 0.0

    def edge_is_free(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        return bool(self.is_free(_line(q0, q1, 0.01)).all())

    def describe(self, q: np.ndarray) -> str:
        gap = self.gap(q[None])[0]
        return f"disc touches a box by {-1e3 * gap:.0f} mm" if gap <= 0 else ""


class SphereArm:
    """Seven joints that turn by turns about z and y, a sphere at each link's end, a shelf to reach past."""

    def __init__(self) -> None:
        self.manipulator = _limits(np.full(7, -2.6), np.full(7, 2.6), np.array([1.2, 1.2, 1.5, 1.5, 1.5, 2.2, 2.2]))
        self.shelf, self.half = np.array([0.55, 0.0, 0.45]), np.array([0.25, 0.4, 0.02])

    def centres(self, q: np.ndarray) -> np.ndarray:
        R, p, centres = (
            np.broadcast_to(np.eye(3), (len(q), 3, 3)),
            np.array([0.0, 0.0, 0.3]) + np.zeros((len(q), 3)),
            [],
        )
        for k in range(7):
            c, s, zero, one = np.cos(q[:, k]), np.sin(q[:, k]), np.zeros(len(q)), np.ones(len(q))
            turn = (
                [[c, -s, zero], [s, c, zero], [zero, zero, one]]
                if k % 2 == 0
                else [[c, zero, s], [zero, one, zero], [-s, zero, c]]
            )
            R = R @ np.moveaxis(np.array(turn), -1, 0)
            p = p + R[:, :, 2] * 0.15
            centres.append(p)
        return np.stack(centres, axis=1)

    def is_free(self, q: np.ndarray) -> np.ndarray:
        centres = self.centres(np.atleast_2d(q))
        away = np.linalg.norm(np.maximum(np.abs(centres - self.shelf) - self.half, 0.0), axis=-1)
        return (away.min(axis=1) > 0.06) & (centres[..., 2].min(axis=1) > 0.06)

    def edge_is_free(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        return bool(self.is_free(_line(q0, q1, 0.02)).all())

    def describe(self, q: np.ndarray) -> str:
        return "" if self.is_free(q)[0] else "arm touches the shelf"


def _line(q0: np.ndarray, q1: np.ndarray, step: float) -> np.ndarray:
    count = int(np.ceil(np.abs(q1 - q0).max() / step)) + 1
    return q0 + np.linspace(0.0, 1.0, max(count, 2))[:, None] * (q1 - q0)


def _dense(q: np.ndarray, step: float) -> np.ndarray:
    return np.concatenate([_line(a, b, step) for a, b in pairwise(q)])


def _length(q: np.ndarray, velocity: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(q, axis=0) / velocity, axis=1).sum())


SLIT = Disc(np.array([[1.0, 0.45, 0.05, 0.45], [1.0, 1.52, 0.05, 0.48]]))  # 140 mm high, the disc 100 mm
CLOSED = Disc(np.array([[1.0, 1.0, 0.05, 1.0]]))
START, GOAL = np.array([0.2, 0.3]), np.array([1.8, 0.3])


@pytest.mark.parametrize("seed", range(6))
def test_the_way_through_a_slit_is_found_and_free(seed: int) -> None:
    path = plan_path(SLIT, START, GOAL, seed=seed)
    assert path.solved and path.reason == "" and path.goal == 0 and not path.straight
    assert (path.q[0] == START).all() and (path.q[-1] == GOAL).all()
    assert SLIT.gap(_dense(path.q, 0.001)).min() > -1e-3  # edges are checked each 10 mm
    # not far above the shortest, which turns at both ends of the slit
    shortest = np.array([START, [0.9, 0.96], [1.1, 0.96], GOAL])
    assert _length(path.q, SLIT.manipulator.velocity) < 1.15 * _length(shortest, SLIT.manipulator.velocity)


@pytest.mark.parametrize("seed", range(8))
def test_an_arm_moves_from_below_a_shelf_to_above_it(seed: int) -> None:
    arm = SphereArm()
    rng = np.random.default_rng(seed)
    q = rng.uniform(arm.manipulator.lower, arm.manipulator.upper, (4000, 7))
    q = q[arm.is_free(q)]
    hand = arm.centres(q)[:, -1]
    near = np.linalg.norm(hand[:, :2] - arm.shelf[:2], axis=1) < 0.3
    start, goals = q[near & (hand[:, 2] < 0.38)][0], q[near & (hand[:, 2] > 0.55)][:3]
    path = plan_path(arm, start, goals, seed=seed)
    assert path.solved, path.reason
    assert (path.q[-1] == goals[path.goal]).all()
    assert arm.is_free(_dense(path.q, 0.02)).all()
    names = tuple(f"joint_{k}" for k in range(7))
    motion = time_path(path.q, joint_names=names, velocity=arm.manipulator.velocity, acceleration=np.full(7, 3.0))
    assert timed_is_free(arm, motion, step=0.05)


def test_no_way_is_said_within_the_number_of_edges() -> None:
    path = plan_path(CLOSED, START, GOAL, config=PathConfig(max_checks=300))
    assert not path.solved and path.goal == -1
    assert path.checks < 400
    assert "300 edges" in path.reason
    assert (path.q == START[None]).all()


def test_a_detour_spares_the_search() -> None:
    low = Disc(np.array([[1.0, 0.3, 0.1, 0.3]]))
    by_detour = plan_path(low, START, GOAL, config=PathConfig(max_checks=1), seed=0)
    assert by_detour.solved and low.gap(_dense(by_detour.q, 0.001)).min() > -1e-3
    assert not plan_path(low, START, GOAL, config=PathConfig(max_checks=1, detours=0), seed=0).solved


def test_a_time_limit_ends_the_search_too() -> None:
    path = plan_path(CLOSED, START, GOAL, config=PathConfig(max_checks=10**9, time_limit_s=0.05))
    assert not path.solved and "0.05 s" in path.reason


def _same(a: PathResult, b: PathResult) -> bool:
    return a.q.shape == b.q.shape and bool((a.q == b.q).all()) and a.checks == b.checks


def test_a_path_depends_on_its_seed_alone() -> None:
    first = {seed: plan_path(SLIT, START, GOAL, seed=seed) for seed in range(5)}
    again = {seed: plan_path(SLIT, START, GOAL, seed=seed) for seed in (3, 1, 3, 4, 0, 2)}
    assert all(_same(first[seed], again[seed]) for seed in first)
    assert not _same(first[0], first[1])


def test_of_several_goals_the_nearest_that_a_line_reaches_is_taken() -> None:
    goals = np.array([GOAL, [0.3, 1.9], [0.8, 0.3], [1.0, 0.3]])
    path = plan_path(SLIT, START, goals)
    assert path.goal == 2 and path.straight and path.checks == 1
    assert (path.q == np.stack([START, goals[2]])).all()
    # none by a line: whichever the search reaches, among them all
    path = plan_path(SLIT, START, goals[[3, 0]])
    assert path.solved and path.goal == 1 and (path.q[-1] == GOAL).all()


def test_near_is_what_takes_little_time() -> None:
    goals = np.array([[0.2, 0.8], [0.8, 0.3]])  # 0.5 and 0.6 away, 1.0 s and 0.6 s
    assert plan_path(SLIT, START, goals).goal == 1


def test_a_start_or_goal_in_collision_is_said_and_nothing_moves() -> None:
    inside = np.array([1.0, 0.3])
    path = plan_path(SLIT, inside, GOAL)
    assert not path.solved and "start" in path.reason and "disc touches a box by 50 mm" in path.reason
    assert path.q.shape == (1, 2)
    path = plan_path(SLIT, START, np.stack([inside, inside]))
    assert not path.solved and "all 2 goals" in path.reason and "50 mm" in path.reason


def test_a_start_that_is_the_goal_is_a_path() -> None:
    path = plan_path(SLIT, START, START)
    assert path.solved and (path.q == START).all()


def test_joints_without_end_are_searched_over_one_turn_about_the_ends() -> None:
    seen = []

    class Watched(Disc):
        def edge_is_free(self, q0: np.ndarray, q1: np.ndarray) -> bool:
            seen.extend([q0, q1])
            return super().edge_is_free(q0, q1)

    limits = _limits(np.full(2, -6.28), np.full(2, 6.28), np.ones(2))
    limits.continuous[0] = True
    wall = np.array([[1.0, 1.0, 0.05, 9.0]])
    plan_path(Watched(wall, manipulator=limits), START, GOAL, config=PathConfig(max_checks=1000))
    low, high = np.min(seen, axis=0), np.max(seen, axis=0)
    middle = 0.5 * (START[0] + GOAL[0])
    assert middle - np.pi - 1e-6 <= low[0] < middle - 2.0 and middle + 2.0 < high[0] <= middle + np.pi + 1e-6
    assert low[1] < -4.0 and high[1] > 4.0


def test_shortcuts_and_corners_keep_ends_and_freedom() -> None:
    rng = np.random.default_rng(0)
    wander = np.concatenate(
        [[START], np.cumsum(rng.normal(0.0, 0.02, (30, 2)), axis=0) + START, [[0.9, 0.96]], [[1.1, 0.96], GOAL]]
    )
    velocity = SLIT.manipulator.velocity
    free = Disc(SLIT.boxes, radius=0.03)
    short = shorten(wander, free.edge_is_free, velocity, rng=rng, tries=40)
    assert _length(short, velocity) < _length(wander, velocity) and len(short) < 8
    soft = round_corners(short, free.edge_is_free, velocity, cut_s=0.3)
    assert len(soft) > len(short) and free.gap(_dense(soft, 0.001)).min() > -1e-3
    for q in (short, soft):
        assert (q[0] == START).all() and (q[-1] == GOAL).all()
    assert _sharpest(soft) < 0.5 * _sharpest(short)


def test_random_shortcuts_cut_what_removing_waypoints_leaves() -> None:
    free = Disc(np.array([[1.0, 0.3, 0.3, 0.3]]))  # the way over it: straight down to its corners
    way = np.array([START, [1.0, 1.9], GOAL])
    velocity = free.manipulator.velocity
    long, short = (shorten(way, free.edge_is_free, velocity, rng=np.random.default_rng(1), tries=n) for n in (0, 60))
    over = np.array([START, [0.65, 0.65], [1.35, 0.65], GOAL])
    assert (long == way).all()
    assert _length(short, velocity) < 1.15 * _length(over, velocity)


def test_a_corner_at_an_edge_is_left_where_no_cut_is_free() -> None:
    hook = np.array([[0.2, 0.3], [0.2, 1.5], [1.8, 1.5]])
    tight = Disc(np.array([[1.0 + 0.255, 0.7 - 0.005, 1.0, 0.75]]))  # 5 mm are left at its corner and sides
    round_ = round_corners(hook, tight.edge_is_free, np.ones(2), cut_s=0.4)
    assert tight.gap(_dense(round_, 0.001)).min() > 0.0
    wide = Disc(np.array([[9.0, 9.0, 0.1, 0.1]]))
    assert _sharpest(round_corners(hook, wide.edge_is_free, np.ones(2), cut_s=0.4)) < 0.2


def test_repeated_waypoints_count_once() -> None:
    velocity = SLIT.manipulator.velocity
    way = np.array([START, START, [0.9, 0.96], [0.9, 0.96], [1.1, 0.96], GOAL, GOAL])
    free = Disc(SLIT.boxes, radius=0.03)
    for q in (shorten(way, free.edge_is_free, velocity, rng=np.random.default_rng(0), tries=20), way):
        soft = round_corners(q, free.edge_is_free, velocity, cut_s=0.3)
        assert np.isfinite(soft).all() and (np.abs(np.diff(soft, axis=0)).max(axis=1) > 1e-6).all()
        assert (soft[[0, -1]] == way[[0, -1]]).all()


def _sharpest(q: np.ndarray) -> float:
    """The largest turn at a waypoint, rad."""
    way = np.diff(q, axis=0)
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    return float(np.arccos(np.clip((way[:-1] * way[1:]).sum(axis=1), -1.0, 1.0)).max())


@pytest.mark.parametrize(
    ("start", "goals", "error", "word"),
    [
        ([0.2, 2.5], [[1.8, 0.3]], InputError, "start 0: joint 1"),
        ([0.2, 0.3], [[1.8, 0.3], [-0.1, 0.3]], InputError, "goal 1: joint 0"),
        ([0.2, np.nan], [[1.8, 0.3]], InputError, "start"),
        ([0.2, 0.3], np.zeros((0, 2)), InputError, "no goals"),
        ([0.2, 0.3, 0.1], [[1.8, 0.3]], ShapeError, "q_start"),
        ([0.2, 0.3], [[1.8, 0.3, 0.1]], ShapeError, "q_goals"),
    ],
)
def test_bad_input_has_a_clear_error(start: list, goals: list, error: type, word: str) -> None:
    with pytest.raises(error, match=word):
        plan_path(SLIT, np.array(start), np.array(goals))


def test_contradictory_limits_have_a_clear_error() -> None:
    crossed = Disc(SLIT.boxes, manipulator=_limits(np.array([0.0, 2.0]), np.array([2.0, 0.0]), np.ones(2)))
    with pytest.raises(InputError, match="joint 1"):
        plan_path(crossed, START, GOAL)
    still = Disc(SLIT.boxes, manipulator=_limits(np.zeros(2), np.full(2, 2.0), np.array([1.0, 0.0])))
    with pytest.raises(InputError, match="velocity"):
        plan_path(still, START, GOAL)
