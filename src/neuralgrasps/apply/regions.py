"""Regions of an object: a side, a box, a ball or what lies near given points; and the surface that lies in one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.apply.region_kernels import TriangleGroups, group_triangles
from neuralgrasps.errors import InputError, check_shape, unknown_name
from neuralgrasps.objects.object_model import ObjectModel

OUTER_THIRD = 1.0 / 3.0
POINTS_REACH_M = 0.005  # of a region given by points: how far from them it goes
AXES = {
    f"{sign}{name}": value * np.eye(3)[k] for k, name in enumerate("xyz") for sign, value in (("+", 1.0), ("-", -1.0))
}
SIDES = (*AXES, "top", "bottom", "side")
_EDGE_M = 5e-4  # the rim of a region is kept to so much
_ROUNDING_M = 1e-9
_PIECE_M = 4e-3  # triangles are cut to about this size, so that few are near a hand
_GROUP_M = 0.012


@dataclass(frozen=True, slots=True)
class Side:
    """The outermost share of an object along an axis, measured on its bounding box.

    Attributes:
        name: +x -x +y -y +z -z, top, bottom (along what is up), or side: neither the top nor the bottom share.
        share: of the extent, above 0 and at most 1.
    """

    name: str
    share: float = OUTER_THIRD

    def __post_init__(self) -> None:
        if self.name not in SIDES:
            raise unknown_name("side", self.name, SIDES)
        if not 0 < self.share <= 1:
            raise InputError(f"side '{self.name}': its share is {self.share:g}; expected above 0 and at most 1.")

    def depth(self, points_O: np.ndarray, obj: ObjectModel, up_O: np.ndarray) -> np.ndarray:
        """Signed distance of points (M, 3) to the region's volume, metres, negative inside; or a bound nearer to 0."""
        if self.name == "side":
            both = [Side(name, self.share).depth(points_O, obj, up_O) for name in ("top", "bottom")]
            return np.maximum(-both[0], -both[1])
        axis = AXES.get(self.name, up_O if self.name == "top" else -up_O)
        reach = obj.mesh.vertices @ axis
        return reach.max() - self.share * np.ptp(reach) - points_O @ axis

    def __str__(self) -> str:
        return self.name if self.share == OUTER_THIRD else f"{self.name}:{self.share:g}"


@dataclass(frozen=True, slots=True)
class Box:
    """A box with edges along the object's axes: `low`, `high` (3,), metres, object frame."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not np.isfinite([self.low, self.high]).all():
            raise InputError(f"region '{self}' holds numbers that are not finite; expected metres.")
        for name, a, b in zip("xyz", self.low, self.high, strict=True):
            if a >= b:
                raise InputError(
                    f"region '{self}' is empty: {name} goes from {a:g} to {b:g}; expected x0,y0,z0,x1,y1,z1 with "
                    "x0 < x1, y0 < y1, z0 < z1, metres."
                )

    def depth(self, points_O: np.ndarray, obj: ObjectModel, up_O: np.ndarray) -> np.ndarray:
        """As for `Side`."""
        low, high = np.array(self.low), np.array(self.high)
        beyond = np.abs(points_O - (low + high) / 2) - (high - low) / 2
        return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)

    def __str__(self) -> str:
        return "box:" + ",".join(f"{v:g}" for v in (*self.low, *self.high))


@dataclass(frozen=True, slots=True)
class Ball:
    """A ball: `centre` (3,) and `radius_m`, object frame."""

    centre: tuple[float, float, float]
    radius_m: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.centre).all() and np.isfinite(self.radius_m)):
            raise InputError(f"region '{self}' holds numbers that are not finite; expected metres.")
        if self.radius_m <= 0:
            raise InputError(f"region '{self}' is empty: its radius is {self.radius_m:g}; expected above 0, metres.")

    def depth(self, points_O: np.ndarray, obj: ObjectModel, up_O: np.ndarray) -> np.ndarray:
        """As for `Side`."""
        return np.linalg.norm(points_O - np.array(self.centre), axis=1) - self.radius_m

    def __str__(self) -> str:
        return "sphere:" + ",".join(f"{v:g}" for v in (*self.centre, self.radius_m))


class Points:
    """What lies within `reach_m` of given points (M, 3), metres, object frame, such as a painted patch."""

    def __init__(self, points_O: np.ndarray, *, reach_m: float = POINTS_REACH_M, name: str = "points") -> None:
        """`name`: how the region is called in messages.

        Raises:
            InputError: no finite points, or a reach that is not above 0. ShapeError: not (M, 3).
        """
        check_shape("points_O", np.shape(points_O), (None, 3))
        points = np.asarray(points_O, np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            raise InputError(f"region '{name}' is empty: it holds no finite point; expected x y z in metres.")
        if not 0 < reach_m < np.inf:
            raise InputError(f"region '{name}': its reach is {reach_m}; expected above 0, metres.")
        self.points_O, self.reach_m, self.name = points, reach_m, name
        self._tree = KDTree(points)

    def depth(self, points_O: np.ndarray, obj: ObjectModel, up_O: np.ndarray) -> np.ndarray:
        """As for `Side`."""
        return self._tree.query(points_O)[0] - self.reach_m

    def __str__(self) -> str:
        return self.name


Region = Side | Box | Ball | Points


@dataclass(frozen=True, kw_only=True, eq=False)
class SplitSurface:
    """An object's surface, cut into what lies in a region and what does not.

    Attributes:
        inside, outside: (T, 3, 3) corners of triangles, metres, object frame; the rim between them is kept to 0.5 mm.
        name: of the region.
    """

    inside: np.ndarray
    outside: np.ndarray
    name: str

    @cached_property
    def inside_groups(self) -> TriangleGroups:
        return group_triangles(self.inside, size=_GROUP_M)

    @cached_property
    def outside_groups(self) -> TriangleGroups:
        return group_triangles(self.outside, size=_GROUP_M)

    @property
    def share(self) -> float:
        """Of the surface's area that lies in the region."""
        inside, outside = _area(self.inside), _area(self.outside)
        return inside / (inside + outside)


