"""Uniform random points on the surface of a posed hand, from its exact shapes (torch-free)."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.dataset.part_rays import part_normal
from neuralgrasps.geometry.pose_kernels import turned_vector
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.packed import PackedHand, hand_distance_many, pose_links

SKIN_M = 2e-6  # a surface point that has another part this close before it is not on the hand's surface


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _box(size: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    areas = np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]])
    axis = rng.choice(3, size=count, p=areas / areas.sum())
    points = rng.uniform(-1.0, 1.0, (count, 3))
    points[np.arange(count), axis] = rng.choice([-1.0, 1.0], size=count)
    return points * size


def _round(radius: float, half: float, area_caps: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on a tube of the given radius and half length, with flat (area 2 pi r^2) or round ends."""
    side = 4.0 * np.pi * radius * half
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-half, half, count)], axis=1)
    end = rng.random(count) * (side + area_caps) >= side
    ends = int(end.sum())
    if area_caps > 2.5 * np.pi * radius**2:  # round ends
        ball = _unit(rng.normal(size=(ends, 3))) * radius
        ball[:, 2] += np.where(ball[:, 2] >= 0.0, half, -half)
        points[end] = ball
    else:
        reach = np.sqrt(rng.random(ends))
        points[end, :2] *= reach[:, None]
        points[end, 2] = rng.choice([-half, half], size=ends)
    return points


def _triangles(triangles: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    area = _triangle_areas(triangles)
    chosen = triangles[rng.choice(len(triangles), size=count, p=area / area.sum())]
    a, b = rng.random((2, count))
    flip = a + b > 1.0
    a, b = np.where(flip, 1.0 - a, a)[:, None], np.where(flip, 1.0 - b, b)[:, None]
    return chosen[:, 0] + a * (chosen[:, 1] - chosen[:, 0]) + b * (chosen[:, 2] - chosen[:, 0])


def _triangle_areas(triangles: np.ndarray) -> np.ndarray:
    edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return 0.5 * np.linalg.norm(edges, axis=1)


def part_areas(packed: PackedHand) -> np.ndarray:
    """(Np,) surface area of each convex part, square metres."""
    areas = np.empty(len(packed.part_kind))
    for k, kind in enumerate(packed.part_kind):
        a, b, c = packed.part_size[k]
        match kind:
            case PartKind.BOX:
                areas[k] = 8.0 * (a * b + b * c + c * a)
            case PartKind.SPHERE:
                areas[k] = 4.0 * np.pi * a**2
            case PartKind.CAPSULE:
                areas[k] = 4.0 * np.pi * a * (a + b)
            case PartKind.CYLINDER:
                areas[k] = 2.0 * np.pi * a * (a + 2.0 * b)
            case _:
                areas[k] = _triangle_areas(_hull_triangles(packed, k)).sum()
    return areas


def _hull_triangles(packed: PackedHand, part: int) -> np.ndarray:
    return packed.hull_triangles[packed.hull_tri_start[part] : packed.hull_tri_start[part + 1]]


def _part_points(packed: PackedHand, part: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) uniform points on one part, in the part frame."""
    size = packed.part_size[part]
    match packed.part_kind[part]:
        case PartKind.BOX:
            return _box(size, count, rng)
        case PartKind.SPHERE:
            return _unit(rng.normal(size=(count, 3))) * size[0]
        case PartKind.CAPSULE:
            return _round(size[0], size[1], 4.0 * np.pi * size[0] ** 2, count, rng)
        case PartKind.CYLINDER:
            return _round(size[0], size[1], 2.0 * np.pi * size[0] ** 2, count, rng)
        case _:
            return _triangles(_hull_triangles(packed, part), count, rng)


def packed_link_poses(packed: PackedHand, q: np.ndarray) -> np.ndarray:
    """X_HL (L, 4, 4) of one posture (J,), link frames in the hand base."""
    X_HL = np.empty((len(packed.parents), 4, 4))
    pose_links(packed, q, X_HL)
    return X_HL


def packed_part_poses(packed: PackedHand, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """X_OP (Np, 4, 4) of the convex parts of one posed hand: X_OH (4, 4), q (J,)."""
    X_OH, q = np.array(X_OH, np.float64), np.array(q, np.float64)  # kernels are compiled for writable arrays
    return (X_OH @ packed_link_poses(packed, q))[packed.part_link] @ np.linalg.inv(packed.part_X_PL)


def hand_normals(packed: PackedHand, X_OP: np.ndarray, points_O: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Outward unit normals (K, 3), object frame, at points (K, 3) on the surfaces of the named parts (K,)."""
    normals = np.empty_like(points_O)
    _normals(
        packed.part_kind, packed.part_size, packed.hull_plane_start, packed.hull_planes, X_OP, points_O, parts, normals
    )
    return normals


@njit(cache=True, error_model="numpy")
def _normals(kinds, sizes, plane_start, planes, X_OP, points, parts, normals):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        part = parts[i]
        X = X_OP[part]
        x, y, z = points[i, 0] - X[0, 3], points[i, 1] - X[1, 3], points[i, 2] - X[2, 3]
        px = X[0, 0] * x + X[1, 0] * y + X[2, 0] * z
        py = X[0, 1] * x + X[1, 1] * y + X[2, 1] * z
        pz = X[0, 2] * x + X[1, 2] * y + X[2, 2] * z
        own = planes[plane_start[part] : plane_start[part + 1]]
        nx, ny, nz = part_normal(kinds[part], sizes[part], own, px, py, pz)
        normals[i, 0], normals[i, 1], normals[i, 2] = turned_vector(X, nx, ny, nz)


def sample_posed_surface(
    packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """The points of `sample_posed_parts` alone: (count, 3) float64, object frame, metres."""
    return sample_posed_parts(packed, X_OH, q, count, rng)[0]


def sample_posed_parts(
    packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points uniform by area on the surface of the union of a posed hand's parts.

    Args:
        packed: the hand; X_OH: (4, 4) hand base in the object frame, metres; q: (J,) joints.
    Returns:
        (count, 3) float64, object frame, metres, and (count,) int64 the part that each lies on. Points inside another
        part, or between two that touch, are drawn again: every point is on the outside of the hand.
    """
    X_OH, q = np.array(X_OH, np.float64), np.array(q, np.float64)  # kernels are compiled for writable arrays
    X_OP = packed_part_poses(packed, X_OH, q)
    area = part_areas(packed)
    kept: list[np.ndarray] = []
    owners: list[np.ndarray] = []
    missing, drawn = count, 0
    while missing > 0:
        share_kept = 0.7 if not drawn else max((count - missing) / drawn, 0.02)
        batch = int(1.05 * missing / share_kept) + 64
        drawn += batch
        shares = rng.multinomial(batch, area / area.sum())
        points = np.concatenate(
            [_part_points(packed, k, n, rng) @ X_OP[k, :3, :3].T + X_OP[k, :3, 3] for k, n in enumerate(shares) if n]
        )
        parts = np.repeat(np.arange(len(shares)), shares)
        before = points + SKIN_M * hand_normals(packed, X_OP, points, parts)
        distance = np.empty(len(points))
        hand_distance_many(packed, X_OH, q, before, distance)
        outside = rng.permutation(np.flatnonzero(distance > 0.5 * SKIN_M))[:missing]
        kept.append(points[outside])
        owners.append(parts[outside])
        missing -= len(outside)
    return np.concatenate(kept), np.concatenate(owners)
