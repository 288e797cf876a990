"""What `pose` looks at: options, their contradictions, and the frames or points they name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from neuralgrasps.cli.options import OptionalFile, OptionalFloat, OptionalFolder
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.geometry.plane import Plane
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.perception.camera_file import CameraNumbers
    from neuralgrasps.perception.frame import Frame
    from neuralgrasps.perception.frame_files import FrameFiles

_LEAST_POINTS = 20
# Spread of the points over the object's diagonal: less is a speck that fits anywhere, more cannot lie on it.
_LEAST_SPREAD, _LARGEST_SPREAD = 0.08, 1.6
_FLAT_SHARE = 0.015  # points this much thinner than wide lie on a plane
_LINE_SHARE = 0.03
_SCENE_M = 10.0  # a cloud of more than this is in another unit, of less a scene


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSource:
    """Where the observation comes from, as options of the command.

    Attributes:
        depth: depth image, 16-bit PNG or TIFF, or NPY.
        colour: picture of the same size, only to draw over: poses come from depth alone.
        mask: image of the same size, not 0 where the object is; without it every cluster on the table is tried. Helps
            where a cluster is missed.
        frames: folder of NAME-depth and NAME-color files, or of depth/ and rgb/, or a BOP scene.
        cloud: points on one object in the camera frame: .ply, .npy or x y z text.
        fx: focal length, pixels.
        fy: focal length, pixels; default fx.
        cx: principal point, pixels; default the middle.
        cy: principal point, pixels; default the middle.
        camera: JSON file of the camera in place of fx to cy; default a camera.json beside the images.
        depth_scale: units of a depth image per metre; default 1000 for whole numbers, 1 for floating ones.
        cloud_scale: units of the cloud per metre; default 1.
        camera_pose: file of X_WC (4 x 4), the camera in the world, z up; a folder of frames has its own files.
        table_height: height of the table in the world, metres, in place of looking for it; needs camera poses.
        max_depth: the table is not looked for beyond this, metres; use it when the floor is taken for the table.
    """

    depth: OptionalFile = None
    colour: OptionalFile = None
    mask: OptionalFile = None
    frames: OptionalFolder = None
    cloud: OptionalFile = None
    fx: OptionalFloat = None
    fy: OptionalFloat = None
    cx: OptionalFloat = None
    cy: OptionalFloat = None
    camera: OptionalFile = None
    depth_scale: OptionalFloat = None
    cloud_scale: OptionalFloat = None
    camera_pose: OptionalFile = None
    table_height: OptionalFloat = None
    max_depth: OptionalFloat = None


SourceOptions = Annotated[PoseSource, tyro.conf.arg(name="")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """One observation: a frame, with the object's mask when it is known; or points on the object alone."""

    name: str
    frame: Frame | None = None
    mask: np.ndarray | None = None
    points_C: np.ndarray | None = None
    units_per_metre: float | None = None  # of the depth image; None when the data set says it

    @property
    def is_one_object(self) -> bool:
        """Whether the observation shows one object and nothing else."""
        return self.frame is None or self.mask is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pending:
    """An observation still to be read, so that a long folder needs no more memory than one frame."""

    name: str
    read: Callable[[], Seen]


def list_sources(given: PoseSource) -> list[Pending]:
    """The observations that the options name, in order; files of single ones are read at once by `Pending.read`.

    Raises:
        InputError: none or several are named, or options that belong to another kind.
    """
    check_source(given)
    if given.cloud is not None:
        return [Pending(name=given.cloud.stem, read=lambda: _read_cloud(given))]
    if given.depth is not None:
        return [Pending(name=given.depth.stem, read=lambda: _read_depth(given))]
    return _folder_sources(given)


