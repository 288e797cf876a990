"""Things that stand on the table or hang in front of an object and hide a part of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import Mesh, box_mesh, cylinder_mesh, hull_planes
from neuralgrasps.geometry.raster import depth_images
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix, transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses

_GAP_M = 0.003  # things keep at least this far apart
_EYE_M = 0.2  # nothing hangs nearer to the camera
_BESIDE_M = 0.12  # how much farther than touching it a thing may stand from the object
_LAYOUTS = 25
_TOLERANCE = 0.015
_HANGING = 0.4
_POINTS = 512


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """A solid that can be placed.

    Attributes:
        mesh: its surface, own frame, metres. points: (P, 3) spread over it.
        distance: signed distances (P,) of points (P, 3) to it, or less; metres.
        centre: (3,) middle of the bounding box. radius_m: of the ball about it through the box's corners.
    """

    mesh: Mesh
    points: np.ndarray
    distance: Callable[[np.ndarray], np.ndarray]
    centre: np.ndarray
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A body at a pose `X_WB` (4, 4)."""

    body: Body
    X_WB: np.ndarray

    @property
    def centre_W(self) -> np.ndarray:
        """(3,) the body's centre."""
        return self.X_WB[:3, :3] @ self.body.centre + self.X_WB[:3, 3]

    @property
    def lowest_m(self) -> float:
        """Height of its lowest vertex."""
        return float((self.body.mesh.vertices @ self.X_WB[2, :3]).min() + self.X_WB[2, 3])

    def is_apart_from(self, other: Placed) -> bool:
        """Whether the points of both are at least 3 mm outside the other."""
        return all(
            b.body.distance(transform_points_np(np.linalg.inv(b.X_WB) @ a.X_WB, a.body.points)).min() > _GAP_M
            for a, b in ((self, other), (other, self))
        )


def _body(mesh: Mesh, points: np.ndarray, distance: Callable[[np.ndarray], np.ndarray]) -> Body:
    low, high = mesh.bounds
    radius = float(0.5 * np.linalg.norm(high - low))
    return Body(mesh=mesh, points=points, distance=distance, centre=0.5 * (low + high), radius_m=radius)


