"""What planning asks of a collision checker and needs to know of a robot."""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol

import numpy as np


class JointLimits(Protocol):
    """What planning needs to know of a robot; `Manipulator` has it. All (D,): rad or metres, per second."""

    @property
    def lower(self) -> np.ndarray: ...
    @property
    def upper(self) -> np.ndarray: ...
    @property
    def velocity(self) -> np.ndarray: ...
    @property
    def continuous(self) -> np.ndarray: ...


class ConfigurationChecker(Protocol):
    """What planning asks of a collision checker; `CollisionChecker` has it."""

    @property
    def manipulator(self) -> JointLimits: ...
    def is_free(self, q_arm: np.ndarray) -> np.ndarray:
        """(N,) bool for postures (N, D)."""
        ...

    def edge_is_free(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether the straight joint line between two postures (D,), ends included, is free."""
        ...

    def describe(self, q_arm: np.ndarray) -> str:
        """What touches what at a posture (D,), "" when nothing does."""
        ...


class CountedChecker:
    """A checker of edges that counts what it was asked for."""

    def __init__(self, checker: ConfigurationChecker) -> None:
        self.checker, self.checks = checker, 0

    def __call__(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        self.checks += 1
        return bool(self.checker.edge_is_free(q0, q1))

    def all_free(self, q: np.ndarray) -> bool:
        """Whether all edges between waypoints (T, D) are free."""
        return all(self(a, b) for a, b in pairwise(q))
