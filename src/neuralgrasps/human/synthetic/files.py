"""Recorded demonstrations on disk: a folder of frames that `read_frames` reads, and the truth beside it."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from safetensors import SafetensorError
from safetensors.numpy import load

from neuralgrasps.errors import DataFormatError
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.human.synthetic.recording import UNITS_PER_METRE, DemonstrationTruth, RecordedDemonstration
from neuralgrasps.perception.frame_files import list_frames, read_colour, read_depth
from neuralgrasps.tensor_files import tensor_bytes

_VERSION = 1
_ARRAYS = ("X_CO", "X_CH", "q", "joints_C", "visible", "X_OH")
_FAST = 1  # of the levels of PNG compression: 9 is a sixth smaller and takes ten times as long


def write_demonstration(folder: Path, recorded: RecordedDemonstration) -> None:
    """Write depth/NNNNNN.png (16 bits), rgb/NNNNNN.png, pose/NNNNNN.txt, camera.json, truth.json, truth.safetensors.

    The masks are packed bits in truth.safetensors; strip.png shows the film at a glance. Frames of an earlier recording
    in the folder are removed.

    Raises:
        StorageError: the folder cannot be written.
    """
    folder, truth, k = Path(folder), recorded.truth, recorded.intrinsics
    _remove_frames(folder, beyond=len(recorded))
    pose = "\n".join(" ".join(f"{v:.17g}" for v in row) for row in recorded.X_WC) + "\n"
    for t in range(len(recorded)):
        write_whole(folder / "depth" / f"{t:06d}.png", _png(recorded.depth_units[t]))
        write_whole(folder / "rgb" / f"{t:06d}.png", _png(recorded.colour[t]))
        write_whole(folder / "pose" / f"{t:06d}.txt", pose)
    camera = {
        "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": k.width, "height": k.height,
        "depth_scale": UNITS_PER_METRE,
    }  # fmt: skip
    notes: dict[str, Any] = {
        "version": _VERSION, "object": truth.object, "side": truth.side, "scale": truth.scale, "kind": truth.kind,
        "frames": len(recorded), "rate_hz": recorded.rate_hz, "seed": recorded.seed, "still": list(truth.still),
        "grasp_frame": truth.grasp_frame, "visible": [round(float(v), 4) for v in truth.visible],
        "X_WC": recorded.X_WC.tolist(), "notes": list(truth.notes),
    }  # fmt: skip
    arrays: dict[str, np.ndarray] = {name: np.asarray(getattr(truth, name), np.float64) for name in _ARRAYS}
    arrays["hand_mask_bits"] = np.packbits(truth.hand_mask, axis=-1)
    write_whole(folder / "strip.png", _png(film_strip(recorded)))
    write_whole(folder / "camera.json", json.dumps(camera, indent=1) + "\n")
    write_whole(folder / "truth.safetensors", tensor_bytes(arrays))
    write_whole(folder / "truth.json", json.dumps(notes, indent=1) + "\n")


def read_truth(folder: Path) -> DemonstrationTruth:
    """The truth of a recorded demonstration, without its images.

    Raises:
        DataFormatError: the folder holds none, or of another version.
    """
    return _truth(Path(folder), _notes(Path(folder)))


def read_demonstration(folder: Path) -> RecordedDemonstration:
    """A recorded demonstration as it was written.

    Raises:
        DataFormatError: no demonstration with its truth, of another version, or incomplete.
        InputError: an image that cannot be read.
    """
    folder = Path(folder)
    notes = _notes(folder)
    camera = json.loads((folder / "camera.json").read_text(encoding="utf-8"))
    names = ("fx", "fy", "cx", "cy", "width", "height")
    files = list_frames(folder)
    if len(files) != notes["frames"] or any(f.colour is None for f in files):
        raise DataFormatError(f"'{folder}' holds {len(files)} frames; its truth.json says {notes['frames']}.")
    depth = np.stack([read_depth(f.depth, float(UNITS_PER_METRE)) for f in files])
    return RecordedDemonstration(
        depth_units=np.rint(depth * UNITS_PER_METRE).astype(np.uint16),
        colour=np.stack([read_colour(f.colour) for f in files if f.colour is not None]),
        intrinsics=Intrinsics(**{name: camera[name] for name in names}),
        X_WC=np.array(notes["X_WC"]),
        rate_hz=notes["rate_hz"],
        seed=notes["seed"],
        truth=_truth(folder, notes),
    )


def film_strip(recorded: RecordedDemonstration, *, count: int = 6, height: int = 180) -> np.ndarray:
    """(height, w, 3) uint8 pictures side by side: frames from the first to the last, one of them the grasp."""
    first, last = recorded.truth.grasp_frame, len(recorded) - 1
    before = np.linspace(0, first, count - 1)
    chosen = np.unique(np.rint([*before, last]).astype(int))
    width = round(recorded.intrinsics.width * height / recorded.intrinsics.height)
    pictures = [Image.fromarray(recorded.colour[t]).resize((width, height)) for t in chosen]
    return np.concatenate([np.asarray(picture) for picture in pictures], axis=1)


def _notes(folder: Path) -> dict[str, Any]:
    path = folder / "truth.json"
    try:
        notes = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataFormatError(
            f"'{folder}' is no recorded demonstration with its truth: '{path}' cannot be read ({error})."
        ) from error
    if not isinstance(notes, dict) or notes.get("version") != _VERSION:
        raise DataFormatError(f"'{path}' is not the truth of a demonstration of version {_VERSION}; record it anew.")
    return notes


def _truth(folder: Path, notes: dict[str, Any]) -> DemonstrationTruth:
    path = folder / "truth.safetensors"
    try:
        arrays = load(path.read_bytes())
        camera = json.loads((folder / "camera.json").read_text(encoding="utf-8"))
        bits = arrays.pop("hand_mask_bits")
        mask = np.unpackbits(bits, axis=-1, count=int(camera["width"])).astype(bool)
        return DemonstrationTruth(
            object=notes["object"], side=notes["side"], scale=notes["scale"], kind=notes["kind"], hand_mask=mask,
            still=(notes["still"][0], notes["still"][1]), grasp_frame=notes["grasp_frame"],
            notes=tuple(notes["notes"]), **{name: arrays[name] for name in _ARRAYS},
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise DataFormatError(f"'{path}' cannot be read: {error}.") from error


def _png(image: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image).save(out, format="PNG", compress_level=_FAST)
    return out.getvalue()


def _remove_frames(folder: Path, *, beyond: int) -> None:
    """Frames numbered from `beyond` on, left by a longer recording."""
    for kind in ("depth", "rgb", "pose"):
        for path in (folder / kind).glob("[0-9]" * 6 + ".*"):
            if int(path.stem) >= beyond:
                path.unlink()
