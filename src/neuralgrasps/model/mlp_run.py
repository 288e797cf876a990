"""Save and load a trained `MlpField` with its codes, beside the runs of the `KinematicField`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays

import neuralgrasps
from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import DataFormatError, InputError, ShapeError
from neuralgrasps.files import write_whole
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.checkpoint import CODES_FILE, FIELD_FILE, GRASPS_FOLDER, RUN_FILE
from neuralgrasps.model.codes import CODE_SIZE, CodeBook
from neuralgrasps.model.mlp_checkpoint import config_of
from neuralgrasps.model.mlp_data import ObjectScenes
from neuralgrasps.model.mlp_field import MlpDecoder, MlpField
from neuralgrasps.model.mlp_parallel import chosen_device
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.mlp_train import MlpResult
from neuralgrasps.model.train_state import numpy_arrays
from neuralgrasps.tensor_files import tensor_bytes

KIND = "mlp"
VERSION = "mlp-2"
PLACED_CODES = "placed_values"
_BOOK_ARRAYS = ("values", "hand_index", "object_index", "grasp_index", "contact_maps", "is_test")


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpRun:
    """A trained field read back.

    Attributes:
        codebook: codes of the training grasps, and of test grasps where they were inferred, as published from signed
            distances alone; all 128 numbers are compared in retrieval.
        placed: the same, but test codes were placed by contact maps too (`mlp_infer.PLACED`); None without.
        contact_decay: length of the closeness in the contact maps, normalised units.
        grasps: by (hand, object), the sets that the code book's `grasp_index` counts in; none if none were saved.
        losses: (steps, 4) total, SDF, triplet, norm of the codes. samples: points seen. config: how it was trained.
        notes: what else was recorded.
    """

    field: MlpField
    codebook: CodeBook
    placed: CodeBook | None
    contact_decay: float
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


def with_test_codes(book: CodeBook, values: np.ndarray) -> CodeBook:
    """The same book with other codes (T, 128) of its test grasps.

    Raises:
        ShapeError: not one code for every test grasp.
    """
    rows = np.flatnonzero(book.is_test)
    if values.shape != (len(rows), CODE_SIZE):
        raise ShapeError(f"placed codes have shape {values.shape}; expected ({len(rows)}, {CODE_SIZE}).")
    every = book.values.copy()
    every[rows] = values
    return replace(book, values=every)


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
    placed: np.ndarray | None = None,
    grasps: Sequence[GraspSet] = (),
    notes: Mapping[str, Any] | None = None,
) -> Path:
    """Write a trained field and its codes into a folder; `run.json`, with the others' sha256, is written last.

    Args:
        placed: (T, 128) other codes of the book's test grasps, in its order: those placed by contact maps too.
        grasps: the grasps that the codes are of, to keep with them; one set a hand.
        notes: what to record beside (JSON).
    Raises:
        ShapeError: not one placed code for every test grasp.
    """
    folder = Path(folder)
    books = {name: np.ascontiguousarray(getattr(codebook, name)) for name in _BOOK_ARRAYS}
    if placed is not None:
        with_test_codes(codebook, placed)
        books[PLACED_CODES] = np.ascontiguousarray(placed, np.float32)
    frame = result.field.normalisation
    arrays = {f"decoder.{k}": v for k, v in numpy_arrays(result.field.decoder.state_dict()).items()}
    arrays |= {"losses": np.asarray(result.losses, np.float64), "offset_O": np.asarray(frame.offset_O, np.float64)}
    files = {
        FIELD_FILE: tensor_bytes(arrays),
        CODES_FILE: tensor_bytes(books),
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
        "contact_decay": result.contact_decay,
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
        DataFormatError: missing, damaged, of another field or another version; DeviceError: no such device.
    """
    folder, where = Path(folder), chosen_device(device)
    record = _run_record(folder)
    if record.get("version") != VERSION:
        raise DataFormatError(
            f"'{folder / RUN_FILE}' has version {record.get('version')}; expected {VERSION}, a run of the MLP field. "
            "Open runs of the kinematic field with load_run; train older ones of this field again."
        )
    try:
        return _loaded(folder, record, where)
    except DataFormatError:
        raise
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise DataFormatError(
            f"'{folder}' has a missing or wrong entry: {type(error).__name__}: {error}. Train again."
        ) from error


