"""When a hand grasps: the frames in which it keeps still relative to the object, and whether it touches it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from neuralgrasps.geometry.sdf_grid import grid_distances
from neuralgrasps.hands.surface import HandSurface, sample_hand_surface
from neuralgrasps.human.seen import FittedHand
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.objects.object_model import ObjectModel

_SPACING_M = 0.006  # of the points on the hand that are asked for their distance to the object
_LAST = 8  # frames of a run that a further frame is compared with


@dataclass(frozen=True, slots=True, kw_only=True)
class StillRun:
    """Frames in which the hand keeps its place and posture.

    Attributes:
        frames: their numbers, ascending.
        middle: the one of them that is nearest to all others.
        spread_m: median distance of the joints between the others and it.
    """

    frames: tuple[int, ...]
    middle: int
    spread_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """How near a posed hand is to an object.

    Attributes:
        gap_m: by part of the hand ("palm", "thumb", ...) its least signed distance to the object; negative inside.
    """

    gap_m: dict[str, float]

    def touching(self, within_m: float) -> tuple[str, ...]:
        """The parts of the hand that are so near."""
        return tuple(part for part, gap in self.gap_m.items() if gap <= within_m)

    @property
    def nearest_m(self) -> float:
        """Of the whole hand."""
        return min(self.gap_m.values())

    def holds(self, within_m: float) -> bool:
        """Whether at least two parts of the hand, one of them a finger, are in contact."""
        return len(self.touching(within_m)) >= 2


def joint_distances(points: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(T, T) how far the joints are apart between frames: the weighted median over the joints, metres.

    Args:
        points: (T, 21, 3) all in one frame that the object does not move in; nan where unknown.
        weight: (T, 21) trust in each, 0 to 1.
    Returns:
        inf between frames without four common joints.
    """
    gap = np.linalg.norm(points[:, None] - points[None], axis=-1)
    trust = np.sqrt(weight[:, None] * weight[None])
    trust = np.where(np.isfinite(gap), trust, 0.0)
    gap = np.where(trust > 0, gap, np.inf)
    order = np.argsort(gap, axis=-1)
    along = np.cumsum(np.take_along_axis(trust, order, axis=-1), axis=-1)
    place = np.argmax(along >= 0.5 * along[..., -1:], axis=-1)
    middle = np.take_along_axis(np.take_along_axis(gap, order, axis=-1), place[..., None], axis=-1)[..., 0]
    return np.where((trust > 0).sum(axis=-1) >= 4, middle, np.inf)


def still_threshold(distance: np.ndarray, *, least_m: float, most_m: float) -> float:
    """How far still hands may seem to move: by the noise between neighbouring frames where it is least."""
    steps = np.diagonal(distance, offset=1)
    steps = steps[np.isfinite(steps)]
    return float(np.clip(2.5 * np.percentile(steps, 25), least_m, most_m)) if len(steps) else least_m


def still_runs(distance: np.ndarray, numbers: Sequence[int], *, within_m: float, least: int) -> list[StillRun]:
    """The still phases of a video, longest first; no frame is in two.

    Args:
        distance: (T, T) of `joint_distances`; numbers: (T,) which frames of the video these are, ascending.
        within_m: a frame belongs to a run when it is so near to the median of the run's last frames; one frame in
            between may be off.
        least: frames of a run.
    """
    free = np.ones(len(distance), bool)
    runs: list[StillRun] = []
    while True:
        grown = [_grown(distance, free, int(start), within_m) for start in np.flatnonzero(free)]
        best = max(grown, key=len, default=[])
        if len(best) < max(least, 1):
            return runs
        runs.append(_run(distance, best, numbers))
        free[best[0] : best[-1] + 1] = False


def touch(fitted: FittedHand, obj: ObjectModel, X_CO: np.ndarray) -> Touch:
    """How near a fitted hand is to an object at X_CO (4, 4)."""
    hand, surface = human_hand(fitted.side), _surface(fitted.side)
    X_HL = forward_numpy(hand.tree, fitted.q)[surface.links]
    points_H = fitted.scale * ((X_HL[:, :3, :3] @ surface.points_L[:, :, None])[..., 0] + X_HL[:, :3, 3])
    X_OH = np.linalg.inv(X_CO) @ fitted.X_CH
    out = np.empty(len(points_H))
    points_O = points_H @ X_OH[:3, :3].T + X_OH[:3, 3]
    grid_distances(obj.sdf.values, obj.sdf.origin, obj.sdf.inv_spacing, points_O, out)
    chains = {"palm": (0,), **{f.name: f.links for f in hand.fingers}}
    return Touch(gap_m={name: float(out[np.isin(surface.links, links)].min()) for name, links in chains.items()})


def first_motion(X_WO: np.ndarray, frames: Sequence[int], *, moved_m: float) -> int | None:
    """The first of these frames in which the object has left the place it had before; None when it never does.

    Args:
        X_WO: (T, 4, 4) the object in any frame at rest; nan where unknown.
    """
    known = np.flatnonzero(np.isfinite(X_WO).all(axis=(1, 2)))
    if not len(known):
        return None
    start = np.median(X_WO[known[:5], :3, 3], axis=0)
    for frame in frames:
        if np.isfinite(X_WO[frame]).all() and np.linalg.norm(X_WO[frame, :3, 3] - start) > moved_m:
            return int(frame)
    return None


def _grown(distance: np.ndarray, free: np.ndarray, start: int, within_m: float) -> list[int]:
    run, missed = [start], 0
    for k in range(start + 1, len(distance)):
        if not free[k]:
            break
        if np.median(distance[k, run[-_LAST:]]) <= within_m and np.median(distance[k, run[:_LAST]]) <= 1.5 * within_m:
            run.append(k)
            missed = 0
        else:
            missed += 1
            if missed > 1:
                break
    return run


def _run(distance: np.ndarray, members: list[int], numbers: Sequence[int]) -> StillRun:
    inside = distance[np.ix_(members, members)]
    middle = int(np.argmin(np.median(inside, axis=1)))
    return StillRun(
        frames=tuple(int(numbers[k]) for k in members),
        middle=int(numbers[members[middle]]),
        spread_m=float(np.median(inside[middle])),
    )


@cache
def _surface(side: str) -> HandSurface:
    return sample_hand_surface(human_hand(side), spacing=_SPACING_M)
