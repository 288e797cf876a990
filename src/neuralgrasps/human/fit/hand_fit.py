"""Fits the human hand model to seen joints and depth points: pose, 20 joints and size, by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from neuralgrasps.dataset.hand_surface import packed_link_poses
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.sdf_grid import grid_distances
from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.hands.variants import mirror_matrix
from neuralgrasps.human.fit.again import other_starts
from neuralgrasps.human.fit.confidence import FitEvidence, confidence, reasons_against
from neuralgrasps.human.fit.problem import HandProblem
from neuralgrasps.human.fit.start import hand_starts
from neuralgrasps.human.fit.steps import cloud_distances, curvature, lower_costs
from neuralgrasps.human.fit.view import hand_view, no_view
from neuralgrasps.human.postures import usual_postures
from neuralgrasps.human.seen import FittedHand, SeenJoints, Side
from neuralgrasps.human.skeleton import NUM_JOINTS, TIPS, Skeleton, human_hand, joint_points, skeleton
from neuralgrasps.model.fit_prior import spread_points
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame

_FLIP_X = np.diag([-1.0, 1.0, 1.0, 1.0])
_SPACING_M = 0.004
_PROBES = 160
_FAR_WIDTH_M = 0.03
_SIZE_STEP = 0.05  # of the log size
_STEPS, _MOST_STEPS = 4, 9  # sizes tried on each side of the usual one; at most, while the outermost is the best
_STILL = 0.2  # weight of the joints of a fit shortly before, in place of seen ones


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
    cloud_sd_m: float = 0.003
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Model:
    packed: PackedHand
    bones: Skeleton
    probe_L: np.ndarray
    probe_link: np.ndarray


@cache
def _model() -> _Model:
    """The right hand of size 1 in arrays."""
    hand = human_hand("right")
    packed = pack_hand(hand, spacing=_SPACING_M)
    probe = spread_points(packed, _PROBES)
    return _Model(
        packed=packed, bones=skeleton(hand), probe_L=packed.point_L[probe], probe_link=packed.point_link[probe]
    )


def fit_hand(
    seen: SeenJoints | None,
    cloud_C: np.ndarray | None,
    *,
    side: Side,
    scale: float | None,
    start: FittedHand | None = None,
    obj: tuple[ObjectModel, np.ndarray] | None = None,
    frame: Frame | None = None,
    config: HandFitConfig | None = None,
) -> FittedHand:
    """The hand that best explains what is seen of it in one frame, or in several of a hand that does not move.

    Lowered is the sum of: errors of the seen joints; exact distances of the cloud's points to the hand's capsules and
    boxes; parts of the hand in front of what the camera measured (with `frame` and the mask in `seen`); depth in the
    object, and gaps between it and fingertips close to it; a distribution of grasp postures. All are robust. Joints
    stay within the model's limits.

    Args:
        seen: the joints; None: only with `start`, whose joints then count a little.
        cloud_C: (M, 3) points of the hand's surface only, camera frame, metres; None or too few: joints alone.
        side: which hand; the caller decides. A hand fitted as its mirror image leaves larger residuals.
        scale: size of the hand (`fit_size`); None: fitted too, weakly determined by one frame.
        start: a fit of a frame shortly before, followed beside the start from the joints.
        obj: what the hand holds, and its pose X_CO (4, 4).
        frame: the depth image, for free space.
    Raises:
        InputError: neither joints nor a start; a size that is not positive.
        ShapeError: a cloud that is not (M, 3).
    """
    config = config or HandFitConfig()
    if seen is None and start is None:
        raise InputError("fit_hand got neither joints nor a start; expected one: points alone do not say.")
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale is {scale}; expected a size above 0, such as 0.8, or None.")
    problem = hand_problem(seen, cloud_C, side=side, scale=scale, obj=obj, frame=frame, config=config, start=start)
    X, q, sizes = _first_starts(problem, start, scale, config)
    at_joints = X[0].copy(), q[0].copy(), float(sizes[0])
    cost = _lower(problem, X, q, sizes, config)
    best = int(np.argmin(cost))
    result = _result(problem, X[best], q[best], float(sizes[best]), side=side)
    if result.confidence >= config.again_below or not len(problem.cloud_C) or seen is None:
        return result
    X, q, sizes = _other_starts(problem, *at_joints)
    again = _lower(problem, X, q, sizes, config)
    other = int(np.argmin(again))
    if again[other] >= cost[best]:
        return result
    return _result(problem, X[other], q[other], float(sizes[other]), side=side)


def _lower(problem: HandProblem, X: np.ndarray, q: np.ndarray, sizes: np.ndarray, config: HandFitConfig) -> np.ndarray:
    """Follow starts in place, first to half of the points, which may be far off; their costs."""
    cost = np.empty(len(q))
    first = _fewer(problem, 2)._replace(cloud_width=max(config.first_width_m, config.cloud_width_m))
    lower_costs(_model().packed, first, X, q, sizes, 6, 1e-2, cost)
    lower_costs(_model().packed, problem, X, q, sizes, config.iterations, 1e-3, cost)
    return cost


def _fewer(problem: HandProblem, step: int) -> HandProblem:
    """The problem with every `step`-th point of the cloud, of as much weight together."""
    return problem._replace(
        cloud_C=np.ascontiguousarray(problem.cloud_C[::step]), cloud_weight=step * problem.cloud_weight
    )


def _other_starts(
    problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The two most promising of more starts: X_CH (2, 4, 4), q (2, 20), sizes (2,)."""
    X, postures = other_starts(_model().packed, problem, X_CH, q, scale)
    sizes, cost = np.full(len(X), scale), np.empty(len(X))
    coarse = _fewer(problem, 4)._replace(cloud_width=_FAR_WIDTH_M)
    lower_costs(_model().packed, coarse, X, postures, sizes, 3, 1e-2, cost)
    best = np.argsort(cost, kind="stable")[:2]
    return np.ascontiguousarray(X[best]), np.ascontiguousarray(postures[best]), sizes[best]


