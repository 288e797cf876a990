"""Frames of a scene from one camera, tens of milliseconds each: only what moves is posed and lit again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.report.light_kernels import _DISC
from neuralgrasps.report.paint_kernels import paint
from neuralgrasps.report.palette import linear_rgb, linear_to_srgb
from neuralgrasps.report.scene import Scene, posed_points
from neuralgrasps.report.scene_kernels import fill_backdrop, fill_faces, lamp_on_plane, light_plane
from neuralgrasps.report.shading import Lights, Style, lights_of, roll_off
from neuralgrasps.report.shadow_maps import dome_directions, shadow_maps

TABLE, FLOOR, HORIZON, OVERHEAD = "#b9b3a6", "#cfccc5", "#e7e5df", "#f7f6f2"
# rays of a pixel: a square turned so that level, upright and slanted edges all get four steps
_OFFSETS = np.array([[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]])
_DOME_LIGHTS, _DOME_MAP, _LAMP_MAP = 27, 112, 640
_SKY_CELL_M, _LAMP_CELL_M = 0.012, 0.005
_FAR_BLUR_M = 0.05
_LAMP_SPREAD = 0.10  # radius of the lamp over its distance
_FLOOR_CELLS, _FLOOR_SIDE_M = 96, 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A camera: X_BC (4, 4) and its intrinsics."""

    X_BC: np.ndarray
    intrinsics: Intrinsics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitMoment:
    """One moment of a scene with its light; good for any view.

    Attributes:
        X_B: (B, 4, 4) bodies; points: (V, 3) corners in B.
        sky, lamp: the lights with their shadow maps, about `centre`.
        top_sky, top_lamp: share of both that the cells of the table's top see.
    """

    X_B: np.ndarray
    points: np.ndarray
    sky: Lights
    lamp: Lights
    top_sky: np.ndarray
    top_lamp: np.ndarray


class ScenePainter:
    """Draws moments of one scene.

    Args of the constructor: the scene; lamp (3,) unit vector towards the lamp; centre and radius of the part of the
    scene that gets shadows, metres.
    """

    def __init__(self, scene: Scene, *, lamp: np.ndarray, centre: np.ndarray, radius: float) -> None:
        self.scene, self._lamp = scene, np.asarray(lamp, float)
        self._zone = np.asarray(centre, float), radius
        self._style = Style()
        self._dome = dome_directions(_DOME_LIGHTS)
        half, middle = scene.table.half, scene.table.X_BX[:3, 3]
        self._low, self._high = middle - half, middle + half
        self._box = box_mesh(half).transformed(scene.table.X_BX)
        self._floor = self._floor_light()
        self._tone = _tone_curve()
        self._still: dict[int, tuple[View, _Still]] = {}

    def light(self, q: np.ndarray, X_BO: np.ndarray) -> LitMoment:
        """Pose everything and find what the lights see, for joints q (Q,) and objects X_BO (K, 4, 4)."""
        meshes, X_B = self.scene.meshes, self.scene.poses(q, X_BO)
        points = posed_points(meshes.points, meshes.point_body, X_B)
        casters = posed_points(meshes.caster_points, meshes.caster_body, X_B)
        table = self._box
        sky = _lights(
            [(casters, meshes.caster_faces), (table.vertices, table.faces)], self._dome, *self._zone, _DOME_MAP
        )
        # without the table, which would hide its own top where a soft shadow looks around
        lamp = _lights([(points, meshes.faces)], self._lamp, *self._zone, _LAMP_MAP)
        size = (self._high - self._low)[:2]
        top_sky, origin, step = _cells(self._low, size, _SKY_CELL_M, self._high[2])
        centre = self._zone[0].astype(np.float32)
        light_plane(origin, step, sky, centre, top_sky)
        top_lamp, origin, step = _cells(self._low, size, _LAMP_CELL_M, self._high[2])
        lamp_on_plane(origin, step, lamp, centre, _DISC, np.float32(_LAMP_SPREAD), top_lamp)
        return LitMoment(
            X_B=X_B, points=points, sky=sky, lamp=lamp,
            top_sky=_softened(top_sky), top_lamp=gaussian_filter(top_lamp, 0.7),
        )  # fmt: skip

    def paint(self, moment: LitMoment, view: View, *, keep: bool = True) -> np.ndarray:
        """(h, w, 3) uint8 picture of a moment; `keep` what stands still in it for the next one from this view."""
        still = self._backdrop(view, keep)
        meshes, k = self.scene.meshes, view.intrinsics
        X_CB = np.linalg.inv(view.X_BC)
        camera = np.array([k.fx, k.fy, k.cx, k.cy], np.float32)
        offsets = _OFFSETS.astype(np.float32)
        face, inverse = still.face.copy(), still.inverse.copy()
        points_C = moment.points @ X_CB[:3, :3].T + X_CB[:3, 3]
        fill_faces(points_C, meshes.faces, meshes.two_sided, camera, _OFFSETS, face, inverse)
        picture = np.empty((k.height, k.width, 3), np.uint8)
        style = self._style
        paint(
            (face, offsets, camera),
            (still.light, still.spot),
            (moment.points.astype(np.float32), meshes.faces, meshes.normals, meshes.flat, meshes.face_body,
             moment.X_B[:, :3, :3].astype(np.float32, order="C"), meshes.colour, meshes.gloss),
            (view.X_BC[:3, :3].astype(np.float32, order="C"), view.X_BC[:3, 3].astype(np.float32),
             self._zone[0].astype(np.float32)),
            (linear_rgb(TABLE).astype(np.float32), self._low[:2].astype(np.float32),
             (self._high - self._low)[:2].astype(np.float32), moment.top_sky, moment.top_lamp),
            moment.sky,
            moment.lamp,
            np.array([style.sky, style.key, style.rim], np.float32),
            self._tone,
            picture,
        )  # fmt: skip
        return picture

    def _floor_light(self) -> _Floor:
        """Light on the floor, under the robot at home and the table."""
        meshes = self.scene.meshes
        is_robot = meshes.caster_body < self.scene.manipulator.tree.num_links
        X_B = self.scene.poses(self.scene.manipulator.q_home, np.tile(np.eye(4), (len(self.scene.objects), 1, 1)))
        points = posed_points(meshes.caster_points, meshes.caster_body, X_B)
        faces = meshes.caster_faces[is_robot[meshes.caster_faces[:, 0]]]
        used = np.concatenate([points[is_robot], self._box.vertices])
        height = float(min(used[:, 2].min(), 0.0))
        centre = np.array([*0.5 * (used.min(axis=0) + used.max(axis=0))[:2], height])
        radius = float(np.linalg.norm(used - centre, axis=1).max())
        grids = []
        for directions, size in ((self._dome, _DOME_MAP), (self._lamp, _LAMP_MAP)):
            lights = _lights([(points, faces), (self._box.vertices, self._box.faces)], directions, centre, radius, size)
            grid, origin, step = _cells(
                centre - _FLOOR_SIDE_M / 2, np.full(2, _FLOOR_SIDE_M), _FLOOR_SIDE_M / _FLOOR_CELLS, height
            )
            if directions.ndim == 2:
                light_plane(origin, step, lights, centre.astype(np.float32), grid)
            else:
                lamp_on_plane(origin, step, lights, centre.astype(np.float32), _DISC, np.float32(_LAMP_SPREAD), grid)
            grids.append(gaussian_filter(grid, 1.0))
        style = self._style
        light = style.sky * grids[0] + style.key * self._lamp[2] * grids[1] + 0.08
        return height, centre[:2].copy(), light, _FLOOR_SIDE_M

    def _backdrop(self, view: View, keep: bool) -> _Still:
        kept = self._still.get(id(view))
        if kept is not None and kept[0] is view:
            return kept[1]
        k = view.intrinsics
        planes, shape = len(_OFFSETS), (k.height, k.width)
        still = _Still(
            face=np.empty((planes, *shape), np.int32),
            inverse=np.empty((planes, *shape), np.float32),
            light=np.zeros((*shape, 3), np.float32),
            spot=np.zeros((*shape, 2), np.float32),
        )
        style = self._style
        facing = np.abs(self._lamp) * (self._lamp * (view.X_BC[:3, 3] - self._box.vertices.mean(axis=0)) > 0)
        fill_backdrop(
            (view.X_BC[:3, :3].copy(), view.X_BC[:3, 3].copy()),
            np.array([k.fx, k.fy, k.cx, k.cy]),
            _OFFSETS,
            (self._low, self._high, 0.5 * style.sky + style.key * facing + 0.08),
            self._floor,
            np.stack([linear_rgb(c) for c in (TABLE, FLOOR, HORIZON, OVERHEAD)]),
            (still.face, still.inverse, still.light, still.spot),
        )
        if keep:
            self._still[id(view)] = (view, still)
        return still


