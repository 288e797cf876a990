"""What speaks against a fitted hand: the signs of a wrong basin, in words. Torch-free."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.hands.packed import hand_distance_many
from neuralgrasps.model.fit_config import Fit, Search
from neuralgrasps.model.fit_prior import posed_points
from neuralgrasps.model.fit_search import EFFECTIVE_POINTS, CloudSearch

UNEXPLAINED_SHARE = 0.04
OUTLIER_SHARE = 0.25
TOUCH_M = 0.005
DEPTH_M = 0.006
AMBIGUOUS_M = 0.005  # two fits whose surfaces are this far apart in the mean are different grasps
AMBIGUOUS_UNITS = 6.0  # twice the logarithm of how much likelier the better one must be
EMPTY_M = 0.015  # hand this far from any point, beyond the noise, was not observed
EMPTY_SHARE = 0.10


def doubts(one: CloudSearch, found: Search) -> tuple[str, ...]:
    """Reasons to suspect the best fit of a search; none when it looks right."""
    best = found.fits[0]
    reasons = [_residual(one, found), *_outliers(one, found), _touch(one, best), _depth(one, best), _empty(one, best)]
    reasons.append(_ambiguity(one, found))
    if not best.stopped:
        reasons.append("the solver did not converge")
    return tuple(reason for reason in reasons if reason)


def _residual(one: CloudSearch, found: Search) -> str:
    if found.excess <= one.config.good:
        return ""
    rms = float(np.sqrt((found.fits[0].distance_m[~found.aside] ** 2).mean()))
    return f"points are {1e3 * rms:.1f} mm (rms) from the hand; their noise is {1e3 * found.noise_m:.1f} mm"


def _outliers(one: CloudSearch, found: Search) -> tuple[str, ...]:
    """Too many points set aside; too many others that the hand does not explain."""
    reasons = []
    if found.outliers > OUTLIER_SHARE:
        reasons.append(f"{100 * found.outliers:.0f} % of the points are outliers or the object's")
    share = float((one.unexplained(found.fits[0].distance_m) & ~found.aside).mean())
    if share > UNEXPLAINED_SHARE:
        reasons.append(f"{100 * share:.0f} % of the points are not explained by the hand")
    return tuple(reasons)


def _touch(one: CloudSearch, best: Fit) -> str:
    """A hand farther from the object than any known grasp is no grasp."""
    least = float(query_grid_numpy(one.sdf, posed_points(one.packed, best.X_OH, best.q, one.prior.probe)).min())
    if least <= max(TOUCH_M, one.prior.reach_m) + one.noise_m:
        return ""
    return f"the hand touches nothing: it is {1e3 * least:.0f} mm from the object"


def _depth(one: CloudSearch, best: Fit) -> str:
    surface = posed_points(one.packed, best.X_OH, best.q, one.prior.probe)
    depth = -float(query_grid_numpy(one.sdf, surface).min())
    return f"the hand is {1e3 * depth:.0f} mm inside the object" if depth > DEPTH_M else ""


def _empty(one: CloudSearch, best: Fit) -> str:
    """Surface that should have been observed and was not: all of the hand, or what the camera must see of it."""
    if one.config.coverage == 0.0 and one.viewpoint_O is None:
        return ""
    chosen = one.prior.material
    if one.viewpoint_O is not None:
        chosen = chosen[one.visible(best.X_OH, best.q)]
    if not len(chosen):
        return "the camera sees nothing of the hand"
    gap = KDTree(one.cloud).query(posed_points(one.packed, best.X_OH, best.q, chosen))[0]
    share = float((gap > EMPTY_M + 3.0 * one.noise_m).mean())
    return f"{100 * share:.0f} % of the hand should have points near and has none" if share > EMPTY_SHARE else ""


def _ambiguity(one: CloudSearch, found: Search) -> str:
    """Another fit with another surface; the two ways round of a parallel jaw are one."""
    best = found.fits[0]
    close = best.cost + AMBIGUOUS_UNITS * one.noise_m**2 / EFFECTIVE_POINTS
    for other in found.fits[1:]:
        if other.cost >= close:
            continue
        surface = posed_points(one.packed, other.X_OH, other.q, one.prior.material)
        distance = np.empty(len(surface))
        hand_distance_many(one.packed, best.X_OH, best.q, surface, distance)
        apart = float(np.abs(distance).mean())
        if apart > AMBIGUOUS_M:
            return f"another fit, {1e3 * apart:.0f} mm away, is nearly as good"
    return ""
