"""The table under an object as one of few planes, so that what was made for one scene serves the next."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix, inverse_np
from neuralgrasps.hands.fingerprint import fingerprint
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.synthesis.prepared import Memory

SNAP_RAD = np.radians(6.0)  # an object that leans by less, or floats or sinks by less than the next, lies on its face
SNAP_M = 0.010
_NORMAL_STEP = 1.0 / 64.0  # about a degree
_FINER = 8  # times as fine is the rounding of planes that are one of few anyway
_OFFSET_STEP_M = 1.0e-3
_PLANES = Memory[tuple[Plane, ...]]()


def resting_planes(obj: ObjectModel) -> tuple[Plane, ...]:
    """The table, in O, under each of the object's resting poses, the likeliest first."""

    def make() -> tuple[Plane, ...]:
        level = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
        poses, _ = resting_poses(obj.mesh.vertices, obj.com_O)
        return tuple(level.moved(inverse_np(X_WO)) for X_WO in poses)

    return _PLANES.get(fingerprint((obj.content_hash, obj.com_O)), make)


def nearest_resting_plane(obj: ObjectModel, plane_O: Plane) -> Plane | None:
    """The plane of the resting pose that an observed table plane is meant to be; None when it is near to none."""
    near = [p for p in resting_planes(obj) if abs(p.height(obj.com_O) - plane_O.height(obj.com_O)) < SNAP_M]
    best = max(near, key=lambda p: float(p.normal @ plane_O.normal), default=None)
    return best if best is not None and best.normal @ plane_O.normal > np.cos(SNAP_RAD) else None


def rounded_plane(plane: Plane, *, finely: bool = False) -> Plane:
    """A plane with its normal rounded to about 1 degree and its offset to 1 mm, or to an eighth of these."""
    steps = _FINER if finely else 1
    normal = np.round(plane.normal / _NORMAL_STEP * steps) * _NORMAL_STEP / steps
    offset = round(plane.offset_m / _OFFSET_STEP_M * steps) * _OFFSET_STEP_M / steps
    return Plane(normal / np.linalg.norm(normal) + 0.0, offset + 0.0)


def representative(obj: ObjectModel, plane_O: Plane) -> tuple[Plane, np.ndarray]:
    """One plane for all that the object's symmetry makes equal, and the motion X_OO (4, 4) from it back to `plane_O`.

    A cylinder that lies on its side is the same problem however it is rolled.
    """
    symmetry = obj.symmetry
    axis = symmetry.continuous_axis
    choices: list[tuple[Plane, np.ndarray]] = []
    for X in symmetry.rotations:
        if axis is not None and X[:3, :3] @ axis @ axis > 0.0 and choices:
            continue  # one for each direction of the axis: the angle about it follows
        moved = plane_O.moved(X)
        if axis is not None:
            X = _turned_about(axis, symmetry.centre, moved.normal) @ X  # noqa: PLW2901 - the same motion, completed
            moved = plane_O.moved(X)
        choices.append((moved, X))
    plane, X = max(choices, key=lambda c: tuple(np.round(c[0].normal / _NORMAL_STEP) + 0.0))
    return plane, inverse_np(X)


def _turned_about(axis: np.ndarray, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(4, 4) the turn about an axis that brings the part of `normal` across it to a fixed direction."""
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    X = np.eye(4)
    if np.hypot(normal @ u, normal @ v) > 1e-6:
        X[:3, :3] = axis_angle_matrix(axis, -np.arctan2(normal @ v, normal @ u))
        X[:3, 3] = centre - X[:3, :3] @ centre
    return X
