"""Joint paths to motions: as fast as limits of speed and acceleration allow, from rest to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint
from toppra.interpolator import AbstractGeometricPath

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError, ShapeError, check_shape
from neuralgrasps.planning.checks import ConfigurationChecker

DEVIATION = 1e-3  # rad or metres that a motion may leave its path by, in any joint
_SAME = 1e-9  # waypoints nearer than this, in every joint, are one
_STRETCH = 1.03  # a motion that is longer by this than its limits ask for is timed again on a finer grid
_STAGES = 100  # least number of pieces that a path is cut into for its speed profile
_SAMPLES = np.array([0.03, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97])  # of an edge, where its distance to the curve is measured
_REFINEMENTS = 24  # each halves the edges that the curve leaves too far
_HAND_ACCELERATION = 50.0  # of the hand, in its top speeds per second: only its speed is limited
_REST_S = 1e-3  # duration of a motion that goes nowhere


def time_path(
    q: np.ndarray,
    *,
    joint_names: tuple[str, ...],
    velocity: np.ndarray,
    acceleration: np.ndarray,
    speed: float = 1.0,
    hand_m: float | np.ndarray | None = None,
    max_hand_speed: float | None = None,
) -> Trajectory:
    """The fastest motion along a path, at rest at both ends.

    A cubic spline through the waypoints, and through further points of the edges where it would leave them, is timed
    by reachability analysis. Limits hold at all times: what little the solver's grid misses, a stretch of time takes.

    Args:
        q: (T, D) waypoints, joined by straight joint lines. Repeated ones count once.
        joint_names: D names. velocity, acceleration: (D,) limits, rad or metres per second.
        speed: 0 to 1, share of the velocity limits; accelerations are scaled by its square, so that the motion is
            the same, `1 / speed` times as long.
        hand_m: what the hand travels, metres: the whole (evenly spread over the edges) or (T,) lengths from the start,
            as `hand_lengths` gives them. max_hand_speed: m/s, not scaled by `speed`. Both or none.
    Returns:
        A motion that stays within `DEVIATION` of the path in every joint. A path that goes nowhere: 1 ms of rest.
    Raises:
        InputError: limits or speeds that are not positive and finite, a waypoint that is not finite.
        ShapeError: shapes do not fit.
    Source:
        Pham and Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis", 2018.
    """
    q = np.asarray(q, float)
    velocity, acceleration = np.asarray(velocity, float), np.asarray(acceleration, float)
    _check_limits(q, joint_names, velocity, acceleration, speed)
    hand = _hand_column(len(q), hand_m, max_hand_speed)
    kept = np.append(True, np.abs(np.diff(q, axis=0)).max(axis=1) > _SAME)
    q, hand = q[kept], None if hand is None else hand[kept]
    if len(q) == 1:
        t, still = np.array([0.0, _REST_S]), np.zeros((2, q.shape[1]))
        return Trajectory(joint_names=tuple(joint_names), t=t, q=q + still, qd=still)
    velocity, acceleration = velocity * speed, acceleration * speed**2
    curve = _curve(q, velocity)
    path = _Path(curve, _positions(q, velocity), hand)
    motions = []
    for pieces in (1, 4):  # sharp corners need a finer grid
        t, s, rate = _profile(path, velocity, acceleration, max_hand_speed, pieces)
        motion = Trajectory(joint_names=tuple(joint_names), t=t, q=curve(s), qd=curve(s, 1) * rate[:, None])
        stretch = _excess(motion, velocity, acceleration)
        motions.append(replace(motion, t=t * stretch, qd=motion.qd / stretch))
        if stretch < _STRETCH:
            break
    return min(motions, key=lambda motion: motion.duration_s)


def kept_within(trajectory: Trajectory, lower: np.ndarray, upper: np.ndarray) -> Trajectory:
    """The motion without what its curve (at most `DEVIATION`) takes it beyond limits (D,): it rests at them instead."""
    q = np.clip(trajectory.q, lower, upper)
    return replace(trajectory, q=q, qd=np.where(q == trajectory.q, trajectory.qd, 0.0))


def hand_lengths(manipulator: Manipulator, q_arm: np.ndarray, *, turn_m: float = 0.0) -> np.ndarray:
    """(T,) metres that the hand base has travelled at waypoints `q_arm` (T, D), from 0.

    Args:
        turn_m: metres that a turn of 1 rad counts; limits the hand's turn to `max_hand_speed / turn_m` as well.
    """
    X_BH = manipulator.hand_pose(q_arm)
    step = np.linalg.norm(np.diff(X_BH[:, :3, 3], axis=0), axis=1)
    chord = np.linalg.norm(np.diff(X_BH[:, :3, :3], axis=0), axis=(1, 2)) / np.sqrt(8.0)
    step += turn_m * 2.0 * np.arcsin(np.minimum(chord, 1.0))  # |R - R'| = sqrt(8) sin(angle / 2)
    return np.concatenate([[0.0], np.cumsum(step)])


def timed_is_free(checker: ConfigurationChecker, trajectory: Trajectory, *, step: float = 0.02) -> bool:
    """Whether a motion is free of collisions, checked where no joint moves more than `step` (rad or metres) between."""
    parts = np.maximum(np.ceil(np.abs(np.diff(trajectory.q, axis=0)).max(axis=1) / step), 1).astype(int)
    t = _divided(trajectory.t, parts)
    return bool(checker.is_free(trajectory.sample(t)[0]).all())


def path_deviation(trajectory: Trajectory, q: np.ndarray) -> float:
    """The farthest, in any joint, that a motion leaves the path (T, D) by, at four times per sample of it."""
    points = trajectory.sample(_divided(trajectory.t, np.full(len(trajectory.t) - 1, 4)))[0]
    q = np.asarray(q, float)
    if len(q) == 1:
        return float(np.abs(points - q).max())
    a, edge = q[:-1], np.diff(q, axis=0)
    length = np.maximum((edge**2).sum(axis=1), _SAME**2)
    share = np.clip(((points @ edge.T) - (a * edge).sum(axis=1)) / length, 0.0, 1.0)
    away = np.abs(points[:, None] - (a + share[..., None] * edge)).max(axis=-1)  # (S, T - 1)
    return float(away.min(axis=1).max())


def _check_limits(
    q: np.ndarray, joint_names: tuple[str, ...], velocity: np.ndarray, acceleration: np.ndarray, speed: float
) -> None:
    count = len(joint_names)
    check_shape("q", q.shape, (None, count))
    if q.ndim != 2 or len(q) == 0:
        raise ShapeError(f"q has shape {q.shape}; expected (T, {count}) with at least one waypoint.")
    if not np.isfinite(q).all():
        raise InputError("the path has waypoints that are not finite; expected numbers.")
    for name, limits in (("velocity", velocity), ("acceleration", acceleration)):
        if limits.shape != (count,):
            raise ShapeError(f"{name} has shape {limits.shape}; expected ({count},), one limit per joint.")
        bad = [f"{joint} {limit:g}" for joint, limit in zip(joint_names, limits, strict=True) if not 0 < limit < np.inf]
        if bad:
            raise InputError(f"{name} limits cannot be used: {', '.join(bad)}; expected positive numbers.")
    if not 0 < speed <= 1:
        raise InputError(f"speed is {speed}; expected a share of the limits in (0, 1].")


def _hand_column(count: int, hand_m: float | np.ndarray | None, max_hand_speed: float | None) -> np.ndarray | None:
    """(count,) metres from the start, or None."""
    if hand_m is None and max_hand_speed is None:
        return None
    if hand_m is None or max_hand_speed is None:
        raise InputError("hand_m and max_hand_speed go together; one of them is missing.")
    if not 0 < max_hand_speed < np.inf:
        raise InputError(f"max_hand_speed is {max_hand_speed}; expected a positive number, m/s.")
    hand = np.asarray(hand_m, float)
    if hand.ndim == 0:
        hand = np.linspace(0.0, float(hand), count)
    if hand.shape != (count,):
        raise ShapeError(f"hand_m has shape {hand.shape}; expected a number or ({count},), one length per waypoint.")
    if not np.isfinite(hand).all() or (np.diff(hand) < 0).any():
        raise InputError("hand_m must be lengths from the start, which never fall.")
    return hand


def _positions(q: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(T,) path positions of waypoints: lengths of the edges, in seconds at top speed."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0) / velocity, axis=1))])


def _curve(q: np.ndarray, velocity: np.ndarray) -> CubicSpline:
    """A spline through the waypoints that stays near the edges; edges are halved where it does not."""
    for _ in range(_REFINEMENTS):
        curve = CubicSpline(_positions(q, velocity), q, bc_type="natural")
        away = _edge_deviation(curve, q)
        far = away > 0.6 * DEVIATION  # the rest is for what lies between the samples and for Hermite pieces
        if not far.any():
            break
        middle = 0.5 * (q[:-1] + q[1:])[far]
        q = np.insert(q, np.flatnonzero(far) + 1, middle, axis=0)
    return curve


def _edge_deviation(curve: CubicSpline, q: np.ndarray) -> np.ndarray:
    """(T - 1,) distance of the curve to each edge, in the worst joint."""
    s, edge = curve.x, np.diff(q, axis=0)
    points = curve(s[:-1, None] + np.diff(s)[:, None] * _SAMPLES) - q[:-1, None]
    share = np.clip(np.einsum("esd,ed->es", points, edge) / (edge**2).sum(axis=1)[:, None], 0.0, 1.0)
    return np.asarray(np.abs(points - share[..., None] * edge[:, None]).max(axis=(1, 2)))


class _Path(AbstractGeometricPath):  # type: ignore[misc]
    """A spline, with the hand's travel as one more joint where that is limited."""

    def __init__(self, curve: CubicSpline, edges: np.ndarray, hand: np.ndarray | None) -> None:
        super().__init__()
        self.curve, self.edges = curve, edges
        self.rate = None if hand is None else np.diff(hand) / np.diff(edges)

    def __call__(self, s: np.ndarray, order: int = 0) -> np.ndarray:
        joints = self.curve(s, order)
        if self.rate is None:
            return np.asarray(joints)
        if order != 1:
            return np.concatenate([joints, np.zeros((*joints.shape[:-1], 1))], axis=-1)
        last = len(self.rate) - 1
        left = np.clip(np.searchsorted(self.edges, s - 1e-12) - 1, 0, last)
        right = np.clip(np.searchsorted(self.edges, s + 1e-12) - 1, 0, last)
        rate = np.maximum(self.rate[left], self.rate[right])
        return np.concatenate([joints, rate[..., None]], axis=-1)

    @property
    def dof(self) -> int:
        return self.curve.c.shape[2] + (self.rate is not None)

    @property
    def path_interval(self) -> np.ndarray:
        return np.asarray(self.curve.x[[0, -1]])


