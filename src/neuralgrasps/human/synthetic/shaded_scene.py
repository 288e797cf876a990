"""Posed meshes with colours drawn into depth, a mesh index and a shaded picture, what does not move drawn once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import NEAR_M, raster_labels

_SHADOW_PIXELS, _SHADOW_VIEW_M = 420, 1.1
_BACKGROUND = (58, 60, 64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A mesh with one colour: red, green, blue, 0 to 255."""

    mesh: Mesh
    colour: tuple[int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """What a camera sees, exactly.

    Attributes:
        depth: (h, w) float32 z-depth, metres; 0 where nothing is seen.
        index: (h, w) int16, which thing is seen: those that stay, then those that move; -1 for none.
        colour: (h, w, 3) uint8.
    """

    depth: np.ndarray
    index: np.ndarray
    colour: np.ndarray


class ShadedScene:
    """A camera, a light, things that stay and things that move from picture to picture."""

    def __init__(
        self, *, intrinsics: Intrinsics, X_WC: np.ndarray, light_W: np.ndarray, stay: Sequence[Thing],
        move: Sequence[Thing],
    ) -> None:  # fmt: skip
        """Draw what stays.

        Args:
            light_W: (3,) place of the light, metres.
            stay: meshes in W. move: meshes of which only the faces count: `draw` is given their vertices.
        """
        self.intrinsics, self.X_WC = intrinsics, X_WC
        self._X_CW = np.linalg.inv(X_WC)
        self._light_W = np.asarray(light_W, np.float64)
        focal = _SHADOW_PIXELS * float(np.linalg.norm(self._light_W)) / _SHADOW_VIEW_M
        middle = 0.5 * (_SHADOW_PIXELS - 1)
        self._shadow = Intrinsics(focal, focal, middle, middle, _SHADOW_PIXELS, _SHADOW_PIXELS)
        self._X_LW = np.linalg.inv(look_at(self._light_W, np.zeros(3), up=(0.0, 1.0, 0.0)))
        self._stay, self._move = _packed(stay), _packed(move)
        self._colours = np.array([t.colour for t in (*stay, *move)], np.float64).reshape(-1, 3)
        vertices_W = np.concatenate([t.mesh.vertices for t in stay]) if stay else np.zeros((0, 3))
        self._count = len(stay)
        self._depth, self._face = self._drawn(vertices_W, self._stay[0], 0, *self._blank())
        self._normals = _normals(vertices_W, self._stay[0])
        self._by_light = np.full((_SHADOW_PIXELS, _SHADOW_PIXELS), np.inf, np.float32)
        self._light_up(vertices_W, self._stay[0], self._by_light)
        self._index, self._colour = np.full(self._face.shape, -1, np.int16), np.empty((*self._face.shape, 3), np.uint8)
        self._lit_at = np.empty(self._face.shape, np.int32)  # where in the light's image each pixel's surface is
        nothing_known = np.zeros(self._face.shape, bool)
        self._shaded(
            self._depth, self._face, self._stay[1], self._normals, self._by_light, nothing_known, self._lit_at,
            self._index, self._colour,
        )  # fmt: skip

    def _blank(self) -> tuple[np.ndarray, np.ndarray]:
        shape = (self.intrinsics.height, self.intrinsics.width)
        return np.full(shape, np.inf, np.float32), np.full(shape, -1, np.int32)

    def _drawn(
        self, vertices_W: np.ndarray, faces: np.ndarray, first: int, depth: np.ndarray, face: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        k = self.intrinsics
        points_C = _moved(self._X_CW, vertices_W)
        labels = np.arange(first, first + len(faces), dtype=np.int32)
        raster_labels(
            points_C, faces, labels, float(k.fx), float(k.fy), float(k.cx), float(k.cy), NEAR_M, depth, face
        )  # fmt: skip
        return depth, face

    def _light_up(self, vertices_W: np.ndarray, faces: np.ndarray, by_light: np.ndarray) -> None:
        """Draw triangles into what the light sees."""
        k, points_L = self._shadow, _moved(self._X_LW, vertices_W)
        unused, labels = np.zeros(by_light.shape, np.int8), np.zeros(len(faces), np.int8)
        raster_labels(points_L, faces, labels, k.fx, k.fy, k.cx, k.cy, NEAR_M, by_light, unused)

    def draw(self, vertices_W: Sequence[np.ndarray]) -> Picture:
        """The picture with the moving things' vertices (V, 3) at these places, one array for each of `move`."""
        points = np.concatenate(vertices_W) if vertices_W else np.zeros((0, 3))
        faces, owner = self._move
        stay_faces, stay_owner = self._stay
        depth, face = self._drawn(points, faces, len(stay_faces), self._depth.copy(), self._face.copy())
        normals = np.concatenate([self._normals, _normals(points, faces)])
        owners = np.concatenate([stay_owner, owner + self._count])
        by_light, known = self._by_light.copy(), np.empty(depth.shape, bool)
        self._light_up(points, faces, by_light)
        _mark_known(face, self._face, self._lit_at, by_light != self._by_light, known)
        index, colour = self._index.copy(), self._colour.copy()
        self._shaded(depth, face, owners, normals, by_light, known, np.empty(depth.shape, np.int32), index, colour)
        return Picture(depth=np.where(face >= 0, depth, np.float32(0.0)), index=index, colour=colour)

    def _shaded(
        self, depth: np.ndarray, face: np.ndarray, owners: np.ndarray, normals: np.ndarray, by_light: np.ndarray,
        known: np.ndarray, lit_at: np.ndarray, index: np.ndarray, colour: np.ndarray,
    ) -> None:  # fmt: skip
        k = self.intrinsics
        _shade(
            depth, face, owners, normals, self._colours, np.array(_BACKGROUND, np.float64), self.X_WC,
            np.array([k.fx, k.fy, k.cx, k.cy]), self._light_W, self._X_LW, by_light, self._shadow.fx, known, lit_at,
            index, colour,
        )  # fmt: skip


def _packed(things: Sequence[Thing]) -> tuple[np.ndarray, np.ndarray]:
    """Faces (F, 3) of all into their joined vertices, and (F,) which thing each belongs to."""
    faces, owner, first = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)], 0
    for i, thing in enumerate(things):
        faces.append(np.asarray(thing.mesh.faces, np.int64) + first)
        owner.append(np.full(len(thing.mesh.faces), i))
        first += len(thing.mesh.vertices)
    return np.concatenate(faces), np.concatenate(owner)


