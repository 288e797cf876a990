"""A robot, a table and objects as triangles that are only posed: what `ScenePainter` draws frame after frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.geometry.mesh import Mesh, convex_hull
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.world import BoxObstacle
from neuralgrasps.report.palette import GRAPHITE, OBJECT_COLOUR, hand_colour, linear_rgb, mix
from neuralgrasps.report.smooth_normals import corner_normals

TARGET_COLOUR = "#e0a23a"
_SHELL, _JOINT = "#e9e8e4", "#4d545e"  # of the arm: light shells, dark between them
_CORNER_SEGMENTS, _CASTER_SEGMENTS = 28, 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneTriangles:
    """Triangles of B bodies, each in its own frame; bodies are the L links of the robot, then the K objects.

    Attributes:
        points: (V, 3) float64; point_body: (V,); faces: (F, 3) int32; face_body: (F,).
        normals: (F, 3, 3) float32 at the corners; flat: (F, 3) float32 across the faces.
        colour: (F, 3) float32 linear; gloss: (F,) float32.
        two_sided: (F,) bool, faces whose back is drawn too.
        caster_points, caster_body, caster_faces: a coarser copy that throws the soft shadows.
    """

    points: np.ndarray
    point_body: np.ndarray
    faces: np.ndarray
    face_body: np.ndarray
    normals: np.ndarray
    flat: np.ndarray
    colour: np.ndarray
    gloss: np.ndarray
    two_sided: np.ndarray
    caster_points: np.ndarray
    caster_body: np.ndarray
    caster_faces: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """What stands and moves in a picture; frame B, the robot's base.

    Attributes:
        manipulator, objects, table: as in the simulation; target: index of the object that is to be lifted.
        meshes: their triangles.
    """

    manipulator: Manipulator
    objects: tuple[ObjectModel, ...]
    table: BoxObstacle
    target: int
    meshes: SceneTriangles

    def poses(self, q: np.ndarray, X_BO: np.ndarray) -> np.ndarray:
        """X_B of all bodies (B, 4, 4), for joints q (Q,) and objects X_BO (K, 4, 4)."""
        return np.concatenate([forward_fast(self.manipulator.tree, q), np.asarray(X_BO, float)])


def make_scene(
    manipulator: Manipulator, objects: Sequence[ObjectModel], table: BoxObstacle, *, target: int = 0
) -> Scene:
    """The scene with its triangles; the target in a warm colour, other objects as plaster."""
    bodies = manipulator.tree.num_links
    pieces = [
        (part.link, part_mesh(part, segments=_CORNER_SEGMENTS), colour, 0.3, False)
        for part, colour in zip(manipulator.parts, _part_colours(manipulator), strict=True)
    ]
    casters = [(part.link, part_mesh(part, segments=_CASTER_SEGMENTS)) for part in manipulator.parts]
    for k, obj in enumerate(objects):
        colour = linear_rgb(TARGET_COLOUR if k == target else OBJECT_COLOUR)
        pieces.append((bodies + k, obj.mesh, colour, 0.1, True))
        casters += [(bodies + k, _hull(hull)) for hull in obj.convex_parts]
    return Scene(
        manipulator=manipulator,
        objects=tuple(objects),
        table=table,
        target=target,
        meshes=_pack(pieces, casters),
    )


def _part_colours(manipulator: Manipulator) -> list[np.ndarray]:
    """Linear colour of each part: its own, or light shells with dark joints for arms, fingers in the hand's colour."""
    hand, shift = manipulator.hand, manipulator.hand_link
    fingers = {link + shift for finger in hand.fingers for link in finger.links}
    own = linear_rgb(hand_colour(hand.name))
    palm = mix(own, linear_rgb(GRAPHITE), 0.86)
    colours = []
    for part in manipulator.parts:
        if part.link >= shift:
            colours.append(own if part.link in fingers else palm)
        elif part.colour is not None:
            colours.append(np.array(part.colour[:3], float) ** 2.2)
        else:
            colours.append(linear_rgb(_JOINT if part.link % 2 else _SHELL))
    return colours


def _hull(vertices: np.ndarray) -> Mesh:
    points, faces = convex_hull(vertices)
    return Mesh(points, faces)


def _pack(
    pieces: Sequence[tuple[int, Mesh, np.ndarray, float, bool]], casters: Sequence[tuple[int, Mesh]]
) -> SceneTriangles:
    points, faces, point_body = _join([(body, mesh) for body, mesh, *_ in pieces])
    caster_points, caster_faces, caster_body = _join(casters)
    counts = [len(mesh.faces) for _, mesh, *_ in pieces]
    return SceneTriangles(
        points=points,
        point_body=point_body,
        faces=faces,
        face_body=np.repeat([body for body, *_ in pieces], counts).astype(np.int32),
        normals=np.concatenate([corner_normals(mesh.vertices, mesh.faces) for _, mesh, *_ in pieces]),
        flat=_face_normals(points, faces),
        colour=np.repeat(np.array([colour for *_, colour, _, _ in pieces], np.float32), counts, axis=0),
        gloss=np.repeat(np.array([gloss for *_, gloss, _ in pieces], np.float32), counts),
        two_sided=np.repeat([both for *_, both in pieces], counts),
        caster_points=caster_points,
        caster_body=caster_body,
        caster_faces=caster_faces,
    )


def _face_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20), np.float32)


def _join(pieces: Sequence[tuple[int, Mesh]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (V, 3), faces (F, 3) and the body of every point."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for _, mesh in pieces])
    points = np.concatenate([mesh.vertices for _, mesh in pieces])
    faces = np.concatenate([mesh.faces + o for (_, mesh), o in zip(pieces, offsets, strict=False)]).astype(np.int32)
    body = np.repeat([b for b, _ in pieces], [len(mesh.vertices) for _, mesh in pieces]).astype(np.int32)
    return points, faces, body


def posed_points(points: np.ndarray, body: np.ndarray, X_B: np.ndarray) -> np.ndarray:
    """(V, 3) points of bodies in B; `X_B` (B, 4, 4) their poses."""
    return np.einsum("vij,vj->vi", X_B[body, :3, :3], points) + X_B[body, :3, 3]
