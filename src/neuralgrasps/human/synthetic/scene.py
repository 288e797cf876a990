"""What is in a demonstration beside the motion: table, wall, clutter, the person's arm, colours, and the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, look_at, project
from neuralgrasps.geometry.mesh import Mesh, box_mesh, cylinder_mesh
from neuralgrasps.geometry.raster import NEAR_M, raster_labels
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.human.forearm import ForearmSize, WristAxes, tapered_mesh
from neuralgrasps.human.synthetic.shaded_scene import Thing
from neuralgrasps.kinematics.forward_kernels import forward_fast

SKINS = ((234, 192, 164), (222, 172, 140), (198, 140, 106), (158, 104, 74), (112, 72, 52))
SLEEVES = ((52, 78, 128), (120, 44, 48), (60, 96, 72), (70, 70, 76), (206, 204, 196))
OBJECTS = ((206, 84, 52), (222, 178, 48), (72, 142, 84), (72, 118, 196), (168, 84, 158), (214, 212, 206))
TABLES = ((172, 140, 104), (206, 200, 188), (128, 96, 72), (150, 156, 162))
WALLS = ((222, 218, 208), (182, 192, 198), (206, 196, 176))
_SEGMENTS = 16
_CAMERAS = 24  # places that are tried
_ALONE_PAD = 0.5  # of the image's size on either side: how far out the unhidden hand is counted


class PosedMesh:
    """A hand's parts as one mesh whose vertices follow the joints."""

    def __init__(self, hand: Hand) -> None:
        self._tree = hand.tree
        meshes = [part_mesh(part, segments=_SEGMENTS) for part in hand.parts]
        first = np.cumsum([0, *(len(m.vertices) for m in meshes)])
        self._points_L = np.concatenate([m.vertices for m in meshes])
        self._links = np.repeat([part.link for part in hand.parts], [len(m.vertices) for m in meshes])
        faces = np.concatenate([m.faces + k for m, k in zip(meshes, first, strict=False)])
        self.mesh = Mesh(self._points_L, faces)

    def vertices(self, X_WH: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(V, 3) of a hand at X_WH (4, 4) with joints q (J,)."""
        X = (X_WH @ forward_fast(self._tree, q))[self._links]
        return np.einsum("vij,vj->vi", X[:, :3, :3], self._points_L) + X[:, :3, 3]


def arm_meshes(hand: Hand, forearm_H: np.ndarray, up_H: np.ndarray, *, scale: float) -> tuple[Mesh, Mesh]:
    """Bare skin and sleeve of the arm behind a hand, in H: the forearm, and the upper arm that rises from the elbow.

    Args:
        forearm_H: (3,) unit direction from wrist to elbow; up_H: (3,) the world's up.
    """
    size, axes = ForearmSize.of(scale), WristAxes.of(hand)
    start, cuff = 0.022 * scale / 0.8 * axes.out, 0.4 * size.length_m
    elbow = size.length_m * forearm_H
    cuff_m = float(size.radius(np.array(cuff)))
    skin = tapered_mesh(start, (cuff + 0.02) * forearm_H, size.wrist_m, cuff_m)
    level = forearm_H - (forearm_H @ up_H) * up_H
    level /= max(float(np.linalg.norm(level)), 1e-9)
    shoulder = elbow + 0.30 * (0.45 * level + 0.9 * up_H)
    lower = tapered_mesh(cuff * forearm_H, elbow, cuff_m + 0.006, size.elbow_m + 0.004)
    upper = tapered_mesh(elbow, shoulder, size.elbow_m + 0.004, size.elbow_m + 0.016)
    return skin, joined([lower, upper])


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Meshes laid together."""
    first = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + k for m, k in zip(meshes, first, strict=False)]),
    )


