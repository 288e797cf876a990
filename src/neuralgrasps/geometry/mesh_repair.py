"""Repairs of raw triangle arrays: bad vertices, open seams, useless faces, inverted winding. Each says what it did."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from neuralgrasps.geometry.mesh_topology import face_bodies, open_edge_count

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Seams wider than the first tolerance are welded only if that closes edges; 1e-3 of a 20 cm object is 0.2 mm.
_WELD_TOLERANCES = (1e-5, 1e-4, 1e-3)


def drop_bad_vertices(vertices: FloatArray, faces: IntArray, repairs: list[str]) -> tuple[FloatArray, IntArray]:
    """Drop faces that use a vertex that is not finite or does not exist."""
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(vertices).all(axis=1))
    in_range: NDArray[np.bool_] = np.asarray(((faces >= 0) & (faces < len(vertices))).all(axis=1))
    keep = in_range.copy()
    keep[in_range] = finite[faces[in_range]].all(axis=1)
    if not finite.all():
        repairs.append(f"dropped {int((~finite).sum())} vertices that are not finite")
    if not keep.all():
        repairs.append(f"dropped {int((~keep).sum())} faces with a missing or non-finite vertex")
    return np.where(finite[:, None], vertices, 0.0), faces[keep]


def compact(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Drop vertices that no face uses."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def _weld_labels(vertices: FloatArray, distance: float) -> IntArray:
    pairs = cKDTree(vertices).query_pairs(distance, output_type="ndarray")
    n = len(vertices)
    graph = sparse.coo_matrix((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _merge(vertices: FloatArray, faces: IntArray, labels: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices of one label become their first member."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")  # keep the file's vertex order
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[inverse.ravel()[faces]]


def _corners_differ(faces: IntArray) -> NDArray[np.bool_]:
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def merge_equal_vertices(vertices: FloatArray, faces: IntArray, repairs: list[str]) -> tuple[FloatArray, IntArray]:
    """Merge vertices at exactly the same place (split by texture seams or stored per triangle)."""
    _, labels = np.unique(vertices, axis=0, return_inverse=True)
    merged, merged_faces = _merge(vertices, faces, labels.ravel().astype(np.int64))
    if len(merged) < len(vertices):
        repairs.append(f"merged {len(vertices) - len(merged)} repeated vertices")
    return merged, merged_faces


def weld_seams(vertices: FloatArray, faces: IntArray, repairs: list[str]) -> tuple[FloatArray, IntArray]:
    """Close open seams: weld boundary vertices closer than a small part of the extent, widening only while it helps."""
    extent = float(np.ptp(vertices, axis=0).max())
    open_edges = open_edge_count(faces.astype(np.int32))
    for tolerance in _WELD_TOLERANCES:
        if open_edges == 0:
            break
        boundary = boundary_vertices(faces)
        labels = np.arange(len(vertices), dtype=np.int64)
        labels[boundary] = boundary[_first_of_label(_weld_labels(vertices[boundary], tolerance * extent))]
        welded, welded_faces = _merge(vertices, faces, labels)
        welded_faces = welded_faces[_corners_differ(welded_faces)]
        remaining = open_edge_count(welded_faces.astype(np.int32))
        if remaining < open_edges:
            count = len(vertices) - len(welded)
            repairs.append(f"welded {count} vertices along open seams (closer than {tolerance * extent * 1e3:.2g} mm)")
            vertices, faces, open_edges = welded, welded_faces, remaining
    return vertices, faces


def boundary_vertices(faces: IntArray) -> IntArray:
    """Vertices on edges without an oppositely directed partner."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, group = np.unique(low * (faces.max() + 1) + high, return_inverse=True)
    balance = np.bincount(group.ravel(), np.where(edges[:, 0] == low, 1, -1))
    return np.unique(edges[balance[group.ravel()] != 0])


def _first_of_label(labels: IntArray) -> IntArray:
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return first[inverse.ravel()]


def drop_useless_faces(faces: IntArray, repairs: list[str]) -> IntArray:
    """Drop faces that name a vertex twice, and repeated faces.

    A sliver of no area between three distinct vertices stays: dropping it would open the surface, and it does no harm.
    Faces on the same three vertices with opposite winding are the two sides of a sheet and both stay.
    """
    distinct = _corners_differ(faces)
    if not distinct.all():
        repairs.append(f"dropped {int((~distinct).sum())} faces without area")
        faces = faces[distinct]
    if not len(faces):
        return faces
    start = faces.argmin(axis=1)
    rolled = np.stack([faces[np.arange(len(faces)), (start + k) % 3] for k in range(3)], axis=1)
    unique, first = np.unique(rolled, axis=0, return_index=True)
    if len(unique) < len(faces):
        repairs.append(f"dropped {len(faces) - len(unique)} repeated faces")
        faces = faces[np.sort(first)]
    return faces