def fit_size(
    seen: Sequence[SeenJoints],
    clouds_C: Sequence[np.ndarray],
    *,
    side: Side,
    objs: Sequence[tuple[ObjectModel, np.ndarray] | None] | None = None,
    config: HandFitConfig | None = None,
) -> float:
    """One size of a person's hand from some frames that show it well (5 to 8 are enough).

    Every frame is fitted at a few sizes; the size is where the sum of the frames' costs is least, the usual sizes of
    people's hands counted in once. A size that people's hands do not have (to 0.5 or 1.24) speaks against the camera.

    Args:
        seen, clouds_C: joints, and points (M, 3), of each frame, as for `fit_hand`; objs: what is held in each.
    Raises:
        InputError: no frame, or not as many clouds as joints.
    """
    if not len(seen) or len(seen) != len(clouds_C):
        raise InputError(f"fit_size got {len(seen)} joints and {len(clouds_C)} clouds; expected as many, at least 1.")
    config = config or HandFitConfig()
    problems, found = [], []
    for joints, cloud, held in zip(seen, clouds_C, objs or [None] * len(seen), strict=True):
        problems.append(hand_problem(joints, cloud, side=side, scale=1.0, obj=held, frame=None, config=config))
        X, q, _ = _first_starts(problems[-1], None, config.scale_mean, config)
        found.append({0: (X[:1], q[:1])})
    cost: dict[int, float] = {}

    def climb(step: int, neighbour: int) -> None:
        """Fit all frames at one size, from their results at the next one."""
        size, one = np.array([config.scale_mean * np.exp(_SIZE_STEP * step)]), np.empty(1)
        cost[step] = (_SIZE_STEP * step / config.scale_sd) ** 2
        for problem, poses in zip(problems, found, strict=True):
            X, q = (array.copy() for array in poses[neighbour])
            lower_costs(_model().packed, problem, X, q, size, 2 * config.iterations, 1e-3, one)
            poses[step] = (X, q)
            cost[step] += float(one[0])

    climb(0, 0)
    for way in (1, -1):
        for step in range(1, _MOST_STEPS + 1):
            if step > _STEPS and min(cost, key=lambda k: cost[k]) != way * (step - 1):
                break
            climb(way * step, way * (step - 1))
    steps = sorted(cost)
    return _least(config.scale_mean * np.exp(_SIZE_STEP * np.array(steps)), np.array([cost[k] for k in steps]))


def _least(sizes: np.ndarray, cost: np.ndarray) -> float:
    """Where the parabola through the least of some costs and its neighbours is lowest, over the logarithm."""
    i = int(np.clip(np.argmin(cost), 1, len(sizes) - 2))
    a, b, c = cost[i - 1 : i + 2]
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend > 0 else float(np.argmin([a, b, c])) - 1.0
    return float(sizes[i] * np.exp(np.clip(shift, -1.0, 1.0) * np.log(sizes[1] / sizes[0])))


