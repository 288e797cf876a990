"""Object and posed hand in front of a ring of cameras, hiding each other in one z-buffer a view. Torch-free.

The object's part of every buffer is rendered once for all scenes that share a ring. The hand's parts are convex and
known exactly, so each pixel's ray is cut with them exactly: no tessellation. Of all pixels that see a shape, one is
kept a small cubic cell, the first in order of view, row and column: enough to thin evenly afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.dataset.camera_ring import HEIGHT, WIDTH, ObjectViews, ring_intrinsics
from neuralgrasps.dataset.hand_surface import hand_normals, packed_part_poses
from neuralgrasps.dataset.part_rays import ray_part
from neuralgrasps.geometry.pose_kernels import moved_point, rigid_inverse, rigid_product, turned_vector
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.packed import PackedHand

_HULL, _CAPSULE, _SPHERE = int(PartKind.HULL), int(PartKind.CAPSULE), int(PartKind.SPHERE)
_EMPTY = -1
_LIMIT = 1 << 16  # cells of a hand


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectCells:
    """The cell of each pixel of `ObjectViews`, (total,) int32, negative where no front face is seen; and how many."""

    cell: np.ndarray
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPoints:
    """What is visible of a shape, about one point a cell: (K, 3) float64 points and unit normals, object frame, m."""

    points_O: np.ndarray
    normals_O: np.ndarray


def part_boxes(packed: PackedHand) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half sizes (Np, 3) of each part's box in the part frame, metres."""
    middle, half = np.zeros((len(packed.part_kind), 3)), packed.part_size.copy()
    for k, kind in enumerate(packed.part_kind):
        a, b, _ = packed.part_size[k]
        if kind == _HULL:
            corners = packed.hull_triangles[packed.hull_tri_start[k] : packed.hull_tri_start[k + 1]].reshape(-1, 3)
            low, high = corners.min(axis=0), corners.max(axis=0)
            middle[k], half[k] = (low + high) / 2, (high - low) / 2
        elif kind != PartKind.BOX:
            half[k] = a, a, {_SPHERE: a, _CAPSULE: a + b}.get(int(kind), b)
    return middle, half


def hand_reach(packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, centre_O: np.ndarray) -> float:
    """Radius of a ball around `centre_O` that holds the posed hand, metres."""
    middle, half = part_boxes(packed)
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    X_OP = packed_part_poses(packed, X_OH, q)
    points = np.einsum("pij,pcj->pci", X_OP[:, :3, :3], middle[:, None] + corners * half[:, None])
    return float(np.linalg.norm(points + X_OP[:, None, :3, 3] - centre_O, axis=-1).max())


def object_cells(views: ObjectViews, size_m: float) -> ObjectCells:
    """Sort the pixels that see the object into cubic cells of `size_m`."""
    k = ring_intrinsics()
    slots = 1 << max(10, math.ceil(math.log2(2 * len(views.depth) + 2)))
    cell = np.empty(len(views.depth), np.int32)
    count = _object_cells(
        views.X_OC, views.boxes, views.starts, views.depth, views.face, k.fx, k.cx, k.cy, 1.0 / size_m, slots, cell
    )
    return ObjectCells(cell=cell, count=count)


@njit(cache=True, inline="always", error_model="numpy")
def _key(x, y, z, per_m):  # type: ignore[no-untyped-def]
    """Number of the cell, of `per_m` a metre, that a point lies in; cells up to 2^20 from the origin each way."""
    i, j, k = math.floor(x * per_m), math.floor(y * per_m), math.floor(z * per_m)
    return ((i & 0x1FFFFF) << 42) | ((j & 0x1FFFFF) << 21) | (k & 0x1FFFFF)


@njit(cache=True, inline="always", error_model="numpy")
def _slot(table, key):  # type: ignore[no-untyped-def]
    """Where `key` is in an open table, or would be."""
    mask = table.shape[0] - 1
    place = ((key ^ (key >> 21) * 19349663 ^ (key >> 42) * 73856093) * 2654435761 >> 7) & mask
    while table[place] != _EMPTY and table[place] != key:
        place = (place + 1) & mask
    return place


@njit(cache=True, error_model="numpy")
def _object_cells(X_OC, boxes, starts, depth, face, focal, cx, cy, per_m, slots, cell):  # type: ignore[no-untyped-def]
    table, number = np.full(slots, _EMPTY, np.int64), np.empty(slots, np.int32)
    count = 0
    for view in range(X_OC.shape[0]):
        at = starts[view]
        for v in range(boxes[view, 0], boxes[view, 1]):
            for u in range(boxes[view, 2], boxes[view, 3]):
                cell[at] = face[at]
                if face[at] >= 0:
                    z = np.float64(depth[at])
                    x, y, z = moved_point(X_OC[view], (u - cx) / focal * z, (v - cy) / focal * z, z)
                    key = _key(x, y, z, per_m)
                    place = _slot(table, key)
                    if table[place] == _EMPTY:
                        table[place], number[place] = key, count
                        count += 1
                    cell[at] = number[place]
                at += 1
    return count


