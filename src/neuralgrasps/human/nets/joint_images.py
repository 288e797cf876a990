# ruff: noqa: NPY002 - compiled code has the old generator only, seeded per image
"""Depth crops of random scenes with the truth about the hand: what the joint net learns from, made as it learns."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.raster import NEAR_M, raster_labels
from neuralgrasps.human.nets.crop import BOX_MARGIN, CROP, DEPTH_UNIT_M, fill_input, middle_depth
from neuralgrasps.human.scenes.image_noise import draw_noise, sense_image
from neuralgrasps.human.scenes.kit import SceneKit
from neuralgrasps.human.scenes.random_scene import SceneMix, compose_scene, scene_buffers
from neuralgrasps.human.scenes.surroundings import HAND
from neuralgrasps.parallel import blocks

CAMERA = (580.0, 319.5, 239.5, 640, 480)
"""fx = fy, cx, cy, width and height of the camera that crops are taken from."""


class CropBatch(NamedTuple):
    """N crops and their truth.

    Attributes:
        inputs: (N, 2, 96, 96) float32 and conditions: (N, 4) float32 as of `crop.Crop`.
        mask: (N, 96, 96) uint8, 1 where the hand is seen.
        joints: (N, 21, 3) float32 u, v in crop widths from the middle, depth from the reference in DEPTH_UNIT_M.
        visible: (N,) float32 share of the hand's pixels within the image that nothing else hides.
        holds: (N,) bool, it holds a solid; refined: (N,) bool, the box is one taken again round joints found before.
        joints_C: (N, 21, 3) float32 camera frame, metres.
    """

    inputs: np.ndarray
    conditions: np.ndarray
    mask: np.ndarray
    joints: np.ndarray
    visible: np.ndarray
    holds: np.ndarray
    refined: np.ndarray
    joints_C: np.ndarray


class CropMix(NamedTuple):
    """How boxes are off.

    Attributes:
        refined: share of boxes taken again round joints found before, whose depth is nearly right.
        shift, size: largest errors of a detected box: of its middle in its widths, of its width (log).
        poor: share of detected boxes that are off by up to 1.8 times as much.
        strongest_noise: times the camera's; measure_visible: render the hand alone too.
        turned: share of crops of the image turned by 180 degrees.
    """

    refined: float = 0.5
    shift: float = 0.1
    size: float = 0.15
    poor: float = 0.4
    strongest_noise: float = 1.4
    measure_visible: bool = False
    turned: float = 0.0


def make_crops(
    kit: SceneKit, seeds: np.ndarray, *, scene: SceneMix | None = None, crop: CropMix | None = None, threads: int = 1
) -> CropBatch:
    """The crops of N seeds (uint32); the same for any number of threads."""
    n = len(seeds)
    batch = CropBatch(
        inputs=np.zeros((n, 2, CROP, CROP), np.float32), conditions=np.zeros((n, 4), np.float32),
        mask=np.zeros((n, CROP, CROP), np.uint8), joints=np.zeros((n, 21, 3), np.float32),
        visible=np.ones(n, np.float32), holds=np.zeros(n, np.bool_), refined=np.zeros(n, np.bool_),
        joints_C=np.zeros((n, 21, 3), np.float32),
    )  # fmt: skip
    mixes = scene or SceneMix(), crop or CropMix()
    parts = [CropBatch(*(array[rows] for array in batch)) for rows in blocks(n, threads)]
    seeds = np.asarray(seeds, np.uint32)
    with ThreadPoolExecutor(threads) as pool:
        list(
            pool.map(
                lambda rows, part: _fill_crops(kit, *mixes, seeds[rows], scene_buffers(kit), part),
                blocks(n, threads), parts,
            )
        )  # fmt: skip
    return batch


@njit(cache=True, error_model="numpy", nogil=True)
def _fill_crops(kit, scene, crop, seeds, room, batch):  # type: ignore[no-untyped-def]
    alone = np.empty((CROP, CROP), np.float32)
    depth, seen, labels = np.empty_like(alone), np.empty_like(alone), np.empty((CROP, CROP), np.int8)
    for n in range(seeds.shape[0]):
        batch.holds[n] = compose_scene(kit, scene, seeds[n], room)
        refined = np.random.random() < crop.refined
        batch.refined[n] = refined
        u, v, side = _hand_box(room.points[: kit.skin_core.shape[0]])
        u, v, side = _wrong_box(u, v, side, crop, refined)
        fx, cx, cy = _crop_camera(u, v, side)
        depth[:], labels[:] = np.inf, 0
        count = room.counts[1]
        raster_labels(room.points, room.faces[:count], room.labels, fx, fx, cx, cy, NEAR_M, depth, labels)
        noise = draw_noise(crop.strongest_noise)
        sense_image(depth, fx, side / CROP, noise, seen)
        _cut_at_image(u, v, side, seen, labels)
        z0 = middle_depth(seen)
        if refined or not z0 > 0.0:
            z0 = room.joints[:, 2].mean() + 0.015 * np.random.normal()
        fill_input(seen, z0, batch.inputs[n])
        _fill_conditions(u, v, side, z0, batch.conditions[n])
        hand = labels == HAND
        batch.mask[n] = hand
        _fill_joints(room.joints, u, v, side, z0, batch.joints[n])
        batch.joints_C[n] = room.joints
        if crop.measure_visible:
            alone[:] = np.inf
            faces = kit.skin_faces.shape[0]
            raster_labels(room.points, room.faces[:faces], room.labels, fx, fx, cx, cy, NEAR_M, alone, labels)
            batch.visible[n] = hand.sum() / max(np.isfinite(alone).sum(), 1)
        if crop.turned > 0.0 and np.random.random() < crop.turned:
            _turn(batch, n)


@njit(cache=True, error_model="numpy")
def _wrong_box(u, v, side, crop, refined):  # type: ignore[no-untyped-def]
    """A box as far off as a detector's, or as one taken again."""
    off = 1.8 if np.random.random() < crop.poor else 1.0
    shift, size = (0.03, 0.05) if refined else (off * crop.shift, off * crop.size)
    u += side * np.random.uniform(-shift, shift)
    v += side * np.random.uniform(-shift, shift)
    return u, v, side * math.exp(np.random.uniform(-size, size))


