"""The published pose estimator, `baseline_pose` (Eq. 1) and `contact_pose` (Eq. 2), to compare with and to build on.

It searches for what brings the observed points onto the object's surface, and with contact also the points that a known
grasp would touch onto the hand's; only distances of a trained field are used. For work, use `estimate_pose`.

Source:
    Khargonkar et al. 2022, supplement, Eq. 1 and 2; numbers that the text leaves open from its published code,
    `object_pose/object_pose_estimation_two_stage.py`. That code differs from the text, and we follow the text:

    - it fits the points to the field without the field's offset (`obj_offset` is read, not used), so its poses are of
      another frame, centimetres off for most scans;
    - it starts at t = -(mean of the cloud) with every rotation R, where R x + t needs t = -R (mean): the cloud starts
      far off the object but for rotations that hardly move its mean;
    - it never calls `eval()`: dropout of 0.2 disturbs every distance, so the same start ends differently each time;
    - it has no acceptance threshold and no rerun: one of the best five is drawn once;
    - it never looks for the nearest grasp: index and gripper are written into the script, the rest was done by a
      program that was not published, so the measure of "nearest" is ours, that of `grasp_features` for poses;
    - it compares contact points as they are given with a cloud in normalised units without the offset;
    - `object_pose_estimation_baseline.py` beside it is not Eq. 1: one random rotation, no grid, 5,000 steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, transform_points_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.field import GraspField
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.perception.observation import check_points
from neuralgrasps.perception.paper_descent import (
    Shape,
    Term,
    descend,
    euler_rotations,
    hand_shape,
    object_centre,
    object_shape,
    rotation_losses,
)
from neuralgrasps.seeds import child_rng
from neuralgrasps.synthesis.select import grasp_features


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperPoseConfig:
    """Knobs of the published estimator; defaults are the published numbers where there are any.

    Attributes:
        points: observed points that are compared, drawn by the seed. Ours: published are all, of unknown number.
        best: starts are drawn among so many best rotations of the 512 (published: 5).
        steps: of Adam, each stage (published: 1,000).
        rate: of Adam, in radians of the rotation vector and metres of the translation (published: 0.01, constant; on
            exact data it keeps circling the truth at 1-2 mm, at 2-6 mm when it turns about the camera).
        accept_m: a run whose mean |distance| is less is taken. Ours: the text has a threshold but not its value.
        max_runs: descents before the best so far is returned, not accepted; those of a baseline run count once. Ours.
        contact_threshold: points of a contact map above it are contact points (published: 0.6, defaults up to 0.8).
        turn_about: what rotation vectors turn about: the middle of the cloud, or as in Eq. 1 as written the camera,
            which ties every turn to a shift.
    """

    points: int = 1000
    best: int = 5
    steps: int = 1000
    rate: float = 0.01
    accept_m: float = 0.0015
    max_runs: int = 5
    contact_threshold: float = 0.6
    turn_about: Literal["cloud", "camera"] = "cloud"

    def __post_init__(self) -> None:
        for name in ("points", "best", "steps", "max_runs"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected at least 1.")
        for name in ("rate", "accept_m"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a positive number.")
        if not 0.0 <= self.contact_threshold < 1.0:
            raise InputError(f"contact_threshold is {self.contact_threshold}; expected 0 <= threshold < 1.")
        if self.turn_about not in ("cloud", "camera"):
            raise InputError(f"turn_about is '{self.turn_about}'; expected 'cloud' or 'camera'.")


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperPose:
    """Where the published method says that an object is.

    Attributes:
        X_CO: (4, 4) object frame in the camera frame.
        loss_m: mean |distance| of all compared points at `X_CO`, metres: of the observed points to the object, and with
            contact also of the contact points to the hand.
        accepted: `loss_m` is below the threshold. It says that the points lie on *a* part of the surface, not that the
            pose is right.
        runs: descents of the first stage that were made.
        seed: of the draw of points and starts.
        grasp_index: with contact, row of the grasp used, in the run's grasps of that hand and object; else None.
        contact_points: how many contact points took part (0: this is the baseline).
        note: why contact was not used, or empty.
    """

    X_CO: np.ndarray
    loss_m: float
    accepted: bool
    runs: int
    seed: int
    grasp_index: int | None = None
    contact_points: int = 0
    note: str = ""


class GraspRun(Protocol):
    """What `contact_pose` needs of a run: a `Run` and an `MlpRun` have it."""

    @property
    def field(self) -> GraspField: ...
    @property
    def codebook(self) -> CodeBook: ...
    @property
    def grasps(self) -> Mapping[tuple[str, str], GraspSet]: ...


def baseline_pose(
    field: GraspField,
    code: np.ndarray | None,
    points_C: np.ndarray,
    *,
    object_name: str,
    config: PaperPoseConfig | None = None,
    seed: int = 0,
) -> PaperPose:
    """Eq. 1: the pose that least sum |f_object(R x + t, z)| leads to, from one of the best rotations of a grid.

    The object starts with its middle at the cloud's, at 512 rotations on a grid of 45 degrees; of the best five by mean
    distance one is drawn, and Adam goes on from there. Below the threshold the pose is accepted; else another of the
    five is tried, and at last the best of all is returned.

    Args:
        field: a `KinematicField` (its object is exact, on a grid), a trained `MlpField`, or any other field.
        code: (D,) code of any grasp of the object; None for a `KinematicField`, whose object depends on no code.
        points_C: (M, 3) observed points on the object, camera frame, metres; M >= 20.
        config: knobs; seed: of the draw of points and starts.
    Raises:
        InputError: see `check_points`; no code for a field that needs one. ShapeError: points that are not (M, 3).
        UnknownNameError: not an object of the field.
    """
    return _Search.of(field, code, points_C, object_name, config or PaperPoseConfig(), seed).baseline()


def contact_pose(
    run: GraspRun,
    points_C: np.ndarray,
    X_CH: np.ndarray,
    *,
    hand: str | Hand,
    object_name: str,
    surface_O: np.ndarray | None = None,
    config: PaperPoseConfig | None = None,
    seed: int = 0,
) -> PaperPose:
    """Eq. 2: `baseline_pose`, then again with the points that the nearest known grasp would touch drawn onto the hand.

    The training grasp nearest to the gripper under the first pose gives a code z and contact points; each is replaced
    by the observed point nearest to it, and the sum of |f_hand(R x + t, z)| over those is added. Only which grasp is
    nearest depends on the gripper: the term draws to *that* grasp's hand, not to the gripper itself. Points above the
    published threshold are up to a centimetre from the hand in that grasp, so even the true pose has a loss.

    Args:
        run: `load_run("ycb7")`, or a run of an `MlpField`.
        points_C: (M, 3) observed points on the object, camera frame, metres; M >= 20.
        X_CH: (4, 4) base of the gripper in the camera frame, at or near its grasp.
        hand: the gripper, of the run.
        surface_O: (P, 3) object points that the contact maps are of, for an `MlpRun` its `ObjectModel.points_O`; None
            where the field knows them.
        config: knobs; seed: of the draw of points and starts.
    Returns:
        The refined pose; the baseline with a `note` where no point of the nearest grasp is above the threshold.
    Raises:
        InputError: the run has no training grasps of this hand and object, a pose that is not finite, no `surface_O`
            for a field that does not know it; see `check_points`. ShapeError: arrays of other shapes.
        UnknownNameError: a hand or object that is not the run's.
    """
    config = config or PaperPoseConfig()
    X_CH = np.asarray(X_CH, np.float64)
    if X_CH.shape != (4, 4):
        raise ShapeError(f"X_CH has shape {X_CH.shape}; expected (4, 4).")
    if not np.isfinite(X_CH).all():
        raise InputError("X_CH is not finite; expected the pose of the gripper's base in the camera frame.")
    known = _known_grasps(run, hand, object_name, surface_O)
    code = run.codebook.values[known.rows[0]]
    search = _Search.of(run.field, code, points_C, object_name, config, seed)
    first = search.baseline()
    best = _with_contact(run.field, search, known, first, X_CH)
    while not best.accepted and best.contact_points and (other := search.next_run()) is not None:
        again = _with_contact(run.field, search, known, other, X_CH)
        if again.contact_points and again.loss_m < best.loss_m:
            best = again
        best = replace(best, runs=search.runs)
    return best


@dataclass(slots=True, kw_only=True)
class _Search:
    """Descents of one estimate, one after the other.

    Attributes:
        points: (M, 3) the compared points, relative to `pivot_C`, which rotations turn about.
        cloud_C: all observed points. starts: poses (R, t) in the order in which they are tried.
    """

    shape: Shape
    cloud_C: np.ndarray
    pivot_C: np.ndarray
    points: np.ndarray
    starts: Iterator[tuple[np.ndarray, np.ndarray]]
    config: PaperPoseConfig
    seed: int
    runs: int = field(default=0)

    @classmethod
    def of(
        cls,
        field: GraspField,
        code: np.ndarray | None,
        points_C: np.ndarray,
        object_name: str,
        config: PaperPoseConfig,
        seed: int,
    ) -> _Search:
        cloud_C = check_points(points_C)
        shape = object_shape(field, code, object_name=object_name)
        rng = child_rng(seed, "paper pose")
        pivot_C = cloud_C.mean(axis=0) if config.turn_about == "cloud" else np.zeros(3)
        few = min(config.points, len(cloud_C))
        points = cloud_C[rng.choice(len(cloud_C), few, replace=False)] - pivot_C
        R = euler_rotations()
        t = object_centre(field, object_name) - R @ (cloud_C.mean(axis=0) - pivot_C)
        losses = rotation_losses(shape, points, R, t)
        order = rng.permutation(np.argsort(losses, kind="stable")[: config.best])
        _, first = np.unique(np.round(R[order].reshape(-1, 9), 6), axis=0, return_index=True)
        chosen = order[np.sort(first)]  # some rotations are on the grid twice; from the same start Adam ends the same
        return cls(
            shape=shape, cloud_C=cloud_C, pivot_C=pivot_C, points=points, config=config, seed=seed,
            starts=iter([(R[k], t[k]) for k in chosen]),
        )  # fmt: skip

    def next_run(self) -> PaperPose | None:
        """A descent from the next start; None when all were tried."""
        start = next(self.starts, None) if self.runs < self.config.max_runs else None
        if start is None:
            return None
        self.runs += 1
        return self.descended(*start, contact=None)

    def baseline(self) -> PaperPose:
        best = self.next_run()
        assert best is not None  # there is at least one start
        while not best.accepted and (other := self.next_run()) is not None:
            best = replace(other if other.loss_m < best.loss_m else best, runs=self.runs)
        return best

    def descended(self, R: np.ndarray, t: np.ndarray, *, contact: Term | None) -> PaperPose:
        """Adam from a pose (camera to object, `t` of the pivot) on all terms."""
        # Eq. 2 sums over all observed points: a draw of them stands for all.
        stands_for = np.full(len(self.points), len(self.cloud_C) / len(self.points))
        terms = [Term(shape=self.shape, points=self.points, weights=stands_for)]
        if contact is not None:
            terms.append(contact)
        R, t, total = descend(terms, R, t, steps=self.config.steps, rate=self.config.rate)
        loss = total / sum(float(term.weights.sum()) for term in terms)
        return PaperPose(
            X_CO=inverse_np(make_transform_np(R, t - R @ self.pivot_C)),
            loss_m=loss,
            accepted=loss < self.config.accept_m,
            runs=self.runs,
            seed=self.seed,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _KnownGrasps:
    """Training grasps of one hand and object: rows of the code book, their poses, and where their maps are."""

    hand: Hand
    object: str
    rows: np.ndarray
    grasp_index: np.ndarray
    X_OH: np.ndarray
    codes: np.ndarray
    contact_maps: np.ndarray
    surface_O: np.ndarray


def _known_grasps(run: GraspRun, hand: str | Hand, object_name: str, surface_O: np.ndarray | None) -> _KnownGrasps:
    book, field = run.codebook, run.field
    name = hand if isinstance(hand, str) else hand.name
    rows = np.flatnonzero(book.where(hand=name, object_name=object_name, is_test=False) & (book.grasp_index >= 0))
    grasps = run.grasps.get((name, object_name))
    if not len(rows) or grasps is None:
        pairs = ", ".join(f"{h} on {o}" for h, o in sorted(run.grasps)) or "none"
        raise InputError(
            f"the run has no training grasps of hand '{name}' on object '{object_name}'; it has grasps of: {pairs}. "
            "Choose one of these, or train a run that has them."
        )
    if surface_O is None:
        if not isinstance(field, KinematicField):
            raise InputError("surface_O is None; expected (P, 3), the object points that the contact maps are of.")
        surface_O = field.object_codecs[object_name].points_O
    maps = book.contact_maps[rows]
    if np.shape(surface_O) != (maps.shape[1], 3):
        raise ShapeError(f"surface_O has shape {np.shape(surface_O)}; the run's contact maps are of {maps.shape[1]}.")
    if isinstance(hand, str):
        hand = field.hand(name) if isinstance(field, KinematicField) else load_hand(name)
    index = book.grasp_index[rows]
    return _KnownGrasps(
        hand=hand, object=object_name, rows=rows, grasp_index=index, X_OH=grasps.X_OH[index], codes=book.values[rows],
        contact_maps=maps, surface_O=np.asarray(surface_O, np.float64),
    )  # fmt: skip


def nearest_grasp(hand: Hand, X_OH_known: np.ndarray, X_OH: np.ndarray) -> int:
    """Row of the known grasp (N, 4, 4) nearest to a pose (4, 4) of the same hand.

    By palm position and palm axes, a turn of 1 rad counting 5 cm; a parallel jaw turned by half a turn is the same.
    """
    poses = np.concatenate([X_OH[None], X_OH_known])
    features = grasp_features(hand, poses, np.tile(hand.tree.lower, (len(poses), 1)))  # the joints are not compared
    return int(np.linalg.norm(features[1:] - features[0], axis=1).argmin())


def _with_contact(
    field: GraspField, search: _Search, known: _KnownGrasps, first: PaperPose, X_CH: np.ndarray
) -> PaperPose:
    """The second stage from a first pose."""
    nearest = nearest_grasp(known.hand, known.X_OH, inverse_np(first.X_CO) @ X_CH)
    threshold = search.config.contact_threshold
    touched_O = known.surface_O[known.contact_maps[nearest] > threshold]
    grasp_index = int(known.grasp_index[nearest])
    if not len(touched_O):
        note = f"no point of the nearest grasp's contact map is above {threshold:g}: this is the baseline."
        return replace(first, note=note, grasp_index=grasp_index)
    _, matched = KDTree(search.cloud_C).query(transform_points_np(first.X_CO, touched_O))
    rows, times = np.unique(matched, return_counts=True)  # a point may be the nearest of several, and counts for each
    contact = Term(
        shape=hand_shape(field, known.codes[nearest], hand=known.hand.name, object_name=known.object),
        points=search.cloud_C[rows] - search.pivot_C,
        weights=times.astype(np.float64),
    )
    X_OC = inverse_np(first.X_CO)
    start = X_OC[:3, :3] @ search.pivot_C + X_OC[:3, 3]
    refined = search.descended(X_OC[:3, :3], start, contact=contact)
    return replace(refined, grasp_index=grasp_index, contact_points=len(touched_O))