def seen_in_scene(
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    views: ObjectViews,
    cells: ObjectCells,
    normals_O: np.ndarray,
    hand_cell_m: float,
) -> tuple[SeenPoints, SeenPoints]:
    """The points of object and hand that the ring sees of a scene, about one a cell.

    Args:
        packed, X_OH (4, 4), q (J,): the posed hand, all of it within the ring's view.
        views, cells: of the object alone.
        normals_O: (F, 3) normals of the object's faces.
        hand_cell_m: size of the hand's cells, metres.
    """
    X_OP = packed_part_poses(packed, X_OH, q)
    k = ring_intrinsics()
    shapes = (packed.part_kind, packed.part_size, packed.hull_plane_start, packed.hull_planes)
    seen = (views.X_OC, views.boxes, views.starts, views.depth, cells.cell)
    points, parts = np.empty((_LIMIT, 3)), np.empty(_LIMIT, np.int64)
    count = -1
    while count < 0:
        first = np.full(cells.count, _EMPTY, np.int64)
        count = _render(
            shapes, X_OP, *part_boxes(packed), seen, k.fx, k.cx, k.cy, 1.0 / hand_cell_m, first, points, parts
        )
        hand_cell_m *= 1.5  # too many cells
    hand = SeenPoints(points_O=points[:count], normals_O=hand_normals(packed, X_OP, points[:count], parts[:count]))
    return _object_points(views, first[first != _EMPTY], normals_O), hand


def _object_points(views: ObjectViews, pixel: np.ndarray, normals_O: np.ndarray) -> SeenPoints:
    """Back-project pixels of the object, given as places in `views.depth`."""
    k = ring_intrinsics()
    view = np.searchsorted(views.starts, pixel, side="right") - 1
    top, _, left, right = views.boxes[view].T
    row, column = np.divmod(pixel - views.starts[view], right - left)
    z = views.depth[pixel].astype(np.float64)
    points_C = np.stack([(column + left - k.cx) / k.fx * z, (row + top - k.cy) / k.fy * z, z], axis=1)
    X_OC = views.X_OC[view]
    points_O = np.einsum("nij,nj->ni", X_OC[:, :3, :3], points_C) + X_OC[:, :3, 3]
    return SeenPoints(points_O=points_O, normals_O=normals_O[views.face[pixel]])


@njit(cache=True, error_model="numpy")
def _outline(X_CP, middle, half, focal, cx, cy, spans):  # type: ignore[no-untyped-def]
    """First and one-past-last row in which a part's box can be seen; `spans` (HEIGHT, 2) gets these rows' columns."""
    corners = np.empty((8, 2))
    low, high = math.inf, -math.inf
    for c in range(8):
        sx, sy, sz = 2.0 * (c & 1) - 1.0, 1.0 * (c & 2) - 1.0, 0.5 * (c & 4) - 1.0
        x, y, z = moved_point(X_CP, middle[0] + sx * half[0], middle[1] + sy * half[1], middle[2] + sz * half[2])
        corners[c, 0], corners[c, 1] = x / z * focal + cx, y / z * focal + cy
        low, high = min(low, corners[c, 1]), max(high, corners[c, 1])
    top, bottom = max(math.ceil(low), 0), min(math.floor(high) + 1, HEIGHT)
    for v in range(top, bottom):
        spans[v, 0], spans[v, 1] = WIDTH, 0
    for c in range(8):  # where the edges of the box cross each row of pixels
        for axis in range(3):
            if c & (1 << axis):
                continue
            a, b = corners[c], corners[c | (1 << axis)]
            if a[1] > b[1]:
                a, b = b, a
            slope = (b[0] - a[0]) / (b[1] - a[1]) if b[1] > a[1] else 0.0
            for v in range(max(math.ceil(a[1]), top), min(math.floor(b[1]) + 1, bottom)):
                u = a[0] + slope * (v - a[1])
                spans[v, 0] = max(min(spans[v, 0], math.ceil(u - 1e-6)), 0)
                spans[v, 1] = min(max(spans[v, 1], math.floor(u + 1e-6) + 1), WIDTH)
    return top, bottom


