"""Build a grasp dataset from grasp sets: resumable, and the same bytes for any number of workers. Torch-free."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import neuralgrasps
from neuralgrasps.dataset.samples import Normalisation, normalisation_of
from neuralgrasps.dataset.schema import (
    SCHEMA_VERSION,
    DatasetConfig,
    HandEntry,
    Manifest,
    ObjectEntry,
    ShardEntry,
    check_name,
    sha256_of_file,
    write_manifest,
)
from neuralgrasps.dataset.shards import ShardFiles, ShardTask, build_shard, fingerprint_of, write_grasps
from neuralgrasps.dataset.splits import sort_held_out, split_grasps
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.files import write_whole
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.tensor_files import tensor_bytes

HAND_POINT_SPACING_M = 0.006  # of the packed hand; SDF samples do not depend on it

Progress = Callable[[int, int, str], None]
"""Called as progress(finished shards, all shards, name of the one just finished)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildResult:
    """What a build did.

    Attributes:
        folder: the dataset; manifest: what is in it.
        built, kept: shards computed now, and shards found complete from an earlier run.
    """

    folder: Path
    manifest: Manifest
    built: int
    kept: int


def build_dataset(
    folder: str | Path,
    grasp_sets: Sequence[GraspSet],
    *,
    hands: Mapping[str, Hand],
    objects: Mapping[str, ObjectModel],
    config: DatasetConfig | None = None,
    hold_out: Sequence[str] = (),
    workers: int = 1,
    progress: Progress | None = None,
) -> BuildResult:
    """Write a dataset of SDF samples, contact maps, point clouds where the configuration asks for them, and splits.

    Each pair of hand and object is one shard, written to a temporary name and renamed. A killed build
    leaves only whole shards; calling again with the same arguments continues it, and finishes at once when all
    is there. The manifest is written last.

    Args:
        folder: where to write; created if missing.
        grasp_sets: one set per pair, at least one grasp each.
        hands, objects: by the names that the grasp sets use.
        hold_out: hands and objects all of whose grasps are for testing; another choice rebuilds nothing.
        workers: processes (1 = this one). Results do not depend on it.
        progress: told after each shard.
    Raises:
        InputError: no grasps, a pair twice, or a name that cannot be a file name.
        UnknownNameError: a grasp set's hand or object is not given, or a name to hold out is neither.
    """
    folder = Path(folder)
    config = config or DatasetConfig()
    _check_pairs(grasp_sets, hands, objects)
    held_hands, held_objects = sort_held_out([(g.hand, g.object) for g in grasp_sets], hold_out)
    frames = {name: normalisation_of(objects[name].points_O) for name in sorted({g.object for g in grasp_sets})}
    tasks, hand_entries = _tasks(folder, grasp_sets, hands, objects, frames, config)
    object_entries = {name: _write_object(folder, objects[name], frames[name]) for name in frames}
    files = _run(tasks, workers, progress)
    manifest = Manifest(
        schema_version=SCHEMA_VERSION,
        library_version=neuralgrasps.__version__,
        config=config,
        objects=object_entries,
        hands=hand_entries,
        shards=tuple(_entry(f, config.seed) for f in sorted(files, key=lambda f: (f.object, f.hand))),
        held_out_hands=held_hands,
        held_out_objects=held_objects,
    )
    write_manifest(folder, manifest)
    built = sum(f.was_built for f in files)
    return BuildResult(folder=folder, manifest=manifest, built=built, kept=len(files) - built)


def _check_pairs(grasp_sets: Sequence[GraspSet], hands: Mapping[str, Hand], objects: Mapping[str, ObjectModel]) -> None:
    if not grasp_sets:
        raise InputError("no grasp sets given; expected at least one hand and object.")
    seen: set[tuple[str, str]] = set()
    for grasps in grasp_sets:
        pair = (check_name("hand", grasps.hand), check_name("object", grasps.object))
        if pair in seen:
            raise InputError(f"grasps of {pair[0]} on {pair[1]} are given twice; concatenate them into one set.")
        seen.add(pair)
        if not len(grasps):
            raise InputError(f"the grasp set of {pair[0]} on {pair[1]} is empty; leave it out.")
        if pair[0] not in hands:
            raise unknown_name("hand", pair[0], hands)
        if pair[1] not in objects:
            raise unknown_name("object", pair[1], objects)
        hands[pair[0]].check_q(grasps.q)