def check_source(given: PoseSource) -> None:
    """Refuse options that contradict each other.

    Raises:
        InputError: says which, and what to give.
    """
    kinds = {"--depth": given.depth, "--cloud": given.cloud, "--frames": given.frames}
    named = [option for option, value in kinds.items() if value is not None]
    if len(named) != 1:
        got = " and ".join(named) or "none"
        raise InputError(
            f"give the observation with either --cloud FILE, --depth FILE or --frames FOLDER, one of them; got {got}."
        )
    camera = ("fx", "fy", "cx", "cy", "camera", "depth_scale", "max_depth", "table_height")
    of_depth = ("colour", "mask", "camera_pose")
    refused = {"--cloud": (*of_depth, *camera), "--depth": ("cloud_scale",), "--frames": (*of_depth, "cloud_scale")}
    wrong = next((name for name in refused[named[0]] if getattr(given, name) is not None), None)
    if wrong is not None:
        goes = {"cloud_scale": "--cloud", **dict.fromkeys(of_depth, "--depth")}.get(wrong, "--depth or --frames")
        own = " Frames of a folder bring their own." if named[0] == "--frames" and wrong != "cloud_scale" else ""
        raise InputError(f"{_option(wrong)} goes with {goes}, not with {named[0]}.{own}")
    numbers = [name for name in ("fx", "fy", "cx", "cy") if getattr(given, name) is not None]
    if numbers and given.camera is not None:
        raise InputError(f"--camera and {_option(numbers[0])} both give the camera; give one of them.")
    if numbers and given.fx is None:
        raise InputError(f"{_option(numbers[0])} was given without --fx; give the focal length in pixels too.")
    if given.depth is not None and given.table_height is not None and given.camera_pose is None:
        raise InputError(
            "--table-height is a height in the world; it needs the camera's pose in it: --camera-pose FILE."
        )
    if given.max_depth is not None and not given.max_depth > 0:
        raise InputError(f"--max-depth is {given.max_depth}; expected metres, above 0.")


def known_table(given: PoseSource, frame: Frame) -> Plane | None:
    """The table at the given height, in the camera frame; None when it must be looked for.

    Raises:
        InputError: the height is given but the frame has no camera pose.
    """
    from neuralgrasps.geometry.plane import horizontal_plane

    if given.table_height is None:
        return None
    if frame.X_WC is None:
        raise InputError(
            f"--table-height is a height in the world, but frame '{frame.name}' has no camera pose; expected a file "
            "such as NAME-pose.txt with X_WC (4 x 4) beside its images."
        )
    return horizontal_plane(given.table_height, frame.X_WC)


def check_extent(models: list[ObjectModel], points_C: np.ndarray, given: PoseSource) -> None:
    """Refuse points that cannot all lie on one of the objects, before searching in vain.

    Args:
        given: says whether the points are a cloud or pixels under a mask, hence what may be wrong.
    Raises:
        InputError: the points span too much or too little, or lie on a line.
    """
    import numpy as np

    low, high = np.percentile(points_C, [5, 95], axis=0)
    spread = float(np.linalg.norm(high - low))
    sizes = [float(np.linalg.norm(obj.mesh.extents)) for obj in models]
    if not (_LEAST_SPREAD * min(sizes) < spread < _LARGEST_SPREAD * max(sizes)):
        largest = models[int(np.argmax(sizes))]
        raise InputError(
            f"the points span {spread:.3g} m but '{largest.name}' measures {max(sizes):.3g} m across; "
            + (
                "give only the object's points (--mask), or the right unit (--depth-scale)."
                if given.cloud is None
                else _cloud_advice(spread, sizes, given.cloud_scale or 1.0)
            )
        )
    widths = np.sqrt(np.linalg.eigvalsh(np.cov(points_C.T)))
    if widths[1] < _LINE_SHARE * widths[2]:
        raise InputError(
            f"the points lie on a line, {1e3 * widths[1]:.2g} mm wide and {1e3 * widths[2]:.3g} mm long (standard "
            "deviations); expected points all over the visible surface."
        )


def _cloud_advice(spread: float, sizes: list[float], scale: float) -> str:
    """What is wrong with a cloud that spans so many metres."""
    if spread < _LEAST_SPREAD * min(sizes):
        return f"is the unit right? --cloud-scale is {scale:g} units per metre."
    if spread <= _SCENE_M:
        return "a cloud must hold one object; to find objects in a scene give --depth and the camera."
    unit, times = ("millimetres", 1000) if spread / 1000 > _LEAST_SPREAD * min(sizes) else ("centimetres", 100)
    return f"the cloud looks like {unit}: --cloud-scale {times * scale:g}."


def is_flat(points_C: np.ndarray) -> bool:
    """Whether the points lie on one plane: one face of a box is seen, or a piece of a table."""
    import numpy as np

    widths = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(points_C.T)), 0.0))
    return bool(widths[0] < _FLAT_SHARE * widths[2])


