"""How a human hand is fitted: usual errors of what is seen, weights, and effort."""

from __future__ import annotations

from dataclasses import dataclass

from neuralgrasps.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFitConfig:
    """How a hand is fitted.

    Attributes:
        points: of the cloud that are used; fewer than 30 are as good as none.
        joint_sd_m: length of the usual error of a seen joint of weight 1 (root mean square of its three coordinates'
            errors, each 1 / sqrt(3) of it); joint_width_m: beyond it an error counts less and less.
        cloud_sd_m: of a depth point, what the points' errors have in common included; cloud_width_m: points farther
            from the hand are soon left out; first_width_m: the same while the hand is still far off.
        free_sd_m, free_slack_m: of hand in front of what is measured; 0 leaves it out.
        deep_sd_m, deep_slack_m: of hand inside the object; touch_sd_m, touch_width_m: of fingertips near its surface,
            which usually lie on it.
        freedom: of the t distribution of postures; small: unusual postures cost little.
        scale_mean, scale_sd: usual size, and its relative standard deviation, where the size is fitted.
        iterations: most steps with the cloud; starts: how many different starts are followed with it.
        again_below: a fit of less confidence is tried again from more starts, which takes three times as long.
    """

    points: int = 400
    joint_sd_m: float = 0.017
    joint_width_m: float = 0.025
    cloud_sd_m: float = 0.002
    cloud_width_m: float = 0.006
    first_width_m: float = 0.03
    free_sd_m: float = 0.01
    free_slack_m: float = 0.006
    free_width_m: float = 0.015
    deep_sd_m: float = 0.002
    deep_slack_m: float = 0.001
    touch_sd_m: float = 0.005
    touch_width_m: float = 0.02
    freedom: float = 8.0
    scale_mean: float = 0.79
    scale_sd: float = 0.08
    iterations: int = 15
    starts: int = 1
    again_below: float = 0.97

    def __post_init__(self) -> None:
        for name in ("joint_sd_m", "cloud_sd_m", "deep_sd_m", "freedom", "scale_mean", "scale_sd"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a number above 0.")
