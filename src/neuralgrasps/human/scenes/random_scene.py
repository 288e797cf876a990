# ruff: noqa: NPY002 - compiled code has the old generator only, seeded per scene
"""Random scenes with one right hand, for training images: what it holds, its forearm, a table, things around.

A scene is triangles with labels in the camera frame; `draw_scene` renders it into any camera. The same seed gives the
same scene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.raster import NEAR_M, raster_labels
from neuralgrasps.human.scenes.kit import SceneKit
from neuralgrasps.human.scenes.surroundings import (
    FOREARM,
    HAND,
    OBJECT,
    add_face,
    lowest_height,
    moved_to,
    place_clutter,
    place_solid,
    place_table,
    place_wall,
    random_rotation,
)
from neuralgrasps.kinematics.forward_kernels import link_poses

_RINGS, _ROUND = 6, 12  # of the forearm: the wrist (2), the cuff without and with cloth, half way, the elbow
_WRIST_THICK_M, _WRIST_BROAD_M = (0.023, 0.033), (0.027, 0.039)  # half sizes of the wrist at scale 1
_CLUTTER = 4


class SceneMix(NamedTuple):
    """How scenes are drawn.

    Attributes:
        held, near: shares of hands that hold a solid, and of those that are about to; the others are empty.
        table, wall: shares of scenes with a table below and with a wall behind.
        varied: share of hands whose bones and thickness are not those of the model.
        smallest, largest: sizes of hands; nearest_m, farthest_m: distance of the palm along the view.
        span_x, span_y: how far from the middle of the view the palm may be, as x / z and y / z.
        clutter: most things around.
    """

    held: float = 0.62
    near: float = 0.12
    table: float = 0.6
    wall: float = 0.7
    varied: float = 0.6
    smallest: float = 0.66
    largest: float = 0.92
    nearest_m: float = 0.35
    farthest_m: float = 1.2
    span_x: float = 0.5
    span_y: float = 0.38
    clutter: int = 3


class SceneBuffers(NamedTuple):
    """Room for one scene: triangles (`counts` of corners and faces are used), labels and the truth about the hand."""

    points: np.ndarray
    faces: np.ndarray
    labels: np.ndarray
    counts: np.ndarray
    joints: np.ndarray
    X_CH: np.ndarray
    q: np.ndarray
    scale: np.ndarray
    X_HL: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomScene:
    """One scene in the camera frame, metres.

    Attributes:
        points_C: (V, 3) corners; faces: (F, 3) int32; face_labels: (F,) int8: BACKGROUND, TABLE, OBJECT (the one held
            or about to be), HAND, FOREARM, CLUTTER.
        joints_C: (21, 3) the right hand's joints; X_CH: (4, 4); q: (20,); scale: its size.
        holds: it holds something.
    """

    points_C: np.ndarray
    faces: np.ndarray
    face_labels: np.ndarray
    joints_C: np.ndarray
    X_CH: np.ndarray
    q: np.ndarray
    scale: float
    holds: bool


def random_scene(kit: SceneKit, seed: int, mix: SceneMix | None = None) -> RandomScene:
    """The scene of a seed (0 to 2^32 - 1)."""
    room = scene_buffers(kit)
    holds = compose_scene(kit, mix or SceneMix(), np.uint32(seed), room)
    corners, triangles = room.counts
    return RandomScene(
        points_C=room.points[:corners], faces=room.faces[:triangles], face_labels=room.labels[:triangles],
        joints_C=room.joints, X_CH=room.X_CH, q=room.q, scale=float(room.scale[0]), holds=bool(holds),
    )  # fmt: skip


def draw_scene(scene: RandomScene, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Depth (h, w) float32, metres, 0 where nothing is, and labels (h, w) int8, without sensor noise."""
    shape = (intrinsics.height, intrinsics.width)
    depth, labels = np.full(shape, np.inf, np.float32), np.zeros(shape, np.int8)
    k = intrinsics
    raster_labels(
        scene.points_C, scene.faces, scene.face_labels, float(k.fx), float(k.fy), float(k.cx), float(k.cy), NEAR_M,
        depth, labels,
    )  # fmt: skip
    depth[~np.isfinite(depth)] = 0.0
    return depth, labels


