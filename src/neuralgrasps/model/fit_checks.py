"""What speaks against a fitted hand: the signs of a wrong basin, in words. Torch-free."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.model.fit_prior import posed_points
from neuralgrasps.model.fit_search import CloudSearch, Search

OUTLIER_SIGMAS = 4.0
OUTLIER_SHARE = 0.04
DEPTH_M = 0.006
AMBIGUOUS_M = 0.01  # two fits this far apart (mean over the hand's surface) are different grasps


def doubts(one: CloudSearch, found: Search) -> tuple[str, ...]:
    """Reasons to suspect the best fit of a search; none when it looks right."""
    best, reasons = found.fits[0], []
    rms = float(np.sqrt((best.distance_m**2).mean()))
    if found.excess > one.config.good:
        reasons.append(f"points are {1e3 * rms:.1f} mm (rms) from the hand; their noise is {1e3 * found.noise_m:.1f} mm")
    outside = float((np.abs(best.distance_m) > OUTLIER_SIGMAS * found.noise_m + 0.001).mean())
    if outside > OUTLIER_SHARE:
        reasons.append(f"{100 * outside:.0f} % of the points are not explained by the hand")
    surface = posed_points(one.packed, best.X_OH, best.q, one.prior.probe)
    depth = -float(query_grid_numpy(one.sdf, surface).min())
    if depth > DEPTH_M:
        reasons.append(f"the hand is {1e3 * depth:.0f} mm inside the object")
    if not best.stopped:
        reasons.append("the solver did not converge")
    return tuple(reasons)
