"""How deep a hand overlaps an object or itself.

Depths are metres, >= 0, and are found at points: they are below the true depth by what fits between neighbouring
points. An edge that cuts into a face between points half a spacing to its sides is missed by up to half a spacing, so
probe the object along its edges too (`probe_surface`), and use a hand packed with fine points for final figures.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.mesh import Mesh, signed_distance
from neuralgrasps.geometry.mesh_tree import MeshTree, tree_distance
from neuralgrasps.geometry.pose_kernels import moved_point, rigid_inverse, rigid_product
from neuralgrasps.geometry.sdf_grid import SdfGrid, grid_distance, query_grid_numpy
from neuralgrasps.grasps.contact import link_is_farther, link_pose_in_object
from neuralgrasps.grasps.probe_points import ProbePoints, group_points
from neuralgrasps.hands.packed import PackedHand, pose_links

_NEAR_M = 0.006  # points farther outside by the grid cannot be inside the mesh
_BOX, _SPHERE, _CAPSULE, _CYLINDER = 0, 1, 2, 3  # hands.hand.PartKind; the rest are hulls


class PenetrationDepths(NamedTuple):
    """Largest depths of N grasps, (N,) float64 metres, 0 = no overlap."""

    hand_in_object: np.ndarray
    object_in_hand: np.ndarray
    hand_in_hand: np.ndarray

    @property
    def deepest(self) -> np.ndarray:
        """(N,) the largest of the three."""
        return np.maximum(np.maximum(self.hand_in_object, self.object_in_hand), self.hand_in_hand)


class PoseScratch(NamedTuple):
    """Three transforms, (3, 4) float64 each, that the kernels below overwrite."""

    first: np.ndarray
    second: np.ndarray
    third: np.ndarray


@njit(cache=True, error_model="numpy")
def new_poses():  # type: ignore[no-untyped-def]
    """A `PoseScratch`."""
    return PoseScratch(np.empty((3, 4)), np.empty((3, 4)), np.empty((3, 4)))


@njit(cache=True, error_model="numpy")
def depth_in_part(packed, part, x, y, z):  # type: ignore[no-untyped-def]
    """Depth of a point (part frame) inside a convex part, metres; negative or 0 outside (not a distance there)."""
    kind = packed.part_kind[part]
    a, b, c = packed.part_size[part, 0], packed.part_size[part, 1], packed.part_size[part, 2]
    if kind == _BOX:
        return min(a - abs(x), b - abs(y), c - abs(z))
    if kind == _SPHERE:
        return a - math.sqrt(x * x + y * y + z * z)
    if kind == _CAPSULE:
        along = max(abs(z) - b, 0.0)
        return a - math.sqrt(x * x + y * y + along * along)
    if kind == _CYLINDER:
        return min(a - math.sqrt(x * x + y * y), b - abs(z))
    depth = math.inf
    for h in range(packed.hull_plane_start[part], packed.hull_plane_start[part + 1]):
        n = packed.hull_planes
        depth = min(depth, -(n[h, 0] * x + n[h, 1] * y + n[h, 2] * z + n[h, 3]))
        if depth <= 0.0:
            return depth
    return depth


@njit(cache=True, error_model="numpy")
def hand_points_in_object(sdf_values, origin, inv_spacing, packed, X_OH, X_HL):  # type: ignore[no-untyped-def]
    """Largest depth of the hand's surface points in the object's distance grid, metres, >= 0."""
    X = np.empty((3, 4))
    deepest = 0.0
    for link in range(packed.link_radius.shape[0]):
        start, end = packed.link_point_start[link], packed.link_point_start[link + 1]
        if start == end:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        if link_is_farther(sdf_values, origin, inv_spacing, packed, X, link, 0.0):
            continue
        for k in range(start, end):
            p = packed.point_L[k]
            x, y, z = moved_point(X, p[0], p[1], p[2])
            deepest = max(deepest, -grid_distance(sdf_values, origin, inv_spacing, x, y, z))
    return deepest


@njit(cache=True, error_model="numpy")
def object_points_in_hand(probe, packed, X_OH, X_HL):  # type: ignore[no-untyped-def]
    """Largest depth of object surface points (`ProbePoints` in O) in the hand's convex parts, metres, >= 0.

    A depth changes by no more than the way a point moves, so a group whose ball's middle is farther outside
    than the ball's radius is passed over.
    """
    return object_points_in_hand_using(probe, packed, X_OH, X_HL, new_poses())


@njit(cache=True, error_model="numpy")
def object_points_in_hand_using(probe, packed, X_OH, X_HL, poses):  # type: ignore[no-untyped-def]
    """`object_points_in_hand` without allocating, for CPU and GPU."""
    X_OL, X_LO, X_PO = poses.first, poses.second, poses.third
    deepest = 0.0
    for part in range(len(packed.part_kind)):
        link_pose_in_object(X_OH, X_HL, packed.part_link[part], X_OL)
        m, radius = packed.part_centre, packed.part_radius[part]
        cx, cy, cz = moved_point(X_OL, m[part, 0], m[part, 1], m[part, 2])
        rigid_inverse(X_OL, X_LO)
        rigid_product(packed.part_X_PL[part], X_LO, X_PO)
        for g in range(len(probe.radius)):
            x, y, z = probe.centre[g, 0], probe.centre[g, 1], probe.centre[g, 2]
            if (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 >= (radius + probe.radius[g]) ** 2:
                continue
            u, v, w = moved_point(X_PO, x, y, z)
            if depth_in_part(packed, part, u, v, w) + probe.radius[g] <= deepest:
                continue
            for i in range(probe.start[g], probe.start[g + 1]):
                u, v, w = moved_point(X_PO, probe.points[i, 0], probe.points[i, 1], probe.points[i, 2])
                deepest = max(deepest, depth_in_part(packed, part, u, v, w))
    return deepest


@njit(cache=True, error_model="numpy")
def _link_points_in_part(packed, X_HL, link, part, poses):  # type: ignore[no-untyped-def]
    """Largest depth of the surface points of `link` in a part of another link."""
    X_LH, X_PH, X_PA = poses.first, poses.second, poses.third
    rigid_inverse(X_HL[packed.part_link[part]], X_LH)
    rigid_product(packed.part_X_PL[part], X_LH, X_PH)
    rigid_product(X_PH, X_HL[link], X_PA)
    deepest = 0.0
    for k in range(packed.link_point_start[link], packed.link_point_start[link + 1]):
        x, y, z = moved_point(X_PA, packed.point_L[k, 0], packed.point_L[k, 1], packed.point_L[k, 2])
        deepest = max(deepest, depth_in_part(packed, part, x, y, z))
    return deepest


@njit(cache=True, error_model="numpy")
def _sphere_gap(X_HL, link_a, centre_a, radius_a, link_b, centre_b, radius_b):  # type: ignore[no-untyped-def]
    """Distance between two bounding spheres given in their links' frames, metres."""
    squared = 0.0
    for r in range(3):
        a = X_HL[link_a, r, 3]
        b = X_HL[link_b, r, 3]
        for c in range(3):
            a += X_HL[link_a, r, c] * centre_a[c]
            b += X_HL[link_b, r, c] * centre_b[c]
        squared += (a - b) ** 2
    return math.sqrt(squared) - radius_a - radius_b


