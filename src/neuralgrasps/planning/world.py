"""What is around a robot, for planning; everything in the robot base frame B."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.objects.object_model import ObjectModel

_RIGID = 1e-6
_LARGEST_M = 50.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoxObstacle:
    """A solid box. X_BX: (4, 4) its centre frame in B; half: (3,) half extents, metres; name: for messages."""

    name: str
    X_BX: np.ndarray
    half: np.ndarray

    def __post_init__(self) -> None:
        X, half = np.asarray(self.X_BX, float), np.asarray(self.half, float)
        check_shape(f"X_BX of box '{self.name}'", X.shape, (4, 4))
        check_shape(f"half of box '{self.name}'", half.shape, (3,))
        if not (np.isfinite(X).all() and np.abs(X[:3, :3].T @ X[:3, :3] - np.eye(3)).max() < _RIGID):
            raise InputError(f"box '{self.name}': X_BX is not a rigid motion; expected a rotation and metres.")
        if not ((half > 0.0) & (half < _LARGEST_M)).all():
            raise InputError(
                f"box '{self.name}': half extents are {half.tolist()}; expected metres, above 0 and below "
                f"{_LARGEST_M:g}. Were millimetres meant?"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedObject:
    """An object of known shape at X_BO (4, 4)."""

    obj: ObjectModel
    X_BO: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanningWorld:
    """Obstacles of one scene.

    Attributes:
        boxes: the table top and whatever else is a box.
        target: the object to be grasped: an obstacle until the hand closes, carried afterwards.
        objects: other objects of known shape and pose.
        cloud_B: (M, 3) observed points of things nobody knows, metres; without points of the robot, of the table, and
            of the objects above.
    """

    boxes: tuple[BoxObstacle, ...] = ()
    target: PlacedObject | None = None
    objects: tuple[PlacedObject, ...] = ()
    cloud_B: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        check_shape("cloud_B", np.shape(self.cloud_B), (None, 3))
        if not np.isfinite(self.cloud_B).all():
            raise InputError("cloud_B holds numbers that are not finite; drop those points.")


def box_distance(box: BoxObstacle, points_B: np.ndarray) -> np.ndarray:
    """Signed distance (...) of points (..., 3) to a box."""
    outside = np.abs((points_B - box.X_BX[:3, 3]) @ box.X_BX[:3, :3]) - box.half
    return np.asarray(np.linalg.norm(np.maximum(outside, 0.0), axis=-1) + np.minimum(outside.max(axis=-1), 0.0))


def box_top(box: BoxObstacle) -> Plane:
    """The upper face of a box, in B, its normal along the box's z."""
    up = np.asarray(box.X_BX[:3, 2], float)
    return Plane(up / np.linalg.norm(up), -float(up @ box.X_BX[:3, 3] + box.half[2]))


def table_box(
    height_m: float, *, centre: tuple[float, float], size: tuple[float, float], thickness_m: float = 0.04
) -> BoxObstacle:
    """A level table top: its upper face at `height_m` above B, middle and size along x and y in metres."""
    X = np.eye(4)
    X[:3, 3] = [*centre, height_m - thickness_m / 2]
    return BoxObstacle(name="table", X_BX=X, half=np.array([size[0] / 2, size[1] / 2, thickness_m / 2]))