def _loaded(folder: Path, record: Mapping[str, Any], device: torch.device) -> MlpRun:
    files = record["sha256"]
    _expect(isinstance(files, dict), "sha256", files)
    arrays, codes = _read_arrays(folder, FIELD_FILE, files), _read_arrays(folder, CODES_FILE, files)
    names = record["objects"]
    _expect(isinstance(names, list) and len(names) == 1 and isinstance(names[0], str), "objects", names)
    book = _book(record, codes, names[0])
    grasps = _read_grasps(folder, files)
    for hand, known in ((hand, grasps.get((hand, names[0]))) for hand in book.hands):
        index = book.grasp_index[book.where(hand=hand)]
        fits = known is None or not len(index) or (index.min() >= 0 and index.max() < len(known))
        _expect(fits, "grasp_index", f"beyond the grasps of '{hand}'")
    _expect(isinstance(record["notes"], dict), "notes", record["notes"])
    _expect(isinstance(record["samples"], int), "samples", record["samples"])
    return MlpRun(
        field=_field(record, arrays, names[0], device),
        codebook=book,
        placed=with_test_codes(book, codes[PLACED_CODES]) if PLACED_CODES in codes else None,
        contact_decay=_positive(record, "contact_decay"),
        grasps=grasps,
        losses=arrays["losses"],
        samples=record["samples"],
        config=config_of(record["config"]),
        notes=record["notes"],
    )


def _field(record: Mapping[str, Any], arrays: dict[str, np.ndarray], name: str, device: torch.device) -> MlpField:
    shape = config_of(record["config"]).decoder
    state = {k.removeprefix("decoder."): torch.from_numpy(v) for k, v in arrays.items() if k.startswith("decoder.")}
    # before such a decoder is made: a wrong number could ask for more memory than there is
    fits = shape.layers <= len(state) and tuple(state["last.weight"].shape) == (2, shape.width)
    _expect(fits and shape.code_size == CODE_SIZE, "config", f"{shape}, of another shape than the weights")
    _expect(arrays["offset_O"].shape == (3,), "offset_O", f"of shape {arrays['offset_O'].shape}")
    decoder = MlpDecoder(shape)
    decoder.load_state_dict(state)
    return MlpField(
        decoder.to(device).requires_grad_(False),
        object_name=name,
        normalisation=Normalisation(offset_O=arrays["offset_O"], scale_m=_positive(record, "scale_m")),
        clamp=_positive(record, "clamp"),
    )


def _book(record: Mapping[str, Any], codes: Mapping[str, np.ndarray], name: str) -> CodeBook:
    hands = record["hands"]
    _expect(isinstance(hands, list) and all(isinstance(hand, str) for hand in hands), "hands", hands)
    return CodeBook(
        **{key: codes[key] for key in _BOOK_ARRAYS}, hands=tuple(hands), objects=(name,), metric_size=CODE_SIZE
    )


def _expect(right: bool, name: str, got: object) -> None:
    if not right:
        raise DataFormatError(f"the run's entry '{name}' is {str(got)[:200]}, which it cannot be. Train again.")


def _positive(record: Mapping[str, Any], name: str) -> float:
    value = record[name]
    _expect(type(value) in (int, float) and 0.0 < value < float("inf"), name, value)
    return float(value)


def _run_record(folder: Path) -> dict[str, Any]:
    path = folder / RUN_FILE
    if not path.is_file():
        raise DataFormatError(f"'{folder}' holds no fitted field: {RUN_FILE} is missing. Train first.")
    try:
        record = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise DataFormatError(f"'{path}' is damaged: {error}. Train again.") from error
    if not isinstance(record, dict):
        raise DataFormatError(f"'{path}' is not the record of a run. Train again.")
    return record


def _checked_bytes(folder: Path, name: str, files: Mapping[str, str]) -> bytes:
    path = folder / name
    if not path.is_file():
        raise DataFormatError(f"'{path}' is missing. Train again.")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != files.get(name):
        raise DataFormatError(f"'{path}' is not the file that {RUN_FILE} names (sha256 differs). Train again.")
    return data


def _read_arrays(folder: Path, name: str, files: Mapping[str, str]) -> dict[str, np.ndarray]:
    try:
        return load_arrays(_checked_bytes(folder, name, files))
    except SafetensorError as error:
        raise DataFormatError(f"'{folder / name}' is damaged: {error}. Train again.") from error


def _read_grasps(folder: Path, files: Mapping[str, str]) -> dict[tuple[str, str], GraspSet]:
    grasps = {}
    for name in files:
        if name.startswith(f"{GRASPS_FOLDER}/"):
            _expect(".." not in Path(name).parts, "sha256", f"of '{name}', outside the run")
            _checked_bytes(folder, name, files)
            some = load_grasps(folder / name)
            grasps[some.hand, some.object] = some
    return grasps