def _profile(
    path: _Path, velocity: np.ndarray, acceleration: np.ndarray, max_hand_speed: float | None, pieces: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, path positions and path speeds, (S,) each, at all corners of the speed profile and half-way between."""
    if max_hand_speed is not None:
        velocity = np.append(velocity, max_hand_speed)
        acceleration = np.append(acceleration, _HAND_ACCELERATION * max_hand_speed)
    knots = path.curve.x
    grid = _divided(knots, np.maximum(np.ceil(np.diff(knots) * (_STAGES / knots[-1])), pieces).astype(int))
    limits = [
        JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        JointAccelerationConstraint(
            np.stack([-acceleration, acceleration], axis=1), discretization_scheme=DiscretizationType.Interpolation
        ),
    ]
    solver = TOPPRA(limits, path, gridpoints=grid, solver_wrapper="seidel", parametrizer="ParametrizeConstAccel")
    _, rate, _ = solver.compute_parameterization(0.0, 0.0)
    if rate is None or not np.isfinite(rate).all():
        raise InputError("the path cannot be timed within these limits.")
    duration = 2.0 * np.diff(grid) / (rate[:-1] + rate[1:])
    gain = np.diff(rate) / duration
    t = np.concatenate([[0.0], np.cumsum(duration)])
    half = 0.5 * duration
    s_half = grid[:-1] + (rate[:-1] + 0.5 * gain * half) * half
    return (
        _woven(t, t[:-1] + half),
        _woven(grid, s_half),
        _woven(rate, rate[:-1] + gain * half),
    )


def _woven(a: np.ndarray, between: np.ndarray) -> np.ndarray:
    """a[0], between[0], a[1], ..., a[-1]."""
    out = np.empty(len(a) + len(between))
    out[::2], out[1::2] = a, between
    return out


def _divided(x: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Rising `x` (K,) with its intervals cut into `parts` (K - 1,) equal ones."""
    first = np.repeat(np.arange(len(parts)), parts)
    within = (np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)) / np.repeat(parts, parts)
    return np.append(x[first] + within * np.diff(x)[first], x[-1])


def _excess(trajectory: Trajectory, velocity: np.ndarray, acceleration: np.ndarray) -> float:
    """How much longer, at least 1, the motion must take so that its cubic pieces exceed no limit anywhere."""
    h = np.diff(trajectory.t)[:, None]
    step, v0, v1 = np.diff(trajectory.q, axis=0) / h, trajectory.qd[:-1], trajectory.qd[1:]
    a0, a1 = (6.0 * step - 4.0 * v0 - 2.0 * v1) / h, (2.0 * v0 + 4.0 * v1 - 6.0 * step) / h  # linear between
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = a0 / (a0 - a1)
        peak = np.where((turn > 0) & (turn < 1), np.abs(v0 + 0.5 * a0 * turn * h), 0.0)
    fastest = np.maximum(np.maximum(np.abs(v0), np.abs(v1)), peak).max(axis=0)
    hardest = np.maximum(np.abs(a0), np.abs(a1)).max(axis=0)
    return max(1.0, float((fastest / velocity).max()), float(np.sqrt((hardest / acceleration).max())))
