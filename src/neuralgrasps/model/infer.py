"""Codes of grasps that are only observed: hand points on an object, no joints, no labels.

Two levels. `encode_points` gives the contact block alone, straight from the points: enough to
retrieve. `infer_grasps` also finds the hand's pose and joints by fitting its exact distance to the points
from many starts, and recomputes the contact block from the fitted hand: the estimate with the highest posterior
under a robust point noise and a weak prior on posture. Encoding known joints (`KinematicField.encode`) is no inference.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree

from neuralgrasps.dataset.hand_surface import packed_link_poses
from neuralgrasps.dataset.samples import closeness, hand_distances
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.rotation import exp_so3
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.model.codes import CODE_SIZE, CONTACT_BLOCK, CodeBook, contact_blocks
from neuralgrasps.model.hand_fit import fit_cost, fit_hand, score_starts
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.seeds import child_rng


@dataclass(frozen=True, slots=True, kw_only=True)
class InferConfig:
    """Effort and noise model of `infer_grasps`.

    Attributes:
        points: observed points used in the last stage (an even subset when there are more).
        coarse_points: used while choosing among the starts.
        starts: grasps of the gallery to start from; finalists: of these, how many are refined to the end.
        coarse_iterations, fine_iterations: least-squares steps.
        width_m: distances beyond it count linearly, in the last stage (ten times as much in the first).
        coverage: weight of "every part of the hand has an observed point near it" in the first stage; set it to 0
            for a partial view.
        posture_prior_m: how far (rms metres of the points) one full joint range off the start counts.
        rounds: at most; later ones start from random variations, and only while no fit is good.
        variations: random starts scored per later round; vary_rad, vary_m, vary_joint: their spread (joints: share of
            range).
        good_m: mean point distance at which the search stops; set it above the noise of the points.
        converged_m: largest mean point distance that counts as a fit.
    """

    points: int = 512
    coarse_points: int = 192
    starts: int = 16
    finalists: int = 4
    coarse_iterations: int = 12
    fine_iterations: int = 40
    width_m: float = 0.003
    coverage: float = 1.0
    posture_prior_m: float = 0.001
    rounds: int = 6
    variations: int = 192
    vary_rad: float = 1.5
    vary_m: float = 0.01
    vary_joint: float = 0.25
    good_m: float = 0.0005
    converged_m: float = 0.0015
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("points", "coarse_points", "starts", "finalists", "rounds", "variations"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected at least 1.")


def one_view_config(noise_m: float = 0.001, *, seed: int = 0) -> InferConfig:
    """For points that one depth camera sees, noise of standard deviation `noise_m` along its rays.

    Parts of the hand may be unseen, so nothing asks for points near them: there the posture stays near its start.
    """
    good = max(0.0005, 0.9 * noise_m)
    return InferConfig(coverage=0.0, good_m=good, converged_m=good + 0.001, seed=seed)


@dataclass(frozen=True, slots=True, kw_only=True)
class InferResult:
    """Grasps inferred from points, one per scene.

    Attributes:
        codes: their codes; contact maps are those of the fitted hands.
        X_OH: (N, 4, 4) hand base in the object frame; q: (N, J) joints.
        residual_m: (N,) mean |distance| of the observed points to the fitted hand, metres.
        converged: (N,) bool, the solver stopped by itself and the residual is within `InferConfig.converged_m`.
        seed: of the start perturbations.
    """

    codes: CodeBook
    X_OH: np.ndarray
    q: np.ndarray
    residual_m: np.ndarray
    converged: np.ndarray
    seed: int


def encode_points(
    hand_points_O: Sequence[np.ndarray], field: KinematicField, *, object_name: str, hand: str = "unknown"
) -> CodeBook:
    """Codes with the contact block and map only, straight from observed hand points; the rest is nan.

    Good for retrieval across hands; no hand model is needed. Closeness is to the nearest observed
    point, so it is too low by up to the point spacing, and blind to what was not seen.

    Args:
        hand_points_O: N clouds (M, 3), object frame, metres.
        hand: name to put into the book.
    """
    points, codec = field.object(object_name).points_O, field.object_codecs[object_name]
    maps = np.stack(
        [
            closeness(KDTree(_checked(cloud, i)).query(points)[0], codec.radius_m)
            for i, cloud in enumerate(hand_points_O)
        ]
    )
    values = np.full((len(maps), CODE_SIZE), np.nan, np.float32)
    values[:, CONTACT_BLOCK] = contact_blocks(maps, codec)
    zeros = np.zeros(len(maps), np.int32)
    return CodeBook(
        values=values,
        hands=(hand,),
        objects=(object_name,),
        hand_index=zeros,
        object_index=zeros,
        grasp_index=zeros - 1,
        contact_maps=maps,
    )


def infer_grasps(
    hand_points_O: Sequence[np.ndarray],
    field: KinematicField,
    gallery: CodeBook,
    *,
    hand: str,
    object_name: str,
    config: InferConfig | None = None,
) -> InferResult:
    """Pose, joints and codes of a known hand from points on its surface.

    Each cloud's result depends on that cloud alone, not on its place among the others.

    Args:
        hand_points_O: N clouds (M, 3) of one hand on one object, object frame, metres; noise and
            outliers are expected.
        gallery: known codes to start from (of that hand; grasps on other objects serve too, after those on this one).
    Raises:
        InputError: the gallery holds no grasp of that hand, or a cloud has fewer than 10 points.
    """
    config = config or InferConfig()
    packed = field.packed[field.hand(hand).name]
    starts = gallery_grasps(field, gallery, hand=hand, object_name=object_name)
    fits = [
        _fit_cloud(packed, cloud, starts, config, _cloud_rng(config.seed, cloud))
        for cloud in (_checked(c, i) for i, c in enumerate(hand_points_O))
    ]
    X_OH, q = np.stack([f.X_OH for f in fits]), np.stack([f.q for f in fits])
    residual = np.array([f.residual_m for f in fits])
    return InferResult(
        codes=field.encode(X_OH, q, hand=hand, object_name=object_name),
        X_OH=X_OH,
        q=q,
        residual_m=residual,
        converged=np.array([f.stopped for f in fits]) & (residual <= config.converged_m),
        seed=config.seed,
    )


def infer_hand(
    cloud_O: np.ndarray,
    field: KinematicField,
    gallery: CodeBook,
    *,
    object_name: str,
    hands: Sequence[str] | None = None,
    config: InferConfig | None = None,
) -> tuple[str, InferResult]:
    """Which of the hands fits a cloud (M, 3) best, and its grasp; every hand of the gallery is tried by default."""
    names = tuple(hands or gallery.hands)
    results = [
        infer_grasps([cloud_O], field, gallery, hand=name, object_name=object_name, config=config) for name in names
    ]
    best = int(np.argmin([float(r.residual_m[0]) for r in results]))
    return names[best], results[best]


@dataclass(frozen=True, slots=True, kw_only=True)
class Starts:
    """Grasps to start from: X_OH (N, 4, 4), q (N, J)."""

    X_OH: np.ndarray
    q: np.ndarray


def gallery_grasps(field: KinematicField, gallery: CodeBook, *, hand: str, object_name: str) -> Starts:
    """Poses and joints of the gallery's grasps by a hand: on this object, or on all when it has none there."""
    rows = np.flatnonzero(gallery.where(hand=hand))
    here = [r for r in rows if gallery.objects[gallery.object_index[r]] == object_name]
    if not len(rows):
        raise InputError(f"the gallery holds no grasp of hand '{hand}'; add some to start from.")
    chosen = here or list(rows)
    codes = torch.as_tensor(gallery.values[chosen].astype(np.float64))
    grasps = field.decode(codes, hand=hand, object_name=object_name)
    return Starts(X_OH=grasps.X_OH.numpy(), q=grasps.q.numpy())


