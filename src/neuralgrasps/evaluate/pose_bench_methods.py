"""Pose estimators on the same simulated scenes: ours, the published ones, and those of other libraries."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from neuralgrasps.errors import InputError, NeuralGraspsError
from neuralgrasps.evaluate.pose import FAILED, PoseErrors, pose_errors
from neuralgrasps.evaluate.pose_peers import PEERS, prepare_peer
from neuralgrasps.evaluate.pose_scenes import CONDITIONS, Condition, PoseScene, pose_scene
from neuralgrasps.geometry.camera import back_project
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.model.checkpoint import Run, load_run
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.run_notes import read_notes, run_folder
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.paper_pose import baseline_pose, contact_pose
from neuralgrasps.perception.pose import estimate_pose
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.table import find_table
from neuralgrasps.seeds import child_rng, child_seed

OURS, BASELINE, CONTACT = "ours", "baseline", "contact"
GRIPPER = "fetch"  # whose held-out grasps say where the gripper of `contact` is


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """What worker processes open by themselves, once each.

    Attributes:
        sources: names or files of the objects.
        run: name of the run whose grasps are used, None without; run_sources: names or files of its objects.
    """

    sources: tuple[str, ...]
    run: str | None = None
    run_sources: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodTrial:
    """One estimate of one scene by one method.

    Attributes:
        condition: of the scene; index: its number; visible_share: of the object.
        errors: against the truth; `FAILED` when there was no pose, and `reason` says why.
        cpu_s: processor time of the estimate; what is made once per object is not in it.
        confidence: said by the method; nan when it says none.
    """

    method: str
    object: str
    condition: Condition
    index: int
    visible_share: float
    errors: PoseErrors
    cpu_s: float
    confidence: float = math.nan
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTrial:
    """The plane fit of one scene: processor time, and how far the plane is off at the object; nan when none was found.

    Attributes:
        angle_rad: between the normals; height_m: of the object's centre over the two planes, the difference.
    """

    cpu_s: float
    angle_rad: float
    height_m: float


@lru_cache(maxsize=4)
def open_library(library: Library) -> tuple[ObjectModel, ...]:
    """The objects of a library."""
    return tuple(load_object(source) for source in library.sources)


@lru_cache(maxsize=4)
def open_library_run(library: Library) -> Run:
    """The run of a library, with that library's objects.

    Raises:
        InputError: the library names no run, or an object of the run is missing or another one.
    """
    if library.run is None:
        raise InputError("the library has no run; expected the name of one.")
    objects = {obj.name: obj for obj in (load_object(source) for source in library.run_sources)}
    missing = [name for name in read_notes(run_folder(library.run)).objects if name not in objects]
    if missing:
        raise InputError(f"run '{library.run}' is also of {', '.join(missing)}; give the meshes of these objects too.")
    return load_run(library.run, objects=objects)


def scene_of(library: Library, target: int, condition: Condition, index: int, seed: int) -> PoseScene:
    """Scene number `index` of an object under a condition; the same for every method."""
    objects = open_library(library)
    scene_seed = child_seed(seed, "pose bench", condition, index)
    return pose_scene(objects[target], condition, seed=scene_seed, distractors=objects)


def fitted_table(scene: PoseScene) -> tuple[Plane | None, TableTrial]:
    """The table that `find_table` sees in a scene; None when it sees none."""
    start = time.process_time()
    try:
        plane = find_table(Frame(depth=scene.depth, intrinsics=scene.intrinsics)).plane
    except InputError:
        return None, TableTrial(cpu_s=time.process_time() - start, angle_rad=math.nan, height_m=math.nan)
    cpu_s = time.process_time() - start
    middle_C = back_project(scene.depth, scene.intrinsics, mask=scene.mask).mean(axis=0)
    cosine = float(np.clip(plane.normal @ scene.table.normal, -1.0, 1.0))
    off = abs(float(plane.height(middle_C) - scene.table.height(middle_C)))
    return plane, TableTrial(cpu_s=cpu_s, angle_rad=math.acos(cosine), height_m=off)


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """What methods are given; each takes what it can use."""

    obj: ObjectModel
    scene: PoseScene
    points_C: np.ndarray
    table: Plane | None
    library: Library
    X_CH: np.ndarray | None
    seed: int


def _ours(view: _View) -> tuple[np.ndarray, float]:
    scene = view.scene
    found = estimate_pose(
        view.obj, depth=scene.depth, intrinsics=scene.intrinsics, mask=scene.mask, table=view.table, seed=view.seed
    )
    return found.X_CO, found.confidence


def _baseline(view: _View) -> tuple[np.ndarray, float]:
    field = _field_of(view.library, view.obj.name)
    return baseline_pose(field, None, view.points_C, object_name=view.obj.name, seed=view.seed).X_CO, math.nan


def _contact(view: _View) -> tuple[np.ndarray, float]:
    assert view.X_CH is not None
    run = open_library_run(view.library)
    found = contact_pose(run, view.points_C, view.X_CH, hand=GRIPPER, object_name=view.obj.name, seed=view.seed)
    return found.X_CO, math.nan


def _peer(name: str) -> Callable[[_View], tuple[np.ndarray, float]]:
    return lambda view: (PEERS[name](view.obj, view.points_C, seed=view.seed), math.nan)


METHODS: Mapping[str, Callable[[_View], tuple[np.ndarray, float]]] = MappingProxyType(
    {OURS: _ours, BASELINE: _baseline, CONTACT: _contact, **{name: _peer(name) for name in PEERS}}
)
"""Estimators by name; the name is the suffix of their figures, but that of ours."""


@lru_cache(maxsize=64)
def _field_of(library: Library, name: str) -> KinematicField:
    """A field of one object: an object of this field is exact, and no run needs to know it."""
    obj = next(obj for obj in open_library(library) if obj.name == name)
    return KinematicField(hands={}, objects={name: obj})


def has_grasps(run: Run, object_name: str) -> bool:
    """Whether a run holds unseen and known grasps of the gripper on an object."""
    return (GRIPPER, object_name) in run.grasps and all(
        run.codebook.where(hand=GRIPPER, object_name=object_name, is_test=part).any() for part in (True, False)
    )


def gripper_pose(run: Run, scene: PoseScene, rng: np.random.Generator) -> np.ndarray:
    """X_CH (4, 4) of the gripper at one of its unseen grasps of the object, at the object's true pose."""
    rows = np.flatnonzero(run.codebook.where(hand=GRIPPER, object_name=scene.object, is_test=True))
    grasp = run.codebook.grasp_index[rows[rng.integers(len(rows))]]
    return scene.X_CO_true @ run.grasps[GRIPPER, scene.object].X_OH[grasp]


