"""Where runs are, and what the notes of one (`run.json`) say."""

from __future__ import annotations

import difflib
import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from neuralgrasps.dataset.schema import MANIFEST_NAME
from neuralgrasps.errors import DataFormatError, InputError

VERSION = 2
RUN_FILE, FIELD_FILE, CODES_FILE = "run.json", "field.safetensors", "codes.safetensors"
GRASPS_FOLDER = "grasps"


@dataclass(frozen=True, slots=True, kw_only=True)
class CodebookNotes:
    """Names that the code book's indices count in."""

    hands: tuple[str, ...]
    objects: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecoderNotes:
    """Hands and sizes of the correction network, as in `DecoderConfig`."""

    hands: tuple[str, ...]
    cells: int
    cell_width: int
    trunk_width: int
    hand_width: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RunNotes:
    """The notes of a run of `KinematicField`.

    Attributes:
        config: of its training. hands, objects: in the order of the field's arrays; radius_m: of each object.
        sha256: of every other file of the run, by its name in the folder.
    """

    version: int
    library_version: str
    config: Mapping[str, Any]
    hands: tuple[str, ...]
    objects: tuple[str, ...]
    radius_m: tuple[float, ...]
    decoder: DecoderNotes | None
    codebook: CodebookNotes
    sha256: Mapping[str, str]

    def __post_init__(self) -> None:
        if len(self.radius_m) != len(self.objects) or not all(radius > 0 for radius in self.radius_m):
            raise ValueError(f"{len(self.objects)} objects, radius_m {self.radius_m}")
        for name in (FIELD_FILE, CODES_FILE):
            if name not in self.sha256:
                raise ValueError(f"no sha256 of {name}")


def shipped_runs() -> tuple[str, ...]:
    """Names of the runs that come with this library."""
    folder = resources.files("neuralgrasps") / "assets" / "runs"
    return tuple(sorted(item.name for item in folder.iterdir() if item.is_dir())) if folder.is_dir() else ()


def run_folder(name_or_path: str | Path) -> Path:
    """The folder of a run: a folder as it is, or by the name of a shipped run (a folder of that name comes first).

    Raises:
        InputError: neither.
    """
    path = Path(name_or_path)
    if path.is_dir():
        return path
    if str(name_or_path) in shipped_runs():
        return Path(str(resources.files("neuralgrasps") / "assets" / "runs" / str(name_or_path)))
    raise InputError(f"'{name_or_path}' is neither a folder that `train` wrote nor {hint_of_runs(str(name_or_path))}")


def hint_of_runs(name: str) -> str:
    """The end of a message about a run that is not there: the runs of this library, and which of them may be meant."""
    near = difflib.get_close_matches(name, shipped_runs(), n=1)
    meant = f" Did you mean '{near[0]}'?" if near else ""
    return f"a run of this library: {', '.join(shipped_runs())}.{meant}"


def read_notes(folder: Path) -> RunNotes:
    """The notes of a run.

    Raises:
        DataFormatError: there are none, they are damaged, of another version, or of a run of `MlpField`.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        if (folder / MANIFEST_NAME).is_file():
            train = shlex.join(["neuralgrasps", "train", str(folder), "--out", "RUN"])
            raise DataFormatError(f"'{folder}' is a dataset, not a run; train it: {train}")
        raise DataFormatError(f"'{folder}' holds no fitted field: {RUN_FILE} is missing. Train first.")
    try:
        raw = json.loads(path.read_bytes())
        version = raw.get("version") if isinstance(raw, dict) else None
        if isinstance(version, str) and version.startswith("mlp"):
            raise DataFormatError(
                f"'{folder}' is a run of MlpField (train --field mlp), which `evaluate` measures; this needs one of "
                "the default field: its codes hold a hand's pose and joints."
            )
        if version != VERSION:
            raise DataFormatError(f"'{path}' has version {version}; this library reads {VERSION}. Train again.")
        return msgspec.convert(raw, RunNotes)
    except (json.JSONDecodeError, UnicodeDecodeError, msgspec.ValidationError, ValueError) as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(f"'{path}' is damaged: {error}. Train again.") from error
