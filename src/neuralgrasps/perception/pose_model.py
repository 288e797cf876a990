"""What the pose search keeps of an object: made once, used for every view."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.mesh import convex_hull
from neuralgrasps.geometry.rotation import super_fibonacci_rotations
from neuralgrasps.geometry.sampling import even_subset, farthest_points
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.objects.symmetry import SymmetryGroup, default_tolerance, find_symmetry

ROTATIONS = 4000  # of the grid over all of SO(3): about 16 degrees apart; those equal by symmetry are left out
VIEWS = 400  # directions from which the visible part is known
HULL_POINTS = 96
LOOKALIKE = 3.0  # turns count that leave the surface within so many times the tolerance of a symmetry
REST_SHARE = 0.995  # of the solid angle of all resting poses is kept
_KEPT_MODELS = 64
_BALL = 100  # so many rotations about no single axis are those of a ball


class PoseModel(NamedTuple):
    """Arrays of one object for the kernels, object frame, metres.

    Attributes:
        values, origin, inv_spacing: signed distance grid, and every second node of it: coarse, coarse_inv_spacing.
        points, normals: (P, 3) even surface points, any first part of them even too.
        hull: (K, 3) vertices of the convex hull, thinned. centre: (3,) of its symmetry. radius: largest distance of the
            hull from `centre`. diameter: largest distance of two hull vertices.
        bounds: (2, 3) of the mesh.
        rests: (S, 3) unit directions that point down when the object rests stably on a table; rest_starts: one of every
            set of them that the symmetry makes equal.
        rotations: (R, 3, 3) grid of rotations, one of every set that the symmetry makes equal.
        views: (V, 3) unit directions of sight; visible: (V, 3) centroid of what is seen along each.
        turns: (S, 4, 4) motions of the object nearly onto itself, the identity first: a view may take one for the
            other; same: of them, its symmetry group. axis: (3,) about which it can turn by any angle, else 0; `turns`
            and `same` then only turn the axis around. is_ball: it can turn about any axis.
    """

    values: np.ndarray
    origin: np.ndarray
    inv_spacing: float
    coarse: np.ndarray
    coarse_inv_spacing: float
    points: np.ndarray
    normals: np.ndarray
    hull: np.ndarray
    centre: np.ndarray
    radius: float
    diameter: float
    bounds: np.ndarray
    rests: np.ndarray
    rest_starts: np.ndarray
    rotations: np.ndarray
    views: np.ndarray
    visible: np.ndarray
    turns: np.ndarray
    same: np.ndarray
    axis: np.ndarray
    is_ball: bool


_models: OrderedDict[tuple[str, bytes, float], PoseModel] = OrderedDict()
_lock = Lock()


def pose_model(obj: ObjectModel) -> PoseModel:
    """The object's arrays, from memory when it was asked for before (0.1-0.2 s else)."""
    symmetry = obj.symmetry
    key = (obj.content_hash, np.ascontiguousarray(symmetry.rotations).tobytes(), symmetry.tolerance_m)
    with _lock:
        if key in _models:
            _models.move_to_end(key)
            return _models[key]
    made = _prepare(obj)
    with _lock:
        _models[key] = made
        while len(_models) > _KEPT_MODELS:
            _models.popitem(last=False)
    return made


def _prepare(obj: ObjectModel) -> PoseModel:
    order = farthest_points(obj.points_O, min(len(obj.points_O), 1024))
    points, normals = np.ascontiguousarray(obj.points_O[order]), np.ascontiguousarray(obj.normals_O[order])
    vertices, _ = convex_hull(obj.mesh.vertices)
    hull = np.ascontiguousarray(vertices[farthest_points(vertices, min(len(vertices), HULL_POINTS))])
    centre = np.asarray(obj.symmetry.centre, np.float64)
    views = sphere_directions(VIEWS)
    values = np.ascontiguousarray(obj.sdf.values)
    grid = (values, obj.sdf.origin, obj.sdf.inv_spacing)
    tolerance = LOOKALIKE * default_tolerance(obj.points_O)
    turns, axis = _turns(_look_alikes(obj, tolerance))
    symmetries = np.ascontiguousarray(turns[:, :3, :3])
    rests = _rest_directions(obj)
    return PoseModel(
        values=values,
        origin=np.asarray(obj.sdf.origin, np.float64),
        inv_spacing=float(obj.sdf.inv_spacing),
        coarse=np.ascontiguousarray(values[::2, ::2, ::2]),
        coarse_inv_spacing=0.5 * float(obj.sdf.inv_spacing),
        points=points,
        normals=normals,
        hull=hull,
        centre=centre,
        radius=float(np.linalg.norm(vertices - centre, axis=1).max()),
        diameter=float(np.linalg.norm(hull[:, None] - hull[None], axis=-1).max()),
        bounds=np.array(obj.mesh.bounds, np.float64) + np.array([[-5e-4], [5e-4]]),
        rests=rests,
        rest_starts=_distinct_directions(rests, symmetries, axis),
        rotations=_fundamental_rotations(symmetries, axis),
        views=views,
        visible=_visible_centroids(*grid, points[:384], normals[:384], views),
        turns=turns,
        same=_turns(obj.symmetry)[0],
        axis=axis,
        is_ball=len(obj.symmetry) > _BALL,
    )


