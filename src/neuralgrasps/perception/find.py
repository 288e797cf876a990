"""All objects of a library in one frame: table, clusters, and which object each is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.identify import Identification, checked_names, identify_object
from neuralgrasps.perception.pose import PoseConfig, PoseResult
from neuralgrasps.perception.table import find_table

_OWN_M = 0.008  # pixels so near to a found object are its own
_SURE_PART = 0.8  # a part of a thing that nobody knows may look like an object
_PART_SHARE, _PARTS_TRIED = 0.3, 2  # a cluster of several objects is tried by the parts that poses explain
_REST_SHARE = 0.15  # what is left of a cluster is looked at again when it is at least so much of it


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundObject:
    """An object in a frame.

    Attributes:
        name: of the object. probability: that it is this object and not another or none.
        pose: where it is. mask: (h, w) bool, its pixels. centre_C: (3,) of the object, camera frame, metres.
    """

    name: str
    probability: float
    pose: PoseResult
    mask: np.ndarray
    centre_C: np.ndarray


def find_objects(
    objects: Sequence[ObjectModel],
    frame: Frame,
    *,
    table: Plane | None = None,
    masks: Sequence[np.ndarray] | None = None,
    min_pixels: int = 400,
    config: PoseConfig | None = None,
    seed: int = 0,
) -> list[FoundObject]:
    """Find which objects of a library stand on the table of a frame, and where.

    Every cluster of pixels above the table is identified; what an accepted object leaves of a cluster is looked at
    again, since objects that touch form one cluster.

    Args:
        objects: the library. table: plane in the camera frame; found in the frame when None.
        masks: clusters to look at, (h, w) bool each; found above the table when None.
        min_pixels: smaller clusters, and smaller rests of them, are left out.
    Returns:
        Found objects, largest mask first; empty when nothing of the library is there.
    Raises:
        InputError: no table can be found, or as `identify_object`.
    """
    if not isinstance(frame, Frame):
        raise InputError(f"the frame is {type(frame).__name__}; expected a Frame: read_frame(...) or Frame(depth=...).")
    checked_names(objects)
    for mask in masks or ():
        if np.shape(mask) != frame.depth.shape:
            raise InputError(f"a mask has shape {np.shape(mask)}; the frame's images are {frame.depth.shape}.")
    if table is None:
        table = find_table(frame, seed=seed).plane
    open_masks = [np.asarray(m, bool) for m in (find_clusters(frame, table) if masks is None else masks)]
    points_C = frame.points
    found: list[FoundObject] = []
    while open_masks:
        mask = open_masks.pop(0) & (frame.depth > 0)
        if mask.sum() < min_pixels:
            continue
        view: dict[str, Any] = {
            "depth": frame.depth,
            "intrinsics": frame.intrinsics,
            "table": table,
            "config": config,
            "seed": seed,
        }
        seen = identify_object(objects, mask=mask, **view)
        if seen.name is None:
            seen = _of_a_part(objects, seen, points_C, mask, min_pixels, view)
        if seen.name is None:
            continue
        obj, pose = next(o for o in objects if o.name == seen.name), seen.poses[seen.name]
        if any(_is_taken(obj, pose.X_CO, other) for other in found):
            continue
        own = mask & _near(obj, pose.X_CO, points_C, mask)
        centre_C = _centre(obj, pose.X_CO)
        found.append(
            FoundObject(name=seen.name, probability=seen.probability[seen.name], pose=pose, mask=own, centre_C=centre_C)
        )
        rest = ndimage.binary_opening(mask & ~own, np.ones((3, 3)))
        labels, count = ndimage.label(rest, structure=np.ones((3, 3)))
        for k in range(1, count + 1):
            part = labels == k
            if part.sum() > max(min_pixels, _REST_SHARE * mask.sum()):
                open_masks.append(part)
    return sorted(found, key=lambda f: -int(f.mask.sum()))


def _of_a_part(
    objects: Sequence[ObjectModel],
    seen: Identification,
    points_C: np.ndarray,
    mask: np.ndarray,
    min_pixels: int,
    view: dict[str, Any],
) -> Identification:
    """What the larger part of a cluster is, when the whole is nothing: the part that the best fitting pose explains."""
    fitting = sorted(objects, key=lambda obj: -seen.poses[obj.name].explained)[:_PARTS_TRIED]
    for obj in fitting:
        own = mask & _near(obj, seen.poses[obj.name].X_CO, points_C, mask)
        if max(min_pixels, _PART_SHARE * mask.sum()) <= own.sum() < 0.95 * mask.sum():
            part = identify_object(objects, mask=own, **view)
            if part.name is not None and part.probability[part.name] > _SURE_PART:
                return part
    return seen


def _is_taken(obj: ObjectModel, X_CO: np.ndarray, other: FoundObject) -> bool:
    """Whether most of an object would lie where another one was found: a piece of that one, taken for a second."""
    return float(np.linalg.norm(_centre(obj, X_CO) - other.centre_C)) < 0.25 * float(np.linalg.norm(obj.mesh.extents))


def _centre(obj: ObjectModel, X_CO: np.ndarray) -> np.ndarray:
    return np.asarray(X_CO[:3, :3] @ obj.symmetry.centre + X_CO[:3, 3])


def _near(obj: ObjectModel, X_CO: np.ndarray, points_C: np.ndarray, mask: np.ndarray) -> np.ndarray:
    out = np.zeros(mask.shape, bool)
    points = (points_C[mask] - X_CO[:3, 3]) @ X_CO[:3, :3]
    out[mask] = np.abs(query_grid_numpy(obj.sdf, points)) < _OWN_M
    return out
