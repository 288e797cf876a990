"""A thing that stands on the table between a camera and a hand, clear of all that moves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from neuralgrasps.geometry.mesh import Mesh, box_mesh, cylinder_mesh
from neuralgrasps.human.synthetic.scene import placed

_GAP_M, _CELL_M = 0.025, 0.01  # between the thing and all that moves; of the grid on which that is tested
_HALF = 1 << 12  # cells on either side of the origin
_BEFORE_M = 0.2  # between the camera and the thing
_TALLEST_M, _LOWEST_M = 0.28, 0.03


def draw_occluder(rng: np.random.Generator, *, hand_W: np.ndarray, X_WC: np.ndarray) -> Mesh | None:
    """A box or a can on the table whose top lies near the line from a camera to the hand; None where none can.

    Args:
        hand_W: (3,) middle of the hand. X_WC: (4, 4) the camera; the thing is not right before it.
    """
    eye, hand = X_WC[:3, 3], hand_W
    away = float(np.linalg.norm((eye - hand)[:2]))
    forth = (eye - hand)[:2] / max(away, 1e-9)
    along = rng.uniform(0.06, 0.32)
    if along > away - 0.05:
        return None
    line = hand[2] + (eye[2] - hand[2]) * along / away
    height = line + rng.uniform(-0.06, 0.06)
    if not _LOWEST_M <= height <= _TALLEST_M:
        return None
    if rng.random() < 0.5:
        mesh = box_mesh([rng.uniform(0.015, 0.05), rng.uniform(0.02, 0.08), height / 2])
    else:
        mesh = cylinder_mesh(rng.uniform(0.02, 0.05), height / 2)
    middle = hand[:2] + along * forth + rng.normal(0.0, 0.04) * np.array([-forth[1], forth[0]])
    turn = float(np.arctan2(forth[1], forth[0])) + rng.normal(0.0, 0.4)
    mesh = placed(mesh, [*middle, height / 2], turn)
    return mesh if np.linalg.norm(mesh.vertices - eye, axis=1).min() > _BEFORE_M else None


def is_near(mesh: Mesh, points: np.ndarray) -> bool:
    """Whether any of some points (M, 3) may be within `_GAP_M` of a convex thing."""
    near = (points > mesh.vertices.min(axis=0) - _GAP_M).all(axis=1)
    near &= (points < mesh.vertices.max(axis=0) + _GAP_M).all(axis=1)
    if not near.any():
        return False
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    off = points[near] @ normals.T - np.einsum("fi,fi->f", normals, corners[:, 0])
    return bool((off.max(axis=1) < _GAP_M).any())  # at least as far as the farthest of its planes


def swept(meshes: Sequence[Mesh], moments: Iterable[Sequence[np.ndarray]]) -> np.ndarray:
    """(M, 3) places that meshes ever take, as cells of a grid, from their vertices (V, 3) in W at some moments."""
    beads, cells = [_Beads(mesh) for mesh in meshes], list[np.ndarray]()
    for vertices_W in moments:
        points = np.concatenate([string.points(v) for string, v in zip(beads, vertices_W, strict=True)])
        x, y, z = np.rint(points / _CELL_M).astype(np.int64).T + _HALF
        cells.append(np.unique((x * 2 * _HALF + y) * 2 * _HALF + z))
    merged = np.unique(np.concatenate(cells))
    z, rest = merged % (2 * _HALF), merged // (2 * _HALF)
    return (np.stack([rest // (2 * _HALF), rest % (2 * _HALF), z], axis=1) - _HALF) * _CELL_M


class _Beads:
    """Points along the edges and over the faces of a mesh, whose vertices move: never farther apart than a cell."""

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.vertices[mesh.faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        parts = np.maximum(np.ceil(longest / _CELL_M), 1).astype(int)
        faces, weights = [], []
        for n in np.unique(parts[parts > 1]):
            i, j = np.divmod(np.arange((n + 1) ** 2), n + 1)
            inside = np.stack([i, j, n - i - j], axis=1)[i + j <= n] / n
            chosen = np.flatnonzero(parts == n)
            faces.append(np.repeat(chosen, len(inside)))
            weights.append(np.tile(inside, (len(chosen), 1)))
        self._corners = mesh.faces[np.concatenate(faces)] if faces else np.zeros((0, 3), int)
        self._weights = np.concatenate(weights) if weights else np.zeros((0, 3))

    def points(self, vertices: np.ndarray) -> np.ndarray:
        return np.concatenate([vertices, np.einsum("nc,ncx->nx", self._weights, vertices[self._corners])])
