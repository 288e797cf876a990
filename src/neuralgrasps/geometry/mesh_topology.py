"""The `Mesh` noun and what follows from its vertices and faces alone: closedness, bodies, normals, mass properties."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from neuralgrasps.errors import MeshError, ShapeError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in one frame, metres. The arrays are copied on construction and read-only.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int32 vertex indices, counter-clockwise seen from outside.

    Raises:
        ShapeError: an array is not (*, 3).
        MeshError: a vertex is not finite or an index is out of range.
    """

    vertices: FloatArray
    faces: IntArray

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, dtype=np.float64, order="C")
        raw_faces = np.asarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise ShapeError(f"vertices has shape {vertices.shape}; expected (V, 3).")
        if raw_faces.ndim != 2 or raw_faces.shape[1] != 3:
            raise ShapeError(f"faces has shape {raw_faces.shape}; expected (F, 3) triangles.")
        if not np.isfinite(vertices).all():
            raise MeshError("A vertex is not finite (NaN or infinite); load_mesh drops such vertices.")
        if raw_faces.size and (raw_faces.min() < 0 or raw_faces.max() >= len(vertices)):
            raise MeshError(f"faces name vertex {raw_faces.max()} but there are {len(vertices)} vertices.")
        faces = np.array(raw_faces, dtype=np.int32, order="C")
        vertices.setflags(write=False)
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    def __repr__(self) -> str:
        size = ", " + " x ".join(f"{1e3 * s:.0f}" for s in self.extents) + " mm" if len(self.vertices) else ""
        return f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces{size})"

    @property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner of the axis-aligned box."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extents(self) -> FloatArray:
        """(3,) side lengths of the axis-aligned box."""
        return np.ptp(self.vertices, axis=0)

    @property
    def triangles(self) -> FloatArray:
        """(F, 3, 3) corner positions."""
        return self.vertices[self.faces]

    def content_hash(self) -> str:
        """sha256 (hex) of the vertex and face arrays: equal meshes, equal hash, on any machine."""
        digest = hashlib.sha256(f"mesh {len(self.vertices)} {len(self.faces)};".encode())
        digest.update(self.vertices.astype("<f8").tobytes())
        digest.update(self.faces.astype("<i4").tobytes())
        return digest.hexdigest()

    def transformed(self, X_AB: FloatArray) -> Mesh:
        """This mesh, given in B, expressed in A by the rigid transform X_AB (4, 4)."""
        X = np.asarray(X_AB, dtype=np.float64)
        return Mesh(self.vertices @ X[:3, :3].T + X[:3, 3], self.faces)


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Of a solid of unit density: `volume` (m^3) and `centre` of mass (3,) in the mesh frame."""

    volume: float
    centre: FloatArray


def merge_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh with all triangles; nothing is cut or welded."""
    if not meshes:
        raise MeshError("merge_meshes got no mesh; expected at least one.")
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    faces = np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)])
    return Mesh(np.concatenate([m.vertices for m in meshes]), faces)


def face_areas_normals(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """(F,) areas in m^2 and (F, 3) outward unit normals (zero for a face without area)."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return 0.5 * length, cross / np.where(length > 0, length, 1.0)[:, None]


def vertex_normals(mesh: Mesh) -> FloatArray:
    """(V, 3) outward unit normals, faces weighted by their angle at the vertex (Baerentzen & Aanaes 2005)."""
    _, normals = face_areas_normals(mesh)
    triangles = mesh.triangles
    total = np.zeros_like(mesh.vertices)
    for corner in range(3):
        u = triangles[:, (corner + 1) % 3] - triangles[:, corner]
        v = triangles[:, (corner + 2) % 3] - triangles[:, corner]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.sum(u * v, axis=1))
        for axis in range(3):
            total[:, axis] += np.bincount(mesh.faces[:, corner], angle * normals[:, axis], minlength=len(total))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def directed_edges(faces: IntArray) -> NDArray[np.int64]:
    """(3F, 2) edges in the faces' winding order; rows f, F+f and 2F+f belong to face f."""
    f = faces.astype(np.int64)
    return np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])


def is_closed(mesh: Mesh) -> bool:
    """True if every edge is used as often in one direction as in the other: no boundary, inside is well defined."""
    return open_edge_count(mesh.faces) == 0


def open_edge_count(faces: IntArray) -> int:
    """How many edges lack an oppositely directed partner (0 for a closed, consistently wound surface)."""
    if not len(faces):
        return 0
    edges = directed_edges(faces)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, group = np.unique(low * (int(faces.max()) + 1) + high, return_inverse=True)
    balance = np.bincount(group.ravel(), np.where(edges[:, 0] == low, 1.0, -1.0))
    return int(np.abs(balance).sum())


def is_manifold(mesh: Mesh) -> bool:
    """True if every edge is shared by exactly two, oppositely wound faces."""
    edges = directed_edges(mesh.faces)
    keys = edges.min(axis=1) * (int(mesh.faces.max(initial=0)) + 1) + edges.max(axis=1)
    _, counts = np.unique(keys, return_counts=True)
    return bool(np.all(counts == 2)) and is_closed(mesh)


def face_bodies(faces: IntArray, num_vertices: int) -> tuple[int, NDArray[np.int32]]:
    """Number of edge- or vertex-connected bodies and the (F,) body of each face."""
    if not len(faces):
        return 0, np.zeros(0, dtype=np.int32)
    edges = directed_edges(faces)
    graph = sparse.coo_matrix((np.ones(len(edges), dtype=np.int8), edges.T), shape=(num_vertices, num_vertices))
    _, label = connected_components(graph, directed=False)
    used, body = np.unique(label[faces[:, 0]], return_inverse=True)
    return len(used), body.ravel().astype(np.int32)


def mass_properties(mesh: Mesh) -> MassProperties:
    """Volume and centre of mass by the divergence theorem; exact for closed meshes, a good guess with small holes.

    Overlapping bodies count twice where they overlap. A surface that encloses nothing gives its area centroid.
    """
    origin = mesh.vertices.mean(axis=0)  # seams then err least
    a, b, c = np.moveaxis(mesh.triangles - origin, 1, 0)
    six_volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = float(six_volume.sum() / 6.0)
    areas, _ = face_areas_normals(mesh)
    if abs(volume) > 1e-9 * float(areas.sum()) ** 1.5:
        centre = (six_volume[:, None] * (a + b + c)).sum(axis=0) / (24.0 * volume)
    else:
        centre = (areas[:, None] * (a + b + c)).sum(axis=0) / (3.0 * max(float(areas.sum()), 1e-300))
    return MassProperties(volume=volume, centre=origin + centre)
