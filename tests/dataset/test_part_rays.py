"""Rays against the exact distances of the same parts."""

import numpy as np
import pytest

from neuralgrasps.dataset.part_rays import part_normal, ray_part
from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.parts import hull_planes, part_distances

SIZES = {
    PartKind.BOX: [0.02, 0.03, 0.05],
    PartKind.SPHERE: [0.03, 0, 0],
    PartKind.CAPSULE: [0.015, 0.03, 0],
    PartKind.CYLINDER: [0.02, 0.03, 0],
    PartKind.HULL: [0, 0, 0],
}


def part_of(kind: PartKind) -> ConvexPart:
    vertices, faces = convex_hull(np.random.default_rng(0).normal(size=(30, 3)) * [0.02, 0.03, 0.02])
    shape = {"vertices": vertices, "faces": faces} if kind == PartKind.HULL else {}
    return ConvexPart(link=0, kind=kind, size=np.array(SIZES[kind], float), X_LP=np.eye(4), **shape)


def rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins outside and directions of any length, some along the axes."""
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(count, 3))
    origins *= 0.2 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = (rng.normal(size=(count, 3)) * 0.03 - origins) * rng.uniform(0.5, 3.0, (count, 1))
    axes = np.eye(3)[np.arange(60) % 3] * rng.choice([-1.0, 1.0], (60, 1))
    origins[:60] = rng.uniform(-0.02, 0.02, (60, 3)) * (axes == 0) - 0.2 * axes
    directions[:60] = axes
    return origins, directions


@pytest.mark.parametrize("kind", list(PartKind))
def test_a_ray_meets_a_part_where_a_walk_along_it_does(kind: PartKind) -> None:
    part = part_of(kind)
    planes = hull_planes(part)[0]
    origins, directions = rays(1500)
    got = np.array([ray_part(int(kind), part.size, planes, *o, *d) for o, d in zip(origins, directions, strict=True)])
    hit = np.isfinite(got)
    assert 0.2 < hit.mean() < 0.95
    # sphere tracing never steps over the surface, and stays on this side of it
    length, walked = np.linalg.norm(directions, axis=1), np.zeros(len(origins))
    for _ in range(400):
        walked += np.maximum(part_distances(part, origins + directions * (walked / length)[:, None]), 0.0)
    reached = part_distances(part, origins + directions * (walked / length)[:, None]) < 1e-9
    grazing = np.abs(part_distances(part, origins + directions * (walked / length)[:, None])) < 1e-5
    assert (hit == reached)[~grazing | reached].all()
    assert np.abs(got * length - walked)[hit & reached].max() < 1e-5


@pytest.mark.parametrize("kind", list(PartKind))
def test_normals_are_the_slope_of_the_distance(kind: PartKind) -> None:
    part = part_of(kind)
    planes = hull_planes(part)[0]
    origins, directions = rays(300)
    step = 1e-6
    checked = 0
    for o, d in zip(origins, directions, strict=True):
        t = ray_part(int(kind), part.size, planes, *o, *d)
        if np.isinf(t):
            continue
        p = o + t * d
        n = np.array(part_normal(int(kind), part.size, planes, *p))
        assert np.linalg.norm(n) == pytest.approx(1.0) and n @ d < 1e-9
        slope = np.array([np.diff(part_distances(part, np.array([p - s, p + s])))[0] for s in step * np.eye(3)])
        if abs(np.linalg.norm(slope) / (2 * step) - 1.0) < 1e-3:  # not on an edge
            checked += 1
            assert np.allclose(n, slope / (2 * step), atol=2e-3)
    assert checked > 80