@njit(cache=True, error_model="numpy")
def _turn(batch, n):  # type: ignore[no-untyped-def]
    """Turn a crop and the truth about it by 180 degrees round the view; see `crop.turned`."""
    batch.inputs[n] = batch.inputs[n, :, ::-1, ::-1].copy()
    batch.mask[n] = batch.mask[n, ::-1, ::-1].copy()
    batch.conditions[n, 1:3] *= -1.0
    batch.joints[n, :, :2] *= -1.0
    batch.joints_C[n, :, :2] *= -1.0


@njit(cache=True, error_model="numpy")
def _hand_box(points):  # type: ignore[no-untyped-def]
    """Middle and width of the square box, pixels of CAMERA's image, round the hand's corners with the margin."""
    u0, v0, u1, v1 = np.inf, np.inf, -np.inf, -np.inf
    for n in range(points.shape[0]):
        z = max(points[n, 2], 0.05)
        u, v = CAMERA[0] * points[n, 0] / z + CAMERA[1], CAMERA[0] * points[n, 1] / z + CAMERA[2]
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if np.random.random() < 0.5:  # a detector may end boxes at the image's edge
        u0, u1 = max(u0, 0.0), min(u1, CAMERA[3] - 1.0)
        v0, v1 = max(v0, 0.0), min(v1, CAMERA[4] - 1.0)
    return 0.5 * (u0 + u1), 0.5 * (v0 + v1), BOX_MARGIN * max(u1 - u0, v1 - v0, 10.0)


@njit(cache=True, error_model="numpy", inline="always")
def _crop_camera(u, v, side):  # type: ignore[no-untyped-def]
    """fx, cx, cy of the crop with its middle at (u, v) of CAMERA's image."""
    ratio = CROP / side
    return CAMERA[0] * ratio, (CAMERA[1] - u) * ratio + 0.5 * (CROP - 1), (CAMERA[2] - v) * ratio + 0.5 * (CROP - 1)


@njit(cache=True, error_model="numpy")
def _cut_at_image(u, v, side, seen, labels):  # type: ignore[no-untyped-def]
    """Nothing is measured beyond the image's edge."""
    for row in range(CROP):
        y = v + (row - 0.5 * (CROP - 1)) * side / CROP
        for column in range(CROP):
            x = u + (column - 0.5 * (CROP - 1)) * side / CROP
            if not (-0.5 <= x < CAMERA[3] - 0.5 and -0.5 <= y < CAMERA[4] - 0.5):
                seen[row, column] = 0.0
                labels[row, column] = 0


@njit(cache=True, error_model="numpy", inline="always")
def _fill_conditions(u, v, side, z0, out):  # type: ignore[no-untyped-def]
    out[0] = side * z0 / CAMERA[0]
    out[1], out[2] = (u - CAMERA[1]) / CAMERA[0], (v - CAMERA[2]) / CAMERA[0]
    out[3] = z0


@njit(cache=True, error_model="numpy", inline="always")
def _fill_joints(joints_C, u, v, side, z0, out):  # type: ignore[no-untyped-def]
    for k in range(joints_C.shape[0]):
        x, y, z = joints_C[k]
        out[k, 0] = (CAMERA[0] * x / z + CAMERA[1] - u) / side
        out[k, 1] = (CAMERA[0] * y / z + CAMERA[2] - v) / side
        out[k, 2] = (z - z0) / DEPTH_UNIT_M