def hand_problem(
    seen: SeenJoints | None,
    cloud_C: np.ndarray | None,
    *,
    side: Side,
    scale: float | None,
    obj: tuple[ObjectModel, np.ndarray] | None,
    frame: Frame | None,
    config: HandFitConfig,
    start: FittedHand | None = None,
) -> HandProblem:
    """What is lowered, for a right hand: what is seen of a left one is mirrored (x to -x)."""
    model, postures, left = _model(), usual_postures(), side == "left"
    joints, weight = _usable_joints(seen, start)
    cloud = _thinned(cloud_C, config.points)
    view = no_view()
    if frame is not None and seen is not None and seen.mask is not None and config.free_sd_m > 0.0:
        view = hand_view(frame, seen.mask, mirrored=left)
    if left:
        joints, cloud = joints * [-1.0, 1.0, 1.0], cloud * [-1.0, 1.0, 1.0]
    touch = np.zeros(len(model.packed.parents))
    touch[model.bones.links[list(TIPS)]] = 1.0 / config.touch_sd_m**2
    X_OC = np.eye(4) if obj is None else np.linalg.inv(obj[1]) @ (_FLIP_X if left else np.eye(4))
    grid = obj[0].sdf if obj is not None else None
    return HandProblem(
        joint_link=model.bones.links,
        joint_L=model.bones.points_L,
        joints_C=joints,
        joint_weight=weight * 3.0 / config.joint_sd_m**2,
        joint_width=config.joint_width_m,
        cloud_C=cloud,
        cloud_weight=1.0 / config.cloud_sd_m**2,
        cloud_width=config.cloud_width_m,
        probe_L=model.probe_L,
        probe_link=model.probe_link,
        depth=view.depth,
        near=view.near,
        camera=view.camera,
        free_weight=1.0 / config.free_sd_m**2 if len(view.depth) else 0.0,
        free_slack=config.free_slack_m,
        free_width=config.free_width_m,
        X_OC=np.ascontiguousarray(X_OC[:3]),
        sdf_values=grid.values if grid is not None else np.zeros((2, 2, 2), np.float32),
        sdf_origin=grid.origin if grid is not None else np.zeros(3),
        sdf_inv_spacing=1.0 / grid.spacing if grid is not None else 1.0,
        deep_weight=1.0 / config.deep_sd_m**2 if grid is not None else 0.0,
        deep_slack=config.deep_slack_m,
        touch_weight=touch,
        touch_width=config.touch_width_m,
        q_mean=postures.mean,
        q_precision=postures.precision,
        q_freedom=config.freedom,
        log_scale=float(np.log(config.scale_mean)),
        log_scale_weight=config.scale_sd**-2,
        free_scale=scale is None,
    )


def _usable_joints(seen: SeenJoints | None, start: FittedHand | None) -> tuple[np.ndarray, np.ndarray]:
    """(21, 3) joints without nan, (21,) weights, 0 for the unknown; those of the start where none are seen."""
    if seen is None:
        still = np.zeros((NUM_JOINTS, 3)) if start is None else start.joints_C
        return np.array(still, np.float64), np.full(NUM_JOINTS, 0.0 if start is None else _STILL)
    check_shape("seen joints", np.shape(seen.points_C), (NUM_JOINTS, 3))
    points = np.array(seen.points_C, np.float64)
    known = np.isfinite(points).all(axis=1) & np.isfinite(seen.weight)
    return np.where(known[:, None], points, 0.0), np.where(known, np.clip(seen.weight, 0.0, 1.0), 0.0)


def _thinned(cloud_C: np.ndarray | None, count: int) -> np.ndarray:
    """At most `count` points, evenly picked from the list; too few to say anything: none."""
    if cloud_C is None:
        return np.zeros((0, 3))
    check_shape("cloud_C", np.shape(cloud_C), (None, 3))
    cloud = np.asarray(cloud_C, np.float64)
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if len(cloud) < 30:
        return np.zeros((0, 3))
    if len(cloud) > count:
        cloud = cloud[np.linspace(0, len(cloud) - 1, count).astype(np.int64)]
    return np.ascontiguousarray(cloud)