def fix_winding(vertices: FloatArray, faces: IntArray, repairs: list[str]) -> IntArray:
    """Make neighbours wind alike within each body, then turn the bodies whose volume is negative.

    A body inside another one may be a cavity: it is turned only together with the body around it.
    """
    if open_edge_count(faces.astype(np.int32)):
        faces, turned = _orient_consistently(faces, len(vertices))
        if turned:
            repairs.append(f"turned {turned} faces that were wound against their neighbours")
    count, body = face_bodies(faces.astype(np.int32), len(vertices))
    volumes = _body_volumes(vertices, faces, body, count)
    outer = _enclosing_body(vertices, faces, body, volumes)
    inverted = (volumes < 0)[outer]
    if inverted.any():
        turn = inverted[body]
        repairs.append(f"turned {int(inverted.sum())} inside-out bodies ({int(turn.sum())} faces)")
        faces = np.where(turn[:, None], faces[:, [0, 2, 1]], faces)
    return faces


def _body_volumes(vertices: FloatArray, faces: IntArray, body: NDArray[np.int32], count: int) -> FloatArray:
    """Signed volume of each body, about its own centre so that holes matter least."""
    triangles = vertices[faces]
    centroid = triangles.mean(axis=1)
    number = np.bincount(body, minlength=count)
    centre = np.stack([np.bincount(body, centroid[:, k], count) / number for k in range(3)], axis=1)
    a, b, c = np.moveaxis(triangles - centre[body][:, None], 1, 0)
    return np.bincount(body, np.einsum("ij,ij->i", a, np.cross(b, c)), count) / 6.0


def _enclosing_body(
    vertices: FloatArray, faces: IntArray, body: NDArray[np.int32], volumes: FloatArray
) -> NDArray[np.int64]:
    """For each body the largest other one that contains it, else itself; by its box, then by winding number."""
    count = len(volumes)
    outer = np.arange(count)
    corners = vertices[faces]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, body, corners.min(axis=1))
    np.maximum.at(high, body, corners.max(axis=1))
    size = np.abs(volumes)
    for k in range(count if count > 1 else 0):
        around = np.flatnonzero((low <= low[k]).all(axis=1) & (high >= high[k]).all(axis=1) & (size > size[k]))
        probe = corners[np.argmax(body == k), :1]
        for j in around[np.argsort(-size[around], kind="stable")]:
            if abs(igl.fast_winding_number(vertices, faces[body == j], probe)[0]) > 0.5:
                outer[k] = j
                break
    return outer


def _orient_consistently(faces: IntArray, num_vertices: int) -> tuple[IntArray, int]:
    """Flip the fewer faces of each body so that neighbours across two-faced edges wind alike (breadth first)."""
    count = len(faces)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(count), 3)
    low, high = edges.min(axis=1), edges.max(axis=1)
    order = np.argsort(low * num_vertices + high, kind="stable")
    key = (low * num_vertices + high)[order]
    _, start, size = np.unique(key, return_index=True, return_counts=True)
    first, second = order[start[size == 2]], order[start[size == 2] + 1]
    same_direction = edges[first, 0] == edges[second, 0]  # neighbours that wind against each other
    # Doubled graph: node f is face f as is, node f + count is face f flipped.
    a, b = owner[first], owner[second]
    ends = np.where(same_direction, b + count, b), np.where(same_direction, b, b + count)
    rows, cols = np.concatenate([a, a + count]), np.concatenate(ends)
    graph = sparse.coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, cols)), shape=(2 * count, 2 * count))
    _, label = connected_components(graph, directed=False)
    as_is, flipped = label[:count], label[count:]
    component = np.minimum(as_is, flipped)  # the two copies of one sheet share this
    flip = as_is > flipped
    total, number = np.bincount(component, minlength=label.max() + 1), np.bincount(component, flip, label.max() + 1)
    flip ^= (number > total / 2)[component] & (as_is != flipped)
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces), int(flip.sum())


def is_flat(points: FloatArray) -> bool:
    """Whether points (N, 3) lie in one plane, up to a millionth of their extent."""
    centred = points - points.mean(axis=0)
    spread = np.linalg.eigvalsh(centred.T @ centred)
    return bool(spread[0] <= 1e-12 * spread[2])