def measure_methods(
    library: Library, target: int, indices: Sequence[int], counts: Mapping[str, int], seed: int
) -> tuple[list[MethodTrial], list[TableTrial]]:
    """Every method on some scenes of one object, under each condition.

    Args:
        target: which object of the library. indices: numbers of the scenes.
        counts: how many scenes of an object each method sees: those with smaller numbers.
    """
    obj = open_library(library)[target]
    trials, tables = [], []
    for method in counts:
        _make_ready(method, library, target)
    for condition in CONDITIONS:
        for index in indices:
            scene = scene_of(library, target, condition, index, seed)
            table, fit = fitted_table(scene)
            tables.append(fit)
            view = _view_of(library, obj, scene, table, index, seed)
            trials += [_tried(m, view, index) for m in counts if index < counts[m] and _applies(m, view)]
    return trials, tables


def _view_of(library: Library, obj: ObjectModel, scene: PoseScene, table: Plane | None, index: int, seed: int) -> _View:
    X_CH = None
    if library.run is not None:
        run = open_library_run(library)
        if has_grasps(run, obj.name):
            X_CH = gripper_pose(run, scene, child_rng(seed, "gripper", obj.name, scene.condition, index))
    return _View(
        obj=obj, scene=scene, points_C=back_project(scene.depth, scene.intrinsics, mask=scene.mask), table=table,
        library=library, X_CH=X_CH, seed=child_seed(seed, "estimate", obj.name, scene.condition, index),
    )  # fmt: skip


def _applies(method: str, view: _View) -> bool:
    return method != CONTACT or view.X_CH is not None


def _make_ready(method: str, library: Library, target: int) -> None:
    """Make what a method keeps of an object, and load its compiled loops, so that no estimate pays for it."""
    obj = open_library(library)[target]
    if method in PEERS:
        prepare_peer(method, obj)
    elif method == OURS:
        pose_model(obj)
    elif method == BASELINE:
        _field_of(library, obj.name)
    _load_loops(method, library)


@lru_cache(maxsize=16)
def _load_loops(method: str, library: Library) -> None:
    """One estimate that is not counted, in every process."""
    objects = open_library(library)
    for target, obj in enumerate(objects):
        scene = scene_of(library, target, "easy", -1, 0)
        view = _view_of(library, obj, scene, scene.table, -1, 0)
        if _applies(method, view):
            _tried(method, view, -1)
            return


def _tried(method: str, view: _View, index: int) -> MethodTrial:
    errors, confidence, reason = FAILED, math.nan, ""
    start = time.process_time()
    try:
        X_CO, confidence = METHODS[method](view)
        cpu_s = time.process_time() - start
        errors = pose_errors(view.obj, X_CO, view.scene.X_CO_true)
    except NeuralGraspsError as error:
        cpu_s, reason = time.process_time() - start, str(error)
    return MethodTrial(
        method=method, object=view.obj.name, condition=view.scene.condition, index=index,
        visible_share=view.scene.visible_share, errors=errors, cpu_s=cpu_s, confidence=confidence, reason=reason,
    )  # fmt: skip
