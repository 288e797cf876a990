"""Effort and noise model of a search for a hand, and what it starts from and finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class InferConfig:
    """Effort and noise model of `infer_grasps`.

    Attributes:
        noise_m: standard deviation of the points off the surface, metres; None: estimated from each fit.
        points: observed points used in the last stage (a random subset when there are more).
        coarse_points: used while choosing among the starts; middle_points: in the stage between.
        starts: best starts that are improved; middle: of these, how many go on; finalists: how many to the end.
        coarse_iterations, middle_iterations, fine_iterations: least-squares steps.
        coverage: weight of "every part of the hand has an observed point near it", against 1 for the points; set it
            to 0 for a partial view.
        view: weight of "hand that the camera must see has an observed point near it", where its place is told.
        prior: weight of what is known of grasps (usual postures, tips touch, nothing goes through the object).
        rounds: at most; later ones only while the points do not fit.
        variations: starts scored per later round; vary_rad, vary_m, vary_joint: their spread (joints: share of range).
        good: mean squared distance of the points, in units of the noise's variance, up to which they fit.
    """

    noise_m: float | None = None
    points: int = 1024
    coarse_points: int = 64
    middle_points: int = 160
    starts: int = 16
    middle: int = 6
    finalists: int = 2
    coarse_iterations: int = 8
    middle_iterations: int = 12
    fine_iterations: int = 30
    coverage: float = 1.0
    view: float = 1.0
    prior: float = 1.0
    rounds: int = 8
    variations: int = 200
    vary_rad: float = 0.3
    vary_m: float = 0.01
    vary_joint: float = 0.1
    good: float = 1.2
    seed: int = 0

    def __post_init__(self) -> None:
        counts = ("points", "coarse_points", "middle_points", "starts", "middle", "finalists", "rounds", "variations")
        for name in counts:
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected at least 1.")
        if self.noise_m is not None and self.noise_m < 0.0:
            raise InputError(f"noise_m is {self.noise_m}; expected 0 or more metres, or None to estimate it.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Starts:
    """Grasps to start from, or found: X_OH (N, 4, 4), q (N, J)."""

    X_OH: np.ndarray
    q: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def take(self, index: np.ndarray) -> Starts:
        return Starts(X_OH=np.ascontiguousarray(self.X_OH[index]), q=np.ascontiguousarray(self.q[index]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """One fit.

    Attributes:
        X_OH: (4, 4), q: (J,): the hand.
        cost: what was lowered, square metres; distance_m: (M,) signed distances of the points used.
        stopped: the solver stopped by itself.
    """

    X_OH: np.ndarray
    q: np.ndarray
    cost: float
    distance_m: np.ndarray
    stopped: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """What a search found.

    Attributes:
        fits: all different ones, best first. noise_m: that it went by; rounds: it took.
        aside: (M,) bool, points used that are no hand's by the best fit: alone, or on the object.
        outliers: share of all points that are no hand's, those that were left out before any fit among them.
        excess: mean squared distance of the other points, in units of the noise's variance.
    """

    fits: tuple[Fit, ...]
    noise_m: float
    aside: np.ndarray
    outliers: float
    excess: float
    rounds: int
