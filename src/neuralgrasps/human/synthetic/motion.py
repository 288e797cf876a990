"""The motion of a demonstration in time: come, close, keep still, lift, keep still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.human.synthetic.hand_path import HandPath


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """T frames of a hand and an object in W.

    Attributes:
        X_WH: (T, 4, 4) the hand; q: (T, J) its joints; X_WO: (T, 4, 4) the object.
        still: first frame of the closed hand keeping still, and the first after these; grasp_frame: their middle.
    """

    X_WH: np.ndarray
    q: np.ndarray
    X_WO: np.ndarray
    still: tuple[int, int]

    @property
    def grasp_frame(self) -> int:
        return (self.still[0] + self.still[1] - 1) // 2

    def keeps(self, t: int) -> bool:
        """Whether nothing moved since the frame before."""
        return t > 0 and all(np.array_equal(x[t], x[t - 1]) for x in (self.X_WH, self.q, self.X_WO))


def demonstration_motion(
    path: HandPath, X_WO: np.ndarray, *, still_frames: tuple[int, int], lift: bool, rng: np.random.Generator
) -> Motion:
    """A hand that follows `path` to the object at X_WO (4, 4), keeps still, and perhaps lifts it 0.08 to 0.18 m."""
    coming, closing = int(rng.integers(12, 18)), int(rng.integers(5, 9))
    still = int(rng.integers(still_frames[0], still_frames[1] + 1))
    lifting, held = (int(rng.integers(8, 12)), int(rng.integers(3, 7))) if lift else (0, 0)
    # the hand slows down before it closes: the last part of the way takes as long as the closing
    far = 1.0 - (1.0 - path.blend) * smooth(np.arange(coming) / coming)
    near = path.blend * (1.0 - smooth_end(np.arange(closing) / closing))
    after = np.zeros(still + lifting + held)
    away = np.concatenate([far, near, after])
    closed = np.concatenate([np.zeros(coming), smooth(np.arange(closing) / closing), np.ones(len(after))])
    rise = np.concatenate([
        np.zeros(coming + closing + still), smooth(np.arange(1, lifting + 1) / max(lifting, 1)), np.ones(held),
    ])  # fmt: skip
    way = np.array([rng.normal(0.0, 0.02), rng.normal(0.0, 0.02), rng.uniform(0.08, 0.18)])
    X_WH, q = path.poses(away), path.joints(closed)
    X_WH[coming + closing :] = path.X_WH
    q[coming + closing :] = path.q
    X = np.tile(X_WO, (len(q), 1, 1))
    X_WH[:, :3, 3] += rise[:, None] * way
    X[:, :3, 3] += rise[:, None] * way
    return Motion(X_WH=X_WH, q=q, X_WO=X, still=(coming + closing, coming + closing + still))


def smooth(t: np.ndarray) -> np.ndarray:
    """From 0 at 0 to 1 at 1, at rest at both ends with the least jerk (Flash and Hogan 1985)."""
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def smooth_end(t: np.ndarray) -> np.ndarray:
    """From 0 at 0 to 1 at 1, at rest at the end only."""
    return 1.0 - (1.0 - t) ** 2
