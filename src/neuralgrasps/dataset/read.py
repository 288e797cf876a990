"""Read a grasp dataset: a manifest and lazily read shards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuralgrasps.dataset.samples import Normalisation, SdfSamples, sample_scenes
from neuralgrasps.dataset.schema import Manifest, ShardEntry, read_manifest
from neuralgrasps.dataset.shards import fingerprint_of, read_arrays
from neuralgrasps.dataset.splits import Split
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

    Attributes:
        folder: where it is.
        manifest: what is in it.
    """

    folder: Path
    manifest: Manifest

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

    def split(self, hand: str, object_name: str) -> Split:
        """Train, test and spare indices into `grasps(hand, object_name)`."""
        entry = self.shard(hand, object_name).split
        return Split(
            train=np.array(entry.train, np.int64),
            test=np.array(entry.test, np.int64),
            spare=np.array(entry.spare, np.int64),
        )

    def grasps(self, hand: str, object_name: str) -> GraspSet:
        """All grasps of a pair."""
        return load_grasps(self.folder / self.shard(hand, object_name).grasps_file)

    def contact_maps(self, hand: str, object_name: str) -> np.ndarray:
        """(N, P) float32 closeness at the object's contact points, one row per grasp of the pair."""
        entry = self.shard(hand, object_name)
        return read_arrays(self.folder / entry.samples_file)["contact_map"]

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
        arrays = read_arrays(self.folder / entry.file, sha256=entry.sha256)
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
        chosen = np.arange(entry.scenes) if indices is None else np.asarray(indices, np.int64)
        if not self.manifest.config.store_samples:
            return self._computed(entry, chosen, packed)
        arrays = read_arrays(self.folder / entry.samples_file)
        return SdfSamples(
            points_O=arrays["points_O"][chosen],
            sdf_object=arrays["sdf_object"][chosen],
            sdf_hand=arrays["sdf_hand"][chosen],
            hand_index=arrays["hand_index"][chosen],
        )

    def _computed(self, entry: ShardEntry, chosen: np.ndarray, packed: PackedHand | None) -> SdfSamples:
        if packed is None:
            raise InputError(
                f"this dataset stores no SDF samples; give the packed hand '{entry.hand}' to compute them "
                "(pack_hand(load_hand(...)))."
            )
        if fingerprint_of(packed) != self.manifest.hands[entry.hand].fingerprint:
            raise InputError(f"the hand '{entry.hand}' given is not the model that this dataset was built with.")
        grasps = self.grasps(entry.hand, entry.object)[chosen]
        model = self.object(entry.object)
        return sample_scenes(
            model.mesh,
            packed,
            grasps.X_OH,
            grasps.q,
            hand=entry.hand,
            object_name=entry.object,
            normalisation=model.normalisation,
            config=self.manifest.config,
            hand_index=self.hands.index(entry.hand),
        )


def read_dataset(folder: str | Path) -> GraspDataset:
    """Open a dataset folder.

    Raises:
        DataFormatError: no manifest, or one of another schema version.
    """
    folder = Path(folder)
    return GraspDataset(folder=folder, manifest=read_manifest(folder))
