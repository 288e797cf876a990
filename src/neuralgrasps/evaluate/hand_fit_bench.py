"""How well the hand model is fitted: to joints with noise and the depth points of a roughly known mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np

from neuralgrasps.evaluate.hand_fit_frames import HandFrame, hand_frames
from neuralgrasps.evaluate.hand_surface import posed_surface, surface_rms
from neuralgrasps.geometry.camera import project
from neuralgrasps.human.fit.hand_cloud import hand_cloud
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.fit.hand_size import fit_size
from neuralgrasps.human.nets.joint_errors import root_relative_error
from neuralgrasps.human.seen import FittedHand, SeenJoints, Side
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng

NOISE_M = 0.010
"""Standard deviation of each coordinate of a seen joint; its error is 17 mm long (root mean square)."""
_VIEWS = 6
_FRONT_M = 0.004
_BAD_M = 0.010
_LEAST_VISIBLE = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class FitErrors:
    """What one fit is off, metres.

    Attributes:
        surface: root mean square distance of points spread over the true hand's surface to the fitted surface; front:
            the same of the points that the camera sees.
        root: mean distance of the joints to the true ones, wrists put on each other; seen_root: before the fit.
        visible: share of the hand that nothing hides. confidence: of the fit. seconds: processor time.
    """

    surface: float
    front: float
    root: float
    seen_root: float
    visible: float
    confidence: float
    seconds: float


def hand_fit_figures(objects: Sequence[ObjectModel], *, count: int, seed: int) -> dict[str, float]:
    """Figures of the fit over about `count` frames: people who hold objects on a table, six views of each grasp.

    Depth has a structured-light camera's noise. The mask is the true one, a pixel too large, too small or right, with
    5 % of pixels from around it. The object and its pose are known. `fit_` figures: the size is known, every coordinate
    of every joint has noise of 10 mm; `fit_10mm_length_`: the error's length has a root mean square of 10 mm instead;
    `fit_sized_`: as the first, but the size is estimated once from the six views. `_rms_mm`: mean over the frames
    of the root mean square distance of the true surface to the fitted one; `_pooled_rms_mm`: over all points at once.
    `_worse_10mm`: share of frames whose figure is above 10 mm. `fit_side_right`: share of frames whose mirror image
    fits worse.
    """
    groups: dict[tuple[str, float, int], list[HandFrame]] = {}
    for i, shown in enumerate(hand_frames(objects, count=-(-count // _VIEWS), seed=seed, views=_VIEWS)):
        groups.setdefault((shown.obj.name, shown.scale, i // _VIEWS), []).append(shown)
    known, shorter, sized, sizes, sides = [], [], [], [], []
    for k, group in enumerate(groups.values()):
        frames = [f for f in group if f.visible > _LEAST_VISIBLE]
        if not frames:
            continue
        rng = child_rng(seed, "joint noise", k)
        seen = [noisy_joints(f, NOISE_M, rng) for f in frames]
        nearer = [noisy_joints(f, NOISE_M / np.sqrt(3.0), rng) for f in frames]
        known += [measure_fit(f, s, scale=f.scale) for f, s in zip(frames, seen, strict=True)]
        shorter += [measure_fit(f, s, scale=f.scale) for f, s in zip(frames, nearer, strict=True)]
        scale = fit_size(
            seen, [_cloud(f, s) for f, s in zip(frames, seen, strict=True)], side="right",
            objs=[(f.obj, f.X_CO) for f in frames],
        )  # fmt: skip
        sizes.append(abs(scale / frames[0].scale - 1.0))
        sized += [measure_fit(f, s, scale=scale) for f, s in zip(frames, seen, strict=True)]
        sides += [_is_right(f, s) for f, s in zip(frames, seen, strict=True)]
    out = {**_figures(known, "fit"), **_figures(shorter, "fit_10mm_length"), **_figures(sized, "fit_sized")}
    out["fit_size_error"] = float(np.mean(sizes)) if sizes else float("nan")
    out["fit_side_right"] = float(np.mean(sides)) if sides else float("nan")
    out["fit_ms"] = 1e3 * float(np.median([e.seconds for e in known])) if known else float("nan")
    return out


def noisy_joints(shown: HandFrame, sd_m: float, rng: np.random.Generator) -> SeenJoints:
    """The true joints with independent Gaussian noise of `sd_m` on every coordinate."""
    points_C = shown.joints_C + sd_m * rng.standard_normal((21, 3))
    return SeenJoints(points_C=points_C, weight=np.ones(21), mask=shown.mask, side="right", source="noise")


def measure_fit(shown: HandFrame, seen: SeenJoints, *, scale: float) -> FitErrors:
    """Fit one frame, and measure it."""
    cloud = _cloud(shown, seen)
    begun = process_time()
    fitted = _fit(shown, seen, cloud, side="right", scale=scale)
    spent = process_time() - begun
    surface_C = posed_surface("right", shown.scale, shown.X_CH, shown.q)
    front_C = surface_C[is_front(shown, surface_C)]
    return FitErrors(
        surface=surface_rms(fitted, surface_C),
        front=surface_rms(fitted, front_C) if len(front_C) else float("nan"),
        root=float(root_relative_error(fitted.joints_C, shown.joints_C)),
        seen_root=float(root_relative_error(seen.points_C, shown.joints_C)),
        visible=shown.visible,
        confidence=fitted.confidence,
        seconds=spent,
    )


def is_front(shown: HandFrame, points_C: np.ndarray) -> np.ndarray:
    """(K,) bool: points of the true hand's surface that the camera sees."""
    k = shown.frame.intrinsics
    pixel = np.rint(project(points_C, k)).astype(np.int64)
    inside = (pixel >= 0).all(axis=1) & (pixel < [k.width, k.height]).all(axis=1)
    out, (u, v) = np.zeros(len(points_C), bool), pixel[inside].T
    out[inside] = shown.true_mask[v, u] & (points_C[inside, 2] < shown.true_depth[v, u] + _FRONT_M)
    return out


def _cloud(shown: HandFrame, seen: SeenJoints) -> np.ndarray:
    return hand_cloud(shown.frame, seen, obj=(shown.obj, shown.X_CO))


def _fit(shown: HandFrame, seen: SeenJoints, cloud: np.ndarray, *, side: Side, scale: float) -> FittedHand:
    return fit_hand(seen, cloud, side=side, scale=scale, obj=(shown.obj, shown.X_CO))


def _is_right(shown: HandFrame, seen: SeenJoints) -> bool:
    """Whether the true side fits better than its mirror image, by the points and by the joints."""
    cloud = _cloud(shown, seen)
    right = _fit(shown, seen, cloud, side="right", scale=shown.scale)
    left = _fit(shown, seen, cloud, side="left", scale=shown.scale)
    return right.confidence > left.confidence


def _figures(errors: Sequence[FitErrors], name: str) -> dict[str, float]:
    if not errors:
        return {}
    surface = np.array([e.surface for e in errors])
    return {
        f"{name}_rms_mm": 1e3 * float(surface.mean()),
        f"{name}_pooled_rms_mm": 1e3 * float(np.sqrt(np.mean(surface**2))),
        f"{name}_rms_p90_mm": 1e3 * float(np.percentile(surface, 90.0)),
        f"{name}_front_rms_mm": 1e3 * float(np.nanmean([e.front for e in errors])),
        f"{name}_root_relative_mm": 1e3 * float(np.mean([e.root for e in errors])),
        f"{name}_seen_root_relative_mm": 1e3 * float(np.mean([e.seen_root for e in errors])),
        f"{name}_worse_10mm": float(np.mean(surface > _BAD_M)),
    }
