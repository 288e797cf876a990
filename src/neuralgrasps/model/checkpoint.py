"""Save and load a fitted field and its codes: safetensors and JSON, written so that readers never see half."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays

import neuralgrasps
from neuralgrasps.errors import DataFormatError, InputError, ShapeError, unknown_name
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.codes import CODE_SIZE, CodeBook, HandCodec, ObjectCodec
from neuralgrasps.model.decoder import Decoder, DecoderConfig
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.run_notes import (
    CODES_FILE,
    FIELD_FILE,
    GRASPS_FOLDER,
    RUN_FILE,
    VERSION,
    RunNotes,
    read_notes,
    run_folder,
    shipped_runs,
)
from neuralgrasps.model.train import TrainConfig, TrainResult
from neuralgrasps.model.train_data import Jitter
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.tensor_files import tensor_bytes

__all__ = [
    "CODES_FILE", "FIELD_FILE", "GRASPS_FOLDER", "RUN_FILE",
    "Run", "load_run", "restored_config", "run_folder", "save_run", "shipped_runs",
]  # fmt: skip

SAME_OBJECT_M = 1e-3  # contact points of a run lie this close to the mesh of its object
_HAND_ARRAYS = ("lower", "upper", "mean", "basis", "X_HP")
_OBJECT_ARRAYS = ("points_O", "cell_of", "centres_O", "offset_O")
_BOOK_ARRAYS = ("values", "hand_index", "object_index", "grasp_index", "contact_maps", "is_test")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A fitted field read back.

    Attributes:
        config: the training configuration as text and numbers, for the record.
        grasps: by (hand, object), the sets that the code book's `grasp_index` counts in; none if none were saved.
    """

    field: KinematicField
    codebook: CodeBook
    losses: np.ndarray
    config: Mapping[str, object]
    grasps: Mapping[tuple[str, str], GraspSet]


def save_run(
    folder: str | Path, result: TrainResult, *, grasps: Sequence[GraspSet] = (), compact_maps: bool = False
) -> Path:
    """Write a fitted field and its codes into a folder; `run.json`, with the others' sha256, is written last.

    Args:
        grasps: the grasps that the codes are of, to keep with them (`GraspDataset.grasps`); one set a pair.
        compact_maps: store contact maps to 1/255, a quarter of the size.
    """
    folder = Path(folder)
    field, book = result.field, result.codebook
    arrays: dict[str, np.ndarray] = {"losses": np.asarray(result.losses, np.float64)}
    for i, codec in enumerate(field.hand_codecs.values()):
        arrays |= {f"hand.{i}.{name}": np.ascontiguousarray(getattr(codec, name)) for name in _HAND_ARRAYS}
    for i, shape in enumerate(field.object_codecs.values()):
        arrays |= {f"object.{i}.{name}": np.ascontiguousarray(getattr(shape, name)) for name in _OBJECT_ARRAYS}
    if field.decoder is not None:
        arrays |= {f"decoder.{k}": v.detach().cpu().contiguous().numpy() for k, v in field.decoder.state_dict().items()}
    field_bytes = tensor_bytes(arrays)
    code_arrays = {name: np.ascontiguousarray(getattr(book, name)) for name in _BOOK_ARRAYS}
    if compact_maps:
        code_arrays["contact_maps"] = np.round(code_arrays["contact_maps"] * 255.0).astype(np.uint8)
    code_bytes = tensor_bytes(code_arrays)
    run = {
        "version": VERSION,
        "library_version": neuralgrasps.__version__,
        "config": asdict(result.config),
        "hands": list(field.hand_codecs),
        "objects": list(field.object_codecs),
        "radius_m": [codec.radius_m for codec in field.object_codecs.values()],
        "decoder": None
        if field.decoder is None
        else {"hands": list(field.decoder.hands), **asdict(field.decoder.config)},
        "codebook": {"hands": list(book.hands), "objects": list(book.objects)},
        "sha256": {
            FIELD_FILE: hashlib.sha256(field_bytes).hexdigest(),
            CODES_FILE: hashlib.sha256(code_bytes).hexdigest(),
            **_write_grasps(folder, grasps, field),
        },
    }
    write_whole(folder / FIELD_FILE, field_bytes)
    write_whole(folder / CODES_FILE, code_bytes)
    write_whole(folder / RUN_FILE, (json.dumps(run, indent=1, sort_keys=True) + "\n").encode())
    return folder


