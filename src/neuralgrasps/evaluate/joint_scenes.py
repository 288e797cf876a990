"""Random scenes with a hand that holds something, for the benchmark of the joint net: drawn, then read."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, project
from neuralgrasps.geometry.raster import NEAR_M, raster_labels
from neuralgrasps.human.nets.joint_errors import procrustes_error, root_relative_error
from neuralgrasps.human.nets.joint_reader import JointReader
from neuralgrasps.human.scenes.image_noise import CAMERA_NOISE, sensed_image
from neuralgrasps.human.scenes.kit import SceneKit
from neuralgrasps.human.scenes.random_scene import RandomScene, SceneMix, draw_scene, random_scene
from neuralgrasps.human.scenes.surroundings import HAND
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.perception.frame import Frame
from neuralgrasps.seeds import child_rng

CAMERA = Intrinsics(580.0, 580.0, 319.5, 239.5, 640, 480)
MIX = SceneMix(held=1.0, near=0.0, varied=0.0)
"""Every hand holds something, and is the model's."""
_FIRST_SEED, _SEEDS = 2**31, 2**32  # training draws its scenes from the seeds below
_BOX_SHIFT, _BOX_SIZE = 0.1, 0.15  # largest errors of a box: of its middle in its widths, of its size (log)
_AROUND = 1.5  # the hand alone is drawn in an image so many times as wide, to see all of it
_COARSE = 2  # and so many times as coarse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointScene:
    """One scene as a camera sees it; camera frame, metres.

    Attributes:
        frame: 640 x 480 depth with the sensor's noise; None where nothing was measured.
        box: the hand's, as far off as a detector's may be.
        joints_C: (21, 3) true joints. mask: (480, 640) bool, the hand's pixels.
        visible: share of the hand's outline that is in the image and not hidden.
    """

    frame: Frame | None
    box: HandBox
    joints_C: np.ndarray
    mask: np.ndarray
    visible: float


@dataclass(frozen=True, slots=True, kw_only=True)
class JointErrors:
    """What was read of one scene; lengths in metres, nan where nothing was read.

    Attributes:
        root, procrustes: see `joint_errors`; absolute: mean distance of the joints in the camera frame.
        iou: of the mask, where something was measured. first_root, first_procrustes: of the first look alone.
        visible: see `JointScene`. look_s, read_s: processor time of one look and of all of it.
    """

    root: float = float("nan")
    procrustes: float = float("nan")
    absolute: float = float("nan")
    iou: float = float("nan")
    first_root: float = float("nan")
    first_procrustes: float = float("nan")
    visible: float = 0.0
    look_s: float = float("nan")
    read_s: float = float("nan")

    @property
    def found(self) -> bool:
        return bool(np.isfinite(self.root))


def joint_scene(kit: SceneKit, seed: int, *path: str | int) -> JointScene:
    """The scene of a seed and of names or numbers below it (see `child_rng`)."""
    rng = child_rng(seed, *path)
    scene = random_scene(kit, int(rng.integers(_FIRST_SEED, _SEEDS)), MIX)
    depth, labels = draw_scene(scene, CAMERA)
    mask = labels == HAND
    seen = sensed_image(depth, CAMERA.fx, noise=CAMERA_NOISE, seed=int(rng.integers(_SEEDS)))
    try:
        frame = Frame(seen, CAMERA)
    except InputError:  # nothing was measured
        frame = None
    return JointScene(
        frame=frame, box=_wrong_box(scene.points_C[: len(kit.skin_core)], rng), joints_C=scene.joints_C, mask=mask,
        visible=float(mask.sum() / max(_pixels_alone(kit, scene), 1.0)),
    )  # fmt: skip


def measure_scene(scene: JointScene, once: JointReader, reader: JointReader) -> JointErrors:
    """Read a scene by one look, then by all."""
    if scene.frame is None:
        return JointErrors(visible=scene.visible)
    first, look_s = _timed(lambda frame: once.read(frame, scene.box), scene.frame)
    seen, read_s = _timed(lambda frame: reader.read(frame, scene.box), scene.frame)
    if seen.mask is None:
        return JointErrors(visible=scene.visible)
    measured = scene.frame.depth > 0
    hand = scene.mask & measured
    return JointErrors(
        root=float(root_relative_error(seen.points_C, scene.joints_C)),
        procrustes=float(procrustes_error(seen.points_C, scene.joints_C)),
        absolute=float(np.linalg.norm(seen.points_C - scene.joints_C, axis=-1).mean()),
        iou=float((hand & seen.mask).sum() / max((hand | (seen.mask & measured)).sum(), 1)),
        first_root=float(root_relative_error(first.points_C, scene.joints_C)),
        first_procrustes=float(procrustes_error(first.points_C, scene.joints_C)),
        visible=scene.visible, look_s=look_s, read_s=read_s,
    )  # fmt: skip


def _timed(read: Callable[[Frame], SeenJoints], frame: Frame) -> tuple[SeenJoints, float]:
    begun = time.process_time()
    seen = read(frame)
    return seen, time.process_time() - begun


def _wrong_box(skin_C: np.ndarray, rng: np.random.Generator) -> HandBox:
    """The box of a hand's skin (V, 3), off by up to a tenth of its longer side and 15 % of its size."""
    points = skin_C.copy()
    points[:, 2] = np.maximum(points[:, 2], 0.05)
    uv = project(points, CAMERA)
    low, high = uv.min(axis=0), uv.max(axis=0)
    shift = rng.uniform(-_BOX_SHIFT, _BOX_SHIFT, 2) * (high - low).max()
    middle, half = 0.5 * (low + high) + shift, 0.5 * (high - low) * np.exp(rng.uniform(-_BOX_SIZE, _BOX_SIZE))
    (u_min, v_min), (u_max, v_max) = middle - half, middle + half
    return HandBox(u_min=u_min, v_min=v_min, u_max=u_max, v_max=v_max, score=1.0, side="right", side_score=1.0)


def _pixels_alone(kit: SceneKit, scene: RandomScene) -> float:
    """How many pixels the hand would have alone, those beyond the image's edges too."""
    faces = len(kit.skin_faces)
    shape = round(_AROUND * CAMERA.height), round(_AROUND * CAMERA.width)
    depth, labels = np.full(shape, np.inf, np.float32), np.zeros(shape, np.int8)
    f = CAMERA.fx / _COARSE
    raster_labels(
        scene.points_C, scene.faces[:faces], scene.face_labels[:faces], f, f, 0.5 * (shape[1] - 1),
        0.5 * (shape[0] - 1), NEAR_M, depth, labels,
    )  # fmt: skip
    return float(_COARSE**2 * (labels == HAND).sum())