def _checked(cloud: np.ndarray, index: int) -> np.ndarray:
    cloud = np.asarray(cloud, np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ShapeError(f"cloud {index} has shape {cloud.shape}; expected (M, 3).")
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if len(cloud) < 10:
        raise InputError(f"cloud {index} has {len(cloud)} finite points; expected at least 10.")
    return cloud


def _cloud_rng(seed: int, cloud_O: np.ndarray) -> np.random.Generator:
    return child_rng(seed, "infer", hashlib.sha256(np.ascontiguousarray(cloud_O).tobytes()).hexdigest())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    X_OH: np.ndarray
    q: np.ndarray
    residual_m: float
    cost: float
    stopped: bool


def _fit_cloud(
    packed: PackedHand, cloud_O: np.ndarray, gallery: Starts, config: InferConfig, rng: np.random.Generator
) -> _Fit:
    """Rounds of fits until one is good: first from the gallery's grasps, then from random variations of them."""
    cloud = rng.permutation(cloud_O)
    material = material_points(packed)
    best: _Fit | None = None
    for turn in range(config.rounds):
        starts = gallery if turn == 0 else _varied(packed, gallery, best, config, rng)
        if config.coverage > 0.0:
            starts = _with_centred(packed, starts, material, cloud, keep=turn == 0)
        for fit in _fit_starts(packed, cloud, material, starts, config):
            if best is None or fit.cost < best.cost:
                best = fit
            if best.residual_m <= config.good_m:
                return best
    assert best is not None
    return best


def _fit_starts(
    packed: PackedHand, cloud: np.ndarray, material: np.ndarray, starts: Starts, config: InferConfig
) -> Iterator[_Fit]:
    """Score all starts, improve the best roughly, refine the best of those to the end, one after the other."""
    fine, coarse = cloud[: config.points], cloud[: config.coarse_points]
    prior, wide = config.posture_prior_m**2, 10.0 * config.width_m
    score = np.empty(len(starts.q))
    score_starts(packed, coarse, material, starts.X_OH, starts.q, wide, config.coverage, score)
    rough: list[tuple[float, np.ndarray, np.ndarray]] = []
    for i in np.argsort(score, kind="stable")[: config.starts]:
        X, q = starts.X_OH[i].copy(), starts.q[i].copy()
        cost = fit_hand(
            packed, coarse, material, X, q, q.copy(), config.coarse_iterations, wide, config.coverage, prior
        )[0]
        rough.append((cost, X, q))
    rough.sort(key=lambda t: t[0])
    for _, X, q in rough[: config.finalists]:
        stopped = fit_hand(packed, fine, material, X, q, q.copy(), config.fine_iterations, config.width_m, 0.0, prior)[
            2
        ]
        distance = np.abs(hand_distances(packed, X[None], q[None], fine)[0])
        yield _Fit(
            X_OH=X,
            q=q,
            residual_m=float(distance.mean()),
            cost=fit_cost(packed, fine, material, X, q, q, wide, config.coverage, 0.0),
            stopped=bool(stopped),
        )


def _varied(
    packed: PackedHand, gallery: Starts, best: _Fit | None, config: InferConfig, rng: np.random.Generator
) -> Starts:
    """Random turns of the palm and random changes of posture, half of the gallery's grasps, half of the best fit."""
    count = config.variations
    chosen = rng.integers(len(gallery.q), size=count)
    X, q = gallery.X_OH[chosen].copy(), gallery.q[chosen].copy()
    if best is not None:
        X[: count // 2], q[: count // 2] = best.X_OH, best.q
    turn = exp_so3(torch.as_tensor(rng.normal(scale=config.vary_rad, size=(count, 3)))).numpy()
    X[:, :3, :3] = X[:, :3, :3] @ turn
    X[:, :3, 3] += rng.normal(scale=config.vary_m, size=(count, 3))
    span = packed.upper - packed.lower
    q = np.clip(q + rng.normal(scale=config.vary_joint, size=q.shape) * span, packed.lower, packed.upper)
    return Starts(X_OH=X, q=q)


def material_points(packed: PackedHand, count: int = 96) -> np.ndarray:
    """(count,) indices of well spread surface points of a hand."""
    X_HL = packed_link_poses(packed, 0.5 * (packed.lower + packed.upper))
    points_H = np.einsum("kij,kj->ki", X_HL[packed.point_link, :3, :3], packed.point_L) + X_HL[packed.point_link, :3, 3]
    return farthest_points(points_H, min(count, len(points_H)))


def _with_centred(
    packed: PackedHand, starts: Starts, material: np.ndarray, cloud_O: np.ndarray, *, keep: bool
) -> Starts:
    """The starts moved so that the hand's middle is the cloud's, and (`keep`) the starts themselves before them."""
    X_centred = starts.X_OH.copy()
    for i, (X, q) in enumerate(zip(starts.X_OH, starts.q, strict=True)):
        X_OL = (X @ packed_link_poses(packed, q))[packed.point_link[material]]
        points_O = np.einsum("kij,kj->ki", X_OL[:, :3, :3], packed.point_L[material]) + X_OL[:, :3, 3]
        X_centred[i, :3, 3] += cloud_O.mean(axis=0) - points_O.mean(axis=0)
    if not keep:
        return Starts(X_OH=X_centred, q=starts.q)
    return Starts(X_OH=np.concatenate([starts.X_OH, X_centred]), q=np.concatenate([starts.q, starts.q]))
