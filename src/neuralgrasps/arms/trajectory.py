"""The `Trajectory` noun: joint positions and speeds over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import ShapeError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Motion of the planned joints of an arm.

    Attributes:
        joint_names: D names.
        t: (T,) float64 seconds, 0 first, strictly rising; T >= 2.
        q: (T, D) positions, rad or metres; qd: (T, D) speeds; between samples the motion is the cubic that meets both.
    """

    joint_names: tuple[str, ...]
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray

    def __post_init__(self) -> None:
        shape = (len(self.t), len(self.joint_names))
        if self.q.shape != shape or self.qd.shape != shape:
            raise ShapeError(f"trajectory: q and qd have shapes {self.q.shape}, {self.qd.shape}; expected {shape}.")
        if len(self.t) < 2 or self.t[0] != 0.0 or not (np.diff(self.t) > 0).all():
            raise ShapeError("trajectory: t must start at 0 and rise; expected at least two samples.")

    @property
    def duration_s(self) -> float:
        return float(self.t[-1])

    def reversed(self) -> Trajectory:
        """The same motion backwards, as fast."""
        t, q, qd = self.t[-1] - self.t[::-1], self.q[::-1].copy(), -self.qd[::-1]
        return Trajectory(joint_names=self.joint_names, t=t, q=q, qd=qd)

    def sample(self, t: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Positions and speeds (..., D) at times (...), held at both ends."""
        t = np.clip(np.asarray(t, float), 0.0, self.t[-1])
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = (self.t[i + 1] - self.t[i])[..., None]
        s = (t - self.t[i])[..., None] / h
        q0, q1, v0, v1 = self.q[i], self.q[i + 1], self.qd[i] * h, self.qd[i + 1] * h
        a, b = 2.0 * (q0 - q1) + v0 + v1, 3.0 * (q1 - q0) - 2.0 * v0 - v1  # cubic Hermite
        return ((a * s + b) * s + v0) * s + q0, ((3.0 * a * s + 2.0 * b) * s + v0) / h
