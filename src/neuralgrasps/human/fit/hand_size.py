"""The size of a person's hand, from some frames that show it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.human.fit.fit_config import HandFitConfig
from neuralgrasps.human.fit.problem import HandProblem, hand_problem
from neuralgrasps.human.fit.right_hand import right_hand
from neuralgrasps.human.fit.start import first_starts
from neuralgrasps.human.fit.steps import lower_costs
from neuralgrasps.human.seen import SeenJoints, Side
from neuralgrasps.objects.object_model import ObjectModel

_STEP = 0.05  # of the log size
_STEPS, _MOST_STEPS = 4, 9  # sizes tried on each side of the usual one; at most, while the outermost is the best

Found = tuple[np.ndarray, np.ndarray]
"""Of one frame at one size: X_CH (1, 4, 4), q (1, 20)."""


def fit_size(
    seen: Sequence[SeenJoints],
    clouds_C: Sequence[np.ndarray],
    *,
    side: Side,
    objs: Sequence[tuple[ObjectModel, np.ndarray] | None] | None = None,
    config: HandFitConfig | None = None,
) -> float:
    """One size of a person's hand from some frames that show it well (5 to 8 are enough).

    Every frame is fitted at a few sizes; the size is where the sum of the frames' costs is least, the usual sizes of
    people's hands counted in once. A size that people's hands do not have (to 0.5 or 1.24) speaks against the camera.

    Args:
        seen, clouds_C: joints, and points (M, 3), of each frame, as for `fit_hand`; objs: what is held in each.
    Raises:
        InputError: no frame, or not as many clouds as joints.
    """
    if not len(seen) or len(seen) != len(clouds_C):
        raise InputError(f"fit_size got {len(seen)} joints and {len(clouds_C)} clouds; expected as many, at least 1.")
    config = config or HandFitConfig()
    problems, starts = [], []
    for joints, cloud, held in zip(seen, clouds_C, objs or [None] * len(seen), strict=True):
        problems.append(hand_problem(joints, cloud, side=side, scale=1.0, obj=held, frame=None, config=config))
        X, q, _ = first_starts(problems[-1], None, config.scale_mean, config)
        starts.append((X[:1], q[:1]))
    usual, middle = _fitted_at(0, problems, starts, config)
    cost = {0: usual}
    for way in (1, -1):
        found = middle
        for step in range(1, _MOST_STEPS + 1):
            if step > _STEPS and min(cost, key=lambda k: cost[k]) != way * (step - 1):
                break
            cost[way * step], found = _fitted_at(way * step, problems, found, config)
    steps = sorted(cost)
    return _least(config.scale_mean * np.exp(_STEP * np.array(steps)), np.array([cost[k] for k in steps]))


def _fitted_at(
    step: int, problems: Sequence[HandProblem], starts: Sequence[Found], config: HandFitConfig
) -> tuple[float, list[Found]]:
    """The cost of all frames at one size, and their fits, which start from those at the next size."""
    size, one = np.array([config.scale_mean * np.exp(_STEP * step)]), np.empty(1)
    cost, found = (_STEP * step / config.scale_sd) ** 2, []
    for problem, start in zip(problems, starts, strict=True):
        X, q = (array.copy() for array in start)
        lower_costs(right_hand().packed, problem, X, q, size, 2 * config.iterations, 1e-3, one)
        found.append((X, q))
        cost += float(one[0])
    return cost, found


def _least(sizes: np.ndarray, cost: np.ndarray) -> float:
    """Where the parabola through the least of some costs and its neighbours is lowest, over the logarithm."""
    i = int(np.clip(np.argmin(cost), 1, len(sizes) - 2))
    a, b, c = cost[i - 1 : i + 2]
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend > 0 else float(np.argmin([a, b, c])) - 1.0
    return float(sizes[i] * np.exp(np.clip(shift, -1.0, 1.0) * np.log(sizes[1] / sizes[0])))
