"""One shard: the grasps, contact maps, SDF samples and point clouds of one hand and object. Torch-free."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.dataset.clouds import SceneClouds, scene_clouds
from neuralgrasps.dataset.samples import Normalisation, SdfSamples, contact_maps, sample_scenes
from neuralgrasps.dataset.schema import DatasetConfig, sha256_of_file
from neuralgrasps.dataset.stored import content_hash, is_whole
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.grasps.grasp_io import save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.tensor_files import tensor_bytes

SAMPLES_LAYOUT, CLOUDS_LAYOUT = 2, 1  # numbers to raise when these files change
SAMPLE_ARRAYS = tuple(f.name for f in fields(SdfSamples))
CLOUD_ARRAYS = tuple(f.name for f in fields(SceneClouds))
CLOUD_SETTINGS = ("clouds", "cloud_points")  # what of the configuration only clouds depend on


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardTask:
    """Everything a worker needs to make one shard; picklable for a process pool, and small.

    Attributes:
        folder: the dataset folder.
        hand, object: names; X_OH: (N, 4, 4), q: (N, J): the grasps; grasps_sha256: of their file, already written.
        mesh: the object's surface; points_O: (P, 3) its contact points; content_hash: of the mesh.
        packed, fingerprint: the hand's arrays and their hash; hand_index: its place among the dataset's hands.
    """

    folder: Path
    hand: str
    object: str
    X_OH: np.ndarray
    q: np.ndarray
    grasps_sha256: str
    mesh: Mesh
    points_O: np.ndarray
    content_hash: str
    packed: PackedHand
    fingerprint: str
    hand_index: int
    normalisation: Normalisation
    config: DatasetConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardFiles:
    """Names (relative to the dataset folder), keys and hashes of a finished shard; no cloud file: all three ""."""

    hand: str
    object: str
    scenes: int
    key: str
    grasps_file: str
    grasps_sha256: str
    samples_file: str
    samples_sha256: str
    clouds_key: str
    clouds_file: str
    clouds_sha256: str
    was_built: bool


def fingerprint_of(packed: PackedHand) -> str:
    """sha256 over every array of a packed hand: kinematics, limits, shapes and surface points."""
    digest = hashlib.sha256()
    for name, value in zip(packed._fields, packed, strict=True):
        array = np.ascontiguousarray(value)
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def samples_key(task: ShardTask) -> str:
    """Hash of all that contact maps and SDF samples are computed from."""
    config = {name: value for name, value in asdict(task.config).items() if name not in CLOUD_SETTINGS}
    return _key(task, SAMPLES_LAYOUT, config)


def clouds_key(task: ShardTask) -> str:
    """Hash of all that the clouds are computed from."""
    config = {name: getattr(task.config, name) for name in ("seed", *CLOUD_SETTINGS)}
    return _key(task, CLOUDS_LAYOUT, config)


def _key(task: ShardTask, layout: int, config: dict[str, Any]) -> str:
    digest = hashlib.sha256()
    digest.update(json.dumps([layout, task.hand, task.object, config], sort_keys=True).encode())
    digest.update(f"{task.content_hash} {task.fingerprint} {task.hand_index}".encode())
    for array in (task.points_O, task.X_OH, task.q):
        digest.update(np.ascontiguousarray(array, np.float64).tobytes())
    return digest.hexdigest()


def shard_path(kind: str, hand: str, object_name: str) -> str:
    """A pair's file of `kind` ("grasps", "samples", "clouds"), relative to the dataset folder, with '/' everywhere."""
    return f"{kind}/{object_name}/{hand}.safetensors"


def write_grasps(folder: Path, grasps: GraspSet) -> str:
    """Write the grasp file of a pair and return its sha256."""
    path = folder / shard_path("grasps", grasps.hand, grasps.object)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_grasps(path, grasps)
    return sha256_of_file(path)


def build_shard(task: ShardTask) -> ShardFiles:
    """Make the files of one shard unless the same ones are already on disk. The worker function of a build."""
    samples, clouds = (shard_path(kind, task.hand, task.object) for kind in ("samples", "clouds"))
    key, own_clouds_key = samples_key(task), clouds_key(task)
    samples_path, clouds_path = task.folder / samples, task.folder / clouds
    without_samples = not is_whole(samples_path, key)
    if without_samples:
        write_whole(samples_path, _bytes(task, key, _sample_arrays(task)))
    wanted = task.config.clouds != "none"
    without_clouds = wanted and not is_whole(clouds_path, own_clouds_key)
    if without_clouds:
        write_whole(clouds_path, _bytes(task, own_clouds_key, _cloud_arrays(task)))
    return ShardFiles(
        hand=task.hand,
        object=task.object,
        scenes=len(task.X_OH),
        key=key,
        grasps_file=shard_path("grasps", task.hand, task.object),
        grasps_sha256=task.grasps_sha256,
        samples_file=samples,
        samples_sha256=sha256_of_file(samples_path),
        clouds_key=own_clouds_key if wanted else "",
        clouds_file=clouds if wanted else "",
        clouds_sha256=sha256_of_file(clouds_path) if wanted else "",
        was_built=without_samples or without_clouds,
    )


def compute_samples(task: ShardTask) -> SdfSamples:
    """The SDF samples of a shard, from its inputs alone."""
    return sample_scenes(
        task.mesh,
        task.packed,
        task.X_OH,
        task.q,
        hand=task.hand,
        object_name=task.object,
        normalisation=task.normalisation,
        config=task.config,
        hand_index=task.hand_index,
    )


def compute_contact_maps(task: ShardTask) -> np.ndarray:
    """(N, P) float32 contact maps of a shard, from its inputs alone."""
    radius = task.config.contact_decay * task.normalisation.scale_m
    return contact_maps(task.packed, task.X_OH, task.q, task.points_O, radius_m=radius)


def compute_clouds(task: ShardTask) -> SceneClouds:
    """The point clouds of a shard, from its inputs alone."""
    return scene_clouds(
        task.mesh,
        task.packed,
        task.X_OH,
        task.q,
        hand=task.hand,
        object_name=task.object,
        normalisation=task.normalisation,
        config=task.config,
    )


def _sample_arrays(task: ShardTask) -> dict[str, np.ndarray]:
    arrays = {"contact_map": compute_contact_maps(task)}
    if task.config.store_samples:
        samples = compute_samples(task)
        arrays |= {name: getattr(samples, name) for name in SAMPLE_ARRAYS}
    return arrays


def _cloud_arrays(task: ShardTask) -> dict[str, np.ndarray]:
    clouds = compute_clouds(task)
    return {name: getattr(clouds, name) for name in CLOUD_ARRAYS}


def _bytes(task: ShardTask, key: str, arrays: dict[str, np.ndarray]) -> bytes:
    return tensor_bytes(arrays, {"key": key, "content": content_hash(arrays), "hand": task.hand, "object": task.object})