def body_of(obj: ObjectModel) -> Body:
    """A library object as a body."""
    step = max(1, len(obj.points_O) // _POINTS)
    return _body(obj.mesh, obj.points_O[::step], lambda p: query_grid_numpy(obj.sdf, p))


def body_of_mesh(mesh: Mesh, *, seed: int) -> Body:
    """Any mesh as a body without a distance of its own: only its points keep clear of others."""
    return _body(mesh, sample_surface(mesh, _POINTS, seed)[0], lambda p: np.full(len(p), np.inf))


def random_primitive(rng: np.random.Generator) -> Body:
    """A box of sides 3 to 25 cm, or a cylinder of radius 1.5 to 6 cm and height 5 to 30 cm."""
    if rng.random() < 0.5:
        mesh = box_mesh(0.5 * np.exp(rng.uniform(np.log(0.03), np.log(0.25), 3)))
    else:
        mesh = cylinder_mesh(rng.uniform(0.015, 0.06), rng.uniform(0.025, 0.15), segments=48)
    planes = hull_planes(mesh.vertices, mesh.faces)
    points = sample_surface(mesh, _POINTS, int(rng.integers(2**31)))[0]
    return _body(mesh, points, lambda p: (p @ planes[:, :3].T + planes[:, 3]).max(axis=1))


def turn_z(angle_rad: float) -> np.ndarray:
    """(4, 4) rotation about z."""
    return make_transform_np(rpy_matrix([0.0, 0.0, angle_rad]))


def hide(
    target: Placed,
    *,
    share: float,
    X_WC: np.ndarray,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    distractors: Sequence[ObjectModel] = (),
) -> tuple[Placed, ...] | None:
    """One to three things that leave `share` of the target's pixels visible, within 0.015.

    Things stand on z = 0 or, four in ten, hang in the air in front; they are library objects when some are given,
    else boxes and cylinders. None goes through another one. All are drawn at random; the first one is then slid
    sideways until the share is met.

    Returns:
        The things; None when they did not fit in 25 draws of their places.
    """
    window, own = _window(target, X_WC, intrinsics)
    things = [_draw(distractors, rng) for _ in range(rng.integers(1, 4))]
    for _ in range(_LAYOUTS):
        tracks = [thing.track(target, X_WC, rng) for thing in things]
        others = [track(rng.uniform(0.0, 1.5)) for track in tracks[1:]]
        nearest = np.min([np.full(own.shape, np.inf), *(own_depth(o, X_WC, window) for o in others)], axis=0)

        def visible(along: float, nearest: np.ndarray = nearest, track: _Track = tracks[0]) -> float:
            return float((own <= np.minimum(nearest, own_depth(track(along), X_WC, window)))[np.isfinite(own)].mean())

        along = _crossing(visible, share)
        if along is not None and _fit(placed := (tracks[0](along), *others), target):
            return placed
    return None


def _crossing(rising: Callable[[float], float], wanted: float) -> float | None:
    """Where in [0, 1] a function is within 0.015 of `wanted`, by bisection; None when it is not found."""
    low, high = 0.0, 1.0
    if rising(low) > wanted + _TOLERANCE or rising(high) < wanted - _TOLERANCE:
        return None
    for _ in range(10):
        middle = 0.5 * (low + high)
        value = rising(middle)
        if abs(value - wanted) < _TOLERANCE:
            return middle
        low, high = (middle, high) if value < wanted else (low, middle)
    return None


def _fit(things: Sequence[Placed], target: Placed) -> bool:
    """Whether all are apart from each other and from the target, and above the table."""
    everything = (target, *things)
    return all(t.lowest_m > -_GAP_M for t in things) and all(
        a.is_apart_from(b) for i, a in enumerate(everything) for b in everything[:i]
    )


def own_depth(target: Placed, X_WC: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(h, w) depth of the target alone, inf beside it."""
    return depth_images(target.body.mesh, (np.linalg.inv(X_WC) @ target.X_WB)[None], intrinsics)[0]


def _window(target: Placed, X_WC: np.ndarray, intrinsics: Intrinsics) -> tuple[Intrinsics, np.ndarray]:
    """The part of the image that holds the target, as a camera, and the target's depth in it."""
    depth = own_depth(target, X_WC, intrinsics)
    row, column = np.nonzero(np.isfinite(depth))
    (v0, v1), (u0, u1) = (row.min(), row.max() + 1), (column.min(), column.max() + 1)
    window = replace(intrinsics, cx=intrinsics.cx - u0, cy=intrinsics.cy - v0, width=int(u1 - u0), height=int(v1 - v0))
    return window, depth[v0:v1, u0:u1]


_Track = Callable[[float], Placed]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Thing:
    """What may be put in front of a target.

    Attributes:
        body: its shape. poses: (K, 4, 4) that it may be put in, at the origin. shares: (K,) how likely they are.
        hangs: whether it hangs in the air, or stands on z = 0.
    """

    body: Body
    poses: np.ndarray
    shares: np.ndarray
    hangs: bool

    def track(self, target: Placed, X_WC: np.ndarray, rng: np.random.Generator) -> _Track:
        """Places from before the target (0) to beside it (1), in a random pose."""
        start, side = (_in_the_air if self.hangs else _on_the_table)(self.body, target, X_WC, rng)
        X_WB = turn_z(rng.uniform(0.0, 2.0 * np.pi)) @ self.poses[rng.choice(len(self.poses), p=self.shares)]
        span = (target.body.radius_m + self.body.radius_m) * side

        def at(along: float) -> Placed:
            return Placed(body=self.body, X_WB=make_transform_np(None, start + along * span) @ X_WB)

        return at


def _draw(distractors: Sequence[ObjectModel], rng: np.random.Generator) -> _Thing:
    hangs = bool(rng.random() < _HANGING)
    obj = distractors[int(rng.integers(len(distractors)))] if len(distractors) else None
    body = random_primitive(rng) if obj is None else body_of(obj)
    if hangs:
        R = Rotation.random(_LAYOUTS, rng=rng).as_matrix()
        poses, shares = make_transform_np(R, -R @ body.centre), np.full(_LAYOUTS, 1.0 / _LAYOUTS)
    else:
        poses, shares = resting_poses(body.mesh.vertices, np.zeros(3) if obj is None else obj.com_O)
    return _Thing(body=body, poses=poses, shares=shares, hangs=hangs)


def _on_the_table(
    body: Body, target: Placed, X_WC: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Where a thing stands in front of the target, up to 12 cm from touching it, and its unit direction aside."""
    to_eye = X_WC[:2, 3] - target.centre_W[:2]
    angle = np.arctan2(to_eye[1], to_eye[0]) + rng.uniform(-0.3, 0.3)
    front = np.array([np.cos(angle), np.sin(angle), 0.0])
    reach = rng.uniform(0.3 * target.body.radius_m, target.body.radius_m + body.radius_m + _BESIDE_M)
    aside = rng.choice([-1.0, 1.0]) * np.array([-front[1], front[0], 0.0])
    return target.centre_W * [1.0, 1.0, 0.0] + reach * front, aside


def _in_the_air(
    body: Body, target: Placed, X_WC: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A place near the line of sight between target and camera, and a unit direction across it."""
    sight = X_WC[:3, 3] - target.centre_W
    distance = float(np.linalg.norm(sight))
    far = max(min(0.5 * distance, distance - _EYE_M - body.radius_m), 0.3 * distance)
    along = rng.uniform(min(target.body.radius_m, far), far)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    beside = X_WC[:3, :2] @ rng.uniform(-0.3, 0.3, 2) * target.body.radius_m
    across = X_WC[:3, :2] @ np.array([np.cos(angle), np.sin(angle)])
    return target.centre_W + along / distance * sight + beside, across
