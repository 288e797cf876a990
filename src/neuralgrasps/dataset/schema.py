"""What a grasp dataset on disk is made of: its configuration and its manifest."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal, get_args

import msgspec

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.files import write_whole

SCHEMA_VERSION = 2
READABLE_VERSIONS = (1, 2)  # 1 had no clouds and held nothing out
CloudKind = Literal["none", "exact", "rendered"]
CLOUD_KINDS: tuple[str, ...] = get_args(CloudKind)
MANIFEST_NAME = "manifest.json"
_RUN_FILE = "run.json"  # of a trained run; given in place of a dataset by mistake
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetConfig:
    """How scenes become SDF samples and contact maps.

    Lengths without a unit are in the object's normalised units (see `samples.Normalisation`).

    Attributes:
        seed: root of every random number in the dataset.
        queries_per_scene: M; the first half is drawn around the object, the second around the hand. Even.
        surface_share: part of the queries that lie near a surface; the rest fills the unit ball.
        noise_wide, noise_narrow: standard deviations of the surface noise, half the points each.
        contact_decay: decay length of the contact map.
        store_samples: write the SDF samples; otherwise readers recompute the same arrays on demand.
        clouds: write point clouds of object and hand: "exact" surface samples, or "rendered" by 128 virtual cameras.
        cloud_points: points of each cloud.

    Source:
        Khargonkar et al. 2022, Sec. 4 and its published code (contact decay in normalised units).
    """

    seed: int = 0
    queries_per_scene: int = 40_000
    surface_share: float = 0.945
    noise_wide: float = 0.0025
    noise_narrow: float = 0.00025
    contact_decay: float = 0.05
    store_samples: bool = True
    clouds: CloudKind = "none"
    cloud_points: int = 4096

    def __post_init__(self) -> None:
        if self.queries_per_scene < 2 or self.queries_per_scene % 2:
            raise InputError(f"queries_per_scene is {self.queries_per_scene}; expected an even number of at least 2.")
        if not 0.0 <= self.surface_share <= 1.0:
            raise InputError(f"surface_share is {self.surface_share}; expected a share between 0 and 1.")
        for name in ("noise_wide", "noise_narrow", "contact_decay"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a positive length in normalised units.")
        if self.clouds not in CLOUD_KINDS:
            raise InputError(f"clouds is '{self.clouds}'; expected {' or '.join(CLOUD_KINDS)}.")
        if self.cloud_points < 1:
            raise InputError(f"cloud_points is {self.cloud_points}; expected at least 1.")


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectEntry:
    """One object of the dataset: the hash of its mesh, its frame of normalisation, and its file."""

    content_hash: str
    offset_O: tuple[float, float, float]
    scale_m: float
    contact_points: int
    file: str
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEntry:
    """One hand of the dataset: a fingerprint of its kinematics and shapes, and its joint names."""

    fingerprint: str
    joints: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitEntry:
    """Grasp indices of one hand and object by their use."""

    train: tuple[int, ...]
    test: tuple[int, ...]
    spare: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardEntry:
    """The files of one hand and object, relative to the dataset folder.

    `key` and `clouds_key` are hashes of everything the samples and clouds were computed from; a rerun with the same
    keys keeps the files. All of clouds is "" where none are stored.
    """

    hand: str
    object: str
    scenes: int
    key: str
    grasps_file: str
    grasps_sha256: str
    samples_file: str
    samples_sha256: str
    split: SplitEntry
    clouds_key: str = ""
    clouds_file: str = ""
    clouds_sha256: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """Everything needed to read, check and rebuild a dataset.

    Attributes:
        held_out_hands, held_out_objects: names whose grasps are all for testing; the entries of `shards` keep the
            split as it is without (`GraspDataset.split` applies both).
    """

    schema_version: int
    library_version: str
    config: DatasetConfig
    objects: Mapping[str, ObjectEntry] = field(default_factory=dict)
    hands: Mapping[str, HandEntry] = field(default_factory=dict)
    shards: tuple[ShardEntry, ...] = ()
    held_out_hands: tuple[str, ...] = ()
    held_out_objects: tuple[str, ...] = ()


def check_name(kind: str, name: str) -> str:
    """`name`, if it can be part of a file name; `InputError` otherwise."""
    if not _NAME.fullmatch(name):
        raise InputError(
            f"{kind} name '{name}' cannot be used as a file name; use letters, digits, '.', '_' and '-' only."
        )
    return name


def sha256_of_file(path: Path) -> str:
    """Hexadecimal sha256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest of a dataset folder (atomic; keys sorted, so equal datasets give equal bytes)."""
    text = json.dumps(asdict(manifest), indent=1, sort_keys=True)
    write_whole(folder / MANIFEST_NAME, text + "\n")


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a dataset folder.

    Raises:
        DataFormatError: there is none, it is not valid, or it is of another schema version.
    """
    path = folder / MANIFEST_NAME
    if not path.is_file():
        if (folder / _RUN_FILE).is_file():
            raise DataFormatError(
                f"'{folder}' is a run, not a dataset: `evaluate`, `retrieve` and `novel` take it. "
                "Give the folder that `dataset build` wrote."
            )
        raise DataFormatError(
            f"'{folder}' is not a grasp dataset: {MANIFEST_NAME} is missing. "
            "Build it first (or let an interrupted build finish: a rerun continues it)."
        )
    try:
        raw = json.loads(path.read_bytes())
        version = raw.get("schema_version") if isinstance(raw, dict) else None
        if version not in READABLE_VERSIONS:
            known = " and ".join(map(str, READABLE_VERSIONS))
            raise DataFormatError(
                f"'{path}' has schema version {version}; this library reads {known}. Rebuild the dataset."
            )
        return msgspec.convert(raw, Manifest)
    except (json.JSONDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise DataFormatError(f"'{path}' is not a valid manifest: {error}. Rebuild the dataset.") from error
