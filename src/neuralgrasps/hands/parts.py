"""Geometry of one convex part: exact distance, bounding sphere, mesh and surface samples. Torch-free."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.mesh import Mesh, box_mesh, capsule_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.geometry.shape_kernels import box_sdf, capsule_sdf, convex_sdf, cylinder_sdf, sphere_sdf
from neuralgrasps.hands.hand import ConvexPart, PartKind

_BOX, _SPHERE, _CAPSULE, _CYLINDER = (
    int(k) for k in (PartKind.BOX, PartKind.SPHERE, PartKind.CAPSULE, PartKind.CYLINDER)
)
_PLASTIC = 0.7548776662466927  # the plastic number's powers give the evenest 2-d additive sequence (Roberts 2018, "R2")


@njit(cache=True, error_model="numpy")
def part_distance(kind, size, planes, triangles, x, y, z):  # type: ignore[no-untyped-def]
    """Exact signed distance from (x, y, z), part frame, metres, to one part.

    Args:
        kind: `PartKind`; size (3,): as in `ConvexPart`.
        planes (F, 4): n . p + d <= 0 inside; triangles (F, 3, 3): only for hulls.
    """
    if kind == _BOX:
        return box_sdf(x, y, z, size[0], size[1], size[2])
    if kind == _CAPSULE:
        return capsule_sdf(x, y, z, size[0], size[1])
    if kind == _SPHERE:
        return sphere_sdf(x, y, z, size[0])
    if kind == _CYLINDER:
        return cylinder_sdf(x, y, z, size[0], size[1])
    return convex_sdf(x, y, z, planes, triangles)


@njit(cache=True, error_model="numpy")
def _distances(kind, size, planes, triangles, points, out):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        out[i] = part_distance(kind, size, planes, triangles, points[i, 0], points[i, 1], points[i, 2])


def part_distances(part: ConvexPart, points_L: np.ndarray) -> np.ndarray:
    """Exact signed distances (M,) from points (M, 3) in the link frame to one part."""
    R, t = part.X_LP[:3, :3], part.X_LP[:3, 3]
    out = np.empty(len(points_L))
    _distances(int(part.kind), part.size, *hull_planes(part), np.ascontiguousarray((points_L - t) @ R), out)
    return out


def hull_planes(part: ConvexPart) -> tuple[np.ndarray, np.ndarray]:
    """(F, 4) planes n . p + d <= 0 inside and (F, 3, 3) triangles of a hull, part frame; empty for other kinds."""
    triangles = part.vertices[part.faces].reshape(-1, 3, 3)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1)
    good = area > 1e-14  # slivers have no normal and add nothing
    normals = cross[good] / area[good, None]
    offsets = -np.einsum("ij,ij->i", normals, triangles[good, 0])
    return np.column_stack([normals, offsets]), np.ascontiguousarray(triangles[good])


def bounding_sphere(part: ConvexPart) -> tuple[np.ndarray, float]:
    """Centre (3,) in the link frame and radius, metres, of a sphere around the part."""
    if part.kind == PartKind.HULL:
        middle = (part.vertices.min(axis=0) + part.vertices.max(axis=0)) / 2
        radius = float(np.linalg.norm(part.vertices - middle, axis=1).max())
        return part.X_LP[:3, :3] @ middle + part.X_LP[:3, 3], radius
    a, b, _ = part.size
    radius = {
        PartKind.BOX: float(np.linalg.norm(part.size)),
        PartKind.SPHERE: a,
        PartKind.CAPSULE: a + b,
        PartKind.CYLINDER: math.hypot(a, b),
    }[part.kind]
    return part.X_LP[:3, 3].copy(), float(radius)


def part_mesh(part: ConvexPart, *, segments: int = 32) -> Mesh:
    """Closed triangle mesh of the part in the link frame; `segments` around for round parts."""
    a, b, _ = (float(v) for v in part.size)
    match part.kind:
        case PartKind.BOX:
            mesh = box_mesh(part.size)
        case PartKind.SPHERE:
            mesh = sphere_mesh(a, segments=segments)
        case PartKind.CAPSULE:
            mesh = capsule_mesh(a, b, segments=segments)
        case PartKind.CYLINDER:
            mesh = cylinder_mesh(a, b, segments=segments)
        case PartKind.HULL:
            mesh = Mesh(part.vertices, part.faces)
    return mesh.transformed(part.X_LP)


def sample_part(part: ConvexPart, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 3) on the exact surface and outward normals (K, 3), link frame; about `density` per square metre.

    A fixed low-discrepancy sequence on each face: no seed, the same points every time.
    """
    a, b, c = (float(v) for v in part.size)
    match part.kind:
        case PartKind.BOX:
            points, normals = _sample_box(a, b, c, density)
        case PartKind.SPHERE:
            points, normals = _sample_capsule(a, 0.0, density)
        case PartKind.CAPSULE:
            points, normals = _sample_capsule(a, b, density)
        case PartKind.CYLINDER:
            points, normals = _sample_cylinder(a, b, density)
        case PartKind.HULL:
            points, normals = _sample_triangles(hull_planes(part)[1], density)
    R = part.X_LP[:3, :3]
    return points @ R.T + part.X_LP[:3, 3], normals @ R.T


