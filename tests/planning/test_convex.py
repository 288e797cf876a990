"""Distances between convex parts: known answers, and against dense samples."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.parts import part_distances, part_mesh, sample_part
from neuralgrasps.planning.convex_kernels import convex_gap, point_gap

_SPACING = 0.004  # of the samples


def _part(kind: PartKind, X: np.ndarray, size: tuple[float, float, float], rng: np.random.Generator) -> ConvexPart:
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    if kind == PartKind.HULL:
        vertices, faces = convex_hull(rng.normal(size=(16, 3)) * size)
    return ConvexPart(link=0, kind=kind, size=np.array(size), X_LP=X, vertices=vertices, faces=faces)


def _gap(a: ConvexPart, b: ConvexPart, need: float = 10.0) -> float:
    parts, poses, info = np.zeros((2, 19)), np.zeros((2, 12)), np.zeros((2, 5), np.int64)
    for i, p in enumerate((a, b)):
        parts[i, 4:7], poses[i] = p.size, p.X_LP[:3].reshape(-1)
        info[i, :3] = int(p.kind), i * len(a.vertices), i * len(a.vertices) + len(p.vertices)
    vertices = np.concatenate([a.vertices, b.vertices])
    return float(convex_gap(parts, info, vertices, poses, 0, 1, need, np.empty((4, 3))))


def _at(x: float, y: float, z: float, rpy: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return make_transform_np(rpy_matrix(rpy), [x, y, z])


@pytest.mark.parametrize(
    ("kind_a", "size_a", "kind_b", "size_b", "X_b", "distance"),
    [
        (PartKind.SPHERE, (1, 0, 0), PartKind.SPHERE, (0.5, 0, 0), _at(3, 0, 4), 3.5),
        (PartKind.BOX, (1, 2, 3), PartKind.BOX, (1, 1, 1), _at(5, 0.3, 0.1), 3.0),  # face to face
        (PartKind.BOX, (1, 1, 1), PartKind.BOX, (1, 1, 1), _at(4, 4, 0), 2 * np.sqrt(2)),  # edge to edge
        (PartKind.BOX, (1, 1, 1), PartKind.BOX, (1, 1, 1), _at(4, 4, 4), 2 * np.sqrt(3)),  # corner to corner
        (PartKind.CAPSULE, (0.1, 2, 0), PartKind.CAPSULE, (0.2, 2, 0), _at(1, 0, 0, (np.pi / 2, 0, 0)), 0.7),
        (PartKind.CYLINDER, (1, 1, 0), PartKind.CYLINDER, (1, 1, 0), _at(0, 0, 5), 3.0),  # cap to cap
        (PartKind.CYLINDER, (1, 1, 0), PartKind.SPHERE, (0.5, 0, 0), _at(4, 0, 5), np.hypot(3, 4) - 0.5),  # the rim
        (PartKind.BOX, (1, 1, 1), PartKind.SPHERE, (0.5, 0, 0), _at(1.2, 0, 0), 0.0),  # overlap
        (PartKind.CAPSULE, (1, 1, 0), PartKind.CAPSULE, (1, 1, 0), _at(0, 0, 0), 0.0),  # the same
    ],
)
def test_known_distances(kind_a, size_a, kind_b, size_b, X_b, distance) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(0)
    a, b = _part(kind_a, np.eye(4), size_a, rng), _part(kind_b, X_b, size_b, rng)
    assert _gap(a, b) == pytest.approx(distance, abs=1e-8)
    assert _gap(b, a) == pytest.approx(distance, abs=1e-8)


@pytest.mark.parametrize("kinds", list(itertools.combinations_with_replacement(PartKind, 2)))
def test_never_more_and_hardly_less_than_between_samples(kinds: tuple[PartKind, PartKind]) -> None:
    rng = np.random.default_rng(hash(kinds) % 1000)
    touching = 0
    for _ in range(24):
        a, b = (
            _part(
                k, _at(*rng.normal(size=3) * 0.05, tuple(rng.uniform(-3, 3, 3))), tuple(rng.uniform(0.02, 0.06, 3)), rng
            )
            for k in kinds
        )
        samples = [np.concatenate([sample_part(p, 1 / _SPACING**2)[0], part_mesh(p).vertices]) for p in (a, b)]
        reference = min(part_distances(b, samples[0]).min(), part_distances(a, samples[1]).min())
        gap = _gap(a, b)
        touching += gap == 0.0
        assert gap <= max(reference, 0.0) + 1e-9
        assert gap >= reference - _SPACING
        if reference <= 0.0:
            assert gap == 0.0
    assert touching < 24


def test_the_search_ends_as_soon_as_enough_is_proved() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        kinds = rng.choice(list(PartKind), 2)
        a, b = (
            _part(PartKind(k), _at(*rng.normal(size=3) * 0.1, tuple(rng.uniform(-3, 3, 3))), (0.03, 0.05, 0.04), rng)
            for k in kinds
        )
        gap, need = _gap(a, b), float(rng.uniform(0, 0.1))
        short = _gap(a, b, need)
        assert (short >= need) == (gap >= need)
        assert short <= gap + 1e-9
        if gap < need:
            assert short == pytest.approx(gap, abs=1e-8)


@pytest.mark.parametrize("kind", [PartKind.BOX, PartKind.CAPSULE, PartKind.CYLINDER])
def test_the_distance_of_a_point_is_that_of_the_part(kind: PartKind) -> None:
    rng = np.random.default_rng(4)
    part = _part(kind, _at(0.1, 0.2, -0.1, (0.3, -1.0, 2.0)), (0.04, 0.06, 0.03), rng)
    parts, poses, info = np.zeros((1, 19)), part.X_LP[:3].reshape(1, 12).copy(), np.array([[int(kind), 0, 0, 0, 0]])
    parts[0, 4:7] = part.size
    for p in rng.normal(size=(50, 3)) * 0.2:
        assert point_gap(parts, info, poses, 0, *p) == pytest.approx(part_distances(part, p[None])[0], abs=1e-12)
