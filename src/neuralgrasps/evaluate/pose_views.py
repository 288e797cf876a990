"""What the sensor makes of a thing in a room: depth, the mask an estimator is given, and the share that is visible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from neuralgrasps.evaluate.pose_occluders import Placed, own_depth
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, render_depth_view

HARD_NOISE = replace(STRUCTURED_LIGHT, white_m=0.0025, scale_error=0.003, bias_m=0.003)
"""The sensor of the hard scenes: 2.5 mm more noise, 0.3 % too far, and a smooth error of 3 mm."""
SPILL_M = 0.003
"""How far the mask of a hard scene reaches over the object's edge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """One thing as the sensor sees it.

    Attributes:
        depth: (h, w) float32 z-depth, metres; 0 = nothing measured.
        mask: (h, w) bool, what an instance segmentation gives: pixels with a measurement.
        true_mask: (h, w) bool, pixels on the thing, measured or not.
        visible_share: share of the pixels it would have alone that the thing has, and that the sensor's projector
            sees too: nothing is measured in the shadow that a thing in front throws beside itself.
    """

    depth: np.ndarray
    mask: np.ndarray
    true_mask: np.ndarray
    visible_share: float


def see(
    target: Placed,
    things: Sequence[Placed],
    room: Mesh,
    *,
    X_WC: np.ndarray,
    intrinsics: Intrinsics,
    hard: bool,
    seed: int,
) -> Sight:
    """Look at a target among things in a room from `X_WC`; `hard`: with that sensor, and a mask that spills over."""
    placed = (target, *things)
    view = render_depth_view(
        [*(p.body.mesh for p in placed), room],
        np.stack([*(p.X_WB for p in placed), np.eye(4)]),
        X_WC=X_WC,
        intrinsics=intrinsics,
        noise=HARD_NOISE if hard else STRUCTURED_LIGHT,
        seed=seed,
    )
    true_mask = view.mesh_index == 0
    own = np.isfinite(own_depth(target, X_WC, intrinsics))
    distance = float((target.centre_W - X_WC[:3, 3]) @ X_WC[:3, 2])
    mask = spilled(true_mask, distance, intrinsics) if hard else true_mask
    return Sight(
        depth=view.depth, mask=mask & (view.depth > 0), true_mask=true_mask,
        visible_share=float((true_mask & view.lit).sum() / max(own.sum(), 1)),
    )  # fmt: skip


def spilled(mask: np.ndarray, depth_m: float, intrinsics: Intrinsics) -> np.ndarray:
    """A mask (h, w) grown by `SPILL_M` at a depth."""
    pixels = SPILL_M * intrinsics.fx / depth_m
    return np.asarray(ndimage.distance_transform_edt(~mask) <= pixels)
