"""Hand joints from files of other trackers: 21 of them per frame, in pixels, with relative depth, or in metres."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.human.seen import SeenJoints, Side
from neuralgrasps.human.skeleton import JOINT_NAMES, NUM_JOINTS
from neuralgrasps.human.video.lift import PictureJoints, lift_video
from neuralgrasps.perception.frame import Frame

Unit = Literal["pixels", "normalised", "metres", "millimetres"]

_UNITS: Mapping[str, Unit] = {
    "pixels": "pixels", "pixel": "pixels", "px": "pixels",
    "normalised": "normalised", "normalized": "normalised", "relative": "normalised",
    "metres": "metres", "meters": "metres", "m": "metres",
    "millimetres": "millimetres", "millimeters": "millimetres", "mm": "millimetres",
}  # fmt: skip
_POINT_KEYS: Mapping[str, Unit | None] = {
    "joints_C": "metres", "xyz": None, "joints": None, "keypoints": None, "points": None,
    "pixels": "pixels", "uv": "pixels", "landmarks": "normalised", "hand_landmarks": "normalised",
}  # fmt: skip
_SCORE_KEYS = ("score", "scores", "weight", "confidence", "visibility")
_KNOWN_KEYS = {*_POINT_KEYS, *_SCORE_KEYS, "side", "handedness", "unit", "units"}
_LENGTHS: Mapping[Unit, float] = {"metres": 1.0, "millimetres": 1e-3}
_FARTHEST_M = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointRecord:
    """Joints of one frame as a file gives them.

    Attributes:
        values: (21, 2) or (21, 3) numbers; nan where not known. unit: of them.
        score: (21,) trust, 0 to 1. side: of the hand, None where it is not said. source: the file.
    """

    values: np.ndarray
    unit: Unit
    score: np.ndarray
    side: Side | None
    source: str


def read_joints(path: str | Path, frames: Sequence[Frame], *, scale: float | None = None) -> list[SeenJoints | None]:
    """The joints of every frame, camera frame, metres; None where the file has none.

    A file holds one frame's record, a list of records (null: no hand), `{"frames": [...]}`, or records by frame name
    or number; a folder holds one file per frame, of the frame's name, or as many as there are frames. A record is a
    list of 21 joints in the order of `skeleton.JOINT_NAMES`, or an object with such a list under joints, keypoints,
    xyz, joints_C, pixels, uv or landmarks, and perhaps score, side (or handedness) and unit (pixels, normalised,
    metres, millimetres). A joint is [u, v], [u, v, relative depth in the scale of u, positive farther], [x, y, z] in
    the camera frame, or an object with x, y, z; null: not known. Without a unit the numbers decide.

    Args:
        scale: of the hand, for joints in pixels; None: estimated.
    Raises:
        InputError: no such file, not JSON, not 21 joints, for another number of frames, or of an unclear unit.
    """
    records = _records(Path(path), frames)
    lifted = lift_video(
        [None if r is None else _picture_joints(r, f) for r, f in zip(records, frames, strict=True)],
        frames,
        scale=scale,
    )
    return [s if r is None else _in_metres(r) or s for r, s in zip(records, lifted, strict=True)]


def _in_metres(record: JointRecord) -> SeenJoints | None:
    """The joints of a record in metres; None for other units."""
    if record.unit not in _LENGTHS:
        return None
    points = record.values * _LENGTHS[record.unit]
    known = np.asarray(np.isfinite(points).all(axis=1))
    return SeenJoints(
        points_C=np.where(known[:, None], points, np.nan), weight=np.where(known, record.score, 0.0), mask=None,
        side=record.side or "right", source=record.source,
    )  # fmt: skip


def _picture_joints(record: JointRecord, frame: Frame) -> PictureJoints | None:
    """The joints of a record in pixels; None for those in metres."""
    if record.unit in _LENGTHS:
        return None
    size = np.array([frame.intrinsics.width, frame.intrinsics.height, frame.intrinsics.width])
    values = record.values * size[: record.values.shape[1]] if record.unit == "normalised" else record.values
    return PictureJoints(
        pixels=values[:, :2], relative=values[:, 2] if values.shape[1] == 3 else None, score=record.score,
        side=record.side or "right", side_known=record.side is not None, source=record.source,
    )  # fmt: skip


def _records(path: Path, frames: Sequence[Frame]) -> list[JointRecord | None]:
    if path.is_dir():
        files = sorted(path.glob("*.json"))
        by_name = {file.stem: file for file in files}
        names = [_stem(f.name) for f in frames]
        if any(name in by_name for name in names):
            chosen = [by_name.get(name) for name in names]
        elif len(files) == len(frames):
            chosen = list(files)
        else:
            raise InputError(
                f"folder '{path}' has {len(files)} JSON files for {len(frames)} frames, and none has a frame's name, "
                f"such as '{names[0]}.json'. Name them so, or put all records in one file."
            )
        return [None if file is None else _record(_read(file), str(file)) for file in chosen]
    content = _read(path)
    if isinstance(content, dict) and isinstance(content.get("frames"), list | dict):
        content = content["frames"]
    if _is_record(content):
        if len(frames) != 1:
            raise InputError(f"'{path}' has joints of one frame, but there are {len(frames)}; give a list of records.")
        return [_record(content, str(path))]
    if isinstance(content, dict):
        return _by_name(content, frames, path)
    if not isinstance(content, list) or len(content) != len(frames):
        got = f"{len(content)} records" if isinstance(content, list) else type(content).__name__
        raise InputError(f"'{path}' has {got} for {len(frames)} frames; expected one per frame, null where no hand is.")
    return [_record(one, f"{path}, frame {k}") for k, one in enumerate(content)]


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError as error:
        raise InputError(f"file of joints '{path}' does not exist.") from error
    except (json.JSONDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(f"file of joints '{path}' cannot be read as JSON: {error}.") from error


def _is_record(content: Any) -> bool:
    if isinstance(content, dict):
        return any(key in content for key in _POINT_KEYS)
    return isinstance(content, list) and len(content) == NUM_JOINTS and _is_joint(content[0])


def _is_joint(row: Any) -> bool:
    if isinstance(row, dict):
        return "x" in row and "y" in row
    return isinstance(row, list) and 2 <= len(row) <= 4 and all(isinstance(x, int | float) for x in row)


def _by_name(content: dict[str, Any], frames: Sequence[Frame], path: Path) -> list[JointRecord | None]:
    found = {_stem(name): record for name, record in content.items()}
    out = []
    for number, frame in enumerate(frames):
        name = _stem(frame.name)
        record = found.get(name, found.get(str(number)))
        out.append(_record(record, f"{path}, frame '{name}'"))
    if content and all(record is None for record in out):
        raise InputError(
            f"'{path}' has records named {', '.join(list(content)[:3])}, ..., but no frame is named so; the first is "
            f"'{_stem(frames[0].name)}'."
        )
    return out


def _stem(name: str) -> str:
    return Path(name).stem.removesuffix("-depth").removesuffix("_depth")


def _record(content: Any, source: str) -> JointRecord | None:
    if content is None or content in ([], {}):
        return None
    fields = content if isinstance(content, dict) else {"joints": content}
    key = next((k for k in _POINT_KEYS if fields.get(k)), None)
    if key is None:
        _refuse_unknown(fields, source)
        return None
    rows = fields[key]
    if len(rows) == 1 and isinstance(rows[0], list) and len(rows[0]) == NUM_JOINTS:
        rows = rows[0]  # a list of hands with one hand in it
    values, score = _numbers(rows, source)
    given = next((fields[k] for k in _SCORE_KEYS if k in fields), None)
    unit = _unit_of(fields.get("unit", fields.get("units")), _POINT_KEYS[key], values, source)
    if unit == "pixels" and values.shape[1] == 3 and given is None and _looks_like_score(values[:, 2]):
        values, score = values[:, :2], values[:, 2]
    if given is not None:
        score = _scores(given, source)
    return JointRecord(
        values=values, unit=unit, score=np.clip(np.nan_to_num(score, nan=1.0), 0.0, 1.0),
        side=_side(fields.get("side", fields.get("handedness")), source),
        source=Path(source.rsplit(", frame", 1)[0]).name,
    )  # fmt: skip


def _refuse_unknown(fields: Mapping[str, Any], source: str) -> None:
    """Refuse a record whose numbers are under a key that is not known, which is not one without a hand."""
    strange = [k for k, v in fields.items() if isinstance(v, list | dict) and v and k not in _KNOWN_KEYS]
    if strange and not any(k in fields for k in _POINT_KEYS):
        named = ", ".join(f"'{k}'" for k in strange)
        raise InputError(
            f"'{source}' has {named} and no joints; expected a list of {NUM_JOINTS} under one of the keys "
            f"{', '.join(_POINT_KEYS)}, or null where no hand is."
        )


def _numbers(rows: Any, source: str) -> tuple[np.ndarray, np.ndarray]:
    """(21, 2 or 3) values and (21,) scores of rows of numbers or objects."""
    if not isinstance(rows, list) or len(rows) != NUM_JOINTS:
        got = len(rows) if isinstance(rows, list) else type(rows).__name__
        raise InputError(
            f"joints of '{source}' are {got}; expected {NUM_JOINTS}: {JOINT_NAMES[0]}, {JOINT_NAMES[1]}, ..., "
            f"{JOINT_NAMES[-1]}."
        )
    listed = [_row(row) for row in rows]
    widths = {len(row) for row in listed if row is not None}
    if not widths or len(widths) > 1 or not widths <= {2, 3, 4}:
        raise InputError(
            f"joints of '{source}' have {' and '.join(map(str, sorted(widths))) or 'no'} numbers each; expected 2 or 3 "
            "(and a score), the same for all; null for a joint that is not known."
        )
    width = widths.pop()
    try:
        values = np.array([[np.nan] * width if row is None else row for row in listed], np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"joints of '{source}' hold something that is no number: {error}.") from error
    score = values[:, 3] if width == 4 else np.ones(NUM_JOINTS)
    return values[:, :3], score


def _row(row: Any) -> list[Any] | None:
    if isinstance(row, dict):
        score = [row[k] for k in _SCORE_KEYS if row.get(k) is not None][:1]
        place = [row[axis] for axis in ("x", "y", "z") if axis in row]
        return place + score if len(place) == 3 else place
    return row if isinstance(row, list) else None


def _unit_of(said: Any, by_key: Unit | None, values: np.ndarray, source: str) -> Unit:
    if said is not None:
        unit = _UNITS.get(str(said).lower())
        if unit is None:
            known = "pixels, normalised, metres, millimetres"
            raise InputError(f"unit of joints in '{source}' is '{said}'; expected one of {known}.")
    else:
        unit = by_key or _guessed_unit(values, source)
    if unit in ("metres", "millimetres") and values.shape[1] != 3:
        raise InputError(f"joints of '{source}' are in {unit} but have 2 numbers each; expected x, y, z.")
    z = values[:, 2:] * (1e-3 if unit == "millimetres" else 1.0)
    if unit in ("metres", "millimetres") and not 0.05 < float(np.nanmedian(z)) < _FARTHEST_M:
        raise InputError(
            f"joints of '{source}' have a median depth of {float(np.nanmedian(z)):.3g} m; expected the camera's frame, "
            "z forward, 0.2 to 1.5 m. Joints relative to the wrist cannot be placed: give them in pixels."
        )
    return unit


def _guessed_unit(values: np.ndarray, source: str) -> Unit:
    """By the numbers: depths of metres or millimetres before the camera, shares of the image, or pixels."""
    flat = float(np.nanmax(np.abs(values[:, :2])))
    if values.shape[1] == 3 and float(np.nanmin(values[:, 2])) > 0.1 and flat < 1.5 * float(np.nanmax(values[:, 2])):
        z = float(np.nanmedian(values[:, 2]))
        if z < _FARTHEST_M and not (flat <= 1.0 and float(np.nanmin(values[:, :2])) >= 0.0):
            return "metres"
        if z > 100.0 and float(np.nanmin(values[:, :2])) < 0.0:
            return "millimetres"
        raise InputError(
            f"the unit of the joints in '{source}' is not clear from the numbers: add 'unit': 'pixels', "
            "'normalised', 'metres' or 'millimetres'."
        )
    return "normalised" if flat <= 2.0 else "pixels"


def _looks_like_score(column: np.ndarray) -> bool:
    """Whether a third number is rather a score than a depth relative to the wrist's."""
    known = column[np.isfinite(column)]
    return bool(((known >= 0.0) & (known <= 1.0)).all() and known.max() > 0.2 and abs(column[0]) > 1e-6)


def _scores(given: Any, source: str) -> np.ndarray:
    if isinstance(given, int | float):
        return np.full(NUM_JOINTS, float(given))
    if isinstance(given, list) and len(given) == NUM_JOINTS:
        return np.array([np.nan if x is None else float(x) for x in given])
    raise InputError(f"scores of '{source}' are {type(given).__name__}; expected one number, or {NUM_JOINTS}.")


def _side(said: Any, source: str) -> Side | None:
    if said is None:
        return None
    text = str(said).strip().lower()
    if text in ("right", "r"):
        return "right"
    if text in ("left", "l"):
        return "left"
    raise InputError(f"side in '{source}' is '{said}'; expected 'right' or 'left'.")