_Floor = tuple[float, np.ndarray, np.ndarray, float]  # height, centre (2,), light (G, G), side


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Still:
    """What does not move in a view; see `fill_backdrop`."""

    face: np.ndarray
    inverse: np.ndarray
    light: np.ndarray
    spot: np.ndarray


def _lights(
    pieces: Sequence[tuple[np.ndarray, np.ndarray]],
    directions: np.ndarray,
    centre: np.ndarray,
    radius: float,
    size: int,
) -> Lights:
    """Lights (L, 3) or (3,) with the shadow maps of posed triangles: points (V, 3) and faces (F, 3) of each piece."""
    points = np.concatenate([points for points, _ in pieces])
    shifts = np.cumsum([0] + [len(points) for points, _ in pieces])
    faces = np.concatenate([faces + shift for (_, faces), shift in zip(pieces, shifts, strict=False)]).astype(np.int32)
    maps = shadow_maps(points, faces, np.atleast_2d(directions), centre=centre, radius=radius, size=size)
    return lights_of(directions, maps)


def _cells(low: np.ndarray, size: np.ndarray, cell: float, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A grid over a level rectangle (Gx, Gy) float32, the middle (3,) of its first cell, and the steps (2,)."""
    count = np.maximum(np.ceil(size / cell).astype(int), 2)
    step = size / count
    return np.empty(count, np.float32), np.array([*(low[:2] + 0.5 * step), height]), step


def _softened(sky: np.ndarray) -> np.ndarray:
    """Light of the sky on the table without the outlines of single lights: smoother, the farther from a contact."""
    near, far = gaussian_filter(sky, 0.8), gaussian_filter(sky, _FAR_BLUR_M / _SKY_CELL_M)
    weight = np.clip((0.70 - near) / 0.35, 0, 1)
    return np.asarray(weight * near + (1 - weight) * far, np.float32)


def _tone_curve() -> np.ndarray:
    """(4096,) uint8 sRGB levels of linear light from 0 to 2; highlights roll off as in still pictures."""
    linear = np.linspace(0.0, 2.0, 4096)
    return np.round(np.clip(linear_to_srgb(roll_off(linear)), 0, 1) * 255).astype(np.uint8)