def _write_grasps(folder: Path, grasps: Sequence[GraspSet], field: KinematicField) -> dict[str, str]:
    """Write a file for each set; sha256 by its name in the folder."""
    written = {}
    for some in grasps:
        name = f"{GRASPS_FOLDER}/{some.object}/{some.hand}.safetensors"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        save_grasps(folder / name, some, hand=field.hands.get(some.hand))
        written[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    return written


def load_run(
    name_or_path: str | Path,
    *,
    hands: Mapping[str, Hand] | None = None,
    objects: Mapping[str, ObjectModel] | None = None,
) -> Run:
    """Read what `save_run` wrote, or a run of this library by its name (`shipped_runs`).

    Args:
        hands, objects: the models it was fitted with, by name (more are welcome); when None, the built-in, imported
            and downloaded ones of these names.
    Raises:
        DataFormatError: missing, damaged, or of another version.
        UnknownNameError: a hand or object of the run is not given, or not found.
        InputError: an object is not the one of the run, or there is no such run.
    """
    folder = run_folder(name_or_path)
    run = read_notes(folder)
    field_arrays = _read_arrays(folder, FIELD_FILE, run)
    code_arrays = _read_arrays(folder, CODES_FILE, run)
    hands = {name: load_hand(name) for name in run.hands} if hands is None else hands
    objects = {name: load_object(name) for name in run.objects} if objects is None else objects
    needed: tuple[tuple[str, tuple[str, ...], Mapping[str, object]], ...] = (
        ("hand", run.hands, hands),
        ("object", run.objects, objects),
    )
    for kind, names, models in needed:
        for name in names:
            if name not in models:
                raise unknown_name(kind, name, models)
    try:
        field = _field_of(run, field_arrays, hands, objects)
        return Run(
            field=field,
            codebook=_book_of(run, code_arrays),
            losses=field_arrays["losses"],
            config=run.config,
            grasps=_grasps_of(folder, run),
        )
    except (KeyError, RuntimeError, ShapeError) as error:
        raise DataFormatError(f"'{folder}' lacks an entry: {error}. Train again.") from error


def run_grasps(name_or_path: str | Path, hand: Hand, obj: ObjectModel) -> GraspSet | None:
    """The grasps of one hand on one object that came with a run; the run's other objects are not needed.

    Returns:
        None where the run has none of this hand on an object of this name.
    Raises:
        DataFormatError: missing, damaged, or of another version.
        InputError: hand or object has the name of the run's, and is another one.
    """
    folder = run_folder(name_or_path)
    run = read_notes(folder)
    name = f"{GRASPS_FOLDER}/{obj.name}/{hand.name}.safetensors"
    if obj.name not in run.objects or hand.name not in run.hands or name not in run.sha256:
        return None
    arrays = _read_arrays(folder, FIELD_FILE, run)
    _check_same({obj.name: _object_codec(run, arrays, run.objects.index(obj.name))}, {obj.name: obj})
    _check_same_hand(_hand_codec(run, arrays, run.hands.index(hand.name)), hand)
    return _grasps_of(folder, run, (name,))[hand.name, obj.name]


def _hand_codec(run: RunNotes, arrays: Mapping[str, np.ndarray], i: int) -> HandCodec:
    return HandCodec(name=run.hands[i], **{a: arrays[f"hand.{i}.{a}"] for a in _HAND_ARRAYS})


def _object_codec(run: RunNotes, arrays: Mapping[str, np.ndarray], i: int) -> ObjectCodec:
    stored = {a: arrays[f"object.{i}.{a}"] for a in _OBJECT_ARRAYS}
    return ObjectCodec(name=run.objects[i], radius_m=run.radius_m[i], **stored)


def _book_of(run: RunNotes, arrays: Mapping[str, np.ndarray]) -> CodeBook:
    maps = arrays["contact_maps"]
    if maps.dtype == np.uint8:
        maps = maps.astype(np.float32) / 255.0
    stored: dict[str, Any] = {name: arrays[name] for name in _BOOK_ARRAYS} | {"contact_maps": maps}
    return CodeBook(**stored, hands=run.codebook.hands, objects=run.codebook.objects)


def _grasps_of(folder: Path, run: RunNotes, names: Sequence[str] | None = None) -> dict[tuple[str, str], GraspSet]:
    """The sets of the files of these names; None: of all."""
    found = {}
    for name in run.sha256 if names is None else names:
        if not name.startswith(f"{GRASPS_FOLDER}/"):
            continue
        path = folder / name
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != run.sha256[name]:
            raise DataFormatError(f"'{path}' is missing or not the file that {RUN_FILE} names. Train again.")
        grasps = load_grasps(path)
        found[grasps.hand, grasps.object] = grasps
    return found


def _check_same(codecs: Mapping[str, ObjectCodec], objects: Mapping[str, ObjectModel]) -> None:
    """That objects are those whose contact points were encoded; all that are not are named at once."""
    wrong = []
    for name, codec in codecs.items():
        away = float(np.quantile(np.abs(query_grid_numpy(objects[name].sdf, codec.points_O)), 0.95))
        if away > SAME_OBJECT_M:
            source = objects[name].provenance.get("source", "unknown")
            origin = "a built-in stand-in" if source.startswith("stand-in") else f"read from: {source}"
            wrong.append(f"'{name}' ({origin}, {1e3 * away:.1f} mm off)")
    if wrong:
        which = "object is not the one" if len(wrong) == 1 else f"{len(wrong)} objects are not the ones"
        raise InputError(
            f"{which} that the run was fitted with: {', '.join(wrong)}; by the 95th percentile of the surface. "
            "Give the right meshes with --objects DIR_OR_FILES (`objects` in Python); the scans of YCB come with "
            "`neuralgrasps objects download ycb`."
        )


def _check_same_hand(codec: HandCodec, hand: Hand) -> None:
    """That a hand has the joints, limits and palm of the one whose grasps were encoded."""
    joints = len(hand.tree.lower)
    same = joints == codec.num_joints and all(
        np.allclose(mine, theirs, atol=1e-6)
        for mine, theirs in ((codec.lower, hand.tree.lower), (codec.upper, hand.tree.upper), (codec.X_HP, hand.X_HP))
    )
    if not same:
        raise InputError(
            f"hand '{codec.name}' given is not the one that the run was fitted with: it has {joints} joints, the run's "
            f"{codec.num_joints}, or other limits or another palm. Give the file of that hand, or train again."
        )


def restored_config(run: Run) -> TrainConfig:
    """The training configuration of a run."""
    values = dict(run.config)
    decoder, jitter = values.pop("decoder"), values.pop("jitter")
    assert isinstance(decoder, dict) and isinstance(jitter, dict)
    return TrainConfig(**values, decoder=DecoderConfig(**decoder), jitter=Jitter(**jitter))  # type: ignore[arg-type]


def _field_of(
    run: RunNotes, arrays: Mapping[str, np.ndarray], hands: Mapping[str, Hand], objects: Mapping[str, ObjectModel]
) -> KinematicField:
    hand_codecs = {name: _hand_codec(run, arrays, i) for i, name in enumerate(run.hands)}
    object_codecs = {name: _object_codec(run, arrays, i) for i, name in enumerate(run.objects)}
    _check_same(object_codecs, objects)
    for name, own in hand_codecs.items():
        _check_same_hand(own, hands[name])
    decoder = None
    if run.decoder is not None:
        widths = {k: v for k, v in asdict(run.decoder).items() if k != "hands"}
        decoder = Decoder(run.decoder.hands, DecoderConfig(**widths))
        state = {k.removeprefix("decoder."): torch.from_numpy(v) for k, v in arrays.items() if k.startswith("decoder.")}
        decoder.load_state_dict(state)
        decoder.eval().requires_grad_(False)
    return KinematicField(
        hands={name: hands[name] for name in run.hands},
        objects={name: objects[name] for name in run.objects},
        hand_codecs=hand_codecs,
        object_codecs=object_codecs,
        decoder=decoder,
    )


def _read_arrays(folder: Path, name: str, run: RunNotes) -> dict[str, np.ndarray]:
    path = folder / name
    if not path.is_file():
        raise DataFormatError(f"'{path}' is missing. Train again.")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != run.sha256[name]:
        raise DataFormatError(f"'{path}' is not the file that {RUN_FILE} names (sha256 differs). Train again.")
    try:
        arrays = load_arrays(data)
    except SafetensorError as error:
        raise DataFormatError(f"'{path}' is damaged: {error}. Train again.") from error
    if name == CODES_FILE and arrays["values"].shape[-1] != CODE_SIZE:
        raise DataFormatError(f"'{path}' holds codes of {arrays['values'].shape[-1]} numbers; expected {CODE_SIZE}.")
    return arrays
