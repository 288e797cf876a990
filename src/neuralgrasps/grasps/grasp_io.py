"""Grasp files: safetensors with a JSON description, checksummed, written whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.files import write_whole
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict, array_fields
from neuralgrasps.hands.fingerprint import hand_fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.tensor_files import tensor_bytes

FORMAT = "neuralgrasps.grasp_set"
VERSION = 2  # 2 added force_residual, palm_contact, finger_count, precision
_VERDICT_ARRAYS = ("success", "displacement_m", "rotation_rad")


# What each tensor holds, for readers without this library. N grasps, J joints, C contacts.
COLUMNS = {
    "X_OH": "(N, 4, 4) hand base H (the hand file's root link) in the object's mesh frame O, metres: p_O = X_OH p_H",
    "q": "(N, J) joints at the grasp, in the order of 'joints', rad (turning) or m (sliding)",
    "q_pregrasp": "(N, J) joints before closing, as q",
    "q_squeeze": "(N, J) position targets that press the fingers on the object, as q",
    "contact_points_O": "(N, C, 3) on the object's surface, frame O, metres, nan where there is no contact",
    "contact_normals_O": "(N, C, 3) unit, frame O, out of the object, nan where there is no contact",
    "contact_links": "(N, C) the link that touches, its place in 'links' from 0, -1 where there is no contact",
    "epsilon": "(N,) Ferrari-Canny quality, 0 = no force closure, no unit",
    "penetration_m": "(N,) deepest overlap, metres, >= 0",
    "force_residual": "(N,) net wrench of the best unit squeeze, 0 = balanced, nan = not measured",
    "palm_contact": "(N,) the palm touches",
    "finger_count": "(N,) fingers that touch, -1 = not labelled",
    "precision": "(N,) only fingertips touch",
    "verdict.I.success": "(N,) the object was held in the trial 'verdicts'[I]",
    "verdict.I.displacement_m": "(N,) largest movement of the object in the hand in that trial, metres",
    "verdict.I.rotation_rad": "(N,) largest rotation of the object in the hand in that trial, rad",
}


def save_grasps(
    path: str | os.PathLike[str], grasps: GraspSet, *, hand: Hand | None = None, object_fingerprint: str = ""
) -> Path:
    """Write `grasps` to `path`, replacing what is there only once the new file is complete; equal sets, equal bytes.

    Args:
        hand: the hand of the grasps; its joint and link names and fingerprint are then in the file.
        object_fingerprint: hash of the object, "" = not known; readers can tell a changed object by it.
    Returns:
        the path written.
    Raises:
        ShapeError: `hand` has another number of joints. InputError: it has another name.
        StorageError: missing or read-only folder, full disk, no permission. An older file is left as it was.
    """
    about = {"columns": COLUMNS} | _about_hand(grasps, hand)
    if object_fingerprint:
        about["object_fingerprint"] = object_fingerprint
    arrays = {name: getattr(grasps, name) for name in array_fields()}
    verdicts = []
    for i, (name, verdict) in enumerate(grasps.verdicts.items()):
        verdicts.append({"name": name, "parameters": dict(verdict.parameters)})
        arrays |= {f"verdict.{i}.{key}": getattr(verdict, key) for key in _VERDICT_ARRAYS}
    description = json.dumps(
        {
            "hand": grasps.hand,
            "object": grasps.object,
            "protocol": grasps.protocol,
            "seed": grasps.seed,
            "config": dict(grasps.config),
            "verdicts": verdicts,
            **about,
        },
        sort_keys=True,
    )
    metadata = {
        "format": FORMAT,
        "version": str(VERSION),
        "description": description,
        "sha256": _checksum(arrays, description),
    }
    return write_whole(path, tensor_bytes(arrays, metadata), make_folder=False)


def _about_hand(grasps: GraspSet, hand: Hand | None) -> dict[str, Any]:
    if hand is None:
        return {}
    if hand.name != grasps.hand:
        raise InputError(f"the grasps are of hand '{grasps.hand}', but hand '{hand.name}' was given with them.")
    hand.check_q(grasps.q)
    return {
        "joints": list(hand.tree.dof_names),
        "links": list(hand.tree.link_names),
        "hand_fingerprint": hand_fingerprint(hand),
    }


def load_grasps(path: str | os.PathLike[str]) -> GraspSet:
    """Read a file written by `save_grasps`.

    Raises:
        InputError: the file is missing or cannot be read.
        DataFormatError: it is not a grasp file, of another version, damaged, or its arrays do not fit together.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read grasps from '{path}': {error.strerror or error}; check the path.") from error
    arrays, metadata = _parse(path, data)
    description = metadata["description"]
    if _checksum(arrays, description) != metadata.get("sha256"):
        raise DataFormatError(f"'{path}' is damaged: its checksum does not match; write it again or fetch a new copy.")
    try:
        return _assemble(arrays, json.loads(description))
    except (KeyError, TypeError, ValueError) as error:
        raise DataFormatError(f"'{path}' is not a consistent grasp file: {error}; write it again.") from error


def _assemble(arrays: dict[str, np.ndarray], text: dict[str, Any]) -> GraspSet:
    verdicts = {
        entry["name"]: Verdict(
            **{key: arrays[f"verdict.{i}.{key}"] for key in _VERDICT_ARRAYS}, parameters=entry["parameters"]
        )
        for i, entry in enumerate(text["verdicts"])
    }
    return GraspSet(
        hand=text["hand"],
        object=text["object"],
        **{name: arrays[name] for name in array_fields()},
        verdicts=verdicts,
        protocol=text["protocol"],
        seed=int(text["seed"]),
        config=text["config"],
    )


def _parse(path: Path, data: bytes) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Arrays and metadata of a file of our format and version."""
    try:
        arrays = load(data)
        size = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + size]).get("__metadata__") or {}
    except (SafetensorError, ValueError, KeyError) as error:
        raise DataFormatError(f"'{path}' is not a grasp file or is damaged ({error}); expected safetensors.") from error
    if metadata.get("format") != FORMAT:
        raise DataFormatError(f"'{path}' holds {metadata.get('format', 'other data')!r}; expected {FORMAT!r}.")
    if metadata.get("version") != str(VERSION):
        raise DataFormatError(
            f"'{path}' has grasp format version {metadata.get('version')}; this library reads version {VERSION}. "
            "Use the library version that wrote it, or make the grasps again."
        )
    if "description" not in metadata:
        raise DataFormatError(f"'{path}' lacks its description; write it again.")
    return arrays, metadata


def _checksum(arrays: dict[str, np.ndarray], description: str) -> str:
    digest = hashlib.sha256(description.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