def sphere_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors, evenly spread (Fibonacci spiral)."""
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    angle = np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def _look_alikes(obj: ObjectModel, tolerance_m: float) -> SymmetryGroup:
    """The symmetry within a wide tolerance; of a nearly round object (a mug) its own: its angle must be searched."""
    wide = find_symmetry(obj.points_O, obj.sdf, tolerance_m=tolerance_m)
    if _is_round(wide) and not _is_round(obj.symmetry):
        return obj.symmetry
    return wide if len(obj.symmetry) <= _BALL else obj.symmetry


def _is_round(symmetry: SymmetryGroup) -> bool:
    return symmetry.continuous_axis is not None or len(symmetry) > _BALL


def _turns(symmetry: SymmetryGroup) -> tuple[np.ndarray, np.ndarray]:
    """Motions (S, 4, 4) of the group, and its continuous axis (0 for none), of which then only flips are kept."""
    X = np.ascontiguousarray(symmetry.rotations)
    if len(X) > _BALL:
        return X[:1], np.array([0.0, 0.0, 1.0])
    if symmetry.continuous_axis is None:
        return X, np.zeros(3)
    axis = np.asarray(symmetry.continuous_axis, np.float64)
    flipped = np.flatnonzero(X[:, :3, :3] @ axis @ axis < -0.9)
    return np.ascontiguousarray(X[[0, *flipped[:1]]]), axis


def _fundamental_rotations(symmetries: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Rotations of the object in the camera, one of every class that the symmetry makes equal."""
    if axis.any():
        spacing = ROTATIONS ** (2.0 / 3.0)  # as many directions as the grid of rotations would have
        directions = sphere_directions(int(1.3 * spacing))
        if len(symmetries) > 1:
            directions = directions[directions[:, 2] <= 0.05]
        return np.stack([_turning(axis, d) for d in directions])
    R = super_fibonacci_rotations(ROTATIONS).numpy().astype(np.float64)
    trace = np.einsum("nij,sji->ns", R, symmetries)
    return np.ascontiguousarray(R[trace[:, 0] >= trace.max(axis=1) - 1e-9])


def _turning(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns unit vector a to b."""
    cross, cosine = np.cross(a, b), float(a @ b)
    if cosine < -0.999999:
        other = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        other /= np.linalg.norm(other)
        return 2.0 * np.outer(other, other) - np.eye(3)
    K = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.eye(3) + K + K @ K / (1.0 + cosine)


def _rest_directions(obj: ObjectModel) -> np.ndarray:
    """(S, 3) down directions, object frame, of the stable poses that make up nearly all of the solid angle."""
    poses, shares = resting_poses(obj.mesh.vertices, obj.com_O, min_share=0.0)
    needed = int(np.searchsorted(np.cumsum(shares), REST_SHARE)) + 1
    down = -poses[:needed, 2, :3]
    return np.ascontiguousarray(down[even_subset(down, 32)] if len(down) > 32 else down)


def _distinct_directions(directions: np.ndarray, symmetries: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Directions of which none comes within 8 degrees of an earlier one under the symmetry."""
    kept: list[np.ndarray] = []
    for one in directions:
        same = False
        for other in kept:
            if axis.any():
                angles = [np.arccos(np.clip(d @ axis, -1, 1)) for d in (*(symmetries @ one), other)]
                same |= min(abs(a - angles[-1]) for a in angles[:-1]) < np.deg2rad(8.0)
            else:
                same |= float((symmetries @ one @ other).max()) > np.cos(np.deg2rad(8.0))
        if not same:
            kept.append(one)
    return np.array(kept)


@njit(cache=True, error_model="numpy")
def _visible_centroids(values, origin, inv_spacing, points, normals, views):  # type: ignore[no-untyped-def]
    """(V, 3) centroids of the points that face each direction of sight and that nothing hides, by foreshortening."""
    out = np.zeros((views.shape[0], 3))
    reach = 0.0
    for m in range(points.shape[0]):
        reach = max(reach, np.sqrt(points[m, 0] ** 2 + points[m, 1] ** 2 + points[m, 2] ** 2))
    for v in range(views.shape[0]):
        total = 0.0
        for m in range(points.shape[0]):
            facing = -(normals[m, 0] * views[v, 0] + normals[m, 1] * views[v, 1] + normals[m, 2] * views[v, 2])
            if facing <= 0.05:
                continue
            along, hidden = 0.004, False
            for _ in range(40):
                x = points[m, 0] - along * views[v, 0]
                y = points[m, 1] - along * views[v, 1]
                z = points[m, 2] - along * views[v, 2]
                d = grid_distance(values, origin, inv_spacing, x, y, z)
                if d < -5.0e-4:
                    hidden = True
                    break
                along += max(d, 1.5e-3)
                if along > 2.0 * reach + 0.05:
                    break
            if not hidden:
                total += facing
                for k in range(3):
                    out[v, k] += facing * points[m, k]
        for k in range(3):
            out[v, k] /= max(total, 1e-9)
    return out
