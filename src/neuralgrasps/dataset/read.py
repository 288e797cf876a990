"""Read a grasp dataset: a manifest and lazily read shards."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from neuralgrasps.dataset.clouds import SceneClouds, scene_clouds
from neuralgrasps.dataset.samples import Normalisation, SdfSamples, sample_scenes
from neuralgrasps.dataset.schema import CloudKind, Manifest, ShardEntry, read_manifest
from neuralgrasps.dataset.shards import CLOUD_ARRAYS, SAMPLE_ARRAYS, fingerprint_of
from neuralgrasps.dataset.splits import Split, check_held_out
from neuralgrasps.dataset.stored import CheckedFiles
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.packed import PackedHand


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetObject:
    """One object as the dataset stores it: contact points, surface and normalisation (object frame, metres)."""

    name: str
    points_O: np.ndarray
    normals_O: np.ndarray
    mesh: Mesh
    normalisation: Normalisation


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspDataset:
    """A dataset folder. Arrays are read from disk when asked for; nothing is kept in memory.

    No file is read before its sha256 was found to be the manifest's; otherwise reading raises `DataFormatError`.

    Attributes:
        folder: where it is.
        manifest: what is in it.
    """

    folder: Path
    manifest: Manifest
    _files: CheckedFiles = field(default_factory=CheckedFiles, repr=False, compare=False)

    @property
    def hands(self) -> tuple[str, ...]:
        """Hand names; `SdfSamples.hand_index` counts in this order."""
        return tuple(sorted(self.manifest.hands))

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(sorted(self.manifest.objects))

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """(hand, object) of each shard, by object, then hand."""
        return tuple((shard.hand, shard.object) for shard in self.manifest.shards)

    def shard(self, hand: str, object_name: str) -> ShardEntry:
        """The manifest's entry of a pair.

        Raises:
            UnknownNameError: the hand or object is not in the dataset, or the pair has no grasps.
        """
        if hand not in self.manifest.hands:
            raise unknown_name("hand", hand, self.manifest.hands)
        if object_name not in self.manifest.objects:
            raise unknown_name("object", object_name, self.manifest.objects)
        for entry in self.manifest.shards:
            if (entry.hand, entry.object) == (hand, object_name):
                return entry
        raise unknown_name("pair", f"{hand} on {object_name}", (f"{h} on {o}" for h, o in self.pairs))

    def holding_out(self, hands: Iterable[str] = (), objects: Iterable[str] = ()) -> GraspDataset:
        """A view in which all grasps of these hands and of these objects are test grasps, and none is for training.

        What this dataset holds out already stays so; the splits of all other pairs are unchanged.

        Raises:
            UnknownNameError: a hand or object that is not in the dataset.
            InputError: nothing would be left to train on.
        """
        manifest = self.manifest
        held_hands, held_objects = check_held_out(
            self.pairs, hands=(*manifest.held_out_hands, *hands), objects=(*manifest.held_out_objects, *objects)
        )
        return replace(self, manifest=replace(manifest, held_out_hands=held_hands, held_out_objects=held_objects))

    def split(self, hand: str, object_name: str) -> Split:
        """Train, test and spare indices into `grasps(hand, object_name)`."""
        entry = self.shard(hand, object_name).split
        split = Split(
            train=np.array(entry.train, np.int64),
            test=np.array(entry.test, np.int64),
            spare=np.array(entry.spare, np.int64),
        )
        held_out = hand in self.manifest.held_out_hands or object_name in self.manifest.held_out_objects
        return split.held_out() if held_out else split

    def grasps(self, hand: str, object_name: str) -> GraspSet:
        """All grasps of a pair."""
        entry = self.shard(hand, object_name)
        return load_grasps(self._files.path(self.folder / entry.grasps_file, entry.grasps_sha256))

    def contact_maps(self, hand: str, object_name: str) -> np.ndarray:
        """(N, P) float32 closeness at the object's contact points, one row per grasp of the pair."""
        entry = self.shard(hand, object_name)
        file = self.folder / entry.samples_file
        return self._files.rows(file, entry.samples_sha256, ("contact_map",), None)["contact_map"]

    def contact_radius_m(self, object_name: str) -> float:
        """Decay length of this object's contact maps, metres."""
        if object_name not in self.manifest.objects:
            raise unknown_name("object", object_name, self.manifest.objects)
        return self.manifest.config.contact_decay * self.manifest.objects[object_name].scale_m

    def object(self, name: str) -> DatasetObject:
        """The stored surface and frame of an object."""
        if name not in self.manifest.objects:
            raise unknown_name("object", name, self.manifest.objects)
        entry = self.manifest.objects[name]
        arrays = self._files.arrays(self.folder / entry.file, entry.sha256)
        return DatasetObject(
            name=name,
            points_O=arrays["points_O"],
            normals_O=arrays["normals_O"],
            mesh=Mesh(arrays["vertices_O"], arrays["faces"]),
            normalisation=Normalisation(offset_O=np.array(entry.offset_O), scale_m=entry.scale_m),
        )

    def samples(
        self,
        hand: str,
        object_name: str,
        indices: Sequence[int] | np.ndarray | None = None,
        *,
        packed: PackedHand | None = None,
    ) -> SdfSamples:
        """SDF samples of a pair's grasps (`indices`, or all).

        Read from disk where they are stored; computed anew otherwise, from the stored grasps and surface and
        the hand's arrays (`packed`, as `hands.packed.pack_hand` gives them): the same arrays either way.

        Raises:
            InputError: they are not stored and `packed` is missing or of another hand model.
        """
        entry = self.shard(hand, object_name)
        if self.manifest.config.store_samples:
            file = self.folder / entry.samples_file
            return SdfSamples(**self._files.rows(file, entry.samples_sha256, SAMPLE_ARRAYS, indices))
        packed = self._own_hand(entry.hand, packed, "stores no SDF samples")
        grasps, model = self._scenes(entry, indices), self.object(object_name)
        return sample_scenes(
            model.mesh,
            packed,
            grasps.X_OH,
            grasps.q,
            hand=hand,
            object_name=object_name,
            normalisation=model.normalisation,
            config=self.manifest.config,
            hand_index=self.hands.index(hand),
        )

    def clouds(
        self,
        hand: str,
        object_name: str,
        indices: Sequence[int] | np.ndarray | None = None,
        *,
        kind: CloudKind | None = None,
        packed: PackedHand | None = None,
    ) -> SceneClouds:
        """Point clouds of a pair's grasps (`indices`, or all), object and hand apart.

        Read from disk where clouds of this kind are stored; computed anew otherwise, from the stored grasps and surface
        and the hand's arrays (`packed`): the same arrays either way.

        Args:
            kind: "exact" or "rendered"; the one that is stored when None.
        Raises:
            InputError: none are stored and no kind is given; or they must be computed and `packed` is missing or of
                another hand model.
        """
        entry, config = self.shard(hand, object_name), self.manifest.config
        kind = kind or config.clouds
        if kind == "none":
            raise InputError("this dataset stores no point clouds; give kind='exact' or kind='rendered'.")
        if kind == config.clouds and entry.clouds_file:
            file = self.folder / entry.clouds_file
            return SceneClouds(**self._files.rows(file, entry.clouds_sha256, CLOUD_ARRAYS, indices))
        packed = self._own_hand(hand, packed, f"stores no {kind} point clouds")
        grasps, model = self._scenes(entry, indices), self.object(object_name)
        return scene_clouds(
            model.mesh,
            packed,
            grasps.X_OH,
            grasps.q,
            hand=hand,
            object_name=object_name,
            normalisation=model.normalisation,
            config=replace(config, clouds=kind),
        )

    def _scenes(self, entry: ShardEntry, indices: Sequence[int] | np.ndarray | None) -> GraspSet:
        grasps = self.grasps(entry.hand, entry.object)
        return grasps if indices is None else grasps[np.asarray(indices, np.int64)]

    def _own_hand(self, hand: str, packed: PackedHand | None, lack: str) -> PackedHand:
        """`packed`, checked to be the hand model that the dataset was built with."""
        if packed is None:
            raise InputError(
                f"this dataset {lack}; give the packed hand '{hand}' to compute them (pack_hand(load_hand(...)))."
            )
        if fingerprint_of(packed) != self.manifest.hands[hand].fingerprint:
            raise InputError(f"the hand '{hand}' given is not the model that this dataset was built with.")
        return packed


def read_dataset(folder: str | Path) -> GraspDataset:
    """Open a dataset folder.

    Raises:
        DataFormatError: no manifest, or one of another schema version.
    """
    folder = Path(folder)
    return GraspDataset(folder=folder, manifest=read_manifest(folder))
