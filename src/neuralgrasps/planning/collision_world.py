"""Obstacles as the arrays of collision checks: boxes, distance grids of objects, and what the hand carries."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_numpy
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.cloud_field import cloud_grid
from neuralgrasps.planning.collision_arrays import (
    ERROR,
    FRAME,
    GRID_COLUMNS,
    HIGH,
    INV_SPACING,
    LOW,
    MIDDLE,
    ORIGIN,
    RADIUS,
)
from neuralgrasps.planning.world import BoxObstacle

_MOST_NODES = 60_000  # of the grid of an object that is not the target
_CARRIED_POINTS = 512
_CORNERS = 64  # directions in which a carried object's farthest points are taken
_KEPT = 64  # objects


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectShape:
    """An object as an obstacle. grid: full or thinned; error_m: by which thinned values may be too large.

    low, high: (3,) box around it in O; points_O: (C, 3) of its surface, its outermost ones included.
    """

    grid: SdfGrid
    error_m: float
    low: np.ndarray
    high: np.ndarray
    points_O: np.ndarray


class _Shapes:
    """The last objects' thinned grids and points, by content."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, ObjectShape] = OrderedDict()

    def __call__(self, obj: ObjectModel) -> ObjectShape:
        if obj.content_hash not in self._known:
            self._known[obj.content_hash] = _thinned(obj)
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        self._known.move_to_end(obj.content_hash)
        return self._known[obj.content_hash]


object_shape = _Shapes()


def _thinned(obj: ObjectModel) -> ObjectShape:
    """Every n-th node of an object's grid; the error is measured at all nodes left out."""
    low, high = np.asarray(obj.mesh.bounds, float)
    grid, error = obj.sdf, 0.0
    stride = 1
    while np.prod(np.array(obj.sdf.values.shape) // stride + 1) > _MOST_NODES:
        stride += 1
    if stride > 1:
        # the last node along each side may fall off: outside the grid the box of the object gives the distance
        thin = SdfGrid(obj.sdf.values[::stride, ::stride, ::stride], obj.sdf.origin, obj.sdf.spacing * stride)
        inner = obj.sdf.values[tuple(slice(0, stride * (n - 1) + 1) for n in thin.values.shape)]
        at = np.stack(np.meshgrid(*(np.arange(n) for n in inner.shape), indexing="ij"), axis=-1)
        over = query_grid_numpy(thin, obj.sdf.origin + obj.sdf.spacing * at) - inner
        grid, error = thin, float(over.max())
    return ObjectShape(grid=grid, error_m=error, low=low, high=high, points_O=_surface(obj))


def _surface(obj: ObjectModel) -> np.ndarray:
    count = min(_CARRIED_POINTS, len(obj.points_O))
    even = obj.points_O[farthest_points(obj.points_O, count)]
    k = np.arange(_CORNERS) + 0.5  # directions on a Fibonacci spiral
    z, angle = 1 - 2 * k / _CORNERS, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z**2)
    directions = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    outermost = np.unique(np.argmax(obj.mesh.vertices @ directions.T, axis=0))
    return np.ascontiguousarray(np.concatenate([even, obj.mesh.vertices[outermost]]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A distance grid at X_BA (4, 4) and the box (3,), (3,) around what it holds; error_m: by which it may be wrong."""

    grid: SdfGrid
    error_m: float
    low: np.ndarray
    high: np.ndarray
    X_BA: np.ndarray


def whole_thing(obj: ObjectModel, X_BO: np.ndarray) -> Thing:
    """One object by its own grid."""
    low, high = np.asarray(obj.mesh.bounds, float)
    return Thing(grid=obj.sdf, error_m=0.0, low=low, high=high, X_BA=np.asarray(X_BO, float))


def thinned_thing(obj: ObjectModel, X_BO: np.ndarray) -> Thing:
    """One object by its thinned grid, whose error is taken off."""
    s = object_shape(obj)
    return Thing(grid=s.grid, error_m=s.error_m, low=s.low, high=s.high, X_BA=np.asarray(X_BO, float))


def cloud_thing(points_B: np.ndarray) -> Thing:
    """Points (M, 3) of things nobody knows, M >= 1."""
    grid, error = cloud_grid(points_B)
    low, high = np.min(points_B, axis=0), np.max(points_B, axis=0)
    return Thing(grid=grid, error_m=error, low=low, high=high, X_BA=np.eye(4))


def grid_tables(things: Sequence[Thing]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of `CheckArrays.grids`, `.grid_info`, and all values, float32; those of a single thing are not copied."""
    flat = [t.grid.values.reshape(-1) for t in things]
    values = flat[0] if len(flat) == 1 else np.concatenate(flat) if flat else np.zeros(0, np.float32)
    start = np.cumsum([0] + [len(f) for f in flat])[:-1]
    info = [[a, *t.grid.values.shape] for a, t in zip(start, things, strict=True)]
    rows = np.empty((len(things), GRID_COLUMNS))
    for row, t in zip(rows, things, strict=True):
        middle = (t.low + t.high) / 2
        row[ORIGIN : ORIGIN + 3], row[INV_SPACING], row[ERROR] = t.grid.origin, t.grid.inv_spacing, t.error_m
        row[LOW : LOW + 3], row[HIGH : HIGH + 3], row[FRAME : FRAME + 12] = t.low, t.high, t.X_BA[:3].reshape(-1)
        row[MIDDLE : MIDDLE + 3] = t.X_BA[:3, :3] @ middle + t.X_BA[:3, 3]
        row[RADIUS] = np.linalg.norm(t.high - middle)
    return rows, np.array(info, np.int64).reshape(-1, 4), values


def box_rows(boxes: Sequence[BoxObstacle]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `CheckArrays.parts` and `.part_info`."""
    rows, info = np.empty((len(boxes), 19)), np.zeros((len(boxes), 5), np.int64)
    info[:, 0] = int(PartKind.BOX)
    for row, b in zip(rows, boxes, strict=True):
        X = np.asarray(b.X_BX, float)
        row[:3], row[3], row[4:7], row[7:] = X[:3, 3], np.linalg.norm(b.half), b.half, X[:3].reshape(-1)
    return rows, info
