# ruff: noqa: NPY002 - compiled code has the old generator only, seeded per scene
"""What is around the hand in random scenes: solids, clutter, a table, a wall, as labelled triangles."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit

BACKGROUND, TABLE, OBJECT, HAND, FOREARM, CLUTTER = range(6)


@njit(cache=True, error_model="numpy")
def random_rotation(R):  # type: ignore[no-untyped-def]
    """A uniformly random rotation, of a random unit quaternion."""
    w, x, y, z = np.random.normal(), np.random.normal(), np.random.normal(), np.random.normal()
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, error_model="numpy", inline="always")
def moved_to(X, p, out):  # type: ignore[no-untyped-def]
    for i in range(3):
        out[i] = X[i, 0] * p[0] + X[i, 1] * p[1] + X[i, 2] * p[2] + X[i, 3]


@njit(cache=True, error_model="numpy", inline="always")
def add_face(room, a, b, c, label):  # type: ignore[no-untyped-def]
    face = room.counts[1]
    room.faces[face, 0], room.faces[face, 1], room.faces[face, 2] = a, b, c
    room.labels[face] = label
    room.counts[1] = face + 1


@njit(cache=True, error_model="numpy")
def place_solid(kit, solid, X, size, label, room):  # type: ignore[no-untyped-def]
    """A solid of the bank at X (4, 4), `size` times as large; `size` per axis."""
    first, start = room.counts[0], kit.point_start[solid]
    count, p = kit.point_start[solid + 1] - start, np.empty(3)
    for v in range(count):
        for i in range(3):
            p[i] = size[i] * kit.solid_points[start + v, i]
        moved_to(X, p, room.points[first + v])
    for f in range(kit.face_start[solid], kit.face_start[solid + 1]):
        add_face(
            room, first + kit.solid_faces[f, 0], first + kit.solid_faces[f, 1], first + kit.solid_faces[f, 2], label
        )
    room.counts[0] = first + count


@njit(cache=True, error_model="numpy")
def lowest_height(room, up):  # type: ignore[no-untyped-def]
    low = np.inf
    for v in range(room.counts[0]):
        low = min(low, room.points[v, 0] * up[0] + room.points[v, 1] * up[1] + room.points[v, 2] * up[2])
    return low


@njit(cache=True, error_model="numpy")
def place_clutter(kit, palm, up, floor, has_table, room):  # type: ignore[no-untyped-def]
    """A solid beside the hand: on the table, standing or lying, or somewhere in the air."""
    solid = np.random.randint(kit.point_start.shape[0] - 1)
    X, size = np.eye(4), np.random.uniform(0.6, 1.4, 3)
    R = X[:3, :3]
    random_rotation(R)
    if has_table and np.random.random() < 0.7:
        _stand(R, up)
    reach, side = np.random.uniform(0.09, 0.4), np.empty(3)
    for i in range(3):
        side[i] = np.random.normal()
    along = side[0] * up[0] + side[1] * up[1] + side[2] * up[2]
    if has_table:
        side -= along * up
    side /= math.sqrt(side[0] ** 2 + side[1] ** 2 + side[2] ** 2) + 1e-9
    X[:3, 3] = palm + reach * side
    first = room.counts[0]
    place_solid(kit, solid, X, size, CLUTTER, room)
    if has_table:
        low = np.inf
        for v in range(first, room.counts[0]):
            low = min(low, room.points[v, 0] * up[0] + room.points[v, 1] * up[1] + room.points[v, 2] * up[2])
        for v in range(first, room.counts[0]):
            room.points[v] += (floor - low) * up


@njit(cache=True, error_model="numpy")
def _stand(R, up):  # type: ignore[no-untyped-def]
    """Turn a rotation the short way so that its z axis points up."""
    z = R[:, 2].copy()
    axis = np.cross(z, up)
    c = z[0] * up[0] + z[1] * up[1] + z[2] * up[2]
    if c < -0.999:
        return
    for column in range(3):
        v = R[:, column].copy()
        cross = np.cross(axis, v)
        dot = axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]
        for i in range(3):
            R[i, column] = c * v[i] + cross[i] + axis[i] * dot / (1.0 + c)


@njit(cache=True, error_model="numpy")
def place_table(palm, up, floor, room):  # type: ignore[no-untyped-def]
    """A rectangle at height `floor` along `up`, under the palm, of random size and turn."""
    side = np.cross(up, np.array([0.3, 0.2, 1.0]))
    side /= math.sqrt(side[0] ** 2 + side[1] ** 2 + side[2] ** 2)
    front = np.cross(side, up)
    turn = np.random.uniform(0.0, 2.0 * math.pi)
    a, b = math.cos(turn) * side + math.sin(turn) * front, math.cos(turn) * front - math.sin(turn) * side
    height = palm[0] * up[0] + palm[1] * up[1] + palm[2] * up[2]
    middle = palm + (floor - height) * up + np.random.uniform(-0.3, 0.3) * a + np.random.uniform(-0.3, 0.3) * b
    _place_quad(middle, a * np.random.uniform(0.35, 1.2), b * np.random.uniform(0.35, 1.2), TABLE, room)


@njit(cache=True, error_model="numpy")
def place_wall(palm, room):  # type: ignore[no-untyped-def]
    """A large plane behind the hand, roughly facing the camera."""
    distance = 0.15 + 2.5 * np.random.random() ** 2
    tilt_x, tilt_y = 0.4 * np.random.normal(), 0.4 * np.random.normal()
    a, b, middle = np.zeros(3), np.zeros(3), palm * (1.0 + distance / palm[2])
    a[0], a[2], b[1], b[2] = 4.0, 4.0 * min(max(tilt_x, -0.8), 0.8), 4.0, 4.0 * min(max(tilt_y, -0.8), 0.8)
    _place_quad(middle, a, b, BACKGROUND, room)


@njit(cache=True, error_model="numpy")
def _place_quad(middle, a, b, label, room):  # type: ignore[no-untyped-def]
    first = room.counts[0]
    for i in range(3):
        room.points[first, i] = middle[i] - a[i] - b[i]
        room.points[first + 1, i] = middle[i] + a[i] - b[i]
        room.points[first + 2, i] = middle[i] + a[i] + b[i]
        room.points[first + 3, i] = middle[i] - a[i] + b[i]
    room.counts[0] = first + 4
    add_face(room, first, first + 1, first + 2, label)
    add_face(room, first, first + 2, first + 3, label)
