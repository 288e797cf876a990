"""The Ferrari-Canny quality of a grasp, exact and fast.

Epsilon is the radius of the largest ball around the origin in the grasp wrench space, the convex hull of the wrenches
of all contacts' cone edges ("L1": the normal forces of all contacts sum to at most 1); 0 when the origin is not in its
interior (no force closure).
Source: Ferrari & Canny 1992, "Planning optimal grasps".
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.polar import OVERFLOW, farthest_vertex, polar_scratch

LEAST = 1e-7  # an epsilon smaller than this times the largest entry of the wrenches is reported as 0
_FIRST_REACH, _LAST_REACH = 1e3, 1.0 / LEAST  # of the polar that is searched: finds epsilon above 1 / this
_HUGE = 1e300
_VERTICES = 2048  # room to begin with; real grasps of 2-39 contacts need up to 1,400


@njit(cache=True, error_model="numpy")
def epsilon_scratch(wrenches, vertices=_VERTICES):  # type: ignore[no-untyped-def]
    """Scratch for `epsilon_with` and `epsilon_within`, for sets of up to so many wrenches."""
    return polar_scratch(wrenches, vertices)


@njit(cache=True, error_model="numpy")
def epsilon_within(wrenches, count, scratch, floor=0.0):  # type: ignore[no-untyped-def]
    """`epsilon_with` without allocation: -1.0 where the scratch is too small."""
    if count > scratch.values.shape[0]:
        return OVERFLOW
    if count == 0:
        return 0.0
    scale = 0.0
    for i in range(count):
        for k in range(6):
            size = abs(wrenches[i, k])
            if not size < _HUGE:
                return np.nan
            scale = max(scale, size)
    if scale < 1.0 / _HUGE:
        return 0.0
    for i in range(count):
        for k in range(6):
            scratch.columns[k, i] = wrenches[i, k] / scale
    least = max(floor / scale, LEAST)
    support, reach = farthest_vertex(scratch, count, _FIRST_REACH, least)
    if reach >= _FIRST_REACH * support and support > least * reach:  # rounding is larger in a larger search
        support, reach = farthest_vertex(scratch, count, _LAST_REACH, least)
    if reach == OVERFLOW:
        return OVERFLOW
    return 0.0 if support <= least * reach else scale * (min(support, 1.0) / reach)


@njit(cache=True, error_model="numpy")
def epsilon_with(wrenches, count, scratch, floor=0.0):  # type: ignore[no-untyped-def]
    """`epsilon` of the first `count` rows of `wrenches` (W, 6), in `scratch`; more is allocated in the rare need.

    `floor`: an epsilon that turns out not to exceed it is returned as 0.0, sooner.
    """
    quality = epsilon_within(wrenches, count, scratch, floor)
    room = scratch.squared.shape[0]
    while quality == OVERFLOW:
        room *= 4
        quality = epsilon_within(wrenches, count, polar_scratch(count, room), floor)
    return quality


@njit(cache=True, error_model="numpy")
def epsilon(wrenches):  # type: ignore[no-untyped-def]
    """Radius of the largest origin-centred ball in the hull of `wrenches`; 0.0 without force closure.

    epsilon = 1 / max |x| over the polar polytope {x : w_i . x <= 1}, found with a proof: see `polar`. Never too large;
    too small by at most 1e-10 of itself (1e-7 of itself below 1e-3). 0.05 ms for a typical grasp, Qhull 32 ms.

    Args:
        wrenches: (W, 6) float64, see `wrench_space.grasp_wrenches`.
    Returns:
        nan when a wrench is not finite.
    """
    return epsilon_with(wrenches, len(wrenches), epsilon_scratch(len(wrenches)))


def epsilon_qhull(wrenches: np.ndarray) -> float:
    """The same quality from a full convex hull in 6D (Qhull, joggled input): slow, the reference of the tests."""
    if len(wrenches) < 7:
        return 0.0
    try:
        hull = ConvexHull(np.asarray(wrenches, np.float64), qhull_options="QJ")
    except QhullError:
        return 0.0
    radius = float(-hull.equations[:, -1].max())
    return radius if radius > 1e-9 else 0.0
