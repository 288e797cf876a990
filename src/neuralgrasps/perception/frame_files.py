"""Frames, depth images, masks, camera poses and point clouds from the files that cameras and tools write."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.perception.camera_file import CameraNumbers, read_camera
from neuralgrasps.perception.frame import Frame, checked_pose

Camera = Intrinsics | CameraNumbers | Path
"""A camera: its intrinsics, its numbers without the image size, or a JSON file of them (see `read_camera`)."""

CAMERA_FILES = ("camera.json", "intrinsics.json", "camera_intrinsics.json", "camera_intrinsic.json")
_TEXT = (".xyz", ".txt", ".csv", ".pts")
_DEPTH = (".png", ".tif", ".tiff", ".npy", ".pgm")
_COLOUR = (".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".tif", ".tiff")
_POSE = (".txt", ".npy", ".json")
_KINDS = {"depth": "depth", "color": "colour", "colour": "colour", "rgb": "colour", "pose": "pose"}
_NAME = re.compile(r"^(?P<stem>.*?)[-_.]?(?P<kind>depth|colou?r|rgb|pose)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFiles:
    """Files of one frame: its name, depth image, and colour image and camera pose where there are such."""

    name: str
    depth: Path
    colour: Path | None = None
    pose: Path | None = None


def read_frame(
    depth: Path,
    *,
    colour: Path | None = None,
    intrinsics: Camera | None = None,
    depth_scale: float | None = None,
    X_WC: np.ndarray | Path | None = None,
    name: str | None = None,
) -> Frame:
    """One frame from its files.

    Args:
        depth: 16-bit PNG or TIFF, or NPY.
        colour: picture registered to the depth image; never flipped or scaled.
        intrinsics: the camera; None for a camera.json or intrinsics.json beside the depth image.
        depth_scale: units of the depth image per metre; None for the camera file's, else 1000 in whole numbers and 1 in
            floating ones.
        X_WC: camera pose, (4, 4) or a file of it.
        name: of the frame; None for the depth file's.
    Raises:
        InputError: a file is missing, unreadable or of the wrong kind; sizes differ; no intrinsics; see `Frame`.
    """
    depth = Path(depth)
    camera = _camera(intrinsics, depth.parent)
    scale = depth_scale if depth_scale is not None else camera.units_per_metre
    image = read_depth(depth, scale, whole_numbers_only=depth_scale is None)
    return Frame(
        depth=image,
        intrinsics=camera.of_size(image.shape[1], image.shape[0], f"depth image '{depth}'"),
        colour=None if colour is None else read_colour(colour),
        X_WC=read_pose(X_WC) if isinstance(X_WC, str | Path) else X_WC,
        name=name or depth.name,
    )


def read_frames(
    folder: Path, *, intrinsics: Camera | None = None, depth_scale: float | None = None, limit: int | None = None
) -> list[Frame]:
    """The frames of a folder in the order of their names (at most `limit`); which files pair, `list_frames` says.

    Raises:
        InputError: no such folder, no depth image in it, or a frame that `read_frame` refuses.
    """
    files = list_frames(folder)[:limit]
    camera = _camera(intrinsics, Path(folder))
    return [
        read_frame(f.depth, colour=f.colour, intrinsics=camera, depth_scale=depth_scale, X_WC=f.pose, name=f.name)
        for f in files
    ]


def list_frames(folder: Path) -> list[FrameFiles]:
    """The frames of a folder, by name.

    Files of one frame share a stem: NAME-depth.png, NAME-color.png, NAME-pose.txt (also with _ or . before the kind,
    and rgb or colour), or depth/NAME.png, rgb/NAME.png (also color or colour), pose/NAME.txt. Colour and pose may lack.

    Raises:
        InputError: no such folder, or no depth image in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"folder of frames '{folder}' does not exist.")
    if (folder / "scene_camera.json").exists():
        raise InputError(f"'{folder}' is a scene folder of a BOP data set; read it with `read_bop_scene`.")
    found = _by_stem(folder)
    frames = [
        FrameFiles(name=stem or folder.name, **kinds) for stem, kinds in sorted(found.items()) if "depth" in kinds
    ]
    if not frames:
        have = ", ".join(p.name for p in sorted(folder.iterdir())[:6]) or "nothing"
        raise InputError(
            f"folder '{folder}' has no depth images; expected NAME-depth.png (16 bits) or NAME-depth.npy with "
            f"NAME-color.png beside it, or folders depth and rgb. It holds {have}."
        )
    return frames


