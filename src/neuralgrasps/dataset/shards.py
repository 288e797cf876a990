"""One shard: the grasps, contact maps and SDF samples of one hand and object. Torch-free."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load

from neuralgrasps.dataset.samples import Normalisation, SdfSamples, contact_maps, sample_scenes
from neuralgrasps.dataset.schema import SCHEMA_VERSION, DatasetConfig, sha256_of_file
from neuralgrasps.errors import DataFormatError
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.grasps.grasp_io import save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.tensor_files import tensor_bytes


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
    """Names (relative to the dataset folder) and hashes of a finished shard."""

    hand: str
    object: str
    scenes: int
    key: str
    grasps_file: str
    grasps_sha256: str
    samples_file: str
    samples_sha256: str
    was_built: bool


def fingerprint_of(packed: PackedHand) -> str:
    """sha256 over every array of a packed hand: kinematics, limits, shapes and surface points."""
    digest = hashlib.sha256()
    for name, value in zip(packed._fields, packed, strict=True):
        array = np.ascontiguousarray(value)
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def shard_key(task: ShardTask) -> str:
    """Hash of all that a shard is computed from."""
    digest = hashlib.sha256()
    config = asdict(task.config)
    digest.update(json.dumps([SCHEMA_VERSION, task.hand, task.object, config], sort_keys=True).encode())
    digest.update(f"{task.content_hash} {task.fingerprint} {task.hand_index}".encode())
    for array in (task.points_O, task.X_OH, task.q):
        digest.update(np.ascontiguousarray(array, np.float64).tobytes())
    return digest.hexdigest()


def shard_paths(hand: str, object_name: str) -> tuple[str, str]:
    """Grasp file and sample file of a pair, relative to the dataset folder, with '/' on every system."""
    return f"grasps/{object_name}/{hand}.safetensors", f"samples/{object_name}/{hand}.safetensors"


def write_grasps(folder: Path, grasps: GraspSet) -> str:
    """Write the grasp file of a pair and return its sha256."""
    path = folder / shard_paths(grasps.hand, grasps.object)[0]
    path.parent.mkdir(parents=True, exist_ok=True)
    save_grasps(path, grasps)
    return sha256_of_file(path)


def build_shard(task: ShardTask) -> ShardFiles:
    """Make the sample file of one shard unless the same one is already on disk. The worker function of a build."""
    grasps_name, samples_name = shard_paths(task.hand, task.object)
    samples_path = task.folder / samples_name
    key = shard_key(task)
    missing = not is_whole(samples_path, key)
    if missing:
        write_whole(samples_path, _sample_bytes(task, key))
    return ShardFiles(
        hand=task.hand,
        object=task.object,
        scenes=len(task.X_OH),
        key=key,
        grasps_file=grasps_name,
        grasps_sha256=task.grasps_sha256,
        samples_file=samples_name,
        samples_sha256=sha256_of_file(samples_path),
        was_built=missing,
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


def _sample_bytes(task: ShardTask, key: str) -> bytes:
    arrays = {"contact_map": compute_contact_maps(task)}
    if task.config.store_samples:
        samples = compute_samples(task)
        arrays |= {
            "points_O": samples.points_O,
            "sdf_object": samples.sdf_object,
            "sdf_hand": samples.sdf_hand,
            "hand_index": samples.hand_index,
        }
    metadata = {"key": key, "content": _content_hash(arrays), "hand": task.hand, "object": task.object}
    return tensor_bytes(arrays, metadata)


def _content_hash(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def is_whole(path: Path, key: str) -> bool:
    """Whether a sample file is there, was computed from the inputs of this key, and has not changed since."""
    metadata = metadata_on_disk(path)
    if metadata.get("key") != key:
        return False
    try:
        return _content_hash(load(path.read_bytes())) == metadata.get("content")
    except (SafetensorError, OSError):
        return False


def metadata_on_disk(path: Path) -> Mapping[str, str]:
    """The header notes of a sample file; empty when there is none or it cannot be read."""
    if not path.is_file():
        return {}
    try:
        with safe_open(path, framework="numpy") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError):
        return {}


def read_arrays(path: Path, *, sha256: str | None = None) -> Mapping[str, np.ndarray]:
    """Arrays of a safetensors file of a dataset.

    Raises:
        DataFormatError: the file is missing, corrupt, or not the one the manifest names (`sha256`).
    """
    fix = "Run the build again: it replaces damaged files and keeps the others."
    if not path.is_file():
        raise DataFormatError(f"dataset file '{path}' is missing. {fix}")
    data = path.read_bytes()
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        raise DataFormatError(f"dataset file '{path}' is not the one its manifest names (sha256 differs). {fix}")
    try:
        return load(data)
    except SafetensorError as error:
        raise DataFormatError(f"dataset file '{path}' is corrupt: {error}. {fix}") from error
