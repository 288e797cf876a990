"""Codes of grasps that are only observed: hand points on an object, no joints, no labels.

Two levels. `encode_points` gives the contact block alone, straight from the points: enough to
retrieve. `infer_grasps` also finds the hand's pose and joints by fitting its exact distance to the points
from many starts, and recomputes the contact block from the fitted hand: the estimate with the highest posterior
under a robust point noise and what is known of grasps. Encoding known joints (`KinematicField.encode`) is no inference.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from scipy.spatial import KDTree

from neuralgrasps.dataset.samples import closeness
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.model.codes import CELLS, CODE_SIZE, CONTACT_BLOCK, CodeBook, contact_blocks
from neuralgrasps.model.fit_checks import doubts
from neuralgrasps.model.fit_config import InferConfig, Search, Starts
from neuralgrasps.model.fit_prior import grasp_prior
from neuralgrasps.model.fit_search import CloudSearch
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.parallel import thread_map
from neuralgrasps.seeds import child_rng

__all__ = ["InferConfig", "InferResult", "encode_points", "gallery_grasps", "infer_grasps", "infer_hand"]

OUTLIER_PRICE_M = 0.01  # what a point set aside counts when hands are compared


def one_view_config(noise_m: float | None = None, *, seed: int = 0) -> InferConfig:
    """For points that one depth camera sees, noise of standard deviation `noise_m` along its rays (None: estimated).

    Parts of the hand may be unseen, so nothing asks for points near them: there, what is known of grasps decides.
    """
    return InferConfig(coverage=0.0, noise_m=noise_m, seed=seed)


@dataclass(frozen=True, slots=True, kw_only=True)
class InferResult:
    """Grasps inferred from points, one per scene.

    Attributes:
        codes: their codes; contact maps are those of the fitted hands.
        X_OH: (N, 4, 4) hand base in the object frame; q: (N, J) joints.
        residual_m: (N,) mean |distance| of the observed points but the outliers to the fitted hand, metres.
        outliers: (N,) share of the points set aside: alone, or the object's.
        noise_m: (N,) standard deviation of the points' noise, given or estimated, metres.
        reasons: per scene what speaks against the fit, in words; empty when nothing does.
        seed: of the search.
    """

    codes: CodeBook
    X_OH: np.ndarray
    q: np.ndarray
    residual_m: np.ndarray
    outliers: np.ndarray
    noise_m: np.ndarray
    reasons: tuple[tuple[str, ...], ...]
    seed: int

    @property
    def suspect(self) -> np.ndarray:
        """(N,) bool: something speaks against the fit, it may be a wrong one."""
        return np.array([len(reasons) > 0 for reasons in self.reasons], np.bool_)

    @property
    def converged(self) -> np.ndarray:
        """(N,) bool: not `suspect`."""
        return ~self.suspect


def encode_points(
    hand_points_O: Sequence[np.ndarray], field: KinematicField, *, object_name: str, hand: str = "unknown"
) -> CodeBook:
    """Codes with the contact block and map only, straight from observed hand points; the rest is nan.

    Good for retrieval across hands; no hand model is needed. Closeness is to the nearest observed
    point, so it is too low by up to the point spacing, and blind to what was not seen.

    Args:
        hand_points_O: N clouds (M, 3), object frame, metres.
        hand: name to put into the book.
    Raises:
        InputError: no cloud at all, or one has fewer than 10 points. ShapeError: a cloud is not (M, 3).
    """
    maps = np.stack([map_of_points(field, object_name, cloud) for cloud in checked_clouds(hand_points_O)])
    return contact_codes(maps, field, object_name=object_name, hand=hand)


def map_of_points(field: KinematicField, object_name: str, points_O: np.ndarray) -> np.ndarray:
    """(P,) closeness of an object's contact points to some points (C, 3), as if these were all of the hand.

    The contact points are those of the codes, whichever way the mesh of the object is sampled.
    """
    field.object(object_name)
    codec = field.object_codecs[object_name]
    return closeness(KDTree(points_O).query(codec.points_O)[0], codec.radius_m)


def contact_codes(maps: np.ndarray, field: KinematicField, *, object_name: str, hand: str) -> CodeBook:
    """Codes that know contact maps (N, P) alone; their palm and posture blocks are nan."""
    values = np.full((len(maps), CODE_SIZE), np.nan, np.float32)
    values[:, CONTACT_BLOCK] = contact_blocks(maps, field.object_codecs[object_name])
    zeros = np.zeros(len(maps), np.int32)
    return CodeBook(
        values=values,
        hands=(hand,),
        objects=(object_name,),
        hand_index=zeros,
        object_index=zeros,
        grasp_index=zeros - 1,
        contact_maps=np.asarray(maps, np.float32),
    )


def infer_grasps(
    hand_points_O: Sequence[np.ndarray],
    field: KinematicField,
    gallery: CodeBook,
    *,
    hand: str,
    object_name: str,
    config: InferConfig | None = None,
    viewpoints_O: Sequence[np.ndarray] | np.ndarray | None = None,
    include_test: bool = False,
    threads: int = 1,
) -> InferResult:
    """Pose, joints and codes of a known hand from points on its surface.

    Each cloud's result depends on that cloud alone, not on its place among the others. Points far from all others,
    and points on the object that no hand explains (of a mask that is too wide), are set aside and counted. The object's
    pose is taken as right: the hand is off by as much as that is, and this is seldom suspected. Codes of
    hands with more than 23 joints hold their strongest synergies only (`HandCodec.is_lossless`): the search then
    starts from such postures, but fits all joints; `q` is what was found, the codes are its nearest.

    Args:
        hand_points_O: N clouds (M, 3) of one hand on one object, object frame, metres; noise and
            outliers are expected.
        gallery: known codes to start from (of that hand; grasps on other objects serve too, after those on this one).
        viewpoints_O: (N, 3) where the camera of each cloud stood, object frame, metres, for clouds of one view: hand
            that it should have seen must then be among the points.
        include_test: start from the gallery's test grasps too.
        threads: clouds fitted at once; the result is the same for any number.
    Raises:
        InputError: the gallery holds no grasp of that hand or is of another kind of field, there is no cloud, or one
            has fewer than 10 points.
        ShapeError: a cloud is not (M, 3), or there is not one viewpoint for each.
    """
    config = config or InferConfig()
    packed, sdf = field.packed[field.hand(hand).name], field.object(object_name).sdf
    clouds = checked_clouds(hand_points_O)
    starts = gallery_grasps(field, gallery, hand=hand, object_name=object_name, include_test=include_test)
    prior = grasp_prior(packed, sdf, starts.X_OH, starts.q)
    eyes = _checked_viewpoints(viewpoints_O, len(clouds))

    def search(index: int) -> tuple[Search, tuple[str, ...]]:
        cloud = clouds[index]
        one = CloudSearch(
            packed, sdf, prior, cloud, config=config, rng=_cloud_rng(config.seed, cloud), viewpoint_O=eyes[index]
        )
        found = one.run(starts)
        return found, doubts(one, found)

    results = thread_map(search, range(len(clouds)), threads=threads)
    best = [found.fits[0] for found, _ in results]
    X_OH, q = np.stack([f.X_OH for f in best]), np.stack([f.q for f in best])
    return InferResult(
        codes=field.encode(X_OH, q, hand=hand, object_name=object_name),
        X_OH=X_OH,
        q=q,
        residual_m=np.array([_residual(found) for found, _ in results]),
        outliers=np.array([found.outliers for found, _ in results]),
        noise_m=np.array([found.noise_m for found, _ in results]),
        reasons=tuple(reasons for _, reasons in results),
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
    include_test: bool = False,
) -> tuple[str, InferResult]:
    """Which of the hands fits a cloud (M, 3) best, and its grasp; every hand of the gallery is tried by default.

    `config` and `include_test` as for `infer_grasps`.
    """
    names = tuple(hands or gallery.hands)
    fitted = partial(
        infer_grasps, [cloud_O], field, gallery, object_name=object_name, config=config, include_test=include_test
    )
    results = [fitted(hand=name) for name in names]
    best = int(np.argmin([float(r.residual_m[0] + OUTLIER_PRICE_M * r.outliers[0]) for r in results]))
    return names[best], results[best]


def _residual(found: Search) -> float:
    kept = found.fits[0].distance_m[~found.aside]
    return float(np.abs(kept).mean()) if len(kept) else float("inf")


def gallery_grasps(
    field: KinematicField, gallery: CodeBook, *, hand: str, object_name: str, include_test: bool = False
) -> Starts:
    """Poses and joints of the gallery's grasps by a hand: on this object, or on all when it has none there.

    Raises:
        InputError: there are none (test grasps count with `include_test` only), or these are no codes of a
            `KinematicField`.
    """
    check_kinematic(gallery)
    every = gallery.where(hand=hand)
    rows = np.flatnonzero(every if include_test else every & ~gallery.is_test)
    here = [r for r in rows if gallery.objects[gallery.object_index[r]] == object_name]
    if not len(rows):
        left_out = f" but {every.sum()} test grasps" if every.any() else ""
        how = "; give include_test=True to start from them" if every.any() else "; add some to start from"
        raise InputError(f"the gallery holds no grasp of hand '{hand}'{left_out}{how}.")
    chosen = here or list(rows)
    with torch.no_grad():
        codes = torch.as_tensor(gallery.values[chosen].astype(np.float64))
        grasps = field.decode(codes, hand=hand, object_name=object_name)
    return Starts(X_OH=grasps.X_OH.numpy(), q=grasps.q.numpy())


def check_kinematic(gallery: CodeBook) -> None:
    """Refuse codes that are not [contacts | palm | posture].

    Raises:
        InputError: they are free codes, as of `MlpField`, which decode to no pose and joints.
    """
    if gallery.metric_size != CELLS:
        raise InputError(
            f"the gallery's codes compare {gallery.metric_size} numbers, as free codes do; expected {CELLS}: codes of "
            "a KinematicField, which decode to pose and joints. Give the code book of one, fitted to the same grasps."
        )


def checked_clouds(clouds: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The finite points of each cloud, at least one of them.

    Raises:
        ShapeError, InputError: as `checked_cloud`; or there is none.
    """
    if not len(clouds):
        raise InputError("got no clouds; expected a sequence of at least one array (M, 3) of hand points.")
    return [checked_cloud(cloud, i) for i, cloud in enumerate(clouds)]


def checked_cloud(cloud: np.ndarray, index: int) -> np.ndarray:
    """The finite points of a cloud, (M, 3) float64.

    Raises:
        ShapeError: not (M, 3). InputError: fewer than 10 finite points.
    """
    cloud = np.array(cloud, np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ShapeError(f"cloud {index} has shape {cloud.shape}; expected (M, 3).")
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if len(cloud) < 10:
        raise InputError(f"cloud {index} has {len(cloud)} finite points; expected at least 10.")
    return np.ascontiguousarray(cloud)


def _checked_viewpoints(viewpoints_O: Sequence[np.ndarray] | np.ndarray | None, count: int) -> list[np.ndarray | None]:
    if viewpoints_O is None:
        return [None] * count
    eyes = np.array(viewpoints_O, np.float64)
    if eyes.shape != (count, 3) or not np.isfinite(eyes).all():
        raise ShapeError(f"viewpoints_O has shape {eyes.shape}; expected ({count}, 3) finite, one for each cloud.")
    return list(eyes)


def _cloud_rng(seed: int, cloud_O: np.ndarray) -> np.random.Generator:
    return child_rng(seed, "infer", hashlib.sha256(np.ascontiguousarray(cloud_O).tobytes()).hexdigest())