def scene_buffers(kit: SceneKit) -> SceneBuffers:
    """Room for any scene of this kit."""
    solids = 1 + _CLUTTER
    corners = len(kit.skin_core) + _RINGS * _ROUND + 1 + solids * kit.max_points + 8
    triangles = len(kit.skin_faces) + 2 * _RINGS * _ROUND + solids * kit.max_faces + 4
    return SceneBuffers(
        points=np.zeros((corners, 3)), faces=np.zeros((triangles, 3), np.int32), labels=np.zeros(triangles, np.int8),
        counts=np.zeros(2, np.int64), joints=np.zeros((21, 3)), X_CH=np.eye(4), q=np.zeros(len(kit.lower)),
        scale=np.ones(1), X_HL=np.zeros((len(kit.parents), 4, 4)),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def compose_scene(kit, mix, seed, room):  # type: ignore[no-untyped-def]
    """Write the scene of a seed into `room`; True when the hand holds a solid."""
    np.random.seed(seed)
    room.counts[:] = 0
    scale = np.random.uniform(mix.smallest, mix.largest)
    room.scale[0] = scale
    share = np.random.random()
    holds, near = share < mix.held, share < mix.held + mix.near
    grasp = np.random.randint(len(kit.held_solid))
    if near:
        _draw_held_posture(kit, grasp, not holds, room.q)
    else:
        _draw_free_posture(kit, room.q)
    up = _draw_up()
    has_table = np.random.random() < mix.table
    forearm_H = _draw_forearm_direction()
    R = room.X_CH[:3, :3]
    _draw_turn(R, up, forearm_H, has_table)
    palm = np.empty(3)
    palm[2] = np.random.uniform(mix.nearest_m, mix.farthest_m)
    palm[0] = palm[2] * np.random.uniform(-mix.span_x, mix.span_x)
    palm[1] = palm[2] * np.random.uniform(-mix.span_y, mix.span_y)
    for i in range(3):  # the middle of the palm lies 0.1 along -x of the wrist
        room.X_CH[i, 3] = palm[i] + 0.1 * scale * R[i, 0]
    thick = _place_hand(kit, mix, scale, room)
    _place_forearm(room, forearm_H, scale * thick)
    if near:
        _place_held(kit, grasp, scale, not holds, room)
    low = lowest_height(room, up)
    floor = low - (0.0 if np.random.random() < 0.5 else np.random.uniform(0.0, 0.15))
    for _ in range(np.random.randint(mix.clutter + 1)):
        place_clutter(kit, palm, up, floor, has_table, room)
    if has_table:
        place_table(palm, up, floor, room)
    if np.random.random() < mix.wall:
        place_wall(palm, room)
    return holds


@njit(cache=True, error_model="numpy")
def _draw_up():  # type: ignore[no-untyped-def]
    """The world's up in the frame of a camera that looks down by up to 75 degrees and is held nearly level."""
    pitch, roll = np.random.uniform(-0.1, 1.3), np.random.normal() * 0.12
    up = np.empty(3)
    up[0], up[1], up[2] = math.cos(pitch) * math.sin(roll), -math.cos(pitch) * math.cos(roll), -math.sin(pitch)
    return up


@njit(cache=True, error_model="numpy")
def _draw_turn(R, up, forearm_H, has_table):  # type: ignore[no-untyped-def]
    """A rotation of the hand; where there is a table, forearms seldom come from below."""
    for _ in range(12):
        random_rotation(R)
        rise = 0.0
        for i in range(3):
            rise += up[i] * (R[i, 0] * forearm_H[0] + R[i, 1] * forearm_H[1] + R[i, 2] * forearm_H[2])
        if not has_table or rise > -0.1:
            break


@njit(cache=True, error_model="numpy")
def _draw_held_posture(kit, grasp, opened, q):  # type: ignore[no-untyped-def]
    """A grasp of the bank with some play in its joints, or on the way from open to it."""
    share = np.random.random() * 0.9 if opened else 1.0
    spread = 0.12 if opened else 0.06
    for j in range(q.shape[0]):
        value = kit.q_open[j] + share * (kit.held_q[grasp, j] - kit.q_open[j]) + spread * np.random.normal()
        q[j] = min(max(value, kit.lower[j]), kit.upper[j])


@njit(cache=True, error_model="numpy")
def _draw_free_posture(kit, q):  # type: ignore[no-untyped-def]
    """Fingers that curl together or each on its own, the last joint with the one before it; joints 4 to a finger."""
    common, together = np.random.random(), np.random.random() < 0.5
    for finger in range(4):
        curl = common + 0.15 * np.random.normal() if together else np.random.random()
        base = 4 * finger
        bend = curl + 0.2 * np.random.normal()
        q[base] = np.random.normal() * 0.5 * kit.upper[base]
        q[base + 1] = -0.1 + 1.6 * (curl + 0.25 * np.random.normal())
        q[base + 2] = 1.6 * bend
        q[base + 3] = 0.67 * q[base + 2] + 0.15 * np.random.normal()
    for j in range(16, 20):
        q[j] = kit.lower[j] + np.random.random() * (kit.upper[j] - kit.lower[j])
        if np.random.random() < 0.5:
            q[j] = 0.5 * (q[j] + kit.q_open[j])
    for j in range(q.shape[0]):
        q[j] = min(max(q[j], kit.lower[j]), kit.upper[j])


@njit(cache=True, error_model="numpy")
def _draw_forearm_direction():  # type: ignore[no-untyped-def]
    """From the wrist to the elbow in H: +x, with the wrist bent about z and y."""
    bend = min(max(0.4 * np.random.normal(), -1.1), 1.1)
    side = min(max(0.2 * np.random.normal(), -0.5), 0.5)
    out = np.empty(3)
    out[0], out[1], out[2] = math.cos(bend) * math.cos(side), math.sin(bend) * math.cos(side), math.sin(side)
    return out


@njit(cache=True, error_model="numpy")
def _place_hand(kit, mix, scale, room):  # type: ignore[no-untyped-def]
    """The hand's skin and joints; bones and thickness may differ from the model's. Returns the thickness factor."""
    links = kit.parents.shape[0]
    longer = np.ones(links)
    thick, breadth = 1.0, 1.0
    if np.random.random() < mix.varied:
        thick, breadth = math.exp(0.07 * np.random.normal()), math.exp(0.03 * np.random.normal())
        for finger in range(5):
            whole = math.exp(0.03 * np.random.normal())
            for k in range(4):
                longer[1 + 4 * finger + k] = whole * math.exp(0.02 * np.random.normal())
    X_parent = kit.X_parent_joint.copy()
    for link in range(links):
        parent = kit.parents[link]
        for i in range(3):
            X_parent[link, i, 3] *= scale * (longer[parent] if parent > 0 else breadth if i == 2 else 1.0)
    link_poses(kit.parents, kit.joint_types, X_parent, kit.axes, kit.coupling, kit.offset, room.q, room.X_HL)
    local, in_H = np.empty(3), np.empty(3)
    for k in range(kit.joint_link.shape[0]):
        link = kit.joint_link[k]
        for i in range(3):
            local[i] = scale * longer[link] * kit.joint_L[k, i]
        moved_to(room.X_HL[link], local, in_H)
        moved_to(room.X_CH, in_H, room.joints[k])
    for v in range(kit.skin_core.shape[0]):
        link = kit.skin_link[v]
        for i in range(3):
            stretch = longer[link] if link > 0 else breadth if i == 2 else 1.0
            local[i] = scale * (stretch * kit.skin_core[v, i] + thick * kit.skin_offset[v, i])
        moved_to(room.X_HL[link], local, in_H)
        moved_to(room.X_CH, in_H, room.points[v])
    for f in range(kit.skin_faces.shape[0]):
        room.faces[f] = kit.skin_faces[f]
        room.labels[f] = HAND
    room.counts[0], room.counts[1] = kit.skin_core.shape[0], kit.skin_faces.shape[0]
    return thick


@njit(cache=True, error_model="numpy")
def _place_forearm(room, along, size):  # type: ignore[no-untyped-def]
    """A tube of ellipses from the wrist, wider towards the elbow, in a sleeve at times."""
    thick, broad = size * np.random.uniform(*_WRIST_THICK_M), size * np.random.uniform(*_WRIST_BROAD_M)
    grows, curve = np.random.uniform(0.25, 0.85), np.random.uniform(0.5, 1.2)
    length = np.random.uniform(0.27, 0.37) * size
    sleeve = np.random.uniform(0.002, 0.018) if np.random.random() < 0.45 else 0.0
    start, cuff = size * np.random.uniform(-0.02, 0.004), size * np.random.uniform(0.02, 0.15)
    blunt, bend = np.random.uniform(0.5, 1.0), 0.0  # how round the start is; how far behind the wrist's origin it bends
    if np.random.random() < 0.6:
        bend = size * np.random.uniform(0.0, 0.03)
    side = np.empty(3)  # across the forearm in its broad direction: z of H made perpendicular to it
    for i in range(3):
        side[i] = (1.0 if i == 2 else 0.0) - along[2] * along[i]
    side /= math.sqrt(side[0] ** 2 + side[1] ** 2 + side[2] ** 2)
    over = np.cross(along, side)
    first, p = room.counts[0], np.empty(3)
    places = (start, start + 0.012 * size, cuff, cuff, 0.5 * (cuff + length), length)
    for ring in range(_RINGS):
        widen = (blunt if ring == 0 else 1.0) * (1.0 + grows * (max(places[ring], 0.0) / length) ** curve)
        cloth = sleeve if ring >= 3 else 0.0
        for k in range(_ROUND):
            angle = 2.0 * math.pi * k / _ROUND
            a, b = (widen * thick + cloth) * math.cos(angle), (widen * broad + cloth) * math.sin(angle)
            for i in range(3):
                p[i] = places[ring] * along[i] + a * over[i] + b * side[i]
            p[0] += bend
            moved_to(room.X_CH, p, room.points[first + ring * _ROUND + k])
    end = first + _RINGS * _ROUND
    for i in range(3):
        p[i] = length * along[i]
    p[0] += bend
    moved_to(room.X_CH, p, room.points[end])
    _join_rings(room, first, end)
    room.counts[0] = end + 1


@njit(cache=True, error_model="numpy")
def _join_rings(room, first, end):  # type: ignore[no-untyped-def]
    """Triangles between the rings of corners from `first` on, the last of which meets in the corner `end`."""
    for ring in range(_RINGS):
        for k in range(_ROUND):
            a, b = first + ring * _ROUND + k, first + ring * _ROUND + (k + 1) % _ROUND
            if ring == _RINGS - 1:
                add_face(room, a, b, end, FOREARM)
            else:
                add_face(room, a, b, a + _ROUND, FOREARM)
                add_face(room, b, b + _ROUND, a + _ROUND, FOREARM)


@njit(cache=True, error_model="numpy")
def _place_held(kit, grasp, scale, opened, room):  # type: ignore[no-untyped-def]
    """The solid of a grasp in the hand, or a little away from a hand that comes to take it."""
    X_OH, X_CO = kit.held_X[grasp], np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                X_CO[i, j] += room.X_CH[i, k] * X_OH[j, k]
    shift, size = np.empty(3), np.full(3, scale)
    away = np.random.uniform(0.0, 0.12) if opened else 0.0
    for i in range(3):
        shift[i] = 0.0015 * np.random.normal()
        if opened:
            shift[i] += 0.01 * np.random.normal()
    shift[0] -= 0.5 * away * np.random.random()  # along the fingers
    shift[1] -= away  # out of the palm
    for i in range(3):
        X_CO[i, 3] = room.X_CH[i, 3]
        for j in range(3):
            X_CO[i, 3] += room.X_CH[i, j] * shift[j] - scale * X_CO[i, j] * X_OH[j, 3]
    place_solid(kit, kit.held_solid[grasp], X_CO, size, OBJECT, room)
