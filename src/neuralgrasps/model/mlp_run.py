"""Save and load a trained `MlpField` with its codes, beside the runs of the `KinematicField`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays

import neuralgrasps
from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.files import write_whole
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.checkpoint import CODES_FILE, FIELD_FILE, GRASPS_FOLDER, RUN_FILE
from neuralgrasps.model.codes import CODE_SIZE, CodeBook
from neuralgrasps.model.mlp_checkpoint import config_of
from neuralgrasps.model.mlp_data import ObjectScenes
from neuralgrasps.model.mlp_field import MlpDecoder, MlpField
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.mlp_train import MlpResult
from neuralgrasps.model.train_state import numpy_arrays
from neuralgrasps.tensor_files import tensor_bytes

KIND = "mlp"
VERSION = "mlp-1"
_BOOK_ARRAYS = ("values", "hand_index", "object_index", "grasp_index", "contact_maps", "is_test")


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpRun:
    """A trained field read back.

    Attributes:
        codebook: codes of the training grasps, and of test grasps where they were inferred; all 128 numbers are
            compared in retrieval.
        grasps: by (hand, object), the sets that the code book's `grasp_index` counts in; none if none were saved.
        losses: (steps, 4) total, SDF, triplet, norm of the codes. samples: points seen. config: how it was trained.
        notes: what else was recorded.
    """

    field: MlpField
    codebook: CodeBook
    grasps: Mapping[tuple[str, str], GraspSet]
    losses: np.ndarray
    samples: int
    config: MlpTrainConfig
    notes: Mapping[str, Any]


def free_codebook(scenes: ObjectScenes, codes: np.ndarray, *, is_test: bool = False) -> CodeBook:
    """A code book of free codes (S, 128) of scenes.

    Raises:
        InputError: the codes are of another size than code books hold.
    """
    if codes.shape != (len(scenes), CODE_SIZE):
        raise InputError(
            f"codes have shape {codes.shape}; expected ({len(scenes)}, {CODE_SIZE}): code books, and so runs, hold "
            f"codes of {CODE_SIZE} numbers. Train with code_size {CODE_SIZE}, or keep the result in memory."
        )
    return CodeBook(
        values=codes.astype(np.float32),
        hands=scenes.hands,
        objects=(scenes.object_name,),
        hand_index=scenes.hand_index,
        object_index=np.zeros(len(scenes), np.int32),
        grasp_index=scenes.grasp_index,
        contact_maps=scenes.contact_maps,
        is_test=np.full(len(scenes), is_test),
        metric_size=CODE_SIZE,
    )


def run_kind(folder: str | Path) -> Literal["kinematic", "mlp"]:
    """Which field a run holds.

    Raises:
        DataFormatError: there is no run, or it is damaged.
    """
    return "mlp" if _run_record(Path(folder)).get("kind") == KIND else "kinematic"


def save_mlp_run(
    folder: str | Path,
    result: MlpResult,
    codebook: CodeBook,
    *,
    grasps: Sequence[GraspSet] = (),
    notes: Mapping[str, Any] | None = None,
) -> Path:
    """Write a trained field and its codes into a folder; `run.json`, with the others' sha256, is written last.

    Args:
        grasps: the grasps that the codes are of, to keep with them; one set a hand.
        notes: what to record beside (JSON).
    """
    folder = Path(folder)
    frame = result.field.normalisation
    arrays = {f"decoder.{k}": v for k, v in numpy_arrays(result.field.decoder.state_dict()).items()}
    arrays |= {"losses": np.asarray(result.losses, np.float64), "offset_O": np.asarray(frame.offset_O, np.float64)}
    files = {
        FIELD_FILE: tensor_bytes(arrays),
        CODES_FILE: tensor_bytes({name: np.ascontiguousarray(getattr(codebook, name)) for name in _BOOK_ARRAYS}),
    }
    for name, data in files.items():
        write_whole(folder / name, data)
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    for some in grasps:
        name = f"{GRASPS_FOLDER}/{some.object}/{some.hand}.safetensors"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        save_grasps(folder / name, some)
        digests[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    record = {
        "kind": KIND,
        "version": VERSION,
        "library_version": neuralgrasps.__version__,
        "config": asdict(result.config),
        "hands": list(codebook.hands),
        "objects": [result.field.object_name],
        "scale_m": frame.scale_m,
        "clamp": result.field.clamp,
        "samples": result.samples,
        "finished": result.finished,
        "notes": dict(notes or {}),
        "sha256": digests,
    }
    write_whole(folder / RUN_FILE, json.dumps(record, indent=1, sort_keys=True) + "\n")
    return folder


def load_mlp_run(folder: str | Path, *, device: torch.device | str = "cpu") -> MlpRun:
    """Read what `save_mlp_run` wrote; no hand or object models are needed.

    Raises:
        DataFormatError: missing, damaged, of another field or another version.
    """
    folder = Path(folder)
    record = _run_record(folder)
    if record.get("version") != VERSION:
        raise DataFormatError(
            f"'{folder / RUN_FILE}' has version {record.get('version')}; expected {VERSION}, a run of the MLP field. "
            "Open runs of the kinematic field with load_run."
        )
    try:
        arrays, codes = _read_arrays(folder, FIELD_FILE, record), _read_arrays(folder, CODES_FILE, record)
        config = config_of(record["config"])
        decoder = MlpDecoder(config.decoder)
        state = {k.removeprefix("decoder."): torch.from_numpy(v) for k, v in arrays.items() if k.startswith("decoder.")}
        decoder.load_state_dict(state)
        object_name = record["objects"][0]
        field = MlpField(
            decoder.to(device).requires_grad_(False),
            object_name=object_name,
            normalisation=Normalisation(offset_O=arrays["offset_O"], scale_m=record["scale_m"]),
            clamp=record["clamp"],
        )
        book = CodeBook(
            **{name: codes[name] for name in _BOOK_ARRAYS},
            hands=tuple(record["hands"]),
            objects=(object_name,),
            metric_size=CODE_SIZE,
        )
        return MlpRun(
            field=field,
            codebook=book,
            grasps=_read_grasps(folder, record),
            losses=arrays["losses"],
            samples=record["samples"],
            config=config,
            notes=record["notes"],
        )
    except (KeyError, IndexError, TypeError, RuntimeError) as error:
        raise DataFormatError(f"'{folder}' lacks an entry: {error}. Train again.") from error


def _run_record(folder: Path) -> dict[str, Any]:
    path = folder / RUN_FILE
    if not path.is_file():
        raise DataFormatError(f"'{folder}' holds no fitted field: {RUN_FILE} is missing. Train first.")
    try:
        record = json.loads(path.read_bytes())
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataFormatError(f"'{path}' is damaged: {error}. Train again.") from error
    if not isinstance(record, dict):
        raise DataFormatError(f"'{path}' is not the record of a run. Train again.")
    return record


def _checked_bytes(folder: Path, name: str, record: Mapping[str, Any]) -> bytes:
    path = folder / name
    if not path.is_file():
        raise DataFormatError(f"'{path}' is missing. Train again.")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != record["sha256"].get(name):
        raise DataFormatError(f"'{path}' is not the file that {RUN_FILE} names (sha256 differs). Train again.")
    return data


def _read_arrays(folder: Path, name: str, record: Mapping[str, Any]) -> dict[str, np.ndarray]:
    try:
        return load_arrays(_checked_bytes(folder, name, record))
    except SafetensorError as error:
        raise DataFormatError(f"'{folder / name}' is damaged: {error}. Train again.") from error


def _read_grasps(folder: Path, record: Mapping[str, Any]) -> dict[tuple[str, str], GraspSet]:
    grasps = {}
    for name in record["sha256"]:
        if name.startswith(f"{GRASPS_FOLDER}/"):
            _checked_bytes(folder, name, record)
            some = load_grasps(folder / name)
            grasps[some.hand, some.object] = some
    return grasps