def surroundings(
    rng: np.random.Generator,
    *,
    X_WC: np.ndarray,
    person: float,
    clutter: int,
    wall: bool,
    occluder: Thing | None = None,
) -> list[Thing]:
    """Table, wall and clutter in W: the table at z = 0, the wall behind it as the camera sees it.

    Args:
        person: azimuth from which the arm comes, rad. clutter: things beside the object, 0.24 to 0.4 m from it.
        occluder: a thing that stands there already, in W; the clutter is put away from it.
    """
    table = box_mesh([rng.uniform(0.6, 0.9), rng.uniform(0.45, 0.7), 0.015])
    turn = rng.uniform(0.0, 2.0 * np.pi)
    things = [Thing(mesh=placed(table, [0.0, 0.0, -0.015], turn), colour=picked(TABLES, rng))]
    view = float(np.arctan2(X_WC[1, 3], X_WC[0, 3]))
    if wall:
        away = rng.uniform(0.95, 1.6)
        panel = box_mesh([0.02, 2.5, 1.6])
        place = [-away * np.cos(view), -away * np.sin(view), 0.3]
        things.append(Thing(mesh=placed(panel, place, view), colour=picked(WALLS, rng)))
    free = [a for a in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False) if _apart(a, person) > 0.9]
    free = [a for a in free if _apart(a, view) > 0.7]
    if occluder is not None:
        x, y = occluder.mesh.vertices[:, :2].mean(axis=0)
        free = [a for a in free if _apart(a, float(np.arctan2(y, x))) > 1.0]
        things.append(occluder)
    for angle in rng.permutation(free)[:clutter]:
        things.append(_clutter(float(angle), rng))
    return things


def choose_camera(
    rng: np.random.Generator,
    *,
    intrinsics: Intrinsics,
    person: float,
    hand_W: np.ndarray,
    meshes: Sequence[Mesh],
    moments: Sequence[Sequence[np.ndarray]],
    least_share: float,
) -> np.ndarray:
    """A camera 0.5 to 1 m from the object, not behind the person, that sees the hand, and some of the object.

    Args:
        person: azimuth from which the arm comes, rad. hand_W: (3,) middle of the hand at the grasp.
        meshes: what hides what: the hand, the object, then others.
        moments: vertices (V, 3) of the meshes in W at times that are to be seen, the grasp first.
        least_share: of the hand that is wanted to be visible, and a third of it of the object at the grasp; where no
            camera tried sees that much, the one that comes nearest is taken.
    Returns:
        X_WC (4, 4).
    """
    small = smaller(intrinsics)
    best, best_score = np.eye(4), -1.0
    for _ in range(_CAMERAS):
        azimuth = person + rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(45.0, 180.0))
        height, distance = np.radians(rng.uniform(22.0, 62.0)), rng.uniform(0.5, 0.95)
        toward = np.array([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)])
        aim = 0.5 * hand_W + 0.03 * rng.standard_normal(3)
        X_WC = look_at(aim + distance * toward, aim)
        score = np.inf
        for time, vertices_W in enumerate(moments):
            drawn = list(zip(vertices_W, (m.faces for m in meshes), strict=True))
            _, seen = drawn_labels(drawn, X_WC, small)
            score = min(score, visible_share(seen == 0, alone_mask(*drawn[0], X_WC, small)))
            if time == 0:
                score = min(score, 3.0 * visible_share(seen == 1, alone_mask(*drawn[1], X_WC, small)))
        if score > best_score:
            best, best_score = X_WC, score
        if best_score >= least_share:
            break
    return best


