"""The forearm behind a hand: which way it can point with a human wrist, clear of the table and of the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import convex_hull, sphere_mesh
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.skeleton import joint_points

_EXTENSION_DEG = (-45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 58.0)  # positive: the back of the hand to the forearm
_DEVIATION_DEG = (-28.0, -14.0, 0.0, 14.0)  # positive: the thumb's side to the forearm
_COMFORT_DEG, _COMFORT_RANGE_DEG = np.array([15.0, -5.0]), np.array([45.0, 22.0])
_SLOPE_DEG, _SLOPE_RANGE_DEG, _STEEPEST_DEG = 30.0, 45.0, 78.0
_THUMB_DOWN = -0.45  # least height of the thumb's side over the little finger's, as the sine of the angle
_ABOVE_TABLE_M, _OFF_OBJECT_M = 0.006, 0.004
_INNERMOST_M = 0.02  # nearer to the wrist, the forearm is inside the hand's base
_ALONG = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class ForearmSize:
    """A straight tapered forearm, metres: from the wrist to the elbow, radii at either end."""

    length_m: float
    wrist_m: float
    elbow_m: float

    @staticmethod
    def of(scale: float) -> ForearmSize:
        """That of a person whose hand has this scale (0.8: a hand of 202 mm, a forearm of 270 mm)."""
        return ForearmSize(length_m=0.3375 * scale, wrist_m=0.0295 * scale, elbow_m=0.051 * scale)

    def radius(self, along: np.ndarray) -> np.ndarray:
        """Radius at distances (N,) from the wrist, metres."""
        return self.wrist_m + (self.elbow_m - self.wrist_m) * along / self.length_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WristAxes:
    """Unit directions of a hand in H: from the fingers to the wrist, out of the back, and to the thumb's side."""

    out: np.ndarray
    back: np.ndarray
    thumb: np.ndarray

    @staticmethod
    def of(hand: Hand) -> WristAxes:
        joints = joint_points(hand, np.eye(4), hand.q_open)
        out, back = hand.X_HP[:3, 0], -hand.X_HP[:3, 2]
        across = np.cross(out, back)
        return WristAxes(out=out, back=back, thumb=across * np.sign(across @ (joints[5] - joints[17])))


def forearm_directions(
    hand: Hand, X_WH: np.ndarray, points_W: np.ndarray, *, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """The easiest direction of the forearm for each of N hands at a table.

    A person's wrist bends 45 degrees to the palm, 58 to the back, 28 to the little finger and 14 to the thumb. The
    elbow is above the table, the forearm clear of the object and no steeper than 78 degrees; the thumb's side is not
    far below the little finger's, which only a raised elbow would allow.

    Args:
        hand: a human hand of any side and this `scale`.
        X_WH: (N, 4, 4) hands, W with the table at z = 0, up.
        points_W: (M, 3) points of the object's surface.
    Returns:
        (N, 3) unit directions from wrist to elbow in H, and (N,) how uneasy each is: about 0 to 4, inf where there is
        none.
    """
    axes, size = WristAxes.of(hand), ForearmSize.of(scale)
    extension, deviation = np.radians(np.stack(np.meshgrid(_EXTENSION_DEG, _DEVIATION_DEG), axis=-1).reshape(-1, 2)).T
    to_H = np.stack([axes.out, axes.back, axes.thumb])
    bent = np.stack([np.cos(extension) * np.cos(deviation), np.sin(extension) * np.cos(deviation), np.sin(deviation)])
    choices_H = bent.T @ to_H  # (D, 3)
    strain = np.degrees(np.stack([extension, deviation], axis=1)) - _COMFORT_DEG
    effort = ((strain / _COMFORT_RANGE_DEG) ** 2).sum(axis=1)
    best, cost = np.tile(axes.out, (len(X_WH), 1)), np.full(len(X_WH), np.inf)
    for i, X in enumerate(X_WH):
        if X[2, :3] @ axes.thumb < _THUMB_DOWN:
            continue
        choices_W = choices_H @ X[:3, :3].T
        slope = np.degrees(np.arcsin(np.clip(choices_W[:, 2], -1.0, 1.0)))
        uneasy = effort + ((slope - _SLOPE_DEG) / _SLOPE_RANGE_DEG) ** 2
        uneasy[slope > _STEEPEST_DEG] = np.inf
        for k in np.argsort(uneasy, kind="stable"):
            if not np.isfinite(uneasy[k]):
                break
            if is_clear(X[:3, 3], choices_W[k], points_W, size):
                best[i], cost[i] = choices_H[k], uneasy[k]
                break
    return best, cost


def is_clear(wrist_W: np.ndarray, direction_W: np.ndarray, points_W: np.ndarray, size: ForearmSize) -> bool:
    """Whether a forearm from a wrist (3,) keeps off the table z = 0 and the object's points (M, 3)."""
    along = np.linspace(_INNERMOST_M, size.length_m, _ALONG)
    middle = wrist_W + along[:, None] * direction_W
    radius = size.radius(along)
    if (middle[1:, 2] - radius[1:] < _ABOVE_TABLE_M).any():
        return False
    t = np.clip((points_W - wrist_W) @ direction_W, _INNERMOST_M, size.length_m)
    gap = np.linalg.norm(points_W - wrist_W - t[:, None] * direction_W, axis=1) - size.radius(t)
    return bool((gap > _OFF_OBJECT_M).all())


def tapered_mesh(start: np.ndarray, end: np.ndarray, start_m: float, end_m: float, *, segments: int = 20) -> Mesh:
    """The convex hull of two spheres: a tapered capsule from `start` to `end` (3,) with these radii, metres."""
    ball = sphere_mesh(1.0, segments=segments).vertices
    vertices, faces = convex_hull(np.concatenate([ball * start_m + start, ball * end_m + end]))
    return Mesh(vertices, faces)