@njit(cache=True, error_model="numpy")
def self_penetration(packed, X_HL):  # type: ignore[no-untyped-def]
    """Largest depth of one link's surface points in the parts of another, over `packed.self_pairs`, metres, >= 0."""
    return self_penetration_using(packed, X_HL, new_poses())


@njit(cache=True, error_model="numpy")
def self_penetration_using(packed, X_HL, poses):  # type: ignore[no-untyped-def]
    """`self_penetration` without allocating, for CPU and GPU."""
    deepest = 0.0
    for s in range(len(packed.self_pairs)):
        a, b = packed.self_pairs[s, 0], packed.self_pairs[s, 1]
        gap = _sphere_gap(
            X_HL, a, packed.link_centre[a], packed.link_radius[a], b, packed.link_centre[b], packed.link_radius[b]
        )
        if gap >= 0.0:
            continue
        for part in range(len(packed.part_kind)):
            owner = packed.part_link[part]
            if owner not in (a, b):
                continue
            other = b if owner == a else a
            gap = _sphere_gap(
                X_HL,
                owner,
                packed.part_centre[part],
                packed.part_radius[part],
                other,
                packed.link_centre[other],
                packed.link_radius[other],
            )
            if gap < 0.0:
                deepest = max(deepest, _link_points_in_part(packed, X_HL, other, part, poses))
    return deepest


