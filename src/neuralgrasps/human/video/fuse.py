"""Several frames of one still hand as one: joints averaged, clouds merged, one fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.human.fit.hand_cloud import merged_cloud
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.seen import FittedHand, SeenJoints
from neuralgrasps.human.video.hand_video import HandVideo

_ROUNDS = 4  # of reweighting
_CUT_M = 0.010  # a joint so far from the mean counts half


def mean_joints(seen: Sequence[SeenJoints], X_CF: Sequence[np.ndarray]) -> SeenJoints:
    """The robust weighted mean of joints seen in several frames F, each moved by X_CF (4, 4) into the frame C.

    The weight of a joint is the mean of its weights, less where the frames disagree. The mask is not known.
    """
    points = np.stack([s.points_C @ X[:3, :3].T + X[:3, 3] for s, X in zip(seen, X_CF, strict=True)])
    trust = np.where(np.isfinite(points).all(axis=-1), np.stack([s.weight for s in seen]), 0.0)
    points = np.where(trust[..., None] > 0, points, 0.0)
    known = trust.sum(axis=0) > 0
    weight, mean = trust, points[0]
    for _ in range(_ROUNDS):
        mean = (weight[..., None] * points).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)[:, None]
        off = np.linalg.norm(points - mean, axis=-1)
        weight = trust / (1.0 + (off / _CUT_M) ** 2)
    agree = weight.sum(axis=0) / np.maximum(trust.sum(axis=0), 1e-9)
    return SeenJoints(
        points_C=np.where(known[:, None], mean, np.nan),
        weight=trust.mean(axis=0) * agree,
        mask=None,
        side=seen[0].side,
        source=f"{seen[0].source}, {len(seen)} frames",
    )


def fused_fit(video: HandVideo, numbers: Sequence[int], target: int) -> tuple[FittedHand, np.ndarray]:
    """One fit to frames that show a still hand, in the camera frame of `target`, and the merged cloud (M, 3) it used.

    The fit of the target frame decides which points are the hand's for the first round, that one for the second.

    Args:
        numbers: at least one frame, all with seen joints, `target` among them.
    """
    shown = [(n, seen, video.to_frame(n, target)) for n in numbers if (seen := video.see(n)) is not None]
    mean = mean_joints([s for _, s, _ in shown], [X for _, _, X in shown])
    fitted = video.fit(target)
    assert fitted is not None
    cloud = np.zeros((0, 3))
    for reach_m in (video.cloud_config.reach_m, 0.8 * video.cloud_config.reach_m):
        moved = [_cloud(video, n, s, fitted, X, reach_m) for n, s, X in shown]
        cloud = merged_cloud(moved, least=2 if len(shown) >= 5 else 1)
        fitted = fit_hand(mean, cloud, side=video.side, scale=video.scale, start=fitted, obj=video.held(target))
    return fitted, cloud


def _cloud(
    video: HandVideo, number: int, seen: SeenJoints, fitted: FittedHand, X_CF: np.ndarray, reach_m: float
) -> np.ndarray:
    """A frame's points near the joints of a hand fitted in C, moved to C."""
    joints_F = (fitted.joints_C - X_CF[:3, 3]) @ X_CF[:3, :3]
    cloud = video.cloud_near(number, replace(seen, points_C=joints_F), reach_m=reach_m)
    return cloud @ X_CF[:3, :3].T + X_CF[:3, 3]


def seen_share(video: HandVideo, number: int, fitted: FittedHand) -> float:
    """Share of a fitted hand's joints that a frame shows: their pixel measures the flesh round the joint."""
    frame, seen = video.frames[number], video.see(number)
    k, p = frame.intrinsics, fitted.joints_C
    u = np.round(k.fx * p[:, 0] / p[:, 2] + k.cx).astype(int)
    v = np.round(k.fy * p[:, 1] / p[:, 2] + k.cy).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < k.width) & (v < k.height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    shown = np.zeros(len(p), bool)
    for dv, du in np.ndindex(3, 3):  # a pixel without depth, or a ragged mask, hides no joint
        row, column = np.clip(v + dv - 1, 0, k.height - 1), np.clip(u + du - 1, 0, k.width - 1)
        z = frame.depth[row, column]
        one = (z > 0) & (p[:, 2] - z > -0.01) & (p[:, 2] - z < 0.03)
        if seen is not None and seen.mask is not None:
            one &= seen.mask[row, column]
        shown |= one
    return float((shown & inside).mean())