def smaller(k: Intrinsics) -> Intrinsics:
    """A camera with a quarter of the pixels each way, to try views with."""
    return Intrinsics(k.fx / 4, k.fy / 4, k.cx / 4, k.cy / 4, k.width // 4, k.height // 4)


def visible_share(seen: np.ndarray, alone: np.ndarray) -> float:
    """Seen pixels of a thing over those it would cover in a larger image with nothing before it; 0 when none."""
    whole = int(alone.sum())
    return min(float(seen.sum()) / whole, 1.0) if whole else 0.0


def alone_mask(vertices_W: np.ndarray, faces: np.ndarray, X_WC: np.ndarray, k: Intrinsics) -> np.ndarray:
    """Pixels (bool) that a mesh covers with nothing before it, seen or not: an image cut out about it.

    It reaches half the image's size beyond the image on every side.
    """
    X_CW = np.linalg.inv(X_WC)
    points_C = vertices_W @ X_CW[:3, :3].T + X_CW[:3, 3]
    uv = project(points_C, k)
    if not np.isfinite(uv).any():
        return np.zeros((1, 1), bool)  # behind the camera
    reach = np.array([k.width, k.height])
    low = np.floor(np.clip(np.nanmin(uv, axis=0), -_ALONE_PAD * reach, (1 + _ALONE_PAD) * reach)).astype(int)
    high = np.ceil(np.clip(np.nanmax(uv, axis=0), -_ALONE_PAD * reach, (1 + _ALONE_PAD) * reach)).astype(int)
    width, height = np.maximum(high - low + 1, 1)
    window = Intrinsics(k.fx, k.fy, k.cx - low[0], k.cy - low[1], int(width), int(height))
    return drawn_labels([(vertices_W, faces)], X_WC, window)[1] == 0


def drawn_labels(
    meshes: Sequence[tuple[np.ndarray, np.ndarray]],
    X_WC: np.ndarray,
    k: Intrinsics,
    *,
    over: tuple[np.ndarray, np.ndarray] | None = None,
    first: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw meshes, each of vertices (V, 3) in W and faces (F, 3).

    Args:
        over: an earlier result; what these meshes hide of it is drawn over, in a copy.
        first: label of the first mesh; the others follow.
    Returns:
        (h, w) float32 depth, metres, inf where there is nothing, and (h, w) int8 which mesh is seen, -1 for none.
    """
    if over is None:
        over = (np.full((k.height, k.width), np.inf, np.float32), np.full((k.height, k.width), -1, np.int8))
    depth, labels = over[0].copy(), over[1].copy()
    X_CW = np.linalg.inv(X_WC)
    for i, (vertices_W, faces) in enumerate(meshes, start=first):
        points_C = np.ascontiguousarray(vertices_W @ X_CW[:3, :3].T + X_CW[:3, 3])
        raster_labels(
            points_C, np.asarray(faces, np.int64), np.full(len(faces), i, np.int8),
            float(k.fx), float(k.fy), float(k.cx), float(k.cy), NEAR_M, depth, labels,
        )  # fmt: skip
    return depth, labels


def _clutter(angle: float, rng: np.random.Generator) -> Thing:
    """A box or a can that stands on the table."""
    radius, height = rng.uniform(0.24, 0.4), rng.uniform(0.03, 0.15)
    if rng.random() < 0.5:
        mesh = box_mesh([rng.uniform(0.015, 0.05), rng.uniform(0.02, 0.06), height / 2])
    else:
        mesh = cylinder_mesh(rng.uniform(0.02, 0.045), height / 2)
    place = [radius * np.cos(angle), radius * np.sin(angle), height / 2]
    return Thing(mesh=placed(mesh, place, rng.uniform(0.0, np.pi)), colour=picked(OBJECTS, rng))


def placed(mesh: Mesh, place: Sequence[float], turn: float) -> Mesh:
    """A mesh turned about z by `turn`, rad, and then put at `place`."""
    X = np.eye(4)
    X[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    X[:3, 3] = place
    return mesh.transformed(X)


def picked(colours: Sequence[tuple[int, int, int]], rng: np.random.Generator) -> tuple[int, int, int]:
    """One of some colours."""
    return colours[int(rng.integers(len(colours)))]


def _apart(a: float, b: float) -> float:
    """Angle between two azimuths, rad, 0 to pi."""
    return abs(float((a - b + np.pi) % (2.0 * np.pi) - np.pi))


@dataclass(frozen=True, slots=True, kw_only=True)
class Looks:
    """Colours of one demonstration."""

    skin: tuple[int, int, int]
    sleeve: tuple[int, int, int]
    obj: tuple[int, int, int]

    @staticmethod
    def drawn(rng: np.random.Generator) -> Looks:
        return Looks(skin=picked(SKINS, rng), sleeve=picked(SLEEVES, rng), obj=picked(OBJECTS, rng))
