"""Where a posed hand touches an object."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point, rigid_product
from neuralgrasps.geometry.sdf_grid import grid_distance, grid_distance_gradient

THRESHOLD_M = 2.5e-3
MAX_PER_LINK = 3
MIN_SEPARATION_M = 1.0e-3  # nearer points of one link count as one contact


class ContactScratch(NamedTuple):
    """What `find_contacts_using` overwrites; K is the most surface points of one link (`most_points`).

    Attributes:
        points, normals: (K, 3) float64; gap: (K,) float64; pose: (3, 4) float64.
    """

    points: np.ndarray
    normals: np.ndarray
    gap: np.ndarray
    pose: np.ndarray


@njit(cache=True, error_model="numpy")
def most_points(packed):  # type: ignore[no-untyped-def]
    """Most surface points of one link of a `PackedHand`, at least 1."""
    most = 1
    for link in range(packed.link_radius.shape[0]):
        most = max(most, packed.link_point_start[link + 1] - packed.link_point_start[link])
    return most


@njit(cache=True, error_model="numpy")
def link_pose_in_object(X_OH, X_HL, link, out):  # type: ignore[no-untyped-def]
    """out (3, 4) = X_OH @ X_HL[link], upper three rows."""
    rigid_product(X_OH, X_HL[link], out)


@njit(cache=True, error_model="numpy")
def link_is_farther(values, origin, inv_spacing, packed, X_OL, link, reach):  # type: ignore[no-untyped-def]
    """Whether no point of a link can be within `reach` of the object, by its bounding sphere; may miss some."""
    c = packed.link_centre[link]
    x, y, z = moved_point(X_OL, c[0], c[1], c[2])
    # the grid's distance is off by less than a cell
    return grid_distance(values, origin, inv_spacing, x, y, z) > packed.link_radius[link] + reach + 1.0 / inv_spacing


@njit(cache=True, error_model="numpy")
def _touching_points(values, origin, inv_spacing, packed, X, link, threshold, points, normals):  # type: ignore[no-untyped-def]
    """Points of a link nearer than `threshold`, projected on the object, the nearest first; returns how many."""
    count, nearest, closest = 0, 0, math.inf
    for k in range(packed.link_point_start[link], packed.link_point_start[link + 1]):
        x, y, z = moved_point(X, packed.point_L[k, 0], packed.point_L[k, 1], packed.point_L[k, 2])
        if grid_distance(values, origin, inv_spacing, x, y, z) > threshold:
            continue
        d, gx, gy, gz = grid_distance_gradient(values, origin, inv_spacing, x, y, z)
        size = math.sqrt(gx * gx + gy * gy + gz * gz)
        if size < 0.1:  # deep inside, on the medial axis: no direction to the surface
            continue
        gx, gy, gz = gx / size, gy / size, gz / size
        points[count, 0], points[count, 1], points[count, 2] = x - d * gx, y - d * gy, z - d * gz
        normals[count, 0], normals[count, 1], normals[count, 2] = gx, gy, gz
        if d < closest:
            nearest, closest = count, d
        count += 1
    for k in range(3):
        points[0, k], points[nearest, k] = points[nearest, k], points[0, k]
        normals[0, k], normals[nearest, k] = normals[nearest, k], normals[0, k]
    return count


@njit(cache=True, error_model="numpy")
def find_contacts(  # type: ignore[no-untyped-def]
    sdf_values, origin, inv_spacing, packed, X_OH, X_HL, threshold, max_per_link, out_points, out_normals, out_links
):
    """Contacts of one posed hand: per link at most `max_per_link` far-apart points, nearest first.

    Args:
        sdf_values (nx, ny, nz), origin (3,), inv_spacing: the object's `SdfGrid`, metres.
        packed: `PackedHand`; X_OH: (4, 4); X_HL: (L, 4, 4) link poses.
        threshold: metres; hand surface points nearer to the object (or inside it) touch.
        max_per_link: points kept per link, by farthest point sampling from the link's nearest point.
        out_points, out_normals: (>= max contacts, 3) float64, written: contact on the object's surface and the outward
            unit normal there (gradient of the distance), object frame. out_links: int32, written: the link.
    Returns:
        the number of contacts; stops early when the outputs are full.
    """
    most = most_points(packed)
    scratch = ContactScratch(np.empty((most, 3)), np.empty((most, 3)), np.empty(most), np.empty((3, 4)))
    return find_contacts_using(
        sdf_values, origin, inv_spacing, packed, X_OH, X_HL, threshold, max_per_link,
        out_points, out_normals, out_links, scratch,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def find_contacts_using(  # type: ignore[no-untyped-def]
    sdf_values, origin, inv_spacing, packed, X_OH, X_HL, threshold, max_per_link, out_points, out_normals, out_links,
    scratch,
):  # fmt: skip
    """`find_contacts` without allocating, for CPU and GPU; `scratch` is a `ContactScratch`."""
    points, normals, gap, X = scratch.points, scratch.normals, scratch.gap, scratch.pose
    total = 0
    for link in range(packed.link_radius.shape[0]):
        if packed.link_point_start[link] == packed.link_point_start[link + 1]:
            continue
        link_pose_in_object(X_OH, X_HL, link, X)
        if link_is_farther(sdf_values, origin, inv_spacing, packed, X, link, threshold):
            continue
        count = _touching_points(sdf_values, origin, inv_spacing, packed, X, link, threshold, points, normals)
        for i in range(count):
            gap[i] = math.inf
        chosen = 0
        for _ in range(min(count, max_per_link)):
            if total >= len(out_links):
                return total
            for k in range(3):
                out_points[total, k] = points[chosen, k]
                out_normals[total, k] = normals[chosen, k]
            out_links[total] = link
            farthest, last = 0.0, chosen
            for i in range(count):
                squared = 0.0
                for k in range(3):
                    squared += (points[i, k] - points[last, k]) ** 2
                gap[i] = min(gap[i], squared)
                if gap[i] > farthest:
                    farthest, chosen = gap[i], i
            total += 1
            if farthest < MIN_SEPARATION_M * MIN_SEPARATION_M:
                break
    return total
