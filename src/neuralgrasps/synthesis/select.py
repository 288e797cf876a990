"""Choose diverse grasps: farthest point sampling over hand pose and joints together."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.hands.hand import Hand

METRES_PER_RADIAN = 0.05  # a turn of 1 rad counts as a shift of 5 cm
METRES_PER_RANGE = 0.05  # a joint moved over its whole range counts as a shift of 5 cm


def grasp_features(hand: Hand, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N, D) features in metres whose Euclidean distance compares grasps of one hand.

    Palm position, palm axes scaled so that a small turn counts `METRES_PER_RADIAN` per rad, and joints over
    their range. A parallel jaw that is turned by 180 degrees about its approach is the same grasp:
    its closing axis enters as an outer product, which has no sign.
    """
    X_OP = X_OH @ hand.X_HP
    span = hand.tree.upper - hand.tree.lower
    joints = (q - hand.tree.lower) / span * METRES_PER_RANGE / np.sqrt(hand.num_dofs)
    closing, approach = X_OP[:, :3, 0], X_OP[:, :3, 2]
    if hand.is_jaw:
        unsigned = closing[:, :, None] * closing[:, None, :]
        turn = np.concatenate([unsigned.reshape(len(q), 9) / np.sqrt(2.0), approach], axis=1)
    else:
        turn = np.concatenate([closing, approach], axis=1)
    return np.concatenate([X_OP[:, :3, 3], turn * METRES_PER_RADIAN, joints], axis=1)


def diverse_order(
    hand: Hand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    start: int,
    count: int | None = None,
    quality: np.ndarray | None = None,
) -> np.ndarray:
    """Indices (count,) of grasps in farthest-point order, beginning with grasp `start`.

    With `quality` (N,), > 0, distances count in proportion to it: of two grasps that are as new, the better one comes
    first, and a poor one only where nothing else is near.
    """
    features = grasp_features(hand, X_OH, q)
    wanted = len(features) if count is None else min(count, len(features))
    if quality is None:
        return farthest_points(features, wanted, start=start)
    return _farthest_weighted(features, np.maximum(quality, 0.0), wanted, start)


def _farthest_weighted(features: np.ndarray, weight: np.ndarray, count: int, start: int) -> np.ndarray:
    chosen = np.empty(count, np.int64)
    nearest, taken, last = np.full(len(features), np.inf), np.zeros(len(features), bool), start
    for i in range(count):
        chosen[i], taken[last] = last, True
        nearest = np.minimum(nearest, np.linalg.norm(features - features[last], axis=1))
        last = int(np.where(taken, -1.0, nearest * weight).argmax())
    return chosen