def _unit_square(area: float, density: float) -> np.ndarray:
    count = max(1, round(area * density))
    k = np.arange(1, count + 1)[:, None]
    return (0.5 + k * np.array([_PLASTIC, _PLASTIC**2])) % 1.0


def _sample_box(a: float, b: float, c: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    half = np.array([a, b, c])
    points, normals = [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        square = 2.0 * _unit_square(4 * half[u] * half[v], density) - 1.0
        for sign in (-1.0, 1.0):
            p = np.empty((len(square), 3))
            p[:, axis], p[:, u], p[:, v] = sign * half[axis], square[:, 0] * half[u], square[:, 1] * half[v]
            points.append(p)
            normals.append(np.broadcast_to(sign * np.eye(3)[axis], p.shape))
    return np.concatenate(points), np.concatenate(normals)


def _sample_capsule(radius: float, half_length: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """By Archimedes, height and angle uniform on tube and caps alike: both have 2 pi r area per unit height."""
    reach = half_length + radius
    square = _unit_square(4 * math.pi * radius * reach, density)
    z, angle = (2 * square[:, 0] - 1) * reach, 2 * math.pi * square[:, 1]
    over = np.sign(z) * np.maximum(np.abs(z) - half_length, 0.0) / radius
    ring = np.sqrt(np.maximum(1.0 - over**2, 0.0))
    normals = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), over])
    points = radius * normals
    points[:, 2] += np.clip(z, -half_length, half_length)
    return points, normals


def _sample_cylinder(radius: float, half_height: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    side = _unit_square(4 * math.pi * radius * half_height, density)
    angle = 2 * math.pi * side[:, 0]
    around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(side))])
    points, normals = [radius * around + (2 * side[:, 1:] - 1) * [0, 0, half_height]], [around]
    disc = _unit_square(math.pi * radius**2, density)
    r, turn = radius * np.sqrt(disc[:, 0]), 2 * math.pi * disc[:, 1]
    for sign in (-1.0, 1.0):
        points.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(len(r), sign * half_height)]))
        normals.append(np.broadcast_to([0.0, 0.0, sign], (len(r), 3)))
    return np.concatenate(points), np.concatenate(normals)


def _sample_triangles(triangles: np.ndarray, density: float) -> tuple[np.ndarray, np.ndarray]:
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    cross = np.cross(u, v)
    areas = np.linalg.norm(cross, axis=1) / 2
    square = _unit_square(float(areas.sum()), density)
    ladder = np.cumsum(areas)
    # stratified: one sample per equal share of the area, so that small faces get their due
    face = np.searchsorted(ladder, (np.arange(len(square)) + 0.5) / len(square) * ladder[-1])
    face = np.minimum(face, len(areas) - 1)
    root = np.sqrt(square[:, :1])
    points = triangles[face, 0] + root * (1 - square[:, 1:]) * u[face] + root * square[:, 1:] * v[face]
    return points, cross[face] / (2 * areas[face, None])
