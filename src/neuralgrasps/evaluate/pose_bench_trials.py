"""What else is measured of our pose estimation: which object it is, what contact adds, and tracking."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.pose import FAILED, PoseErrors, pose_errors
from neuralgrasps.evaluate.pose_bench_methods import (
    Library,
    fitted_table,
    open_library,
    open_library_run,
    scene_of,
)
from neuralgrasps.evaluate.pose_occluders import Placed, body_of, turn_z
from neuralgrasps.evaluate.pose_room import random_room
from neuralgrasps.evaluate.pose_scenes import (
    UNKNOWN_KINDS,
    Condition,
    PoseScene,
    background_scene,
    held_scene,
)
from neuralgrasps.evaluate.pose_views import see
from neuralgrasps.geometry.camera import back_project
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import make_transform_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.contact import ContactPoints
from neuralgrasps.perception.identify import identify_object
from neuralgrasps.perception.pose import estimate_pose
from neuralgrasps.perception.track import track_pose
from neuralgrasps.seeds import child_rng, child_seed

IdentityKind = Literal["occluded", "hard", "left out", "background"]
NEAR_M = 0.010  # a contact point so near to an observed one is seen


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentityTrial:
    """One view, and which object of the library it was said to show.

    Attributes:
        kind: occluded and hard scenes of a library object; "left out": occluded ones of an object that was taken out of
            the library; "background": of things that no library has.
        object: what is there: a library's object, or a kind of background.
        named: what was said; None = none of the library. right: it is right. probability: said of it.
        cpu_s: of the whole question.
    """

    kind: IdentityKind
    object: str
    named: str | None
    right: bool
    probability: float
    visible_share: float
    cpu_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactTrial:
    """One view of an object in a hand, estimated with and without the hand's contacts.

    Attributes:
        seen_share: of the contact points, those within 10 mm of an observed point of the object.
        before, after: errors without and with contacts. cpu_s: of the estimate with.
    """

    object: str
    hand: str
    grasp: int
    contacts: int
    seen_share: float
    visible_share: float
    before: PoseErrors
    after: PoseErrors
    cpu_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackTrial:
    """An object that is pushed over a table in front of a camera that stands still.

    Attributes:
        start: errors of the first pose, by `estimate_pose`. errors: of every frame after it.
        cpu_s: of every frame after the first.
    """

    object: str
    start: PoseErrors
    errors: tuple[PoseErrors, ...]
    cpu_s: tuple[float, ...]


def measure_identity(
    library: Library, target: int, kind: IdentityKind, indices: Sequence[int], seed: int
) -> list[IdentityTrial]:
    """Ask what some scenes show; those of "left out" are occluded ones, and `target` is not used for the background."""
    objects = open_library(library)
    _load_identity_loops(library)
    trials = []
    for index in indices:
        if kind == "background":
            name = UNKNOWN_KINDS[index % len(UNKNOWN_KINDS)]
            scene = background_scene(child_seed(seed, "background", index), kind=name, distractors=objects)
        else:
            name, condition = objects[target].name, _CONDITION_OF[kind]
            scene = scene_of(library, target, condition, index, seed)
        asked = [obj for i, obj in enumerate(objects) if kind != "left out" or i != target]
        trials.append(_identified(asked, scene, kind, name, child_seed(seed, "identity", kind, name, index)))
    return trials


_CONDITION_OF: Mapping[IdentityKind, Condition] = {"occluded": "occluded", "hard": "hard", "left out": "occluded"}


def _identified(
    objects: Sequence[ObjectModel], scene: PoseScene, kind: IdentityKind, name: str, seed: int
) -> IdentityTrial:
    table, _ = fitted_table(scene)
    start = time.process_time()
    found = identify_object(
        objects, depth=scene.depth, intrinsics=scene.intrinsics, mask=scene.mask, table=table, seed=seed
    )
    cpu_s = time.process_time() - start
    truth = name if kind in ("occluded", "hard") else None
    return IdentityTrial(
        kind=kind, object=name, named=found.name, right=found.name == truth,
        probability=found.none_probability if found.name is None else found.probability[found.name],
        visible_share=scene.visible_share, cpu_s=cpu_s,
    )  # fmt: skip


@lru_cache(maxsize=4)
def _load_identity_loops(library: Library) -> None:
    """Objects prepared and compiled loops loaded in this process, uncounted."""
    scene = scene_of(library, 0, "easy", -1, 0)
    _identified(open_library(library), scene, "occluded", scene.object, 0)


def measure_contact(
    library: Library, hand: str, object_name: str, grasps: Sequence[int], seed: int
) -> list[ContactTrial]:
    """Estimate an object in a hand with and without its contacts, for some grasps of the library's run."""
    run = open_library_run(library)
    obj, model, known = run.field.object(object_name), run.field.hand(hand), run.grasps[hand, object_name]
    trials = []
    for grasp in grasps:
        scene = held_scene(obj, model, known, grasp, seed=child_seed(seed, "held", hand, object_name, grasp))
        if not len(scene.contact_points_C) or not scene.mask.any():
            continue
        contact = ContactPoints(points_C=scene.contact_points_C)
        common: dict[str, Any] = {
            "depth": scene.depth,
            "intrinsics": scene.intrinsics,
            "mask": scene.mask,
            "seed": scene.seed,
        }
        try:
            before = estimate_pose(obj, **common)
            start = time.process_time()
            after = estimate_pose(obj, **common, contact=contact)
            cpu_s = time.process_time() - start
        except InputError:  # too little of it is seen, for both
            continue
        observed_C = back_project(scene.depth, scene.intrinsics, mask=scene.mask)
        gaps, _ = cKDTree(observed_C).query(scene.contact_points_C)
        trials.append(
            ContactTrial(
                object=object_name, hand=hand, grasp=grasp, contacts=len(scene.contact_points_C),
                seen_share=float((gaps < NEAR_M).mean()), visible_share=scene.visible_share,
                before=pose_errors(obj, before.X_CO, scene.X_CO_true),
                after=pose_errors(obj, after.X_CO, scene.X_CO_true), cpu_s=cpu_s,
            )
        )  # fmt: skip
    return trials


