"""Farthest points against a slow reference; surface samples on the surface, uniform, even and repeatable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from neuralgrasps.errors import InputError, MeshError, ShapeError
from neuralgrasps.geometry.mesh import Mesh, box_mesh, capsule_mesh, face_areas_normals, signed_distance
from neuralgrasps.geometry.sampling import cover, even_subset, even_surface_points, farthest_points, sample_surface

HALF = np.array([0.03, 0.05, 0.02])


def slow_farthest(points: np.ndarray, count: int, start: int) -> list[int]:
    chosen = [start]
    for _ in range(count - 1):
        distance = ((points[:, None] - points[chosen]) ** 2).sum(-1).min(axis=1)
        chosen.append(int(distance.argmax()))
    return chosen


@pytest.mark.parametrize("dims", [1, 2, 3, 7])
@pytest.mark.parametrize("start", [0, 13])
def test_farthest_points_equal_the_slow_reference(dims: int, start: int) -> None:
    points = np.random.default_rng(dims).normal(size=(200, dims))
    index = farthest_points(points, 60, start=start)
    assert index.dtype == np.int64
    assert index.tolist() == slow_farthest(points, 60, start)


def test_farthest_points_ties_go_to_the_lowest_index_and_all_can_be_chosen() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 1, 0.0]])
    assert farthest_points(square, 4).tolist() == [0, 3, 1, 2]
    cloud = np.random.default_rng(0).normal(size=(50, 3))
    assert sorted(farthest_points(cloud, 50)) == list(range(50))


@pytest.mark.parametrize("dims", [2, 3])
def test_equal_points_are_each_chosen_once(dims: int) -> None:
    points = np.repeat(np.random.default_rng(0).random((4, dims)), 3, axis=0)
    assert sorted(farthest_points(points, 12, start=5)) == list(range(12))


def test_farthest_points_refuse_what_does_not_fit() -> None:
    with pytest.raises(InputError, match="count is 6; expected 1 to the number of points, 5"):
        farthest_points(np.zeros((5, 3)), 6)
    with pytest.raises(InputError, match="start is 5"):
        farthest_points(np.zeros((5, 3)), 2, start=5)
    with pytest.raises(ShapeError, match=r"points has shape \(5,\)"):
        farthest_points(np.zeros(5), 2)


def test_surface_samples_are_on_their_face_and_uniform() -> None:
    mesh = box_mesh(HALF)
    points, normals, face = sample_surface(mesh, 40000, 5)
    assert np.abs(signed_distance(mesh, points)).max() < 1e-16
    areas, face_normals = face_areas_normals(mesh)
    np.testing.assert_array_equal(normals, face_normals[face])
    np.testing.assert_allclose(np.bincount(face) / 40000, areas / areas.sum(), atol=0.01)
    mean = np.stack([np.bincount(face, points[:, k]) for k in range(3)], axis=1) / np.bincount(face)[:, None]
    np.testing.assert_allclose(mean, mesh.triangles.mean(axis=1), atol=0.002)  # also uniform within each face
    top = points[normals[:, 2] > 0.5]
    np.testing.assert_allclose(top[:, :2].std(axis=0), HALF[:2] / 3**0.5, rtol=0.02)
    np.testing.assert_array_equal(points, sample_surface(mesh, 40000, 5)[0])
    assert not np.array_equal(points[:10], sample_surface(mesh, 10, 6)[0])


@pytest.mark.parametrize("spacing", [0.003, 0.01])
def test_even_points_are_neither_crowded_nor_sparse(spacing: float) -> None:
    mesh = capsule_mesh(0.02, 0.03, segments=48)
    points, normals, face = even_surface_points(mesh, spacing, 0)
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    assert nearest.min() >= 0.7 * spacing
    gaps = cKDTree(points).query(sample_surface(mesh, 20000, 1)[0])[0]
    assert gaps.max() < spacing
    assert np.abs(signed_distance(mesh, points)).max() < 1e-14
    np.testing.assert_array_equal(normals, face_areas_normals(mesh)[1][face])
    np.testing.assert_array_equal(points, even_surface_points(mesh, spacing, 0)[0])


def test_even_points_of_a_tiny_part_are_at_least_one() -> None:
    assert len(even_surface_points(box_mesh([1e-3, 1e-3, 1e-3]), 0.05, 0)[0]) == 1


def test_surfaces_without_area_are_refused() -> None:
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], dtype=np.int32))
    with pytest.raises(MeshError, match="no area"):
        sample_surface(flat, 5, 0)
    with pytest.raises(InputError, match="spacing is 0"):
        even_surface_points(box_mesh(HALF), 0.0, 0)


@pytest.mark.parametrize("radius", [0.05, 0.15, 0.5, 5.0])
def test_cover_is_that_of_the_plain_algorithm(radius):
    rng = np.random.default_rng(3)
    points = np.round(rng.random((400, 3)), 1)  # many equal points and equal distances
    chosen = [0]
    while True:
        nearest = ((points[:, None] - points[chosen]) ** 2).sum(axis=-1).min(axis=1)
        if nearest.max() < radius**2:
            break
        chosen.append(int(nearest.argmax()))
    np.testing.assert_array_equal(cover(points, radius), chosen)


def test_an_even_subset_has_the_number_asked_for_and_no_two_close_together() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for count in (1, 50, 500, 6000):
        chosen = even_subset(points, count)
        assert len(chosen) == count == len(set(chosen)) and (np.diff(chosen) > 0).all()
    chosen = points[even_subset(points, 500)]
    apart = np.linalg.norm(chosen[:, None] - chosen[None], axis=2) + 9.0 * np.eye(500)
    # 500 discs of this diameter on the sphere: random ones that touch no other fill about half of it
    assert apart.min() > 0.75 * np.sqrt(4 * np.pi / 500)
    assert np.array_equal(even_subset(np.zeros((7, 3)), 7), np.arange(7))
    with pytest.raises(InputError, match="count is 8"):
        even_subset(np.zeros((7, 3)), 8)


def test_points_that_coincide_are_still_as_many_as_asked_for() -> None:
    points = np.repeat(np.eye(3), 5, axis=0)
    assert len(even_subset(points, 4)) == 4
