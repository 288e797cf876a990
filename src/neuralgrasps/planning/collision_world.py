"""Obstacles as the arrays of collision checks: boxes, distance grids of objects, and what the hand carries."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.collision_arrays import Grids
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


def no_grids() -> Grids:
    """Nothing."""
    return stack_grids([])


def stack_grids(things: Sequence[tuple[SdfGrid, float, np.ndarray, np.ndarray, np.ndarray]]) -> Grids:
    """Grids of (grid, error, low (3,), high (3,), X_BA (4, 4)); one alone is not copied."""
    grids = [thing[0] for thing in things]
    flat = [g.values.reshape(-1) for g in grids]
    values = flat[0] if len(flat) == 1 else np.concatenate(flat) if flat else np.zeros(0, np.float32)
    low, high = (np.array([t[k] for t in things], float).reshape(-1, 3) for k in (2, 3))
    X_BA = np.array([t[4] for t in things], float).reshape(-1, 4, 4)
    middle = (low + high) / 2
    return Grids(
        values=values,
        start=np.cumsum([0] + [len(f) for f in flat])[:-1].astype(np.int64),
        sides=np.array([g.values.shape for g in grids], np.int64).reshape(-1, 3),
        origin=np.array([g.origin for g in grids], float).reshape(-1, 3),
        inv_spacing=np.array([g.inv_spacing for g in grids], float),
        low=low,
        high=high,
        error=np.array([t[1] for t in things], float),
        X_BA=X_BA,
        centre=np.einsum("aij,aj->ai", X_BA[:, :3, :3], middle) + X_BA[:, :3, 3],
        radius=np.linalg.norm(high - middle, axis=1),
    )


def full_grid(obj: ObjectModel, X_BO: np.ndarray) -> Grids:
    """One object by its own grid."""
    low, high = np.asarray(obj.mesh.bounds, float)
    return stack_grids([(obj.sdf, 0.0, low, high, np.asarray(X_BO, float))])


def thinned_grids(objects: Sequence[tuple[ObjectModel, np.ndarray]]) -> Grids:
    """Objects at X_BO by thinned grids, whose error is taken off."""
    shapes = [(object_shape(obj), X_BO) for obj, X_BO in objects]
    return stack_grids([(s.grid, s.error_m, s.low, s.high, np.asarray(X, float)) for s, X in shapes])


def box_arrays(boxes: Sequence[BoxObstacle]) -> tuple[np.ndarray, np.ndarray]:
    """X_BX (Nb, 4, 4) and half sizes (Nb, 3)."""
    X = np.array([b.X_BX for b in boxes], float).reshape(-1, 4, 4)
    return X, np.array([b.half for b in boxes], float).reshape(-1, 3)
