"""Scene folders of BOP data sets: frames, visible masks and true poses, in metres.

The format is that of the BOP benchmark (Hodan et al. 2018; its public description of data sets): one folder per scene
with scene_camera.json, depth/, rgb/ (or gray/) and, for annotated scenes, scene_gt.json and mask_visib/. Lengths there
are millimetres.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.perception.camera_file import camera_from
from neuralgrasps.perception.frame import Frame, checked_pose
from neuralgrasps.perception.frame_files import read_colour, read_depth, read_mask

_MM = 1e-3
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


@dataclass(frozen=True, slots=True, kw_only=True)
class BopFrame:
    """One image of a scene and what is annotated in it, by instance.

    Attributes:
        image: its number in the scene.
        frame: depth, camera, colour, and the camera pose where the scene gives one.
        masks: (h, w) bool of each instance's visible pixels; None where there is no file.
        object_ids: the data set's object numbers; empty when the scene is not annotated.
        X_CO: (K, 4, 4) float64 true poses, metres, in the data set's object frames; None when not annotated.
    """

    image: int
    frame: Frame
    masks: tuple[np.ndarray | None, ...]
    object_ids: tuple[int, ...]
    X_CO: np.ndarray | None


def is_bop_scene(folder: Path) -> bool:
    """Whether a folder is one scene of a BOP data set, or holds such scenes (`read_bop_scene` then names them)."""
    folder = Path(folder)
    return (folder / "scene_camera.json").is_file() or bool(_scenes(folder))


def bop_images(folder: Path) -> list[int]:
    """Numbers of the images of a scene that have a depth image.

    Raises:
        InputError: not a scene folder, or no depth images.
    """
    cameras = _records(_scene_folder(folder), "scene_camera.json")
    images = [i for i in sorted(cameras) if _picture(Path(folder) / "depth", i) is not None]
    if not images:
        raise InputError(f"BOP scene '{folder}' has no depth images; expected depth/000000.png and so on.")
    return images


def read_bop_scene(folder: Path, *, images: Sequence[int] | None = None) -> list[BopFrame]:
    """Frames of one scene folder, in the order of their numbers, or those numbers only.

    Raises:
        InputError: not a scene folder, an image it does not have, or a file that cannot be read.
    """
    have = bop_images(folder)
    unknown = sorted(set(images or ()) - set(have))
    if unknown:
        raise InputError(
            f"BOP scene '{folder}' has no image {unknown[0]}; it has {len(have)}, from {have[0]} to {have[-1]}."
        )
    cameras = _records(Path(folder), "scene_camera.json")
    truth = _records(Path(folder), "scene_gt.json") if (Path(folder) / "scene_gt.json").exists() else {}
    return [_read(Path(folder), i, cameras[i], truth.get(i)) for i in (have if images is None else images)]


def _read(folder: Path, image: int, camera: dict[str, Any], truth: list[dict[str, Any]] | None) -> BopFrame:
    what = f"image {image} of BOP scene '{folder}'"
    path = _picture(folder / "depth", image)
    assert path is not None
    try:
        numbers = camera_from({"cam_K": camera["cam_K"]})
        millimetres = float(camera.get("depth_scale", 1.0))
        X_WC = _camera_pose(camera, what)
        poses = [_pose(gt["cam_R_m2c"], gt["cam_t_m2c"], what) for gt in truth or ()]
        object_ids = tuple(int(gt["obj_id"]) for gt in truth or ())
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{what} has a broken record in scene_camera.json or scene_gt.json: {error!r}; expected cam_K, and "
            "cam_R_m2c, cam_t_m2c, obj_id of every instance."
        ) from error
    if not millimetres > 0:
        raise InputError(f"{what} has depth_scale {millimetres}; expected millimetres per unit, above 0.")
    depth = read_depth(path, 1.0 / (millimetres * _MM))
    colour = _picture(folder / "rgb", image) or _picture(folder / "gray", image)
    frame = Frame(
        depth=depth,
        intrinsics=numbers.of_size(depth.shape[1], depth.shape[0], f"depth image '{path}'"),
        colour=None if colour is None else read_colour(colour),
        X_WC=X_WC,
        name=f"{folder.name}/{image:06d}",
    )
    return BopFrame(
        image=image,
        frame=frame,
        masks=_masks(folder, image, None if truth is None else len(truth), depth.shape),
        object_ids=object_ids,
        X_CO=None if truth is None else np.array(poses).reshape(-1, 4, 4),
    )


def _masks(folder: Path, image: int, count: int | None, shape: tuple[int, ...]) -> tuple[np.ndarray | None, ...]:
    """By instance; without annotations as many as there are files."""
    paths = {int(p.stem.split("_")[1]): p for p in (folder / "mask_visib").glob(f"{image:06d}_*.png")}
    count = count if count is not None else max(paths, default=-1) + 1
    return tuple(read_mask(paths[i], shape) if i in paths else None for i in range(count))


def _pose(rotation: Any, translation_mm: Any, what: str) -> np.ndarray:
    R, t = np.array(rotation, np.float64), np.array(translation_mm, np.float64)
    if R.size != 9 or t.size != 3:
        raise InputError(f"{what} has a pose of {R.size} and {t.size} numbers; expected 9 and 3.")
    return checked_pose(np.concatenate([R.reshape(3, 3), t.reshape(3, 1) * _MM], axis=1), f"a pose in {what}")


def _camera_pose(camera: dict[str, Any], what: str) -> np.ndarray | None:
    if "cam_R_w2c" not in camera or "cam_t_w2c" not in camera:
        return None
    return np.linalg.inv(_pose(camera["cam_R_w2c"], camera["cam_t_w2c"], what))


def _scene_folder(folder: Path) -> Path:
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"BOP scene '{folder}' does not exist.")
    if not (folder / "scene_camera.json").is_file():
        scenes = _scenes(folder)
        if scenes:
            shown = ", ".join(scenes[:8]) + (", ..." if len(scenes) > 8 else "")
            raise InputError(f"'{folder}' holds {len(scenes)} BOP scenes ({shown}); give one of these folders.")
        raise InputError(f"'{folder}' is not a BOP scene: it has no scene_camera.json.")
    return folder


def _scenes(folder: Path) -> list[str]:
    return sorted(p.parent.name for p in folder.glob("*/scene_camera.json"))


def _records(folder: Path, name: str) -> dict[int, Any]:
    """A JSON file of records by image number."""
    try:
        data = json.loads((folder / name).read_text(encoding="utf-8"))
        return {int(key): value for key, value in data.items()}
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"'{folder / name}' cannot be read as records by image number: {error}.") from error


def _picture(folder: Path, image: int) -> Path | None:
    for suffix in _PICTURES:
        path = folder / f"{image:06d}{suffix}"
        if path.is_file():
            return path
    return None
