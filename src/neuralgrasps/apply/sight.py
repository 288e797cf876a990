"""What a robot makes of one look at its table: the table, the object to pick, and what else is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.meshes import posed_meshes
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.find import find_objects
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.pose import PoseResult, estimate_pose
from neuralgrasps.perception.table import TableFit, find_table
from neuralgrasps.planning.world import BoxObstacle, PlacedObject

_ROBOT_M = 0.02  # pixels whose depth is so near to that of the robot's own surface are the robot
_ROBOT_RIM = 2  # pixels around it
_BEYOND_M, _TOWARDS_M = 0.30, 0.03  # how far a table is taken to go on beyond what is seen of it, and to the robot
_LEAST_PIXELS = 200  # of something that may be the object asked for
_LEAST_CONFIDENCE = 0.5  # of the pose of an object that stands alone; less, and nothing is planned
_CLUSTERS = 3  # clusters that may be the one object asked for
_THICKNESS_M = 0.04
_CLEAR_OF_TABLE_M = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableView:
    """One look at a table.

    Attributes:
        frame: what was seen, without the robot itself; `X_WC` is the camera in B.
        fit: the table in the camera frame. plane_B: its top in B, normal up. box: it as an obstacle.
        clusters: masks (h, w) of what stands on it, largest first.
    """

    frame: Frame
    fit: TableFit
    plane_B: Plane
    box: BoxObstacle
    clusters: tuple[np.ndarray, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """Where the object to pick is, and what else stands there.

    Attributes:
        X_BO: (4, 4) the object in B, or None; reason: why it is not known.
        pose: the estimate behind it. mask: (h, w) its pixels.
        others: other objects that were recognised. unknown_B: (M, 3) points of what was not.
    """

    X_BO: np.ndarray | None
    reason: str
    pose: PoseResult | None = None
    mask: np.ndarray | None = None
    others: tuple[PlacedObject, ...] = ()
    unknown_B: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


def view_table(frame: Frame, manipulator: Manipulator, q: np.ndarray, *, seed: int = 0) -> TableView:
    """Find the table and what stands on it.

    Args:
        frame: with the camera's pose in B. q: (Q,) all joints of the robot at that moment.
    Raises:
        InputError: no table is seen; the frame has no camera pose.
    """
    if frame.X_WC is None:
        raise InputError(f"frame '{frame.name}' has no camera pose; give X_WC, the camera in the robot base frame.")
    frame = without_robot(frame, manipulator, q)
    fit = find_table(frame, seed=seed)
    assert frame.X_WC is not None
    plane_B = fit.plane.moved(frame.X_WC)
    clusters = tuple(find_clusters(frame, fit.plane, extent=fit.extent))
    return TableView(frame=frame, fit=fit, plane_B=plane_B, box=_table_obstacle(frame, fit), clusters=clusters)


def without_robot(frame: Frame, manipulator: Manipulator, q: np.ndarray) -> Frame:
    """The frame without the pixels that show the robot itself."""
    assert frame.X_WC is not None
    meshes, X_BL = posed_meshes(manipulator, q, segments=16)
    own = rasterise(list(meshes), inverse_np(frame.X_WC) @ X_BL, frame.intrinsics).depth
    robot = np.isfinite(own) & (frame.depth > own - _ROBOT_M) & (frame.depth < own + _ROBOT_M)
    if not robot.any():
        return frame
    grown = ndimage.binary_dilation(robot, iterations=_ROBOT_RIM)
    return replace(frame, depth=np.where(grown, 0.0, frame.depth))


def _table_obstacle(frame: Frame, fit: TableFit) -> BoxObstacle:
    """The table as a box, level as it was seen, somewhat larger than what was seen of it."""
    assert frame.X_WC is not None
    seen_B = transform_points_np(frame.X_WC, frame.points[fit.mask])
    low, high = np.percentile(seen_B[:, :2], [0.5, 99.5], axis=0)
    low, high = low - [_TOWARDS_M, _BEYOND_M], high + _BEYOND_M
    plane = fit.plane.moved(frame.X_WC)
    middle = (low + high) / 2
    height = -(plane.offset_m + plane.normal[:2] @ middle) / plane.normal[2]
    X = np.eye(4)
    z = plane.normal
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    X[:3, 0] = x / np.linalg.norm(x)
    X[:3, 1], X[:3, 2] = np.cross(z, X[:3, 0]), z
    X[:3, 3] = np.array([*middle, height]) - 0.5 * _THICKNESS_M * z
    return BoxObstacle(name="table", X_BX=X, half=np.array([*((high - low) / 2), _THICKNESS_M / 2]))


def locate(view: TableView, obj: ObjectModel, *, others: Sequence[ObjectModel] = (), seed: int = 0) -> Sighting:
    """Find `obj` among what stands on the table.

    Alone (no `others`), it is the cluster that it explains best; among others, every cluster is identified, and when
    none gets its name, it is what it explains best of what the others leave, if the pose found there is trusted.

    Args:
        others: further objects that may be there.
    """
    if not view.clusters:
        return Sighting(X_BO=None, reason="nothing stands on the table.")
    if others:
        return _among_others(view, obj, others, seed)
    X_BC = view.frame.X_WC
    assert X_BC is not None
    best: tuple[PoseResult, np.ndarray] | None = None
    for mask in view.clusters[:_CLUSTERS]:
        if (mask & (view.frame.depth > 0)).sum() < 20:
            continue
        pose = estimate_pose(
            obj, depth=view.frame.depth, intrinsics=view.frame.intrinsics, mask=mask, table=view.fit.plane, seed=seed
        )
        if best is None or pose.confidence > best[0].confidence:
            best = pose, mask
    if best is None:
        return Sighting(X_BO=None, reason="what stands on the table is seen by too few pixels.")
    pose, mask = best
    if pose.confidence < _LEAST_CONFIDENCE:
        reason = f"what stands there does not look like '{obj.name}': the confidence is {pose.confidence:.2f}."
        return Sighting(X_BO=None, reason=reason, pose=pose, mask=mask)
    X_BO = X_BC @ pose.X_CO
    rest = [m for m in view.clusters if m is not mask]
    return Sighting(X_BO=X_BO, reason="", pose=pose, mask=mask, unknown_B=_points_B(view, rest))


def _among_others(view: TableView, obj: ObjectModel, others: Sequence[ObjectModel], seed: int) -> Sighting:
    X_BC = view.frame.X_WC
    assert X_BC is not None
    library = {o.name: o for o in (obj, *others)}
    found = find_objects(list(library.values()), view.frame, table=view.fit.plane, masks=list(view.clusters), seed=seed)
    mine = max((f for f in found if f.name == obj.name), key=lambda f: f.probability, default=None)
    placed = tuple(PlacedObject(obj=library[f.name], X_BO=X_BC @ f.pose.X_CO) for f in found if f is not mine)
    explained = np.zeros(view.frame.depth.shape, bool)
    for f in found:
        explained |= f.mask
    unknown_B = _points_B(view, [m & ~explained for m in view.clusters])
    pose, mask = (mine.pose, mine.mask) if mine is not None else _unnamed(view, obj, explained, seed)
    if pose is None:
        seen = ", ".join(sorted({f.name for f in found})) or "nothing that is known"
        reason = f"'{obj.name}' was not found on the table; seen: {seen}."
        return Sighting(X_BO=None, reason=reason, others=placed, unknown_B=unknown_B)
    return Sighting(X_BO=X_BC @ pose.X_CO, reason="", pose=pose, mask=mask, others=placed, unknown_B=unknown_B)


def _unnamed(
    view: TableView, obj: ObjectModel, explained: np.ndarray, seed: int
) -> tuple[PoseResult | None, np.ndarray | None]:
    """An object that is known to be there, among what nothing else explains: its pose and mask, or None twice."""
    best: tuple[PoseResult | None, np.ndarray | None] = None, None
    for cluster in view.clusters:
        mask = cluster & ~explained & (view.frame.depth > 0)
        if mask.sum() < _LEAST_PIXELS:
            continue
        pose = estimate_pose(
            obj, depth=view.frame.depth, intrinsics=view.frame.intrinsics, mask=mask, table=view.fit.plane, seed=seed
        )
        if pose.converged and (best[0] is None or pose.confidence > best[0].confidence):
            best = pose, mask
    return best


def _points_B(view: TableView, masks: Sequence[np.ndarray]) -> np.ndarray:
    assert view.frame.X_WC is not None
    union = np.zeros(view.frame.depth.shape, bool)
    for mask in masks:
        union |= mask
    points_B = transform_points_np(view.frame.X_WC, view.frame.points[union & (view.frame.depth > 0)])
    return np.asarray(points_B[view.plane_B.height(points_B) > _CLEAR_OF_TABLE_M])
