"""Measure what the demo made: overlap against the true mesh, the latent space on held-out grasps, poses from depth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from neuralgrasps.evaluate.grasps import measured_penetration
from neuralgrasps.evaluate.pose import PoseErrors, pose_errors
from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.plane import horizontal_plane
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.parallel import run_tasks
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.pose import PoseResult, estimate_pose
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import DepthNoise, DepthView, render_depth_view

Progress = Callable[[int, int, str], None]


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
        view: what the camera saw. X_CO_true: (4, 4). result, errors: the estimate and how far off it is.
        wall_s: time of the estimate. diameter_m: largest extent of the object.
    """

    object: str
    view: DepthView
    X_CO_true: np.ndarray
    result: PoseResult
    errors: PoseErrors
    wall_s: float
    diameter_m: float


def pose_trials(
    objects: Sequence[ObjectModel], *, views: int, seed: int, progress: Progress | None = None
) -> tuple[PoseTrial, ...]:
    """Random stable poses on a table, random views from 0.5 to 1.2 m, sensor noise; nothing hides the object."""
    trials = []
    for obj in objects:
        for i in range(views):
            trials.append(_pose_trial(obj, child_seed(seed, "pose trial", obj.name, i)))
            if progress is not None:
                progress(len(trials), len(objects) * views, obj.name)
    return tuple(trials)


def _pose_trial(obj: ObjectModel, seed: int) -> PoseTrial:
    rng = child_rng(seed, "scene")
    intrinsics = Intrinsics.from_fov(np.deg2rad(45.0), 320, 240)
    poses, shares = resting_poses(obj.mesh.vertices, obj.com_O)
    spin, around = rng.uniform(0.0, 2.0 * np.pi, 2)
    X_WO = np.eye(4)
    X_WO[:2, :2] = [[np.cos(spin), -np.sin(spin)], [np.sin(spin), np.cos(spin)]]
    X_WO = X_WO @ poses[rng.choice(len(poses), p=shares)]
    height, distance = np.deg2rad(rng.uniform(25.0, 65.0)), rng.uniform(0.5, 1.2)
    eye = distance * np.array([np.cos(around) * np.cos(height), np.sin(around) * np.cos(height), np.sin(height)])
    X_WC = look_at(eye, np.array([0.0, 0.0, 0.05]))
    X_WT = np.eye(4)
    X_WT[2, 3] = -0.01
    view = render_depth_view(
        [obj.mesh, box_mesh([0.6, 0.6, 0.01])], np.stack([X_WO, X_WT]), X_WC=X_WC, intrinsics=intrinsics,
        noise=DepthNoise(), seed=seed,
    )  # fmt: skip
    masks = find_clusters(Frame(view.depth, intrinsics), horizontal_plane(0.0, X_WC))
    points_C = back_project(view.depth, intrinsics, mask=masks[0])
    start = time.perf_counter()
    result = estimate_pose(obj, points_C, depth=view.depth, intrinsics=intrinsics, seed=seed)
    wall_s = time.perf_counter() - start
    X_CO_true = np.linalg.inv(X_WC) @ X_WO
    return PoseTrial(
        object=obj.name, view=view, X_CO_true=X_CO_true, result=result, errors=pose_errors(obj, result.X_CO, X_CO_true),
        wall_s=wall_s, diameter_m=float(pdist(obj.points_O[::8]).max()),
    )  # fmt: skip