@njit(cache=True, error_model="numpy")
def _depths(probe, sdf_values, origin, inv_spacing, packed, X_OH, q, out):  # type: ignore[no-untyped-def]
    X_HL = np.empty((len(packed.parents), 4, 4))
    for n in range(len(X_OH)):
        pose_links(packed, q[n], X_HL)
        out[0, n] = hand_points_in_object(sdf_values, origin, inv_spacing, packed, X_OH[n], X_HL)
        out[1, n] = object_points_in_hand(probe, packed, X_OH[n], X_HL)
        out[2, n] = self_penetration(packed, X_HL)


def penetration_depths(
    packed: PackedHand, sdf: SdfGrid, points_O: np.ndarray | ProbePoints, *, X_OH: np.ndarray, q: np.ndarray
) -> PenetrationDepths:
    """Depths of N grasps.

    Args:
        packed: the hand; its points decide the resolution.
        sdf: the object's distances.
        points_O: (P, 3) the object's surface points, object frame, metres; or these in groups (`probe_surface`).
        X_OH: (N, 4, 4) float64; q: (N, J) float64.
    """
    out = np.zeros((3, len(X_OH)))
    probe = points_O if isinstance(points_O, ProbePoints) else group_points(points_O)
    X, joints = np.ascontiguousarray(X_OH, np.float64), np.ascontiguousarray(q, np.float64)
    _depths(probe, sdf.values, sdf.origin, sdf.inv_spacing, packed, X, joints, out)
    return PenetrationDepths(*out)


@njit(cache=True, error_model="numpy")
def _object_depths(probe, packed, X_OH, q, out):  # type: ignore[no-untyped-def]
    X_HL = np.empty((len(packed.parents), 4, 4))
    for n in range(len(X_OH)):
        pose_links(packed, q[n], X_HL)
        out[n] = object_points_in_hand(probe, packed, X_OH[n], X_HL)


def object_depths(packed: PackedHand, probe: ProbePoints, *, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N,) largest depth of the object's points in the exact parts of N posed hands, metres, >= 0; no grid is used."""
    out = np.zeros(len(X_OH))
    _object_depths(probe, packed, np.ascontiguousarray(X_OH, np.float64), np.ascontiguousarray(q, np.float64), out)
    return out


def _links(packed: PackedHand, q: np.ndarray) -> np.ndarray:
    X_HL = np.empty((len(packed.parents), 4, 4))
    pose_links(packed, np.ascontiguousarray(q, np.float64), X_HL)
    return X_HL


def mesh_depths(
    packed: PackedHand, mesh: Mesh, sdf: SdfGrid, *, X_OH: np.ndarray, q: np.ndarray, tree: MeshTree | None = None
) -> np.ndarray:
    """(N,) largest depth of the hand's points in the object's mesh at N poses and postures, metres, >= 0.

    The distances are the mesh's own; `sdf` only tells which points may be the deepest. With the `tree` of the mesh they
    are the same to rounding, and many times faster for a few grasps.
    """
    depth = np.zeros(len(X_OH))
    owner, points_O = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    for n in range(len(X_OH)):
        X_OL = X_OH[n] @ _links(packed, q[n])
        points = np.empty((len(packed.point_L), 3))
        for link in range(len(X_OL)):
            own = slice(packed.link_point_start[link], packed.link_point_start[link + 1])
            points[own] = packed.point_L[own] @ X_OL[link, :3, :3].T + X_OL[link, :3, 3]
        by_grid = query_grid_numpy(sdf, points)
        # the grid is off by less than a cell either way
        near = by_grid < min(by_grid.min(initial=np.inf) + 2.0 * sdf.spacing, _NEAR_M)
        points_O.append(points[near])
        owner.append(np.full(int(near.sum()), n))
    points = np.concatenate(points_O)
    distance = signed_distance(mesh, points) if tree is None else tree_distance(tree, mesh, points)
    np.maximum.at(depth, np.concatenate(owner), -distance)
    return depth
