"""Exact distances of many points to a posed hand, part by part: plain loops over the points, which processors run at
eight a time. Where most parts are near most points, as in contact maps, this is faster than looking for the few that
matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.parts import part_distance

_BOX, _SPHERE, _CAPSULE, _CYLINDER = (
    int(k) for k in (PartKind.BOX, PartKind.SPHERE, PartKind.CAPSULE, PartKind.CYLINDER)
)


class Nearest(NamedTuple):
    """Points and what is nearest to them.

    Attributes:
        points_A: (3, M) points, rows x, y, z, in any frame A, metres.
        distance: (M,) signed, to the nearest part. part: (M,) which that is.
    """

    points_A: np.ndarray
    distance: np.ndarray
    part: np.ndarray


@njit(cache=True, error_model="numpy")
def new_nearest(points):  # type: ignore[no-untyped-def]
    """Room for so many points."""
    return Nearest(np.empty((3, points)), np.empty(points), np.empty(points, np.int64))


@njit(cache=True, error_model="numpy")
def points_in_hand(X_OH, points_O, out):  # type: ignore[no-untyped-def]
    """Points (M, 3) of the object frame into rows (3, M) of the hand's, X_OH its pose."""
    for i in range(points_O.shape[0]):
        x, y, z = points_O[i, 0] - X_OH[0, 3], points_O[i, 1] - X_OH[1, 3], points_O[i, 2] - X_OH[2, 3]
        for k in range(3):
            out[k, i] = X_OH[0, k] * x + X_OH[1, k] * y + X_OH[2, k] * z


@njit(cache=True, error_model="numpy")
def _to_box(X, size, first, x, y, z, distance, part):  # type: ignore[no-untyped-def]
    for i in range(x.shape[0]):
        dx = abs(X[0, 0] * x[i] + X[0, 1] * y[i] + X[0, 2] * z[i] + X[0, 3]) - size[0]
        dy = abs(X[1, 0] * x[i] + X[1, 1] * y[i] + X[1, 2] * z[i] + X[1, 3]) - size[1]
        dz = abs(X[2, 0] * x[i] + X[2, 1] * y[i] + X[2, 2] * z[i] + X[2, 3]) - size[2]
        ox = dx if dx > 0.0 else 0.0
        oy = dy if dy > 0.0 else 0.0
        oz = dz if dz > 0.0 else 0.0
        deep = dx if dx > dy else dy
        deep = deep if deep > dz else dz
        d = math.sqrt(ox * ox + oy * oy + oz * oz) + (deep if deep < 0.0 else 0.0)
        nearer = d < distance[i]
        distance[i] = d if nearer else distance[i]
        part[i] = first if nearer else part[i]


@njit(cache=True, error_model="numpy")
def _to_cylinder(X, size, first, x, y, z, distance, part):  # type: ignore[no-untyped-def]
    for i in range(x.shape[0]):
        px = X[0, 0] * x[i] + X[0, 1] * y[i] + X[0, 2] * z[i] + X[0, 3]
        py = X[1, 0] * x[i] + X[1, 1] * y[i] + X[1, 2] * z[i] + X[1, 3]
        dz = abs(X[2, 0] * x[i] + X[2, 1] * y[i] + X[2, 2] * z[i] + X[2, 3]) - size[1]
        dr = math.sqrt(px * px + py * py) - size[0]
        orr = dr if dr > 0.0 else 0.0
        oz = dz if dz > 0.0 else 0.0
        deep = dr if dr > dz else dz
        d = math.sqrt(orr * orr + oz * oz) + (deep if deep < 0.0 else 0.0)
        nearer = d < distance[i]
        distance[i] = d if nearer else distance[i]
        part[i] = first if nearer else part[i]


@njit(cache=True, error_model="numpy")
def _to_capsule(X, radius, half_length, first, x, y, z, distance, part):  # type: ignore[no-untyped-def]
    for i in range(x.shape[0]):
        px = X[0, 0] * x[i] + X[0, 1] * y[i] + X[0, 2] * z[i] + X[0, 3]
        py = X[1, 0] * x[i] + X[1, 1] * y[i] + X[1, 2] * z[i] + X[1, 3]
        dz = abs(X[2, 0] * x[i] + X[2, 1] * y[i] + X[2, 2] * z[i] + X[2, 3]) - half_length
        oz = dz if dz > 0.0 else 0.0
        d = math.sqrt(px * px + py * py + oz * oz) - radius
        nearer = d < distance[i]
        distance[i] = d if nearer else distance[i]
        part[i] = first if nearer else part[i]


@njit(cache=True, error_model="numpy")
def _to_hull(packed, X, first, x, y, z, distance, part):  # type: ignore[no-untyped-def]
    planes = packed.hull_planes[packed.hull_plane_start[first] : packed.hull_plane_start[first + 1]]
    triangles = packed.hull_triangles[packed.hull_tri_start[first] : packed.hull_tri_start[first + 1]]
    for i in range(x.shape[0]):
        px = X[0, 0] * x[i] + X[0, 1] * y[i] + X[0, 2] * z[i] + X[0, 3]
        py = X[1, 0] * x[i] + X[1, 1] * y[i] + X[1, 2] * z[i] + X[1, 3]
        pz = X[2, 0] * x[i] + X[2, 1] * y[i] + X[2, 2] * z[i] + X[2, 3]
        farther = False  # a hull is no nearer than any of its planes
        for k in range(planes.shape[0]):
            if planes[k, 0] * px + planes[k, 1] * py + planes[k, 2] * pz + planes[k, 3] >= distance[i]:
                farther = True
                break
        if farther:
            continue
        d = part_distance(packed.part_kind[first], packed.part_size[first], planes, triangles, px, py, pz)
        if d < distance[i]:
            distance[i], part[i] = d, first


@njit(cache=True, error_model="numpy")
def nearest_parts(packed, X_PA, nearest):  # type: ignore[no-untyped-def]
    """Fill distance and part of `nearest`, a `Nearest`, for the hand's parts posed by X_PA (Np, 3, 4)."""
    x, y, z = nearest.points_A[0], nearest.points_A[1], nearest.points_A[2]
    distance, part = nearest.distance, nearest.part
    distance[:] = math.inf
    part[:] = 0
    for p in range(packed.part_link.shape[0]):
        kind, X, size = packed.part_kind[p], X_PA[p], packed.part_size[p]
        if kind == _BOX:
            _to_box(X, size, p, x, y, z, distance, part)
        elif kind == _CYLINDER:
            _to_cylinder(X, size, p, x, y, z, distance, part)
        elif kind == _CAPSULE:
            _to_capsule(X, size[0], size[1], p, x, y, z, distance, part)
        elif kind == _SPHERE:
            _to_capsule(X, size[0], 0.0, p, x, y, z, distance, part)
        else:
            _to_hull(packed, X, p, x, y, z, distance, part)