def names_without_depth(folder: Path) -> list[str]:
    """Names of the colour images of a folder that have no depth image, and so are no frames of `list_frames`."""
    return sorted(stem for stem, kinds in _by_stem(Path(folder)).items() if "depth" not in kinds and "colour" in kinds)


def _by_stem(folder: Path) -> dict[str, dict[str, Path]]:
    """The files of a folder by their stem and kind."""
    found: dict[str, dict[str, Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.is_dir() and path.name.lower() in _KINDS:
            for inner in sorted(path.iterdir()):
                _note(found, inner.stem, _KINDS[path.name.lower()], inner)
        elif match := _NAME.match(path.stem):
            _note(found, match["stem"], _KINDS[match["kind"].lower()], path)
    return found


def _note(found: dict[str, dict[str, Path]], stem: str, kind: str, path: Path) -> None:
    kinds = {"depth": _DEPTH, "colour": _COLOUR, "pose": _POSE}[kind]
    if path.is_file() and path.suffix.lower() in kinds:
        before = found.setdefault(stem, {}).setdefault(kind, path)
        if before != path:
            raise InputError(f"frame '{stem}' has two {kind} files, '{before}' and '{path}'; remove one.")


def _camera(intrinsics: Camera | None, folder: Path) -> CameraNumbers:
    if isinstance(intrinsics, CameraNumbers):
        return intrinsics
    if isinstance(intrinsics, Intrinsics):
        k = intrinsics
        return CameraNumbers(fx=k.fx, fy=k.fy, cx=k.cx, cy=k.cy, width=k.width, height=k.height)
    if intrinsics is not None:
        return read_camera(Path(intrinsics))
    for place in (folder, folder.parent):
        for name in CAMERA_FILES:
            if (place / name).is_file():
                return read_camera(place / name)
    raise InputError(
        f"the camera of the frames in '{folder}' is not known: give --fx PIXELS, and --fy, --cx, --cy where they "
        f"differ, or put a {CAMERA_FILES[0]} beside the images with fx, fy, cx, cy in pixels."
    )


def read_depth(path: Path, units_per_metre: float | None, *, whole_numbers_only: bool = False) -> np.ndarray:
    """(h, w) float64 depth in metres, 0 = nothing measured.

    Args:
        path: 16-bit PNG or TIFF, or a NPY file.
        units_per_metre: of the file; None for 1000 (millimetres) in whole numbers, 1 in floating ones.
        whole_numbers_only: take a floating image as metres whatever `units_per_metre` is.
    Raises:
        InputError: missing, unreadable, or not a depth image.
    """
    path = Path(path)
    image = _array(path, "depth image")
    if image.ndim != 2 or image.dtype.kind not in "fiu":
        raise InputError(
            f"depth image '{path}' holds {image.dtype} of shape {image.shape}; expected one channel (height, width)."
        )
    if image.dtype.itemsize == 1:
        raise InputError(
            f"depth image '{path}' has 8 bits per pixel; expected 16 bits or floating point. Is it a picture of depth "
            "made for looking at?"
        )
    if units_per_metre is None or (whole_numbers_only and image.dtype.kind == "f"):
        units_per_metre = 1.0 if image.dtype.kind == "f" else 1000.0
    if not (units_per_metre > 0 and np.isfinite(units_per_metre)):
        raise InputError(f"--depth-scale is {units_per_metre}; expected units per metre, such as 1000 for millimetres.")
    depth = image.astype(np.float64) / units_per_metre
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0.0)


def read_colour(path: Path) -> np.ndarray:
    """(h, w, 3) uint8 red, green, blue, as stored: no flip, no rotation; grey becomes three equal channels.

    Raises:
        InputError: missing or unreadable.
    """
    image = _array(Path(path), "colour image", mode="RGB")
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    if image.ndim != 3 or image.shape[2] < 3 or image.dtype != np.uint8:
        raise InputError(f"colour image '{path}' holds {image.dtype} of shape {image.shape}; expected 8-bit colours.")
    return np.ascontiguousarray(image[..., :3])


def read_mask(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool, the pixels of a mask image that are not 0.

    Raises:
        InputError: missing, unreadable, or of another size than the depth image.
    """
    mask = _array(Path(path), "mask")
    mask = mask if mask.ndim == 2 else mask[..., :3].max(axis=-1)
    if mask.shape != shape:
        raise InputError(
            f"mask '{path}' is {mask.shape[1]} x {mask.shape[0]}; the depth image {shape[1]} x {shape[0]}."
        )
    return mask > 0


def read_pose(path: Path) -> np.ndarray:
    """(4, 4) float64 rigid motion of a NPY, text (4 or 3 rows of 4 numbers) or JSON file (such rows, or X_WC: rows).

    Raises:
        InputError: missing, unreadable, or not rigid.
    """
    path = Path(path)
    _check_exists(path, "pose")
    try:
        if path.suffix.lower() == ".npy":
            X = np.load(path, allow_pickle=False)
        elif path.suffix.lower() == ".json":
            data = json.loads(path.read_text(encoding="utf-8"))
            X = np.array(data.get("X_WC") if isinstance(data, dict) else data, np.float64)
        else:
            X = np.array(path.read_text(encoding="utf-8").replace(",", " ").split(), np.float64)
    except (ValueError, TypeError, EOFError, OSError) as error:
        raise InputError(f"pose '{path}' cannot be read: {_first_line(error)}.") from error
    if X.size in {12, 16}:
        X = X.reshape(-1, 4)
    return checked_pose(X, f"pose '{path}'")


def read_cloud(path: Path) -> np.ndarray:
    """(M, 3) float64 points of a PLY, NPY or text file (x y z per line, further columns are left out), as stored.

    Raises:
        InputError: missing, unreadable, or not points.
    """
    _check_exists(path, "point cloud")
    kind = path.suffix.lower()
    try:
        if kind == ".npy":
            points = np.load(path, allow_pickle=False)
        elif kind in _TEXT:
            lines = path.read_text(encoding="utf-8", errors="replace").replace(",", " ").splitlines()
            points = np.array(
                [line.split()[:3] for line in lines if line.strip() and line.lstrip()[0] in "+-.0123456789n"], float
            )
        elif kind == ".ply":
            points = _ply_points(path)
        else:
            raise InputError(f"point cloud '{path}' is of kind '{kind}'; expected .ply, .npy, {', '.join(_TEXT)}.")
    except (ValueError, EOFError, OSError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"point cloud '{path}' cannot be read: {_first_line(error)}.") from error
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise InputError(f"point cloud '{path}' holds {points.dtype} of shape {points.shape}; expected numbers (M, 3).")
    return points[:, :3].astype(np.float64)


def _ply_points(path: Path) -> np.ndarray:
    import trimesh  # noqa: PLC0415 - slow to import, and only this kind of file needs it

    try:
        loaded = trimesh.load(path, process=False)
    except Exception as error:  # the reader raises whatever its parser raises
        raise InputError(f"point cloud '{path}' cannot be read as PLY: {_first_line(error)}.") from error
    return np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), np.float64)


def _array(path: Path, what: str, *, mode: str | None = None) -> np.ndarray:
    """Numbers of an NPY or picture file; `mode`: convert palette, grey and transparent pictures to it."""
    _check_exists(path, what)
    try:
        if path.suffix.lower() == ".npy":
            return np.load(path, allow_pickle=False)
        with Image.open(path) as image:
            return np.asarray(image.convert(mode) if mode and image.mode != mode else image)
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, EOFError) as error:
        raise InputError(f"{what} '{path}' cannot be read: {_first_line(error)}.") from error


def _check_exists(path: Path, what: str) -> None:
    if not path.is_file():
        raise InputError(f"{what} '{path}' does not exist.")
    if path.stat().st_size == 0:
        raise InputError(f"{what} '{path}' is empty (0 bytes).")


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200].rstrip(".") if lines else type(error).__name__
