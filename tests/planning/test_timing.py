"""Motions along joint paths: limits, rest at the ends, closeness to the path, bad input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.planning.timing import DEVIATION, hand_lengths, kept_within, path_deviation, time_path, timed_is_free

VELOCITY = np.array([0.1, 1.25, 1.45, 1.57, 1.52, 1.57, 2.26, 2.26])
ACCELERATION = np.array([0.5, 1.5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5])
NAMES = tuple(f"joint_{k}" for k in range(8))


def _timed(q: np.ndarray, **options: object) -> Trajectory:
    return time_path(q, joint_names=NAMES, velocity=VELOCITY, acceleration=ACCELERATION, **options)


def _excess(motion: Trajectory, velocity: np.ndarray, acceleration: np.ndarray) -> tuple[float, float]:
    """Largest speed and acceleration over their limits, by finite differences at 1 kHz of the positions alone."""
    q = motion.sample(np.arange(0.0, motion.duration_s, 1e-3))[0]
    return (
        float(np.abs(np.diff(q, axis=0) / 1e-3 / velocity).max()),
        float(np.abs(np.diff(q, 2, axis=0) / 1e-6 / acceleration).max()),
    )


def _random_path(rng: np.random.Generator, kind: int) -> np.ndarray:
    steps = rng.normal(size=(rng.integers(2, 7), 8)) * VELOCITY * 10.0 ** rng.uniform(-3.0, 0.2, size=(1, 1))
    q = np.cumsum(steps, axis=0)
    if kind == 1:
        return np.concatenate([q, q[::-1]])  # there and back: the sharpest corner
    if kind == 2:
        q[:, 1:] = q[0, 1:]  # one joint only
    if kind == 3:
        return np.repeat(q, 2, axis=0)
    return q


@pytest.mark.parametrize("seed", range(24))
def test_limits_hold_and_the_motion_stays_on_its_path(seed: int) -> None:
    q = _random_path(np.random.default_rng(seed), seed % 4)
    motion = _timed(q)
    fast, hard = _excess(motion, VELOCITY, ACCELERATION)
    assert fast <= 1.01 and hard <= 1.01
    assert path_deviation(motion, q) <= DEVIATION
    assert np.abs(motion.q[[0, -1]] - q[[0, -1]]).max() <= 1e-9
    assert np.abs(motion.qd[[0, -1]]).max() <= 1e-9
    # it visits every waypoint, in order
    far = [np.abs(motion.q - waypoint).max(axis=1).min() for waypoint in q]
    assert max(far) <= DEVIATION


def test_a_path_of_corners_is_not_much_slower_than_its_limits_ask_for() -> None:
    q = np.cumsum(np.random.default_rng(3).normal(size=(5, 8)) * VELOCITY * 0.4, axis=0)
    motion = _timed(q)
    stops = sum(_timed(edge).duration_s for edge in (q[k : k + 2] for k in range(4)))
    assert motion.duration_s <= 1.03 * stops  # stopping at every corner is always possible
    assert max(_excess(motion, VELOCITY, ACCELERATION)) >= 0.95


@pytest.mark.parametrize(("way", "top", "gain"), [(1.0, 1.2, 2.0), (0.2, 1.2, 2.0), (-2.5, 0.7, 5.0), (1e-3, 0.1, 0.5)])
def test_one_joint_takes_the_time_of_a_trapezoid(way: float, top: float, gain: float) -> None:
    motion = time_path(
        np.array([[0.3], [0.3 + way]]), joint_names=("a",), velocity=np.array([top]), acceleration=np.array([gain])
    )
    ramp = top / gain
    expected = abs(way) / top + ramp if abs(way) >= top * ramp else 2.0 * np.sqrt(abs(way) / gain)
    assert motion.duration_s == pytest.approx(expected, rel=0.02)


def test_speed_is_a_stretch_of_time() -> None:
    q = np.cumsum(np.random.default_rng(5).normal(size=(4, 8)) * VELOCITY * 0.3, axis=0)
    full, slow = _timed(q), _timed(q, speed=0.25)
    assert slow.duration_s == pytest.approx(4.0 * full.duration_s, rel=0.01)
    fast, hard = _excess(slow, 0.25 * VELOCITY, 0.0625 * ACCELERATION)
    assert fast <= 1.01 and hard <= 1.01


@pytest.mark.parametrize("as_lengths", [False, True])
def test_the_hand_is_no_faster_than_asked(as_lengths: bool) -> None:
    q = np.linspace(0.0, 1.0, 11)[:, None] * 0.3 * np.ones(8) * VELOCITY
    lengths = np.linspace(0.0, 1.0, 11) ** 1.5 * 0.1 if as_lengths else 0.1
    motion = _timed(q, hand_m=lengths, max_hand_speed=0.05)
    t = np.arange(0.0, motion.duration_s, 1e-3)
    travelled = np.interp(motion.sample(t)[0][:, 1], q[:, 1], lengths if as_lengths else np.linspace(0.0, 0.1, 11))
    speed = np.diff(travelled) / 1e-3
    assert 0.045 <= speed.max() <= 0.0505
    assert motion.duration_s > _timed(q).duration_s


def test_the_hand_of_an_arm_neither_moves_nor_turns_faster_than_asked() -> None:
    robot = mount(load_arm("fetch"), load_hand("fetch"))
    ends = np.stack([robot.q_home[robot.arm_dofs]] * 2)
    ends[1] += 0.3 * np.array([0.1, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 2.0])
    q = ends[0] + np.linspace(0.0, 1.0, 21)[:, None] * (ends[1] - ends[0])
    limits = {"joint_names": robot.arm_names, "velocity": robot.velocity, "acceleration": robot.acceleration}
    lengths = hand_lengths(robot, q, turn_m=0.2)
    assert lengths[-1] == pytest.approx(hand_lengths(robot, q)[-1] + 0.2 * hand_turn(robot, q).sum(), rel=1e-6)
    motion = time_path(q, **limits, hand_m=lengths, max_hand_speed=0.1)
    at = motion.sample(np.arange(0.0, motion.duration_s, 2e-3))[0]
    speed = np.linalg.norm(np.diff(robot.hand_pose(at)[:, :3, 3], axis=0), axis=1) / 2e-3
    turn = hand_turn(robot, at) / 2e-3
    assert speed.max() <= 0.102 and turn.max() <= 0.51
    assert (speed + 0.2 * turn).max() >= 0.095


def hand_turn(robot: Manipulator, q: np.ndarray) -> np.ndarray:
    """(T - 1,) angles between successive postures."""
    R = robot.hand_pose(q)[:, :3, :3]
    return np.linalg.norm(Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec(), axis=1)


def test_a_curved_series_of_waypoints_takes_little_longer_than_the_straight_line() -> None:
    u = np.linspace(0.0, 1.0, 11)[:, None]
    q = u * 0.5 * VELOCITY * np.ones(8) + u**2 * 0.1 * VELOCITY[::-1] * np.array([0.1, 1, 1, 1, 1, 1, 1, 1])
    assert _timed(q).duration_s < 1.05 * _timed(q[[0, -1]]).duration_s


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_path_that_goes_nowhere_is_a_short_rest(count: int) -> None:
    motion = _timed(np.repeat(np.ones((1, 8)) * 0.3, count, axis=0))
    assert motion.duration_s <= 0.01
    assert (motion.q == 0.3).all() and (motion.qd == 0.0).all()


def test_a_motion_that_hits_something_between_its_waypoints_is_noticed() -> None:
    class Wall:
        def is_free(self, q: np.ndarray) -> np.ndarray:
            return np.abs(q[:, 1] - 0.5) > 0.015

    q = np.array([np.zeros(8), np.ones(8) * VELOCITY])
    assert not timed_is_free(Wall(), _timed(q))
    assert timed_is_free(Wall(), _timed(q * 0.3))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"velocity": np.r_[VELOCITY[:7], 0.0]}, "joint_7"),
        ({"acceleration": np.r_[-1.0, ACCELERATION[1:]]}, "joint_0"),
        ({"velocity": np.r_[VELOCITY[:7], np.nan]}, "joint_7"),
        ({"velocity": np.r_[VELOCITY[:7], np.inf]}, "joint_7"),
        ({"speed": 0.0}, "speed"),
        ({"speed": 1.5}, "speed"),
        ({"q": np.full((2, 8), np.nan)}, "finite"),
        ({"hand_m": 0.1}, "max_hand_speed"),
        ({"hand_m": 0.1, "max_hand_speed": -1.0}, "max_hand_speed"),
        ({"hand_m": np.array([0.1, 0.0]), "max_hand_speed": 0.1}, "hand_m"),
    ],
)
def test_bad_limits_have_a_clear_error(change: dict, word: str) -> None:
    options = {"velocity": VELOCITY, "acceleration": ACCELERATION, **change}
    q = options.pop("q", np.array([np.zeros(8), np.ones(8)]))
    with pytest.raises(InputError, match=word):
        time_path(q, joint_names=NAMES, **options)


@pytest.mark.parametrize("q", [np.zeros((2, 7)), np.zeros(8), np.zeros((0, 8))])
def test_bad_shapes_have_a_clear_error(q: np.ndarray) -> None:
    with pytest.raises(ShapeError):
        _timed(q)


def test_a_curve_that_bulges_over_a_limit_rests_at_it() -> None:
    q = np.array([[0.0, 0.0], [1.0, 0.6], [0.2, 1.0]])
    motion = time_path(q, joint_names=("a", "b"), velocity=np.ones(2), acceleration=np.full(2, 2.0))
    upper = np.array([float(motion.q[:, 0].max()) - 4e-4, 2.0])
    kept = kept_within(motion, np.array([-1.0, -1.0]), upper)
    over = motion.q[:, 0] > upper[0]
    assert over.any() and (kept.q <= upper).all() and (kept.qd[over, 0] == 0.0).all()
    np.testing.assert_array_equal(kept.q[~over], motion.q[~over])
    np.testing.assert_array_equal(kept.qd[:, 1], motion.qd[:, 1])
