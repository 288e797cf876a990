"""Rotations that leave an object's shape unchanged, found by measuring on its signed distances."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_gradient_numpy, query_grid_numpy

_CONTINUOUS_STEPS = 36
_ORDERS = (6, 5, 4, 3, 2)
_REFINE_POINTS = 512
_SHARE = 0.95  # of the surface must stay within the tolerance; the rest is scanning noise and dents
_STAYED = math.cos(math.radians(15.0))
_LARGEST_GROUP = 24  # finite, with perpendicular axes: the cube's
_SNAP = math.cos(math.radians(0.05))


@dataclass(frozen=True, slots=True, kw_only=True)
class SymmetryGroup:
    """The rotations of an object onto itself, within a stated tolerance.

    Attributes:
        rotations: (S, 4, 4) float64 transforms of the object frame, the identity first. A continuous symmetry is
            sampled every 10 degrees.
        continuous_axis: (3,) unit axis about which every angle is a symmetry; None when there is none.
        centre: (3,) the point that all rotations fix.
        tolerance_m: the tolerance that decided.
        deviation_m: the largest deviation over all rotations of the group: 95 % of the surface moves off by no more.
    """

    rotations: np.ndarray
    continuous_axis: np.ndarray | None
    centre: np.ndarray
    tolerance_m: float
    deviation_m: float = 0.0

    def __len__(self) -> int:
        return len(self.rotations)


def trivial_symmetry(centre: np.ndarray, tolerance_m: float) -> SymmetryGroup:
    """The group of the identity alone."""
    return SymmetryGroup(
        rotations=np.eye(4)[None], continuous_axis=None, centre=np.array(centre, float), tolerance_m=tolerance_m
    )


def default_tolerance(points_O: np.ndarray) -> float:
    """2 % of the diameter of (P, 3) points, at most 5 mm.

    With it the scanned bleach bottle has no symmetry, the mustard bottle a half turn, and the boxes that of a box; but
    for the cracker box, which bulges so much that a half turn moves its surface by 5.2 mm.
    """
    try:
        corners = points_O[ConvexHull(points_O).vertices]
    except QhullError:
        corners = points_O
    return min(0.005, 0.02 * float(pdist(corners).max()))


def find_symmetry(points_O: np.ndarray, sdf: SdfGrid, *, tolerance_m: float | None = None) -> SymmetryGroup:
    """The group of rotations that carry the surface onto itself.

    Axes are looked for near the principal axes, the axes of the smallest box and the frame's own axes; each
    candidate (any angle, or n-fold with n = 6..2) is first fitted to the shape and then measured. Of the groups that
    the axes found generate, the largest is taken whose every rotation is within the tolerance. Groups with axes that
    are not perpendicular (tetrahedron, icosahedron) are found only in part.

    Args:
        points_O: (P, 3) evenly spread surface points, object frame.
        sdf: the object's signed distances.
        tolerance_m: default `default_tolerance(points_O)`.
    """
    tolerance = default_tolerance(points_O) if tolerance_m is None else tolerance_m
    centre = 0.5 * (points_O.min(axis=0) + points_O.max(axis=0))
    found = [
        axis
        for candidate in _candidate_axes(points_O)
        if (axis := _measure_axis(points_O, sdf, candidate, centre, tolerance)) is not None
    ]
    if not found:
        return trivial_symmetry(centre, tolerance)
    found.sort(key=lambda a: (-a.order, a.deviation))
    axes = _perpendicular(found)
    fallback = points_O.mean(axis=0)
    for generators in _combinations(axes):
        group = _group_of(points_O, sdf, generators, fallback, tolerance)
        if group is not None:
            return group
    return trivial_symmetry(centre, tolerance)


@dataclass(frozen=True, slots=True)
class _Axis:
    axis: np.ndarray
    order: float  # math.inf: continuous
    point: np.ndarray
    deviation: float

    @property
    def angle(self) -> float:
        """A rotation that tests it: the generator, or an angle that is not a fraction of a turn."""
        return 2.0 if self.order == math.inf else 2.0 * math.pi / self.order


def _candidate_axes(points_O: np.ndarray) -> list[np.ndarray]:
    """Unit axes worth a test, nearly equal ones once."""
    spread = points_O - points_O.mean(axis=0)
    principal = np.linalg.eigh(spread.T @ spread)[1].T
    axes: list[np.ndarray] = []
    for axis in np.concatenate([principal, _smallest_box_axes(points_O, principal), np.eye(3)]):
        if all(abs(float(axis @ other)) < math.cos(math.radians(3.0)) for other in axes):
            axes.append(axis)
    return axes


def _smallest_box_axes(points_O: np.ndarray, principal: np.ndarray) -> np.ndarray:
    """(9, 3): for each principal axis held fixed, the axes of the smallest box over turns of one degree."""
    angles = np.radians(np.arange(90.0))
    result = []
    for k in range(3):
        u, v = principal[(k + 1) % 3], principal[(k + 2) % 3]
        first = np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v
        second = -np.sin(angles)[:, None] * u + np.cos(angles)[:, None] * v
        areas = np.ptp(points_O @ first.T, axis=0) * np.ptp(points_O @ second.T, axis=0)
        best = int(np.argmin(areas))
        result += [principal[k], first[best], second[best]]
    return np.array(result)


def _measure_axis(
    points_O: np.ndarray, sdf: SdfGrid, axis: np.ndarray, centre: np.ndarray, tolerance: float
) -> _Axis | None:
    """The highest order of rotational symmetry near `axis`, fitted to the shape; None when there is none."""
    fitted, point = _fit_axis(points_O, sdf, axis, centre, math.pi)
    turns = 2.0 * math.pi * np.arange(1, 10) / 19.0
    worst = 0.0
    for turn in turns:
        worst = max(worst, _deviation(points_O, sdf, _about(fitted, point, turn)))
        if worst > tolerance:
            break
    else:
        return _Axis(fitted, math.inf, point, worst)
    for order in _ORDERS:
        angle = 2.0 * math.pi / order
        fitted, point = _fit_axis(points_O, sdf, axis, centre, angle)
        if abs(float(fitted @ axis)) < _STAYED:
            continue  # the fit ran away to another symmetry
        deviation = _deviation(points_O, sdf, _about(fitted, point, angle))
        if deviation <= tolerance:
            return _Axis(fitted, float(order), point, deviation)
    return None


def _fit_axis(
    points_O: np.ndarray, sdf: SdfGrid, axis: np.ndarray, centre: np.ndarray, angle: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton of a free rigid motion, started at the rotation, onto the zero level; its axis and a point on it."""
    step = max(1, len(points_O) // _REFINE_POINTS)
    points = points_O[::step] - centre
    R, t = Rotation.from_rotvec(angle * axis).as_matrix(), np.zeros(3)
    radius = float(np.linalg.norm(points, axis=1).mean())
    for _ in range(8):
        moved = points @ R.T
        distance, gradient = query_grid_gradient_numpy(sdf, moved + t + centre)
        weight = 1.0 / (1.0 + (distance / (0.2 * radius)) ** 2)
        J = np.concatenate([gradient, np.cross(moved, gradient) / radius], axis=1)
        # the damping keeps motions that the shape does not resist (a turn of a can about its axis) where they are
        normal = (J * weight[:, None]).T @ J + 1e-3 * len(points) * np.eye(6)
        update = -np.linalg.solve(normal, (J * weight[:, None]).T @ distance)
        t = t + update[:3]
        R = Rotation.from_rotvec(update[3:] / radius).as_matrix() @ R
    turn = Rotation.from_matrix(R).as_rotvec()
    fitted = turn / max(float(np.linalg.norm(turn)), 1e-12)
    point = centre + np.linalg.lstsq(np.eye(3) - R, t, rcond=0.1)[0]
    return _snapped(fitted), point


def _snapped(axis: np.ndarray) -> np.ndarray:
    """The axis with its largest coordinate positive; exactly a frame axis when within 0.05 degrees of one."""
    k = int(np.argmax(np.abs(axis)))
    axis = axis * np.sign(axis[k])
    return np.eye(3)[k] if axis[k] > _SNAP else axis


def _deviation(points_O: np.ndarray, sdf: SdfGrid, X: np.ndarray) -> float:
    """How far the moved surface lies off the surface: the 95 % quantile of |sdf|, metres."""
    return float(np.quantile(np.abs(query_grid_numpy(sdf, points_O @ X[:3, :3].T + X[:3, 3])), _SHARE))


def _about(axis: np.ndarray, point: np.ndarray, angle: float) -> np.ndarray:
    return _place(Rotation.from_rotvec(angle * axis).as_matrix(), point)


def _place(R: np.ndarray, centre: np.ndarray) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = R
    X[:3, 3] = centre - R @ centre
    return X


def _perpendicular(found: Sequence[_Axis]) -> list[_Axis]:
    """The best axis and those nearly perpendicular to it and to each other, made exactly so."""
    kept: list[_Axis] = []
    for candidate in found:
        if any(abs(float(candidate.axis @ k.axis)) > math.sin(math.radians(10.0)) for k in kept):
            continue
        axis = candidate.axis
        for k in kept:
            axis = axis - (axis @ k.axis) * k.axis
        axis = axis / np.linalg.norm(axis)
        kept.append(_Axis(axis, candidate.order, candidate.point, candidate.deviation))
    return kept


def _common_point(axes: Sequence[_Axis], fallback: np.ndarray) -> np.ndarray:
    """The point nearest to all axes; along a single axis, the one nearest to `fallback`."""
    A, b = 1e-6 * np.eye(3), 1e-6 * fallback
    for a in axes:
        across = np.eye(3) - np.outer(a.axis, a.axis)
        A, b = A + across, b + across @ a.point
    return np.linalg.solve(A, b)


def _combinations(axes: Sequence[_Axis]) -> list[list[_Axis]]:
    """The axes, and what is left when some are dropped or taken at a lower order; the largest groups first."""
    choices = [[None, *(replace(a, order=n) for n in _lower_orders(a.order))] for a in axes]
    result = [[a for a in chosen if a is not None] for chosen in itertools.product(*choices)]
    sizes = {id(c): len(group) for c in result if c and (group := _sampled_group(c)) is not None}
    return sorted((c for c in result if id(c) in sizes), key=lambda c: (-sizes[id(c)], sum(a.deviation for a in c)))


def _lower_orders(order: float) -> list[float]:
    if order == math.inf:
        return [math.inf, 2.0]
    return [float(n) for n in range(2, int(order) + 1) if order % n == 0]


def _group_of(
    points_O: np.ndarray, sdf: SdfGrid, axes: Sequence[_Axis], fallback: np.ndarray, tolerance: float
) -> SymmetryGroup | None:
    """The group that `axes` generate about their common point; None when one of its rotations is too far off.

    Two rotations within the tolerance can have a product that is not, so each of the group is measured.
    """
    rotations = _sampled_group(axes)
    if rotations is None:
        return None
    centre = _common_point(axes, fallback)
    X_OO = np.stack([_place(R, centre) for R in rotations])
    worst = max(_deviation(points_O, sdf, X) for X in X_OO)
    if worst > tolerance:
        return None
    continuous = [a.axis for a in axes if a.order == math.inf]
    return SymmetryGroup(
        rotations=X_OO,
        continuous_axis=continuous[0] if len(continuous) == 1 else None,
        centre=centre,
        tolerance_m=tolerance,
        deviation_m=worst,
    )


def _sampled_group(axes: Sequence[_Axis]) -> np.ndarray | None:
    """(S, 3, 3) closure of the axes' rotations, identity first; continuous axes sampled. None when it is not finite."""
    continuous = [a for a in axes if a.order == math.inf]
    if len(continuous) > 1:
        return _sphere_rotations()
    if continuous:
        turns = 2.0 * math.pi * np.arange(_CONTINUOUS_STEPS) / _CONTINUOUS_STEPS
        around = Rotation.from_rotvec(turns[:, None] * continuous[0].axis).as_matrix()
        flips = [a for a in axes if a.order != math.inf and a.order % 2 == 0]
        if not flips:
            return around
        return np.concatenate([around, around @ Rotation.from_rotvec(math.pi * flips[0].axis).as_matrix()])
    generators = [Rotation.from_rotvec(a.angle * a.axis).as_matrix() for a in axes]
    group = [np.eye(3)]
    queue = [np.eye(3)]
    while queue:
        R = queue.pop(0)
        for g in generators:
            product = g @ R
            if all(float(np.abs(product - known).max()) > 1e-6 for known in group):
                group.append(product)
                queue.append(product)
        if len(group) > _LARGEST_GROUP:
            return None
    return np.array(group)


def _sphere_rotations() -> np.ndarray:
    """All orientations, 30 degrees apart in each Euler angle; identity first."""
    turns = 30.0 * np.arange(12)
    angles = np.array([(a, b, c) for b in 30.0 * np.arange(7) for a in turns for c in turns if 0 < b < 180 or c == 0])
    return Rotation.from_euler("ZYZ", angles, degrees=True).as_matrix()