def _tasks(
    folder: Path,
    grasp_sets: Sequence[GraspSet],
    hands: Mapping[str, Hand],
    objects: Mapping[str, ObjectModel],
    frames: Mapping[str, Normalisation],
    config: DatasetConfig,
) -> tuple[list[ShardTask], dict[str, HandEntry]]:
    names = sorted({g.hand for g in grasp_sets})
    packed = {name: pack_hand(hands[name], spacing=HAND_POINT_SPACING_M) for name in names}
    entries = {
        name: HandEntry(fingerprint=fingerprint_of(packed[name]), joints=tuple(hands[name].tree.dof_names))
        for name in names
    }
    tasks = [
        ShardTask(
            folder=folder,
            hand=grasps.hand,
            object=grasps.object,
            X_OH=np.array(grasps.X_OH),
            q=np.array(grasps.q),
            grasps_sha256=write_grasps(folder, grasps),
            mesh=objects[grasps.object].mesh,
            points_O=objects[grasps.object].points_O,
            content_hash=objects[grasps.object].content_hash,
            packed=packed[grasps.hand],
            fingerprint=entries[grasps.hand].fingerprint,
            hand_index=names.index(grasps.hand),
            normalisation=frames[grasps.object],
            config=config,
        )
        for grasps in grasp_sets
    ]
    return tasks, entries


def _write_object(folder: Path, model: ObjectModel, frame: Normalisation) -> ObjectEntry:
    """Store what a reader needs of an object, so that a dataset can be read without its assets."""
    name = f"objects/{model.name}.safetensors"
    arrays: dict[str, np.ndarray] = {
        "points_O": np.ascontiguousarray(model.points_O, np.float64),
        "normals_O": np.ascontiguousarray(model.normals_O, np.float64),
        "vertices_O": np.ascontiguousarray(model.mesh.vertices, np.float64),
        "faces": np.ascontiguousarray(model.mesh.faces, np.int32),
    }
    write_whole(folder / name, tensor_bytes(arrays))
    return ObjectEntry(
        content_hash=model.content_hash,
        offset_O=(float(frame.offset_O[0]), float(frame.offset_O[1]), float(frame.offset_O[2])),
        scale_m=frame.scale_m,
        contact_points=len(model.points_O),
        file=name,
        sha256=sha256_of_file(folder / name),
    )


def _run(tasks: Sequence[ShardTask], workers: int, progress: Progress | None) -> list[ShardFiles]:
    # The largest shards first, so that no worker ends with one while the others wait.
    order = sorted(tasks, key=lambda t: len(t.X_OH) * (8 + len(t.packed.part_kind)), reverse=True)
    files: list[ShardFiles] = []
    for _, done in run_tasks(build_shard, [(task,) for task in order], workers=workers):
        files.append(done)
        if progress is not None:
            progress(len(files), len(order), f"{done.hand} on {done.object}")
    return files


def _entry(files: ShardFiles, seed: int) -> ShardEntry:
    split = split_grasps(files.scenes, hand=files.hand, object_name=files.object, seed=seed)
    return ShardEntry(
        hand=files.hand,
        object=files.object,
        scenes=files.scenes,
        key=files.key,
        grasps_file=files.grasps_file,
        grasps_sha256=files.grasps_sha256,
        samples_file=files.samples_file,
        samples_sha256=files.samples_sha256,
        split=split.entry(),
        clouds_key=files.clouds_key,
        clouds_file=files.clouds_file,
        clouds_sha256=files.clouds_sha256,
    )
