"""Masses and inertias of hand links and objects, computed here so that no file's inertia is ever trusted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.hands.hand import ConvexPart, PartKind


def solid_inertia(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Inertia tensor of a uniform solid of mass 1, about `centre`, m^2.

    Sums the tetrahedra between `centre` and each face, so small holes in a scan do little harm. When the faces are
    far from enclosing a solid (inside out, or a twentieth of the surface missing), the solid bounding box is used.

    Args:
        vertices: (V, 3) metres; faces: (F, 3) indices, outward.
        centre: (3,) metres.
    Returns:
        (3, 3) float64, symmetric, positive definite, axes of the mesh frame.
    """
    corners = vertices[faces] - centre  # (F, 3, 3)
    six_volumes = np.linalg.det(corners)  # (F,)
    volume = six_volumes.sum() / 6
    # second moment of a tetrahedron with one corner at the origin: det/120 (sum_i v_i v_i' + s s'), s = sum_i v_i
    total = corners.sum(axis=1)
    moments = np.einsum("f,fki,fkj->ij", six_volumes, corners, corners)
    moments = (moments + np.einsum("f,fi,fj->ij", six_volumes, total, total)) / 120
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # (F, 3), sums to 0 when closed
    missing = np.linalg.norm(areas.sum(axis=0)) / max(np.linalg.norm(areas, axis=1).sum(), 1e-300)
    if missing < 0.05 and volume > 0 and np.linalg.eigvalsh(moments)[0] > 0:
        second = moments / volume
    else:
        extents = vertices.max(axis=0) - vertices.min(axis=0)
        offset = (vertices.max(axis=0) + vertices.min(axis=0)) / 2 - centre
        second = np.diag(extents**2) / 12 + np.outer(offset, offset)
    return np.trace(second) * np.eye(3) - second


def part_volume(part: ConvexPart) -> float:
    """Volume of one convex part, m^3 (of its bounding box for a hull without faces)."""
    a, b, c = part.size if part.kind != PartKind.HULL else (0.0, 0.0, 0.0)
    if part.kind == PartKind.BOX:
        return 8 * a * b * c
    if part.kind == PartKind.SPHERE:
        return 4 / 3 * np.pi * a**3
    if part.kind == PartKind.CAPSULE:
        return np.pi * a**2 * (2 * b + 4 / 3 * a)
    if part.kind == PartKind.CYLINDER:
        return np.pi * a**2 * 2 * b
    if len(part.faces):
        corners = part.vertices[part.faces] - part.vertices.mean(axis=0)
        return float(abs(np.linalg.det(corners).sum()) / 6)
    return float(np.prod(np.ptp(part.vertices, axis=0)))


def part_bounds(parts: Sequence[ConvexPart]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of the box around the parts of one link, link frame, metres."""
    lows, highs = [], []
    for part in parts:
        R, t = part.X_LP[:3, :3], part.X_LP[:3, 3]
        if part.kind == PartKind.HULL:
            points = part.vertices @ R.T + t
            low, high = points.min(axis=0), points.max(axis=0)
        else:
            half = np.abs(R) @ _half_extents(part)
            low, high = t - half, t + half
        lows.append(low)
        highs.append(high)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _half_extents(part: ConvexPart) -> np.ndarray:
    radius, half_length = part.size[0], part.size[1]
    if part.kind == PartKind.BOX:
        return np.asarray(part.size, np.float64)
    if part.kind == PartKind.SPHERE:
        return np.full(3, radius)
    if part.kind == PartKind.CAPSULE:
        return np.array([radius, radius, half_length + radius])
    return np.array([radius, radius, half_length])
