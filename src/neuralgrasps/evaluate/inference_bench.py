"""How well grasps are inferred from observed points: surface errors, wrong basins, retrieval, time."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.evaluate.observe import observe_hand, view_hand, with_outliers, with_pose_error
from neuralgrasps.evaluate.retrieval import score_codebook
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.codes import CodeBook, join_codes
from neuralgrasps.model.infer import InferConfig, infer_grasps, one_view_config
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import hand_surface_distances
from neuralgrasps.parallel import run_tasks
from neuralgrasps.seeds import child_seed

WRONG_BASIN_M = 0.010


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """What is observed of the hand.

    Attributes:
        one_view: by one depth camera, the object and the hand in the way; else all over the hand.
        noise_m: standard deviation, of each coordinate, or along the ray of one view.
        viewpoint: the camera's place is told. noise_known: so is `noise_m`; else it is estimated.
        outliers: share of the points that are anywhere in a box around the hand.
        spill: share of the points that are of visible object; of one view only.
        pose_off_m, pose_off_rad: how far off the object's pose is, in a random direction.
    """

    one_view: bool
    noise_m: float
    viewpoint: bool = False
    noise_known: bool = False
    outliers: float = 0.0
    spill: float = 0.0
    pose_off_m: float = 0.0
    pose_off_rad: float = 0.0


CONDITIONS: Mapping[str, Condition] = {
    "F1": Condition(one_view=False, noise_m=0.001),
    "F3": Condition(one_view=False, noise_m=0.003),
    "V1": Condition(one_view=True, noise_m=0.001),
    "V3": Condition(one_view=True, noise_m=0.003),
    "V3 outliers": Condition(one_view=True, noise_m=0.003, outliers=0.05),
    "V3 spill": Condition(one_view=True, noise_m=0.003, spill=0.10),
    "V3 pose": Condition(one_view=True, noise_m=0.003, pose_off_m=0.005, pose_off_rad=math.radians(3.0)),
    "V1 eye": Condition(one_view=True, noise_m=0.001, viewpoint=True),
    "V3 eye": Condition(one_view=True, noise_m=0.003, viewpoint=True),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class InferenceRow:
    """Figures of one condition over all test grasps asked for. Surface errors are exact, both ways pooled.

    Attributes:
        grasps: how many.
        surface_mean_mm, surface_median_mm, surface_p95_mm: over surface points of all grasps.
        grasp_median_mm, grasp_p95_mm: over the grasps' mean surface errors.
        wrong_basins: share of grasps with a mean surface error above 10 mm; flagged: share of these that the result
            itself suspects (nan without any); false_alarms: share of the other grasps that it suspects.
        retrieval_gap: Near GT - Near Z, averaged over objects; contact_error: mean |contact map - true one|.
        infer_ms_median, infer_ms_p95, infer_ms_mean: processor time per grasp, one thread.
    """

    condition: str
    grasps: int
    surface_mean_mm: float
    surface_median_mm: float
    surface_p95_mm: float
    grasp_median_mm: float
    grasp_p95_mm: float
    wrong_basins: float
    flagged: float
    false_alarms: float
    retrieval_gap: float
    contact_error: float
    infer_ms_median: float
    infer_ms_p95: float
    infer_ms_mean: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PairInference:
    """Raw figures of one hand on one object: codes as inferred, |surface distances| (N, 2 K), suspicion, time."""

    hand: str
    object: str
    codes: CodeBook
    distance_m: np.ndarray
    suspect: np.ndarray
    seconds: np.ndarray


def measure_inference(
    field: KinematicField,
    codebook: CodeBook,
    grasp_sets: Mapping[tuple[str, str], GraspSet],
    *,
    condition: str = "V3",
    seed: int = 0,
    workers: int | None = 1,
    limit_per_pair: int | None = None,
    config: InferConfig | None = None,
) -> InferenceRow:
    """Infer the book's test grasps from simulated observations, and compare with the truth.

    Args:
        codebook: of `field`, test grasps marked; its training grasps are the gallery.
        grasp_sets: the grasps that the book's `grasp_index` counts in, by (hand, object).
        condition: one of `CONDITIONS`. seed: of the observations.
        workers: processes; the figures but the times are the same for any number.
        limit_per_pair: at most so many test grasps of each hand and object.
        config: in place of the default for the condition.
    Raises:
        UnknownNameError: no such condition. InputError: nothing to measure.
    """
    if condition not in CONDITIONS:
        raise unknown_name("condition", condition, CONDITIONS)
    how = CONDITIONS[condition]
    tasks, asked = [], []
    for hand, obj in grasp_sets:
        rows = np.flatnonzero(codebook.where(hand=hand, object_name=obj, is_test=True))[:limit_per_pair]
        if not len(rows):
            continue
        asked.append(rows)
        chosen = grasp_sets[hand, obj][codebook.grasp_index[rows]]
        known = codebook[codebook.where(hand=hand, object_name=obj, is_test=False)]
        small = KinematicField(
            hands={hand: field.hands[hand]}, objects={obj: field.objects[obj]},
            hand_codecs={hand: field.hand_codecs[hand]}, object_codecs={obj: field.object_codecs[obj]},
        )  # fmt: skip
        tasks.append((small, known, chosen, codebook.grasp_index[rows], how, seed, config))
    if not tasks:
        raise InputError("the code book holds no test grasps of these grasp sets; expected some to infer.")
    pairs: dict[int, PairInference] = dict(run_tasks(infer_pair, tasks, workers=workers))
    return _row(codebook, condition, [pairs[i] for i in range(len(tasks))], asked)


def observe(
    field: KinematicField, grasps: GraspSet, index: np.ndarray, how: Condition, seed: int
) -> tuple[list[np.ndarray], np.ndarray | None]:
    """Clouds of the grasps of a set, and the cameras' places (N, 3) for one view; `index`: the grasps' names."""
    hand, obj, packed = field.hands[grasps.hand], field.objects[grasps.object], field.packed[grasps.hand]
    clouds, eyes = [], []
    for X_OH, q, i in zip(grasps.X_OH, grasps.q, index, strict=True):
        at = child_seed(seed, "observed", grasps.hand, grasps.object, int(i))
        if how.one_view:
            view = view_hand(hand, obj, X_OH, q, seed=at, noise_m=how.noise_m, spill=how.spill)
            cloud, eye = view.points_O, view.viewpoint_O
        else:
            cloud, eye = observe_hand(packed, X_OH, q, seed=at, noise_m=how.noise_m), np.zeros(3)
        if how.outliers > 0.0:
            cloud = with_outliers(cloud, how.outliers, seed=at)
        if how.pose_off_m > 0.0 or how.pose_off_rad > 0.0:
            cloud, X = with_pose_error(cloud, how.pose_off_m, how.pose_off_rad, centre_O=obj.com_O, seed=at)
            eye = X[:3, :3] @ eye + X[:3, 3]
        clouds.append(cloud)
        eyes.append(eye)
    return clouds, np.stack(eyes) if how.one_view else None


def infer_pair(
    field: KinematicField,
    gallery: CodeBook,
    grasps: GraspSet,
    index: np.ndarray,
    how: Condition,
    seed: int,
    config: InferConfig | None = None,
) -> PairInference:
    """Observe and infer the grasps of one hand on one object."""
    clouds, eyes = observe(field, grasps, index, how, seed)
    noise = how.noise_m if how.noise_known else None
    config = config or (one_view_config(noise) if how.one_view else InferConfig(noise_m=noise))
    books, X_OH, q, suspect, seconds = [], [], [], [], []
    for i, cloud in enumerate(clouds):
        begun = time.process_time()
        result = infer_grasps(
            [cloud],
            field,
            gallery,
            hand=grasps.hand,
            object_name=grasps.object,
            config=config,
            viewpoints_O=eyes[i : i + 1] if eyes is not None and how.viewpoint else None,
        )
        seconds.append(time.process_time() - begun)
        books.append(result.codes)
        X_OH.append(result.X_OH[0])
        q.append(result.q[0])
        suspect.append(bool(result.suspect[0]))
    distance = hand_surface_distances(
        field.packed[grasps.hand], np.stack(X_OH), np.stack(q), grasps.X_OH, grasps.q, seed=seed
    )
    return PairInference(
        hand=grasps.hand,
        object=grasps.object,
        codes=replace(join_codes(books), grasp_index=np.asarray(index, np.int32)),
        distance_m=distance.astype(np.float32),
        suspect=np.array(suspect),
        seconds=np.array(seconds),
    )


def _row(book: CodeBook, condition: str, pairs: list[PairInference], asked: list[np.ndarray]) -> InferenceRow:
    distance = 1e3 * np.concatenate([p.distance_m for p in pairs])
    per_grasp = distance.mean(axis=1)
    wrong, suspect = per_grasp > 1e3 * WRONG_BASIN_M, np.concatenate([p.suspect for p in pairs])
    milliseconds = 1e3 * np.concatenate([p.seconds for p in pairs])
    gaps, errors = [], []
    train = np.flatnonzero(book.where(is_test=False))
    for name in sorted({p.object for p in pairs}):
        here = [i for i, p in enumerate(pairs) if p.object == name]
        rows = np.concatenate([asked[i] for i in here])
        order = np.argsort(rows, kind="stable")
        queries = join_codes([pairs[i].codes for i in here])[order]
        some = book[np.sort(np.concatenate([train, rows]))]
        gaps.append(score_codebook(some, object_name=name, queries=queries).gap)
        errors.append(float(np.abs(queries.contact_maps - book.contact_maps[rows[order]]).mean()))
    return InferenceRow(
        condition=condition,
        grasps=len(per_grasp),
        surface_mean_mm=float(distance.mean()),
        surface_median_mm=float(np.median(distance)),
        surface_p95_mm=float(np.quantile(distance, 0.95)),
        grasp_median_mm=float(np.median(per_grasp)),
        grasp_p95_mm=float(np.quantile(per_grasp, 0.95)),
        wrong_basins=float(wrong.mean()),
        flagged=float(suspect[wrong].mean()) if wrong.any() else float("nan"),
        false_alarms=float(suspect[~wrong].mean()) if (~wrong).any() else float("nan"),
        retrieval_gap=float(np.mean(gaps)),
        contact_error=float(np.mean(errors)),
        infer_ms_median=float(np.median(milliseconds)),
        infer_ms_p95=float(np.quantile(milliseconds, 0.95)),
        infer_ms_mean=float(milliseconds.mean()),
    )
