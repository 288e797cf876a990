"""Closed triangle meshes from stacked cross-sections, and rounded boxes. Metres, z up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.geometry.mesh import Mesh

# Vertices are rounded to a tenth of a micrometre, so that the last bit of a platform's sine does not
# change the content hash of a generated mesh.
_DECIMALS = 7


def superellipse(half_x: float, half_y: float, exponent: float, count: int) -> np.ndarray:
    """(count, 2) points of |x / half_x|^n + |y / half_y|^n = 1, counter-clockwise from +x.

    `exponent` 2 is an ellipse, larger is squarer. `count` must be a multiple of 4: the points then include the
    four extremes, so the outline has exactly the asked width.
    """
    angle = 2.0 * np.pi * np.arange(count) / count
    cos, sin = np.cos(angle), np.sin(angle)
    power = 2.0 / exponent
    return np.stack(
        [half_x * np.sign(cos) * np.abs(cos) ** power, half_y * np.sign(sin) * np.abs(sin) ** power], axis=1
    )


def rounded_rectangle(half_x: float, half_y: float, radius: float, count: int) -> np.ndarray:
    """(count, 2) points of a rectangle with round corners, counter-clockwise; `count` a multiple of 4.

    Each corner gets count / 4 points; the straight sides are single edges.
    """
    per_corner = count // 4
    arc = np.linspace(0.0, 0.5 * np.pi, per_corner)
    centres = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (half_x - radius, half_y - radius)
    angle = (arc[None, :] + 0.5 * np.pi * np.arange(4)[:, None])[..., None]
    return (centres[:, None, :] + radius * np.concatenate([np.cos(angle), np.sin(angle)], axis=2)).reshape(-1, 2)


def loft(outlines: Sequence[np.ndarray], heights: Sequence[float]) -> Mesh:
    """The closed surface through outlines stacked from bottom to top.

    Args:
        outlines: (K, 2) counter-clockwise points each, all with the same K.
        heights: z of each outline. They may go down as well (a recessed lid), as long as the surface does not
            cross itself.
    Returns:
        A closed manifold mesh, faces outward, first and last outline closed by a fan about their means.
    """
    rings = np.stack(
        [np.column_stack([outline, np.full(len(outline), z)]) for outline, z in zip(outlines, heights, strict=True)]
    )
    ring_count, size = rings.shape[:2]
    vertices = np.concatenate([rings.reshape(-1, 3), rings[:1].mean(axis=1), rings[-1:].mean(axis=1)])
    here = np.arange(size)
    after = (here + 1) % size
    base = size * np.arange(ring_count - 1)[:, None]
    a, b, c, d = base + here, base + after, base + size + after, base + size + here
    sides = np.concatenate([np.stack([a, b, c], axis=2).reshape(-1, 3), np.stack([a, c, d], axis=2).reshape(-1, 3)])
    bottom, top = len(vertices) - 2, len(vertices) - 1
    last = size * (ring_count - 1)
    caps = np.concatenate(
        [
            np.column_stack([after, here, np.full(size, bottom)]),
            np.column_stack([last + here, last + after, np.full(size, top)]),
        ]
    )
    faces = np.concatenate([sides, caps]).astype(np.int32)
    return Mesh(np.round(vertices, _DECIMALS), faces)


def rounded_box(half: Sequence[float], radius: float, *, arc_steps: int = 5, flat_steps: int = 10) -> Mesh:
    """A closed box with edges and corners rounded by `radius`; outer half extents exactly `half`.

    Each side is a grid, dense over the rounding and coarse over the flat; a grid point p of the sharp box moves to
    c + radius * (p - c) / |p - c| with c its nearest point in the box shrunk by `radius`.
    """
    half_m = np.asarray(half, dtype=np.float64)
    lines = [_grid_line(h, radius, arc_steps, flat_steps) for h in half_m]
    corners: list[np.ndarray] = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            grid = np.empty((len(lines[u]), len(lines[v]), 3))
            grid[..., axis] = sign * half_m[axis]
            grid[..., u], grid[..., v] = np.meshgrid(lines[u], lines[v], indexing="ij")
            quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
            corners.append(quads if sign > 0 else quads[:, ::-1])
    quads = np.concatenate(corners)
    inner = np.clip(quads, -(half_m - radius), half_m - radius)
    offset = quads - inner
    points = np.round(inner + radius * offset / np.linalg.norm(offset, axis=2, keepdims=True), _DECIMALS) + 0.0
    vertices, index = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
    quad = index.reshape(-1, 4)
    return Mesh(vertices, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32))


def _grid_line(half: float, radius: float, arc_steps: int, flat_steps: int) -> np.ndarray:
    """Grid coordinates from -half to half whose rounded images are evenly spaced over the arcs.

    An edge's arc spans 45 degrees on each of its two sides, hence tan of angles up to 45 degrees.
    """
    arc = radius * np.tan(np.linspace(0.0, 0.25 * np.pi, arc_steps + 1))[1:]
    flat = np.linspace(-(half - radius), half - radius, flat_steps + 1)
    return np.concatenate([-(half - radius) - arc[::-1], flat, half - radius + arc])
