"""A hand's surface points in small clusters, so that the nearest one to an object is found without visiting all."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.grasps.contact import link_pose_in_object
from neuralgrasps.hands.packed import PackedHand

POINTS_PER_CLUSTER = 12


class Clusters(NamedTuple):
    """Runs of consecutive points of a `PackedHand`, each within a ball around its first point.

    Attributes:
        of_link (L + 1,): clusters of link i are of_link[i]:of_link[i + 1].
        start (C + 1,): points of cluster c are start[c]:start[c + 1]; point start[c] is its centre.
        radius (C,): metres.
    """

    of_link: np.ndarray
    start: np.ndarray
    radius: np.ndarray


def cluster_points(packed: PackedHand, *, size: int = POINTS_PER_CLUSTER) -> tuple[PackedHand, Clusters]:
    """The same hand with the points of every link ordered by cluster, and the clusters (about `size` points each)."""
    order: list[np.ndarray] = []
    of_link, start, radius = [0], [0], []
    for link in range(len(packed.link_radius)):
        own = np.arange(packed.link_point_start[link], packed.link_point_start[link + 1])
        if len(own):
            points = packed.point_L[own]
            centres = farthest_points(points, math.ceil(len(own) / size))
            distance = np.linalg.norm(points[:, None] - points[centres], axis=-1)
            nearest = distance.argmin(axis=1)
            for c in range(len(centres)):
                members = np.flatnonzero(nearest == c)
                members = members[np.argsort(distance[members, c], kind="stable")]
                order.append(own[members])
                start.append(start[-1] + len(members))
                radius.append(distance[members[-1], c])
        of_link.append(len(radius))
    index = np.concatenate(order)
    ordered = packed._replace(
        point_L=np.ascontiguousarray(packed.point_L[index]),
        point_normal_L=np.ascontiguousarray(packed.point_normal_L[index]),
    )
    return ordered, Clusters(np.array(of_link), np.array(start), np.array(radius))


@njit(cache=True, error_model="numpy")
def most_clusters(clusters):  # type: ignore[no-untyped-def]
    """Most clusters of one link."""
    most = 0
    for link in range(clusters.of_link.shape[0] - 1):
        most = max(most, clusters.of_link[link + 1] - clusters.of_link[link])
    return most


@njit(cache=True, error_model="numpy")
def least_distance(values, origin, inv_spacing, x, y, z):  # type: ignore[no-untyped-def]
    """`grid_distance`, but never more than the true distance where the point lies outside the grid.

    The grid's own value there is the distance to the grid's box plus the one stored at its boundary. The object lies
    inside the (convex) box, so the two legs meet at a right angle or a blunt one, and the hypotenuse is a lower bound.
    """
    d = grid_distance(values, origin, inv_spacing, x, y, z)
    squared = 0.0
    for k in range(3):
        p = x if k == 0 else (y if k == 1 else z)
        low = origin[k]
        high = low + (values.shape[k] - 1) / inv_spacing
        if p < low:
            squared += (low - p) ** 2
        elif p > high:
            squared += (p - high) ** 2
    if squared > 0.0:
        d -= math.sqrt(squared)
        d = math.sqrt(d * d + squared)
    return d


@njit(cache=True, error_model="numpy")
def sphere_distance(values, origin, inv_spacing, packed, X, link):  # type: ignore[no-untyped-def]
    """Lower bound of a link's distance to the object, from the link's bounding sphere; X (3, 4) link in object."""
    c = packed.link_centre
    x, y, z = moved_point(X, c[link, 0], c[link, 1], c[link, 2])
    return least_distance(values, origin, inv_spacing, x, y, z) - packed.link_radius[link]


@njit(cache=True, error_model="numpy")
def link_distance(values, origin, inv_spacing, packed, clusters, X, link, limit):  # type: ignore[no-untyped-def]
    """Smallest signed distance of a link's surface points to the object; `limit` when that is nearer."""
    at_centre = np.empty(clusters.of_link[link + 1] - clusters.of_link[link])
    return link_distance_using(values, origin, inv_spacing, packed, clusters, X, link, limit, at_centre)


@njit(cache=True, error_model="numpy")
def link_distance_using(values, origin, inv_spacing, packed, clusters, X, link, limit, at_centre):  # type: ignore[no-untyped-def]
    """`link_distance` without allocating, for CPU and GPU; overwrites `at_centre` (>= clusters of the link,)."""
    first, last = clusters.of_link[link], clusters.of_link[link + 1]
    best = limit
    p = packed.point_L
    for c in range(first, last):
        k = clusters.start[c]
        x, y, z = moved_point(X, p[k, 0], p[k, 1], p[k, 2])
        at_centre[c - first] = least_distance(values, origin, inv_spacing, x, y, z)
        best = min(best, at_centre[c - first])
    for c in range(first, last):
        if at_centre[c - first] - clusters.radius[c] >= best:
            continue
        for k in range(clusters.start[c] + 1, clusters.start[c + 1]):
            x, y, z = moved_point(X, p[k, 0], p[k, 1], p[k, 2])
            best = min(best, least_distance(values, origin, inv_spacing, x, y, z))
    return best


@njit(cache=True, error_model="numpy")
def hand_clearance(values, origin, inv_spacing, packed, clusters, X_OH, X_HL):  # type: ignore[no-untyped-def]
    """Smallest signed distance, metres, of the hand's surface points to the object."""
    X, at_centre = np.empty((3, 4)), np.empty(most_clusters(clusters))
    return hand_clearance_using(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, X, at_centre)


@njit(cache=True, error_model="numpy")
def hand_clearance_using(values, origin, inv_spacing, packed, clusters, X_OH, X_HL, X, at_centre):  # type: ignore[no-untyped-def]
    """`hand_clearance` without allocating, for CPU and GPU; overwrites X (3, 4) and `at_centre` (`most_clusters`,)."""
    best = 1.0e9
    for link in range(packed.link_radius.shape[0]):
        if clusters.of_link[link] == clusters.of_link[link + 1]:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        if sphere_distance(values, origin, inv_spacing, packed, X, link) < best:
            best = link_distance_using(values, origin, inv_spacing, packed, clusters, X, link, best, at_centre)
    return best