def _read_cloud(given: PoseSource) -> Seen:
    import numpy as np

    from neuralgrasps.perception.frame_files import read_cloud

    assert given.cloud is not None
    scale = 1.0 if given.cloud_scale is None else given.cloud_scale
    if not scale > 0:
        raise InputError(f"--cloud-scale is {scale}; expected units per metre, such as 1000 for millimetres.")
    points = read_cloud(given.cloud) / scale
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) < _LEAST_POINTS:
        lost = f" ({len(points) - len(finite)} others are NaN or infinite)" if len(finite) < len(points) else ""
        raise InputError(
            f"'{given.cloud}' holds {len(finite)} finite points{lost}; expected at least {_LEAST_POINTS} on the object."
        )
    if np.median(finite[:, 2]) <= 0:
        raise InputError(
            f"the points of '{given.cloud}' lie behind the camera (their median z is {np.median(finite[:, 2]):.3g} m); "
            "expected the camera frame with x right, y down, z forward. Where z points backwards, change the signs of "
            "y and z."
        )
    return Seen(name=given.cloud.stem, points_C=finite)


def _read_depth(given: PoseSource) -> Seen:
    from neuralgrasps.geometry.camera import back_project
    from neuralgrasps.perception.frame_files import read_frame, read_mask

    assert given.depth is not None
    frame = read_frame(
        given.depth,
        colour=given.colour,
        intrinsics=_camera(given),
        depth_scale=given.depth_scale,
        X_WC=given.camera_pose,
        name=given.depth.stem,
    )
    if given.mask is None:
        return Seen(name=frame.name, frame=frame, units_per_metre=_units(given.depth, frame))
    mask = read_mask(given.mask, frame.depth.shape)
    points = back_project(frame.depth, frame.intrinsics, mask=mask)
    if len(points) < _LEAST_POINTS:
        marked = "marks no pixel" if not mask.any() else f"marks {len(points)} measured pixels of {mask.sum()}"
        raise InputError(f"mask '{given.mask}' {marked}; expected at least {_LEAST_POINTS} on the object.")
    return Seen(name=frame.name, frame=frame, mask=mask, points_C=points, units_per_metre=_units(given.depth, frame))


def _folder_sources(given: PoseSource) -> list[Pending]:
    from neuralgrasps.perception.bop_scene import bop_images, is_bop_scene
    from neuralgrasps.perception.frame_files import list_frames

    folder = given.frames
    assert folder is not None
    if folder.is_dir() and is_bop_scene(folder):
        if given.camera is not None or given.fx is not None or given.depth_scale is not None:
            raise InputError(
                f"'{folder}' is a BOP scene, whose scene_camera.json gives camera and scale; leave them out."
            )
        return [Pending(name=f"{i:06d}", read=partial(_read_bop_frame, folder, i)) for i in bop_images(folder)]
    return [Pending(name=files.name, read=partial(_read_files, files, given)) for files in list_frames(folder)]


def _read_bop_frame(folder: Path, image: int) -> Seen:
    from neuralgrasps.perception.bop_scene import read_bop_scene

    return Seen(name=f"{image:06d}", frame=read_bop_scene(folder, images=[image])[0].frame)


def _read_files(files: FrameFiles, given: PoseSource) -> Seen:
    from neuralgrasps.perception.frame_files import read_frame

    frame = read_frame(
        files.depth,
        colour=files.colour,
        intrinsics=_camera(given),
        depth_scale=given.depth_scale,
        X_WC=files.pose,
        name=files.name,
    )
    return Seen(name=files.name, frame=frame, units_per_metre=_units(files.depth, frame))


def _units(file: Path, frame: Frame) -> float:
    """Units per metre that a depth image was read with, whether given, of the camera's file or the default."""
    from neuralgrasps.perception.frame_files import read_depth

    return float(f"{read_depth(file, 1.0).max() / frame.depth.max():.6g}")


def _camera(given: PoseSource) -> CameraNumbers | Path | None:
    """The camera as far as it is given; None to look for a file beside the images."""
    from neuralgrasps.perception.camera_file import CameraNumbers

    if given.fx is None:
        return given.camera
    return CameraNumbers(fx=given.fx, fy=given.fy, cx=given.cx, cy=given.cy)


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
