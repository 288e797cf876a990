"""Fits the human hand model to seen joints and depth points: pose, 20 joints and size, by Levenberg-Marquardt."""

from __future__ import annotations

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.human.fit.again import other_starts
from neuralgrasps.human.fit.fit_config import HandFitConfig
from neuralgrasps.human.fit.problem import HandProblem, fewer_points, hand_problem
from neuralgrasps.human.fit.result import fit_result
from neuralgrasps.human.fit.right_hand import right_hand
from neuralgrasps.human.fit.start import first_starts
from neuralgrasps.human.fit.steps import lower_costs
from neuralgrasps.human.seen import FittedHand, SeenJoints, Side
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame


def fit_hand(
    seen: SeenJoints | None,
    cloud_C: np.ndarray | None,
    *,
    side: Side,
    scale: float | None,
    start: FittedHand | None = None,
    obj: tuple[ObjectModel, np.ndarray] | None = None,
    frame: Frame | None = None,
    config: HandFitConfig | None = None,
) -> FittedHand:
    """The hand that best explains what is seen of it in one frame, or in several of a hand that does not move.

    Lowered is the sum of: errors of the seen joints; exact distances of the cloud's points to the hand's capsules and
    boxes; parts of the hand in front of what the camera measured (with `frame` and the mask in `seen`); depth in the
    object, and gaps between it and fingertips close to it; a distribution of grasp postures. All are robust. Joints
    stay within the model's limits.

    Args:
        seen: the joints; None: only with `start`, whose joints then count a little.
        cloud_C: (M, 3) points of the hand's surface only, camera frame, metres; None or too few: joints alone.
        side: which hand; the caller decides. A hand fitted as its mirror image leaves larger residuals.
        scale: size of the hand (`fit_size`); None: fitted too, weakly determined by one frame.
        start: a fit of a frame shortly before, followed beside the start from the joints.
        obj: what the hand holds, and its pose X_CO (4, 4).
        frame: the depth image, for free space.
    Raises:
        InputError: neither joints nor a start; a size that is not positive.
        ShapeError: a cloud that is not (M, 3).
    """
    config = config or HandFitConfig()
    if seen is None and start is None:
        raise InputError("fit_hand got neither joints nor a start; expected one: points alone do not say.")
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale is {scale}; expected a size above 0, such as 0.8, or None.")
    problem = hand_problem(seen, cloud_C, side=side, scale=scale, obj=obj, frame=frame, config=config, start=start)
    X, q, sizes = first_starts(problem, start, scale, config)
    at_joints = X[0].copy(), q[0].copy(), float(sizes[0])
    cost = _lower(problem, X, q, sizes, config)
    best = int(np.argmin(cost))
    result = fit_result(problem, X[best], q[best], float(sizes[best]), side=side)
    if result.confidence >= config.again_below or not len(problem.cloud_C) or seen is None:
        return result
    X, q, sizes = other_starts(problem, *at_joints)
    again = _lower(problem, X, q, sizes, config)
    other = int(np.argmin(again))
    if again[other] >= cost[best]:
        return result
    return fit_result(problem, X[other], q[other], float(sizes[other]), side=side)


def _lower(problem: HandProblem, X: np.ndarray, q: np.ndarray, sizes: np.ndarray, config: HandFitConfig) -> np.ndarray:
    """Follow starts in place, first to half of the points, which may be far off; their costs."""
    cost = np.empty(len(q))
    first = fewer_points(problem, 2)._replace(cloud_width=max(config.first_width_m, config.cloud_width_m))
    lower_costs(right_hand().packed, first, X, q, sizes, 6, 1e-2, cost)
    lower_costs(right_hand().packed, problem, X, q, sizes, config.iterations, 1e-3, cost)
    return cost