@njit(cache=True, error_model="numpy")
def _cast(shapes, part, rows, spans, X_PC, focal, cx, cy, nearest, owner):  # type: ignore[no-untyped-def]
    """Cut the rays of the pixels in `spans` with one part: z-depths into `nearest`, the part seen into `owner`."""
    kinds, sizes, plane_start, planes = shapes
    kind, size, own = kinds[part], sizes[part], planes[plane_start[part] : plane_start[part + 1]]
    ox, oy, oz = X_PC[0, 3], X_PC[1, 3], X_PC[2, 3]
    for v in range(rows[0], rows[1]):
        ax, ay, az = turned_vector(X_PC, -cx / focal, (v - cy) / focal, 1.0)
        for u in range(spans[v, 0], spans[v, 1]):
            t = u / focal
            dx, dy, dz = ax + t * X_PC[0, 0], ay + t * X_PC[1, 0], az + t * X_PC[2, 0]
            z = ray_part(kind, size, own, ox, oy, oz, dx, dy, dz)
            if z < nearest[v, u]:
                nearest[v, u], owner[v, u] = z, part


@njit(cache=True, error_model="numpy")
def _mark_object(box, start, cell, owner, first):  # type: ignore[no-untyped-def]
    """Note in `first` the first pixel that sees each of the object's cells."""
    for v in range(box[0], box[1]):
        at = start + (v - box[0]) * (box[3] - box[2]) - box[2]
        for u in range(box[2], box[3]):
            seen = cell[at + u]
            if seen >= 0 and first[seen] == _EMPTY and owner[v, u] == _EMPTY:
                first[seen] = at + u


@njit(cache=True, error_model="numpy")
def _keep_hand(X_OC, window, nearest, owner, focal, cx, cy, per_m, table, points, parts, count):  # type: ignore[no-untyped-def]
    """Append one point for each new cell of the hand; returns how many there are, -1 when they are too many."""
    last = np.int64(_EMPTY)
    for v in range(window[0], window[1]):
        for u in range(window[2], window[3]):
            if owner[v, u] == _EMPTY:
                continue
            z = nearest[v, u]
            x, y, z = moved_point(X_OC, (u - cx) / focal * z, (v - cy) / focal * z, z)
            key = _key(x, y, z, per_m)
            if key == last:
                continue
            last = key
            place = _slot(table, key)
            if table[place] == _EMPTY:
                if count == points.shape[0]:
                    return -1
                table[place] = key
                points[count, 0], points[count, 1], points[count, 2] = x, y, z
                parts[count] = owner[v, u]
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def _render(shapes, X_OP, middle, half, views, focal, cx, cy, per_m, first, points, parts):  # type: ignore[no-untyped-def]
    """Fill `first` (object cells,) and `points`, `parts` of the hand; returns the number of these, or -1."""
    X_OC, boxes, starts, depth, cell = views
    nearest, owner = np.full((HEIGHT, WIDTH), math.inf), np.full((HEIGHT, WIDTH), _EMPTY, np.int32)
    table = np.full(2 * points.shape[0], _EMPTY, np.int64)
    spans, window = np.empty((HEIGHT, 2), np.int64), np.empty(4, np.int64)
    X_PO, X_CO = np.empty((X_OP.shape[0], 3, 4)), np.empty((3, 4))
    X_PC, X_CP = np.empty((3, 4)), np.empty((3, 4))
    for part in range(X_OP.shape[0]):
        rigid_inverse(X_OP[part], X_PO[part])
    count = 0
    for view in range(X_OC.shape[0]):
        box, width = boxes[view], boxes[view, 3] - boxes[view, 2]
        for v in range(box[0], box[1]):
            at = starts[view] + (v - box[0]) * width
            for u in range(width):
                nearest[v, box[2] + u] = depth[at + u]
        window[:] = HEIGHT, 0, WIDTH, 0
        rigid_inverse(X_OC[view], X_CO)
        for part in range(X_OP.shape[0]):
            rigid_product(X_CO, X_OP[part], X_CP)
            rows = _outline(X_CP, middle[part], half[part], focal, cx, cy, spans)
            rigid_product(X_PO[part], X_OC[view], X_PC)
            _cast(shapes, part, rows, spans, X_PC, focal, cx, cy, nearest, owner)
            window[0], window[1] = min(window[0], rows[0]), max(window[1], rows[1])
            for v in range(rows[0], rows[1]):
                window[2], window[3] = min(window[2], spans[v, 0]), max(window[3], spans[v, 1])
        _mark_object(box, starts[view], cell, owner, first)
        count = _keep_hand(X_OC[view], window, nearest, owner, focal, cx, cy, per_m, table, points, parts, count)
        if count < 0:
            return count
        nearest[window[0] : window[1], window[2] : window[3]] = math.inf
        owner[window[0] : window[1], window[2] : window[3]] = _EMPTY
        nearest[box[0] : box[1], box[2] : box[3]] = math.inf
    return count
