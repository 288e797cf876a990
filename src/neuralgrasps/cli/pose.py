"""`neuralgrasps pose`: where a known object is, from points or a depth image."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.models import warn_of_damage
from neuralgrasps.cli.options import NamePath, OptionalFile, OptionalFloat, Unit, check_seed
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.geometry.camera import Intrinsics
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.perception.pose import PoseResult

# Spread of the points over the object's diagonal: less is a speck that fits anywhere, more cannot lie on it.
_LEAST_SPREAD, _LARGEST_SPREAD = 0.08, 1.6


def pose(
    terminal: Terminal,
    object_name: NamePath,
    /,
    *,
    cloud: OptionalFile = None,
    depth: OptionalFile = None,
    mask: OptionalFile = None,
    fx: OptionalFloat = None,
    fy: OptionalFloat = None,
    cx: OptionalFloat = None,
    cy: OptionalFloat = None,
    depth_scale: OptionalFloat = None,
    cloud_scale: float = 1.0,
    unit: Unit = "auto",
    out: OptionalFile = None,
    seed: int = 0,
) -> Outcome:
    """Find the pose of an object in a cloud of its visible points, or in a depth image.

    Prints X_CO, the object in the camera frame (x right, y down, z forward, metres). Exit code 1 when the points do
    not fit the object.

    Args:
        object_name: name of the object, or a mesh file.
        cloud: points on the object in the camera frame: .ply, .npy or x y z text.
        depth: depth image, 16-bit PNG or NPY; give the camera with fx, fy, cx, cy.
        mask: image of the depth's size, not 0 where the object is.
        fx: focal length, pixels.
        fy: focal length, pixels; default fx.
        cx: principal point, pixels; default the middle.
        cy: principal point, pixels; default the middle.
        depth_scale: units of the depth image per metre; default 1000 for whole numbers, 1 for floating ones.
        cloud_scale: units of the cloud per metre.
        unit: length unit of a mesh file.
        out: PNG file, the pose drawn over the depth image.
        seed: of the point subsampling.
    """
    from neuralgrasps.objects.zoo import load_object
    from neuralgrasps.perception.pose import estimate_pose

    check_seed(seed)
    if (cloud is None) == (depth is None):
        raise InputError("give the observation with either --cloud FILE or --depth FILE.")
    if out is not None:
        check_writable(out)
        if depth is None:
            raise InputError("--out draws over a depth image; give --depth FILE instead of --cloud.")
    image, camera = None, None
    if depth is not None:
        image, camera, points = _depth_points(depth, mask, depth_scale, (fx, fy, cx, cy))
    else:
        assert cloud is not None
        points = _cloud_points(cloud, cloud_scale)
    with terminal.progress("reading the object"):
        obj = load_object(object_name, unit=unit)
    warn_of_damage(terminal, [obj])
    _check_extent(obj, points)
    start = time.perf_counter()
    with terminal.progress("searching"):
        found = estimate_pose(obj, points, depth=image, intrinsics=camera, seed=seed)
    record = pose_record(obj, found, points=len(points), wall_s=time.perf_counter() - start)
    _show(terminal, record)
    if out is not None and image is not None and camera is not None:
        from neuralgrasps.report.figures import render_pose_overlay, save_picture

        make_parent(out)
        save_picture(out, render_pose_overlay(image, obj, found.X_CO, camera))
        terminal.say(f"Picture: {out}")
        record["picture"] = str(out)
    return Outcome(result=record, exit_code=0 if found.converged else 1)


def _depth_points(
    path: Path, mask_path: Path | None, scale: float | None, camera: tuple[float | None, ...]
) -> tuple[np.ndarray, Intrinsics, np.ndarray]:
    """Depth image in metres, its camera, and the points of the mask."""
    from neuralgrasps.cli.scan_files import read_depth, read_mask
    from neuralgrasps.geometry.camera import Intrinsics, back_project

    image = read_depth(path, scale)
    height, width = image.shape
    fx, fy, cx, cy = camera
    if fx is None:
        raise InputError(
            "--depth needs the camera's focal length: --fx PIXELS, and --fy, --cx, --cy where they differ."
        )
    intrinsics = Intrinsics(
        fx,
        fx if fy is None else fy,
        0.5 * (width - 1) if cx is None else cx,
        0.5 * (height - 1) if cy is None else cy,
        width,
        height,
    )
    mask = None if mask_path is None else read_mask(mask_path, image.shape)
    points = back_project(image, intrinsics, mask=mask)
    if len(points) < 20:
        where = "inside the mask" if mask is not None else "in the image"
        raise InputError(f"'{path}' has {len(points)} measured pixels {where}; expected at least 20 on the object.")
    return image, intrinsics, points


def _cloud_points(path: Path, scale: float) -> np.ndarray:
    import numpy as np

    from neuralgrasps.cli.scan_files import read_cloud

    if not scale > 0:
        raise InputError(f"--cloud-scale is {scale}; expected units per metre, such as 1000 for millimetres.")
    points = read_cloud(path) / scale
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 20:
        raise InputError(f"'{path}' holds {len(points)} finite points; expected at least 20 on the object.")
    return points


def _check_extent(obj: ObjectModel, points: np.ndarray) -> None:
    """Refuse points that cannot all lie on the object, before searching in vain."""
    import numpy as np

    spread = float(np.linalg.norm(np.percentile(points, 95, axis=0) - np.percentile(points, 5, axis=0)))
    size = float(np.linalg.norm(obj.mesh.extents))
    if not _LEAST_SPREAD < spread / size < _LARGEST_SPREAD:
        raise InputError(
            f"the points span {spread:.3g} m but '{obj.name}' measures {size:.3g} m across; give only the object's "
            "points (--mask), or the right unit (--depth-scale, --cloud-scale)."
        )


def pose_record(obj: ObjectModel, found: PoseResult, *, points: int, wall_s: float) -> dict[str, Any]:
    """A pose as JSON: matrix in metres, quaternion w x y z."""
    import torch

    from neuralgrasps.geometry.rotation import quaternion_from_matrix

    quaternion = quaternion_from_matrix(torch.as_tensor(found.X_CO[:3, :3])).numpy()
    return {
        "object": obj.name,
        "converged": found.converged,
        "X_CO_m": found.X_CO,
        "position_m": found.X_CO[:3, 3],
        "quaternion_wxyz": quaternion,
        "score_mm": found.score_m * 1e3,
        "residual_median_mm": found.residual * 1e3,
        "points": points,
        "wall_s": wall_s,
        "seed": found.seed,
        "symmetry_rotations": len(obj.symmetry.rotations),
    }


def _show(terminal: Terminal, record: dict[str, Any]) -> None:
    terminal.say(f"{record['object']}: {'found' if record['converged'] else 'NOT found: the points do not fit it'}")
    position = ", ".join(f"{v:+.4f}" for v in record["position_m"])
    quaternion = ", ".join(f"{v:+.4f}" for v in record["quaternion_wxyz"])
    terminal.facts(
        [
            ("position", f"{position} m"),
            ("quaternion", f"{quaternion} (w x y z)"),
            ("points", f"{record['points']}, median {record['residual_median_mm']:.2f} mm off the surface"),
            ("time", f"{record['wall_s']:.2f} s"),
        ]
    )
    terminal.say("X_CO =")
    for row in record["X_CO_m"]:
        terminal.say("  " + " ".join(f"{v:+9.5f}" for v in row))