def _moved(X: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points @ X[:3, :3].T + X[:3, 3])


@njit(cache=True, error_model="numpy")
def _normals(vertices, faces):  # type: ignore[no-untyped-def]
    out = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(x * x + y * y + z * z) + 1e-30
        out[f, 0], out[f, 1], out[f, 2] = x / length, y / length, z / length
    return out


@njit(cache=True, error_model="numpy")
def _mark_known(face, still_face, lit_at, changed, known):  # type: ignore[no-untyped-def]
    """Pixels that look as if only what stays were there: the same face is seen, and no shadow came or went on it.

    Args:
        lit_at: as `_shade` writes it. changed: (n, n) bool, where the light sees something else. known: written.
    """
    wide = changed.shape[1]
    for v in range(face.shape[0]):
        for u in range(face.shape[1]):
            known[v, u] = face[v, u] == still_face[v, u]
            if known[v, u] and lit_at[v, u] >= 0:
                row, column = lit_at[v, u] // wide, lit_at[v, u] % wide
                for k in range(5):
                    i, j = (0, 0) if k == 4 else (2 * (k // 2) - 1, 2 * (k % 2) - 1)
                    known[v, u] &= not changed[row + i, column + j]


@njit(cache=True, error_model="numpy")
def _shade(  # type: ignore[no-untyped-def]
    depth, face, owners, normals, colours, background, X_WC, k, light, X_LW, by_light, focal, known, lit_at, index, out
):  # fmt: skip
    """Lambert's law with a sky, a fill from the camera, and a soft shadow.

    Args:
        known: (h, w) bool, pixels that are right already.
        lit_at: (h, w) int32, written: the pixel of the light's image, row by row, that says whether a surface is lit;
            -1 where that does not matter.
    """
    half = 0.5 * (by_light.shape[0] - 1)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if known[v, u]:
                continue
            f = face[v, u]
            lit_at[v, u] = -1
            if f < 0:
                for c in range(3):
                    out[v, u, c] = np.uint8(background[c])
                continue
            z = depth[v, u]
            x_C, y_C = (u - k[2]) / k[0] * z, (v - k[3]) / k[1] * z
            px = X_WC[0, 0] * x_C + X_WC[0, 1] * y_C + X_WC[0, 2] * z + X_WC[0, 3]
            py = X_WC[1, 0] * x_C + X_WC[1, 1] * y_C + X_WC[1, 2] * z + X_WC[1, 3]
            pz = X_WC[2, 0] * x_C + X_WC[2, 1] * y_C + X_WC[2, 2] * z + X_WC[2, 3]
            nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
            ex, ey, ez = X_WC[0, 3] - px, X_WC[1, 3] - py, X_WC[2, 3] - pz
            eye = np.sqrt(ex * ex + ey * ey + ez * ez)
            facing = (nx * ex + ny * ey + nz * ez) / eye
            lx, ly, lz = light[0] - px, light[1] - py, light[2] - pz
            far = np.sqrt(lx * lx + ly * ly + lz * lz)
            sun = max((nx * lx + ny * ly + nz * lz) / far, 0.0)
            if sun > 0.0:
                bias = 0.003 + 0.004 / (sun + 0.15)  # a surface along the light spans more depth per pixel
                qx = X_LW[0, 0] * px + X_LW[0, 1] * py + X_LW[0, 2] * pz + X_LW[0, 3]
                qy = X_LW[1, 0] * px + X_LW[1, 1] * py + X_LW[1, 2] * pz + X_LW[1, 3]
                qz = X_LW[2, 0] * px + X_LW[2, 1] * py + X_LW[2, 2] * pz + X_LW[2, 3]
                su, sv = int(np.rint(qx / qz * focal + half)), int(np.rint(qy / qz * focal + half))
                if 1 <= su < by_light.shape[1] - 1 and 1 <= sv < by_light.shape[0] - 1:
                    lit_at[v, u] = sv * by_light.shape[1] + su
                    lit = 1.0 * (by_light[sv, su] > qz - bias)
                    for i in range(-1, 2, 2):
                        for j in range(-1, 2, 2):
                            lit += by_light[sv + i, su + j] > qz - bias
                    sun *= lit / 5.0
            bright = 0.38 + 0.14 * (0.5 + 0.5 * nz) + 0.12 * max(facing, 0.0) + 0.48 * sun
            index[v, u] = owners[f]
            for c in range(3):
                out[v, u, c] = np.uint8(min(colours[owners[f], c] * bright, 255.0))