def measure_tracking(library: Library, target: int, indices: Sequence[int], frames: int, seed: int) -> list[TrackTrial]:
    """Follow an object over `frames` frames, without a mask; it moves 5 to 10 mm and turns 2 to 3 degrees a frame."""
    obj = open_library(library)[target]
    return [_tracked(obj, library, target, index, frames, seed) for index in indices]


def _tracked(obj: ObjectModel, library: Library, target: int, index: int, frames: int, seed: int) -> TrackTrial:
    first = scene_of(library, target, "easy", index, seed)
    table, _ = fitted_table(first)
    X_WO = first.X_WC @ first.X_CO_true
    room = random_room(child_rng(seed, "tracking room", obj.name, index), first.X_WC)
    motion = _pushes(frames, child_rng(seed, "tracking", obj.name, index))
    found = estimate_pose(
        obj, depth=first.depth, intrinsics=first.intrinsics, mask=first.mask, table=table, seed=first.seed
    )
    X_CO, errors, cpu_s = found.X_CO, [], []
    track_pose(obj, first.depth, first.intrinsics, X_CO, table=table)  # loads compiled loops
    for frame, (shift_W, turn) in enumerate(motion):
        X_WO = _pushed(obj, X_WO, shift_W, turn)
        sight = see(
            Placed(body=body_of(obj), X_WB=X_WO), (), room, X_WC=first.X_WC, intrinsics=first.intrinsics, hard=False,
            seed=child_seed(seed, "tracking sensor", obj.name, index, frame),
        )  # fmt: skip
        start = time.process_time()
        X_CO, missing = _followed(obj, sight.depth, first, X_CO, table)
        cpu_s.append(time.process_time() - start)
        errors.append(FAILED if missing else pose_errors(obj, X_CO, np.linalg.inv(first.X_WC) @ X_WO))
    return TrackTrial(
        object=obj.name, start=pose_errors(obj, found.X_CO, first.X_CO_true), errors=tuple(errors), cpu_s=tuple(cpu_s)
    )


def _followed(
    obj: ObjectModel, depth: np.ndarray, first: PoseScene, X_CO: np.ndarray, table: Plane | None
) -> tuple[np.ndarray, bool]:
    """The next pose, and whether there is none."""
    try:
        return track_pose(obj, depth, first.intrinsics, X_CO, table=table).X_CO, False
    except InputError:
        return X_CO, True


def _pushes(frames: int, rng: np.random.Generator) -> list[tuple[np.ndarray, float]]:
    """(3,) shifts on the table and turns about its normal, frame by frame; the shifts go round once in 20 frames."""
    way, turn = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
    pushes = []
    for frame in range(frames):
        angle = way + turn * 2.0 * np.pi * frame / 20.0
        shift = rng.uniform(0.005, 0.010) * np.array([np.cos(angle), np.sin(angle), 0.0])
        pushes.append((shift, turn * np.deg2rad(rng.uniform(2.0, 3.0))))
    return pushes


def _pushed(obj: ObjectModel, X_WO: np.ndarray, shift_W: np.ndarray, turn: float) -> np.ndarray:
    """A pose moved by a shift, and turned about the vertical through the centre of mass."""
    place = X_WO[:3, :3] @ obj.com_O + X_WO[:3, 3]
    return make_transform_np(None, place + shift_W) @ turn_z(turn) @ make_transform_np(None, -place) @ X_WO
