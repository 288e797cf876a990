"""Things that no library of household objects holds, made at random: what an estimator must refuse to name.

None is a plain box or cylinder with sides of 3 to 25 cm, which could be mistaken with good reason. Metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import unknown_name
from neuralgrasps.geometry.mesh import (
    Mesh,
    box_mesh,
    capsule_mesh,
    convex_hull,
    cylinder_mesh,
    merge_meshes,
    sphere_mesh,
)
from neuralgrasps.geometry.se3_numpy import make_transform_np
from neuralgrasps.objects.loft import loft, superellipse

_AROUND = 40


def unknown_shape(kind: str, rng: np.random.Generator) -> Mesh:
    """A random thing of one of the `SHAPES`, as a mesh in a frame of its own; parts may overlap.

    Raises:
        UnknownNameError: no such kind.
    """
    if kind not in SHAPES:
        raise unknown_name("kind of shape", kind, tuple(SHAPES))
    return SHAPES[kind](rng)


def _at(mesh: Mesh, place: np.ndarray | list[float], rotation: np.ndarray | None = None) -> Mesh:
    return mesh.transformed(make_transform_np(rotation, place))


def _turned(radii: np.ndarray, heights: np.ndarray) -> Mesh:
    return loft([superellipse(r, r, 2.0, _AROUND) for r in radii], heights.tolist())


def _shell(radii: np.ndarray, heights: np.ndarray, wall: float) -> Mesh:
    """A turned vessel: the outside up, then the inside down to a floor as thick as the wall."""
    inner_r, inner_z = np.maximum(radii[::-1] - wall, 1e-3), np.maximum(heights[::-1], heights[0] + wall)
    return _turned(np.concatenate([radii, inner_r]), np.concatenate([heights, inner_z]))


def _tube(path: np.ndarray, radii: np.ndarray, *, segments: int = 20) -> Mesh:
    """A tube of circles about a path (K, 3) in the plane y = 0."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    across = np.cross(tangent, side)
    angle = 2.0 * np.pi * np.arange(segments) / segments
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * across[:, None, :]
    rings = path[:, None, :] + radii[:, None, None] * circle
    here = np.arange(segments)
    after = (here + 1) % segments
    base = segments * np.arange(len(path) - 1)[:, None]
    a, b, c, d = base + here, base + after, base + segments + after, base + segments + here
    first, last = len(path) * segments, segments * (len(path) - 1)
    faces = [np.stack([a, b, c], axis=2).reshape(-1, 3), np.stack([a, c, d], axis=2).reshape(-1, 3)]
    faces += [np.column_stack([after, here, np.full(segments, first)])]
    faces += [np.column_stack([last + here, last + after, np.full(segments, first + 1)])]
    return Mesh(np.concatenate([rings.reshape(-1, 3), path[:1], path[-1:]]), np.concatenate(faces))


def _arc(radius: float, start: float, end: float, count: int) -> np.ndarray:
    """(count, 3) points of a circle about the origin in the plane y = 0."""
    angle = np.linspace(start, end, count)
    return radius * np.column_stack([np.cos(angle), np.zeros(count), np.sin(angle)])


def _frame(rng: np.random.Generator) -> Mesh:
    """Bars and plates as of a chair or a shelf: two uprights 20 to 40 cm long with two to four rails or slats."""
    length, gap = rng.uniform(0.2, 0.4), rng.uniform(0.1, 0.25)
    thick, wide = rng.uniform(0.008, 0.02, 2), rng.uniform(0.01, 0.05)
    parts = [_at(box_mesh([0.5 * length, 0.5 * thick[0], 0.5 * thick[1]]), [0.0, s * 0.5 * gap, 0.0]) for s in (-1, 1)]
    for place in np.linspace(-0.45, 0.45, int(rng.integers(2, 5))) * length:
        parts.append(_at(box_mesh([0.5 * wide, 0.5 * gap, 0.4 * thick[1]]), [place, 0.0, 0.0]))
    return merge_meshes(parts)


def _bowl(rng: np.random.Generator) -> Mesh:
    """A bowl, plate or half shell 10 to 28 cm wide."""
    rim, depth, wall = rng.uniform(0.05, 0.14), rng.uniform(0.15, 1.0), rng.uniform(0.002, 0.006)
    angle = np.linspace(np.deg2rad(20.0), 0.5 * np.pi, 14)
    return _shell(rim * np.sin(angle), rim * depth * (1.0 - np.cos(angle)), wall)


def _mug(rng: np.random.Generator) -> Mesh:
    """A cup, slightly conical, with a handle."""
    radius, height, flare = rng.uniform(0.03, 0.05), rng.uniform(0.06, 0.12), rng.uniform(0.75, 1.2)
    cup = _shell(radius * np.array([1.0, flare]), np.array([0.0, height]), rng.uniform(0.002, 0.005))
    reach, thick = rng.uniform(0.3, 0.45) * height, rng.uniform(0.004, 0.007)
    handle = _tube(_arc(reach, -0.5 * np.pi, 0.5 * np.pi, 16), np.full(16, thick))
    return merge_meshes([cup, _at(handle, [0.97 * radius * min(1.0, 0.5 + 0.5 * flare), 0.0, 0.5 * height])])