def _first_starts(
    problem: HandProblem, start: FittedHand | None, scale: float | None, config: HandFitConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts X_CH (N, 4, 4), q (N, 20), sizes (N,), best first: from the joints alone, and the one that is given."""
    model, size = _model(), scale if scale is not None else config.scale_mean
    X, q, sizes = np.zeros((0, 4, 4)), np.zeros((0, 20)), np.zeros(0)
    if np.count_nonzero(problem.joint_weight) >= 4:
        X, q = hand_starts(problem.joints_C, problem.joint_weight, size)
        sizes = np.full(len(q), size)
        bare = problem._replace(cloud_C=np.zeros((0, 3)), free_weight=0.0, deep_weight=0.0)
        cost = np.empty(len(q))
        lower_costs(model.packed, bare, X, q, sizes, 15, 1e-3, cost)
        order = np.argsort(cost, kind="stable")[: config.starts]
        X, q, sizes = X[order], q[order], sizes[order]
    if start is not None:
        X = np.concatenate([X, _righted(start.X_CH, start.side)[None]])
        q = np.concatenate([q, np.asarray(start.q, np.float64)[None]])
        sizes = np.append(sizes, scale if scale is not None else start.scale)
    if not len(q):
        raise InputError("fewer than 4 of the 21 joints are known, and there is no start; expected 4 joints or more.")
    return np.ascontiguousarray(X), np.ascontiguousarray(q), sizes


def _righted(X_CH: np.ndarray, side: Side) -> np.ndarray:
    """The pose of the right hand in the mirrored image, of a hand in the image; and the other way round."""
    if side == "right":
        return np.array(X_CH, np.float64)
    return _FLIP_X @ X_CH @ mirror_matrix(human_hand("right"))


def _result(problem: HandProblem, X: np.ndarray, q: np.ndarray, scale: float, *, side: Side) -> FittedHand:
    X_CH = _righted(X, side)
    right = joint_points(human_hand("right"), np.eye(4), q) * scale @ X[:3, :3].T + X[:3, 3]
    known = problem.joint_weight > 0.0
    miss = np.linalg.norm(right - problem.joints_C, axis=1)[known]
    distance, link = cloud_distances(_model().packed, problem, X, q, scale)
    near = np.abs(distance) < 3.0 * problem.cloud_width
    evidence = FitEvidence(
        cloud_rms_m=float(np.sqrt(np.mean(distance[near] ** 2))) if near.any() else float("nan"),
        near_share=float(near.mean()) if len(near) else float("nan"),
        links_seen=len(np.unique(link[near])),
        joint_sd_m=_joint_deviation(problem, X, q, scale),
        joint_rms_m=float(np.sqrt(np.mean(miss**2))) if known.any() else float("nan"),
        penetration_m=_penetration(problem, X, q, scale),
    )
    return FittedHand(
        X_CH=X_CH,
        q=q,
        scale=scale,
        side=side,
        joints_C=right * [-1.0, 1.0, 1.0] if side == "left" else right,
        cloud_rms_m=evidence.cloud_rms_m,
        joint_rms_m=evidence.joint_rms_m,
        penetration_m=evidence.penetration_m,
        confidence=confidence(evidence),
        reasons=reasons_against(evidence),
    )


def _penetration(problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float) -> float:
    """Depth of the hand's probes in the object, metres; 0 without one."""
    if problem.deep_weight == 0.0:
        return 0.0
    X_HL = packed_link_poses(_model().packed, q)[problem.probe_link]
    points_H = (X_HL[:, :3, :3] @ problem.probe_L[:, :, None])[..., 0] + X_HL[:, :3, 3]
    points_O = (scale * points_H @ X_CH[:3, :3].T + X_CH[:3, 3]) @ problem.X_OC[:, :3].T + problem.X_OC[:, 3]
    out = np.empty(len(points_O))
    grid_distances(problem.sdf_values, problem.sdf_origin, problem.sdf_inv_spacing, points_O, out)
    return max(-float(out.min()), 0.0)


def _joint_deviation(problem: HandProblem, X_CH: np.ndarray, q: np.ndarray, scale: float) -> float:
    """Standard deviation of the joints' places (root mean square length), metres, by the curvature of the cost.

    Linear, and as if the residuals were independent: of use to compare fits, not as a length to rely on.
    """
    A, J = curvature(_model().packed, problem, X_CH, q, scale)
    A[np.diag_indices_from(A)] += np.where(A.diagonal() > 0.0, 1e-6, 1e12)  # what is held does not move
    return float(np.sqrt(np.einsum("ij,jk,ik->", J, np.linalg.inv(A), J) / NUM_JOINTS))
