"""Measure what the demo made: overlap against the true mesh, the latent space on held-out grasps, poses from depth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.evaluate.grasps import measured_penetration
from neuralgrasps.evaluate.pose import PoseErrors, diameter_m, pose_errors
from neuralgrasps.evaluate.pose_scenes import PoseScene, pose_scene
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.perception.pose import PoseResult, estimate_pose
from neuralgrasps.seeds import child_seed

Progress = Callable[[int, int, str], None]
CAMERA = Intrinsics.from_fov(np.deg2rad(45.0), 320, 240)


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspMeasures:
    """Deepest overlap of hand and true mesh per grasp, metres, hand points in the mesh and mesh points in the hand.

    Attributes:
        by_pair: (hand, object) -> (N,) at 2 mm point spacing. coarse_m: all grasps, at 4 mm.
    """

    by_pair: Mapping[tuple[str, str], np.ndarray]
    coarse_m: np.ndarray

    @property
    def fine_m(self) -> np.ndarray:
        """All grasps, at 2 mm."""
        return np.concatenate(list(self.by_pair.values()))


def measure_grasps(
    hands: Mapping[str, Hand], objects: Mapping[str, ObjectModel], grasp_sets: Sequence[GraspSet], *, workers: int
) -> GraspMeasures:
    """Overlap of every grasp with the mesh itself."""
    tasks = [(hands[g.hand], objects[g.object], g) for g in grasp_sets]
    found = dict(run_tasks(_overlaps, tasks, workers=workers))
    return GraspMeasures(
        by_pair={(g.hand, g.object): found[i][0] for i, g in enumerate(grasp_sets)},
        coarse_m=np.concatenate([found[i][1] for i in range(len(tasks))]),
    )


def _overlaps(hand: Hand, obj: ObjectModel, grasps: GraspSet) -> tuple[np.ndarray, np.ndarray]:
    return tuple(measured_penetration(hand, obj, grasps, spacing=spacing) for spacing in (0.002, 0.004))  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseTrial:
    """One object on a table, one depth view, one estimate.

    Attributes:
        view: what the camera saw, and the truth. result, errors: the estimate and how far off it is.
        wall_s: time of the estimate. diameter_m: largest extent of the object.
    """

    object: str
    view: PoseScene
    result: PoseResult
    errors: PoseErrors
    wall_s: float
    diameter_m: float

    @property
    def X_CO_true(self) -> np.ndarray:
        """(4, 4) the object's true pose in the camera."""
        return self.view.X_CO_true


def pose_trials(
    objects: Sequence[ObjectModel], *, views: int, seed: int, progress: Progress | None = None
) -> tuple[PoseTrial, ...]:
    """Estimates in `views` easy scenes (`pose_scene`) per object, 320 x 240 pixels; mask and table are given."""
    trials = []
    for obj in objects:
        for i in range(views):
            trials.append(_pose_trial(obj, child_seed(seed, "pose trial", obj.name, i)))
            if progress is not None:
                progress(len(trials), len(objects) * views, obj.name)
    return tuple(trials)


def _pose_trial(obj: ObjectModel, seed: int) -> PoseTrial:
    view = pose_scene(obj, "easy", seed=seed, intrinsics=CAMERA)
    start = time.perf_counter()
    result = estimate_pose(
        obj, depth=view.depth, intrinsics=view.intrinsics, mask=view.mask, table=view.table, seed=seed
    )
    wall_s = time.perf_counter() - start
    return PoseTrial(
        object=obj.name, view=view, result=result, errors=pose_errors(obj, result.X_CO, view.X_CO_true), wall_s=wall_s,
        diameter_m=diameter_m(obj),
    )  # fmt: skip
