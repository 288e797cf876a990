"""Whether the camera's focal length fits the hand and the object that it shows, and which one would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.fit.hand_misfit import misfit
from neuralgrasps.human.fit.hand_size import fit_size
from neuralgrasps.human.seen import SeenJoints, Side
from neuralgrasps.human.skeleton import LARGEST, SMALLEST
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.track import track_pose

FACTORS = (0.55, 0.65, 0.75, 0.87, 1.0, 1.15, 1.33, 1.55, 1.8)
"""Focal lengths tried, times the given one."""

_FIRST = (0.8, 1.0, 1.25)  # tried of an object at first

_CLEAR = 0.8  # another focal length must lower the residual to this share of the given one's
_EDGE = 0.01  # a size so near to the smallest or largest has run out of the range
_SIZE_COST = 6.0  # share by which a hand's residual is raised, for each share that its size is beyond people's
_LENGTH_M = 0.252  # from wrist to middle fingertip at size 1
_USUAL_SIZE = float(np.sqrt(SMALLEST * LARGEST))


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalCheck:
    """How well a focal length fits.

    Attributes:
        factor: the best focal length over the given one, 1 where no other is clearly better.
        residual_m: of the given one; best_m: of the best.
        sure: whether the given one is clearly better than all others tried.
    """

    factor: float
    residual_m: float
    best_m: float
    sure: bool

    @property
    def off(self) -> float:
        """How far the best focal length is from the given one, as a logarithm without sign."""
        return abs(float(np.log(self.factor)))


def out_of_sizes(scale: float) -> bool:
    """Whether a fitted size lies at the edge of what people's hands are."""
    return not SMALLEST * (1.0 + _EDGE) < scale < LARGEST * (1.0 - _EDGE)


def size_doubt(scale: float, fx: float) -> str:
    """What a hand of this size says of the focal length `fx`, pixels; "" for a size that people's hands have."""
    if not out_of_sizes(scale):
        return ""
    small = scale < _USUAL_SIZE  # what is seen through too long a focal length seems too small
    factor, usual = (min(scale / SMALLEST, 1.0) if small else max(scale / LARGEST, 1.0)), scale / _USUAL_SIZE
    return (
        f"the focal length may be wrong ({size_words(scale)}): it seems too {'long' if small else 'short'}; "
        f"{factor:.2f} times as long or {'less' if small else 'more'} (fx = {fx * factor:.0f}) would bring the hand "
        f"into that range, about {usual:.2f} times (fx = {fx * usual:.0f}) would make it a usual one."
    )


def size_words(scale: float) -> str:
    """A size beside those that people's hands have."""
    length, least, most = (round(1e3 * _LENGTH_M * s) for s in (scale, SMALLEST, LARGEST))
    return f"the hand measures {length} mm, people's are {least} to {most} mm"


def beyond_sizes(scale: float) -> float:
    """How far a size lies beyond people's, as a logarithm; 0 within."""
    return max(float(np.log(SMALLEST / scale)), float(np.log(scale / LARGEST)), 0.0)


def stretched(points_C: np.ndarray, factor: float) -> np.ndarray:
    """Points (..., 3) of a depth image as they are when its focal lengths are `factor` times as long.

    Pixels and depths stay, so that x and y shrink.
    """
    return points_C * np.array([1.0 / factor, 1.0 / factor, 1.0])


def hand_focal(seen: Sequence[SeenJoints], clouds: Sequence[np.ndarray], *, side: Side) -> FocalCheck:
    """The focal length at which a hand of a person's size fits joints and points (M, 3) of several frames best.

    The residual of a hand that is larger or smaller than people's is raised by 6 % for each 1 % that it is beyond.
    """
    cost = {}
    for factor in FACTORS:
        moved = [replace(s, points_C=stretched(s.points_C, factor)) for s in seen]
        points = [stretched(cloud, factor) for cloud in clouds]
        scale = fit_size(moved, points, side=side)
        fits = [fit_hand(s, c, side=side, scale=scale) for s, c in zip(moved, points, strict=True)]
        apart = [misfit(f, cloud) for f, cloud in zip(fits, points, strict=True)]
        cost[factor] = float(np.median(apart)) * (1.0 + _SIZE_COST * beyond_sizes(scale))
    return _check(cost)


def object_focal(frame: Frame, obj: ObjectModel, X_CO: np.ndarray) -> FocalCheck | None:
    """The focal length at which an object of known size fits its points best, near a pose X_CO (4, 4) seen with the
    given one; None where it cannot be told.

    Reliable in a frame in which nothing hides the object: there it tells 20 % too long or short a focal length apart.
    """
    first = _object_costs(frame, obj, X_CO, _FIRST)
    if 1.0 not in first or _check(first).factor == 1.0:
        return _check(first) if 1.0 in first else None
    return _check({**_object_costs(frame, obj, X_CO, FACTORS), 1.0: first[1.0]})


def _object_costs(frame: Frame, obj: ObjectModel, X_CO: np.ndarray, factors: Sequence[float]) -> dict[float, float]:
    """By factor the residual of the object, metres, larger where it leaves points unexplained."""
    cost, k = {}, frame.intrinsics
    for factor in factors:
        start = X_CO.copy()
        start[:3, 3] = stretched(start[:3, 3], factor)
        camera = replace(k, fx=k.fx * factor, fy=k.fy * factor)
        try:
            found = track_pose(obj, frame.depth, camera, start)
        except InputError:  # too few points near it
            continue
        cost[factor] = found.residual_m / max(found.explained, 0.05)
    return cost


def _check(cost: dict[float, float]) -> FocalCheck:
    factor = min(cost, key=lambda f: cost[f])
    if cost[factor] > _CLEAR * cost[1.0]:
        others = [cost[f] for f in cost if f != 1.0]
        sure = bool(others) and cost[1.0] <= _CLEAR * min(others)
        return FocalCheck(factor=1.0, residual_m=cost[1.0], best_m=cost[1.0], sure=sure)
    return FocalCheck(factor=parabola_factor(cost, factor), residual_m=cost[1.0], best_m=cost[factor], sure=False)


def parabola_factor(cost: dict[float, float], best: float) -> float:
    """The factor at the lowest point of the parabola through the best factor and its neighbours, over the logarithm."""
    tried = sorted(cost)
    place = tried.index(best)
    near = tried[max(place - 1, 0) : place + 2]
    if len(near) < 3:
        return best
    a, b, _ = np.polyfit(np.log(near), [cost[f] for f in near], 2)
    if a <= 0:
        return best
    return float(np.exp(np.clip(-b / (2 * a), np.log(near[0]), np.log(near[-1]))))