def _ring(rng: np.random.Generator) -> Mesh:
    """A ring, roll of tape or tyre 8 to 24 cm wide."""
    thick = rng.uniform(0.006, 0.025)
    path = _arc(rng.uniform(0.04, 0.12) + thick, 0.0, 2.0 * np.pi, 48)
    return _tube(path, np.full(48, thick))


def _cone(rng: np.random.Generator) -> Mesh:
    """A cone or flower pot whose top is at most half as wide as its foot."""
    foot, height = rng.uniform(0.03, 0.09), rng.uniform(0.06, 0.25)
    return _turned(foot * np.array([1.0, rng.uniform(0.02, 0.5)]), np.array([0.0, height]))


def _wedge(rng: np.random.Generator) -> Mesh:
    """A ramp or a roof."""
    x, y, z = rng.uniform([0.06, 0.04, 0.03], [0.25, 0.15, 0.15])
    ridge = rng.uniform(0.0, 1.0) * x
    corners = [[0, 0, 0], [x, 0, 0], [0, y, 0], [x, y, 0], [ridge, 0, z], [ridge, y, z]]
    vertices, faces = convex_hull(np.array(corners, float))
    return Mesh(vertices, faces)


def _profile(rng: np.random.Generator) -> Mesh:
    """An L, T or U of two or three plates."""
    length, flange, web = rng.uniform([0.08, 0.06, 0.06], [0.35, 0.15, 0.2])
    thick = rng.uniform(0.004, 0.015)
    base = box_mesh([0.5 * length, 0.5 * flange, 0.5 * thick])
    places = ([0.5], [0.0], [-0.5, 0.5])[int(rng.integers(3))]
    webs = [_at(box_mesh([0.5 * length, 0.5 * thick, 0.5 * web]), [0.0, p * flange, 0.5 * web]) for p in places]
    return merge_meshes([base, *webs])


def _ball(rng: np.random.Generator) -> Mesh:
    """A ball or an egg of radius 1.5 to 9 cm."""
    ball = sphere_mesh(rng.uniform(0.015, 0.09), segments=48)
    return Mesh(ball.vertices * [1.0, 1.0, rng.choice([1.0, rng.uniform(1.2, 1.7)])], ball.faces)


def _bunch(rng: np.random.Generator) -> Mesh:
    """Three to seven boxes, balls, rods and cylinders grown together: a toy, a tool, a heap."""
    parts, reach = [], rng.uniform(0.03, 0.07)
    for _ in range(int(rng.integers(3, 8))):
        a, b, c = rng.uniform(0.01, 0.05, 3)
        solids = (box_mesh([a, b, c]), sphere_mesh(a), capsule_mesh(0.6 * a, 1.5 * b), cylinder_mesh(a, b))
        parts.append(_at(solids[int(rng.integers(4))], rng.normal(0.0, reach, 3), Rotation.random(rng=rng).as_matrix()))
    return merge_meshes(parts)


def _book(rng: np.random.Generator) -> Mesh:
    """A slab far larger (28 to 45 cm) or a block far smaller (1.5 to 2.8 cm) than the boxes of a library."""
    large = rng.uniform([0.28, 0.18, 0.008], [0.45, 0.32, 0.03])
    return box_mesh(0.5 * (large if rng.random() < 0.6 else rng.uniform(0.015, 0.028, 3)))


def _banana(rng: np.random.Generator) -> Mesh:
    """A bent, tapering body, 10 to 25 cm along the bend."""
    bend = rng.uniform(0.8, 2.5)
    length, thick = rng.uniform(0.1, 0.25), rng.uniform(0.012, 0.022)
    along = np.linspace(-1.0, 1.0, 24)
    return _tube(_arc(length / bend, -0.5 * bend, 0.5 * bend, 24), thick * np.sqrt(1.02 - along**4))


def _lump(rng: np.random.Generator) -> Mesh:
    """A stone, potato or crumpled cloth: a ball of 3 to 8 cm with waves and three different axes."""
    ball = sphere_mesh(1.0, segments=48)
    direction = ball.vertices
    waves = rng.normal(0.0, 1.0, (6, 3)) * 2.0
    swell = 1.0 + 0.06 * np.sin(direction @ waves.T + rng.uniform(0.0, 2.0 * np.pi, 6)).sum(axis=1)
    return Mesh(direction * swell[:, None] * rng.uniform(0.02, 0.08, 3), ball.faces)


SHAPES: Mapping[str, Callable[[np.random.Generator], Mesh]] = MappingProxyType(
    {
        "frame": _frame, "bowl": _bowl, "mug": _mug, "ring": _ring, "cone": _cone, "wedge": _wedge,
        "profile": _profile, "ball": _ball, "bunch": _bunch, "book": _book, "banana": _banana, "lump": _lump,
    }
)  # fmt: skip
"""Kinds of things, by name."""
