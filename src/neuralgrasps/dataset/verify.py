"""Check a dataset folder against its manifest and against geometry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.schema import ShardEntry, sha256_of_file
from neuralgrasps.dataset.shards import CLOUD_ARRAYS
from neuralgrasps.dataset.splits import check_held_out
from neuralgrasps.dataset.stored import CheckedFiles, header_fits, metadata_on_disk
from neuralgrasps.errors import NeuralGraspsError
from neuralgrasps.geometry.mesh import signed_distance, unsigned_distance
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
    """Check every file's sha256 and shapes, every split, what is held out, and some distances and points per shard.

    Args:
        spot_checks: query points and object cloud points per shard whose distance to the object is computed again.
        seed: chooses them.
    """
    problems = _held_out_problems(dataset)
    errors = [0.0]
    files = scenes = 0
    damaged: set[str] = set()
    for name, stored in sorted(dataset.manifest.objects.items()):
        files += 1
        found = _file_problems(dataset, stored.file, stored.sha256, f"object {name}")
        problems += found
        damaged |= {name} if found else set()
    for entry in dataset.manifest.shards:
        files += len(_files_of(entry))
        scenes += entry.scenes
        found = list(_shard_problems(dataset, entry))
        if not found and entry.object not in damaged and spot_checks > 0:
            for name, error in _spot_errors(dataset, entry, spot_checks, seed).items():
                errors.append(error)
                if not error <= TOLERANCE_M:
                    found.append(f"{name}: stored object distances are off by up to {1e3 * error:.4f} mm")
        problems += found
    return VerifyResult(problems=tuple(problems), files=files, scenes=scenes, max_error_m=max(errors))


def short_files(dataset: GraspDataset) -> tuple[str, ...]:
    """One line for each file that is missing, or not as long as its own header says; nothing is read but headers."""
    entries = [(stored.file, "") for _, stored in sorted(dataset.manifest.objects.items())]
    entries += [file for entry in dataset.manifest.shards for file in _files_of(entry)]
    problems = []
    for name, _ in entries:
        path = dataset.folder / name
        if not path.is_file():
            problems.append(f"{name}: missing")
        elif not header_fits(path):
            problems.append(f"{name}: cut short or no shard ({path.stat().st_size:,} bytes)")
    return tuple(problems)


def _files_of(entry: ShardEntry) -> list[tuple[str, str]]:
    """Name and sha256 of each file of a shard."""
    files = [(entry.grasps_file, entry.grasps_sha256), (entry.samples_file, entry.samples_sha256)]
    return [*files, (entry.clouds_file, entry.clouds_sha256)] if entry.clouds_file else files


def _held_out_problems(dataset: GraspDataset) -> list[str]:
    manifest = dataset.manifest
    try:
        check_held_out(dataset.pairs, hands=manifest.held_out_hands, objects=manifest.held_out_objects)
    except NeuralGraspsError as error:
        return [f"manifest.json: {error}"]
    return []


def _file_problems(dataset: GraspDataset, name: str, sha256: str, what: str) -> list[str]:
    path = dataset.folder / name
    if not path.is_file():
        return [f"{name}: missing ({what})"]
    if sha256_of_file(path) != sha256:
        return [f"{name}: sha256 differs from the manifest ({what})"]
    return []


def _shard_problems(dataset: GraspDataset, entry: ShardEntry) -> Iterator[str]:
    what = f"{entry.hand} on {entry.object}"
    damaged = [line for file in _files_of(entry) for line in _file_problems(dataset, *file, what)]
    if damaged:
        yield from damaged
        return
    for name, key in ((entry.samples_file, entry.key), (entry.clouds_file, entry.clouds_key)):
        if name and metadata_on_disk(dataset.folder / name).get("key") != key:
            yield f"{name}: was made from other inputs than the manifest says"
    split = [*entry.split.train, *entry.split.test, *entry.split.spare]
    if sorted(split) != list(range(entry.scenes)):
        yield f"{what}: the split does not hold each of the {entry.scenes} grasps once"
    try:
        count = len(dataset.grasps(entry.hand, entry.object))
        if count != entry.scenes:
            yield f"{entry.grasps_file}: holds {count} grasps; the manifest says {entry.scenes}"
        yield from _array_problems(dataset, entry)
    except NeuralGraspsError as error:
        yield str(error)


def _array_problems(dataset: GraspDataset, entry: ShardEntry) -> Iterator[str]:
    """Arrays that are missing, of another shape or not finite. Of clouds a scene's whole array may be NaN: not seen."""
    config, scenes = dataset.manifest.config, entry.scenes
    expected: dict[str, tuple[int, ...]] = {}
    expected["contact_map"] = (scenes, dataset.manifest.objects[entry.object].contact_points)
    if config.store_samples:
        queries = config.queries_per_scene
        expected |= {"points_O": (scenes, queries, 3), "hand_index": (scenes,)}
        expected |= {"sdf_object": (scenes, queries), "sdf_hand": (scenes, queries)}
    files = [(entry.samples_file, entry.samples_sha256, expected)]
    if entry.clouds_file:
        of_clouds: dict[str, tuple[int, ...]] = dict.fromkeys(CLOUD_ARRAYS, (scenes, config.cloud_points, 3))
        files.append((entry.clouds_file, entry.clouds_sha256, of_clouds))
    for file, sha256, shapes in files:
        arrays = CheckedFiles().arrays(dataset.folder / file, sha256)
        for name, shape in shapes.items():
            got = arrays[name].shape if name in arrays else None
            if got != shape:
                yield f"{file}: {name} has shape {got}; expected {shape}"
                continue
            finite = np.isfinite(arrays[name]).reshape(scenes, -1)
            unseen = ~finite.any(axis=1) if file == entry.clouds_file else np.zeros(scenes, bool)
            if not finite[~unseen].all():
                yield f"{file}: {name} is not finite everywhere"


def _spot_errors(dataset: GraspDataset, entry: ShardEntry, count: int, seed: int) -> dict[str, float]:
    """By file, the largest difference (m) between stored and fresh object distances at some points.

    Points of the object's cloud are stored with the distance zero.
    """
    rng = child_rng(seed, "verify", entry.object, entry.hand)
    mesh, errors = dataset.object(entry.object).mesh, {}
    if dataset.manifest.config.store_samples:
        samples = dataset.samples(entry.hand, entry.object)
        chosen = rng.integers(samples.sdf_object.size, size=min(count, samples.sdf_object.size))
        fresh = signed_distance(mesh, samples.points_O.reshape(-1, 3)[chosen].astype(np.float64))
        errors[entry.samples_file] = float(np.abs(fresh - samples.sdf_object.reshape(-1)[chosen]).max())
    if entry.clouds_file:
        points = dataset.clouds(entry.hand, entry.object).object_points_O.reshape(-1, 3)
        points = points[rng.integers(len(points), size=min(count, len(points)))].astype(np.float64)
        off = unsigned_distance(mesh, points[np.isfinite(points).all(axis=1)])
        errors[entry.clouds_file] = float(off.max()) if len(off) else 0.0
    return errors
