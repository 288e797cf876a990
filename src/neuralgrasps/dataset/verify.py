"""Check a dataset folder against its manifest and against geometry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.schema import ShardEntry, sha256_of_file
from neuralgrasps.dataset.shards import metadata_on_disk, read_arrays
from neuralgrasps.errors import NeuralGraspsError
from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.seeds import child_rng

TOLERANCE_M = 2e-6  # float32 rounding of points and distances below a metre


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyResult:
    """What a check found.

    Attributes:
        problems: one line per problem, empty when the dataset is sound.
        files, scenes: how many were checked.
        max_error_m: largest difference between a stored object distance and one computed now
            (0 when no samples are stored).
    """

    problems: tuple[str, ...]
    files: int
    scenes: int
    max_error_m: float

    @property
    def ok(self) -> bool:
        return not self.problems


def verify_dataset(dataset: GraspDataset, *, spot_checks: int = 200, seed: int = 0) -> VerifyResult:
    """Check every file's sha256 and shapes, every split, and some stored distances per shard.

    Args:
        spot_checks: query points per shard whose distance to the object is computed again.
        seed: chooses them.
    """
    problems: list[str] = []
    errors = [0.0]
    files = scenes = 0
    damaged: set[str] = set()
    for name, stored in sorted(dataset.manifest.objects.items()):
        files += 1
        found = _file_problems(dataset, stored.file, stored.sha256, f"object {name}")
        problems += found
        damaged |= {name} if found else set()
    for entry in dataset.manifest.shards:
        files += 2
        scenes += entry.scenes
        found = list(_shard_problems(dataset, entry))
        if not found and entry.object not in damaged:
            error = _spot_error(dataset, entry, spot_checks, seed)
            errors.append(error)
            if error > TOLERANCE_M:
                found = [f"{entry.samples_file}: stored object distances are off by up to {1e3 * error:.4f} mm"]
        problems += found
    return VerifyResult(problems=tuple(problems), files=files, scenes=scenes, max_error_m=max(errors))


def _file_problems(dataset: GraspDataset, name: str, sha256: str, what: str) -> list[str]:
    path = dataset.folder / name
    if not path.is_file():
        return [f"{name}: missing ({what})"]
    if sha256_of_file(path) != sha256:
        return [f"{name}: sha256 differs from the manifest ({what})"]
    return []


def _shard_problems(dataset: GraspDataset, entry: ShardEntry) -> Iterator[str]:
    what = f"{entry.hand} on {entry.object}"
    damaged = _file_problems(dataset, entry.grasps_file, entry.grasps_sha256, what)
    damaged += _file_problems(dataset, entry.samples_file, entry.samples_sha256, what)
    if damaged:
        yield from damaged
        return
    if metadata_on_disk(dataset.folder / entry.samples_file).get("key") != entry.key:
        yield f"{entry.samples_file}: was made from other inputs than the manifest says"
    split = [*entry.split.train, *entry.split.test, *entry.split.spare]
    if sorted(split) != list(range(entry.scenes)):
        yield f"{what}: the split does not hold each of the {entry.scenes} grasps once"
    try:
        count = len(dataset.grasps(entry.hand, entry.object))
        arrays = read_arrays(dataset.folder / entry.samples_file)
    except NeuralGraspsError as error:
        yield str(error)
        return
    if count != entry.scenes:
        yield f"{entry.grasps_file}: holds {count} grasps; the manifest says {entry.scenes}"
    queries = dataset.manifest.config.queries_per_scene
    points = dataset.manifest.objects[entry.object].contact_points
    expected: dict[str, tuple[int, ...]] = {"contact_map": (entry.scenes, points)}
    if dataset.manifest.config.store_samples:
        expected |= {"points_O": (entry.scenes, queries, 3), "hand_index": (entry.scenes,)}
        expected |= {"sdf_object": (entry.scenes, queries), "sdf_hand": (entry.scenes, queries)}
    for name, shape in expected.items():
        got = arrays[name].shape if name in arrays else None
        if got != shape:
            yield f"{entry.samples_file}: {name} has shape {got}; expected {shape}"
        elif not np.isfinite(arrays[name]).all():
            yield f"{entry.samples_file}: {name} is not finite everywhere"


def _spot_error(dataset: GraspDataset, entry: ShardEntry, count: int, seed: int) -> float:
    """Largest difference (m) between stored and fresh object distances at some query points."""
    if not dataset.manifest.config.store_samples or count < 1:
        return 0.0
    arrays = read_arrays(dataset.folder / entry.samples_file)
    total = arrays["sdf_object"].size
    chosen = child_rng(seed, "verify", entry.object, entry.hand).integers(total, size=min(count, total))
    points = arrays["points_O"].reshape(-1, 3)[chosen].astype(np.float64)
    fresh = signed_distance(dataset.object(entry.object).mesh, points)
    return float(np.abs(fresh - arrays["sdf_object"].reshape(-1)[chosen]).max())