def split_surface(obj: ObjectModel, regions: Sequence[Region], *, up_O: np.ndarray = AXES["+z"]) -> SplitSurface:
    """What of an object's surface lies in any of the regions.

    Args:
        regions: at least one. up_O: (3,) unit, what is up in the object's frame, for the sides top and bottom.
    Raises:
        InputError: no region, or one in which none of the surface lies.
    """
    if not regions:
        raise InputError("no region is given; expected at least one.")
    for region in regions:
        if not (region.depth(_even_points(obj), obj, up_O) < 0).any() and not len(_split(obj, [region], up_O)[0]):
            low, high = (np.round(1e3 * v).astype(int).tolist() for v in obj.mesh.bounds)
            raise InputError(
                f"none of the surface of '{obj.name}' lies in the region '{region}'. Regions are in metres, in the "
                f"object's frame, where it goes from {low} to {high} mm."
            )
    inside, outside = _split(obj, regions, up_O)
    return SplitSurface(inside=inside, outside=outside, name=" or ".join(map(str, regions)))


def region_depths(
    points_O: np.ndarray, obj: ObjectModel, regions: Sequence[Region], *, up_O: np.ndarray = AXES["+z"]
) -> np.ndarray:
    """(M,) signed distance of points (M, 3) to the nearest region's volume, metres, negative inside."""
    return np.min([region.depth(points_O, obj, up_O) for region in regions], axis=0)


def _even_points(obj: ObjectModel) -> np.ndarray:
    return np.concatenate([obj.mesh.vertices, obj.points_O])


def _split(obj: ObjectModel, regions: Sequence[Region], up_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles inside and outside, cut until each is one or the other, or as small as the rim is kept to."""
    left = np.asarray(obj.mesh.vertices, np.float64)[obj.mesh.faces]
    found: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    while len(left):
        middle = left.mean(axis=1)
        reach = np.linalg.norm(left - middle[:, None], axis=2).max(axis=1)
        depth = region_depths(middle, obj, regions, up_O=up_O)
        done = (reach <= _PIECE_M) & ((np.abs(depth) >= reach) | (reach <= _EDGE_M))
        found[0].append(left[done & (depth <= _ROUNDING_M)])
        found[1].append(left[done & (depth > _ROUNDING_M)])
        left = _quartered(left[~done])
    return np.concatenate(found[0]), np.concatenate(found[1])


def _quartered(triangles: np.ndarray) -> np.ndarray:
    """Each triangle (T, 3, 3) cut at the middles of its edges: (4 T, 3, 3)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def _area(triangles: np.ndarray) -> float:
    edges = triangles[:, 1:] - triangles[:, :1]
    return float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2)
