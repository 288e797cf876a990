"""How well a fitted hand explains what was seen of it: what decides between sides, sizes and cameras."""

from __future__ import annotations

from functools import cache

import numpy as np

from neuralgrasps.hands.packed import PackedHand, hand_distance_many, pack_shapes
from neuralgrasps.human.seen import FittedHand, Side
from neuralgrasps.human.skeleton import human_hand

_CUT_M = 0.015


def misfit(fitted: FittedHand, cloud_C: np.ndarray) -> float:
    """How badly a fitted hand explains what was seen: mean distance of the points (M, 3), each cut at 15 mm, metres.

    The joints' errors count a third: they may all be off in the same way.
    """
    apart = _CUT_M
    if len(cloud_C):
        out = np.empty(len(cloud_C))
        X_CH = fitted.X_CH.copy()
        X_CH[:3, 3] /= fitted.scale
        hand_distance_many(_shapes(fitted.side), X_CH, fitted.q, cloud_C / fitted.scale, out)
        apart = float(np.minimum(fitted.scale * np.abs(out), _CUT_M).mean())
    return float(np.hypot(apart, np.nan_to_num(fitted.joint_rms_m) / 3.0))


@cache
def _shapes(side: Side) -> PackedHand:
    return pack_shapes(human_hand(side))
