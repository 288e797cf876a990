"""The Mesh noun, topology, mass, primitives, hulls and exact distances against closed forms and real scans."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from neuralgrasps.errors import MeshError, ShapeError
from neuralgrasps.geometry.mesh import (
    Mesh,
    box_mesh,
    capsule_mesh,
    closest_points,
    contains,
    convex_hull,
    cylinder_mesh,
    is_closed,
    is_manifold,
    load_mesh,
    mass_properties,
    merge_meshes,
    signed_distance,
    sphere_mesh,
    unsigned_distance,
    vertex_normals,
)
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix
from neuralgrasps.geometry.shapes import sdf_box

HALF = np.array([0.03, 0.05, 0.02])
POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (4000, 3))


def box_distance(points: np.ndarray) -> np.ndarray:
    return sdf_box(torch.tensor(points), torch.tensor(HALF)).numpy()


@pytest.mark.parametrize(
    ("mesh", "volume", "centred_area"),
    [
        (box_mesh(HALF), 8 * HALF.prod(), None),
        (sphere_mesh(0.05, segments=128), 4 / 3 * math.pi * 0.05**3, None),
        (cylinder_mesh(0.03, 0.04, segments=256), math.pi * 0.03**2 * 0.08, None),
        (capsule_mesh(0.03, 0.04, segments=128), math.pi * 0.03**2 * 0.08 + 4 / 3 * math.pi * 0.03**3, None),
        (capsule_mesh(0.03, 0.0, segments=128), 4 / 3 * math.pi * 0.03**3, None),
    ],
)
def test_primitives_are_closed_and_have_the_volume_of_the_solid(
    mesh: Mesh, volume: float, centred_area: float | None
) -> None:
    assert is_closed(mesh) and is_manifold(mesh)
    mass = mass_properties(mesh)
    assert mass.volume == pytest.approx(volume, rel=2e-3)
    np.testing.assert_allclose(mass.centre, 0, atol=1e-15)


def test_mass_moves_with_the_mesh() -> None:
    X = make_transform_np(rpy_matrix([0.3, -1.0, 2.0]), [5.0, -3.0, 1.0])
    pyramid = Mesh(*convex_hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 1]]))
    centre = np.array([0.5, 0.5, 0.25])
    assert mass_properties(pyramid).volume == pytest.approx(1 / 3)
    np.testing.assert_allclose(mass_properties(pyramid).centre, centre, atol=1e-15)
    moved = mass_properties(pyramid.transformed(X))
    assert moved.volume == pytest.approx(1 / 3, rel=1e-13)
    np.testing.assert_allclose(moved.centre, X[:3, :3] @ centre + X[:3, 3], atol=1e-13)


def test_mesh_is_frozen_checked_and_hashed_by_content() -> None:
    box = box_mesh(HALF)
    with pytest.raises(ValueError, match="read-only"):
        box.vertices[0, 0] = 1.0
    with pytest.raises(ShapeError, match=r"faces has shape \(3, 4\)"):
        Mesh(box.vertices, np.zeros((3, 4), dtype=np.int32))
    with pytest.raises(MeshError, match="name vertex 8 but there are 8"):
        Mesh(box.vertices, np.array([[0, 1, 8]], dtype=np.int32))
    with pytest.raises(MeshError, match="not finite"):
        Mesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]], dtype=np.int32))
    assert box.content_hash() == Mesh(box.vertices.copy(), box.faces.astype(np.int64)).content_hash()
    assert box.content_hash() != box_mesh(HALF * (1 + 1e-15)).content_hash()
    assert box.content_hash() != Mesh(box.vertices, box.faces[:, [1, 2, 0]]).content_hash()
    np.testing.assert_allclose(box.bounds, [-HALF, HALF])
    np.testing.assert_allclose(box.extents, 2 * HALF)


def test_vertex_normals_of_a_sphere_and_a_box() -> None:
    sphere = sphere_mesh(0.05, segments=48)
    np.testing.assert_allclose(vertex_normals(sphere), sphere.vertices / 0.05, atol=0.01)
    # Weighting by angle makes a corner's normal the diagonal however its squares are cut into triangles.
    np.testing.assert_allclose(vertex_normals(box_mesh([1, 1, 1])), box_mesh([1, 1, 1]).vertices / 3**0.5, atol=1e-15)


def test_distance_to_a_box_is_exact() -> None:
    np.testing.assert_allclose(signed_distance(box_mesh(HALF), POINTS), box_distance(POINTS), atol=1e-16)


def test_distance_to_a_sphere_within_its_tessellation() -> None:
    mesh = sphere_mesh(0.05, segments=200)
    error = signed_distance(mesh, POINTS) - (np.linalg.norm(POINTS, axis=1) - 0.05)
    assert error.min() > -1e-15  # vertices are on the sphere, so the mesh is inside it
    assert error.max() < 0.05 * (1 - math.cos(math.pi / 200)) * 2


def test_distance_to_an_open_box_keeps_its_size_and_sign() -> None:
    whole = box_mesh(HALF)
    vertices = whole.vertices[whole.faces].reshape(-1, 3)  # every triangle by itself, with gaps of 2 um
    centre = np.repeat(whole.vertices[whole.faces].mean(axis=1), 3, axis=0)
    gappy = Mesh(vertices + (centre - vertices) * 5e-5, np.arange(36).reshape(12, 3))
    assert not is_closed(gappy)
    np.testing.assert_allclose(signed_distance(gappy, POINTS), box_distance(POINTS), atol=5e-6)


def test_a_missing_side_leaves_inside_what_is_mostly_enclosed() -> None:
    cube = box_mesh([0.03, 0.03, 0.03])
    tray = Mesh(cube.vertices, cube.faces[~(cube.triangles[:, :, 2] > 0.029).all(axis=1)])
    assert len(tray.faces) == 10
    # The winding number is 5/6 at the centre and 1/2 near the rim's plane.
    inside = contains(tray, [[0, 0, 0], [0, 0, 0.025], [0, 0, 0.035], [0.031, 0, 0]])
    assert inside.tolist() == [True, True, False, False]
    assert signed_distance(tray, [[0, 0, 0], [0, 0, 0.035]]) == pytest.approx([-0.03, np.hypot(0.03, 0.005)])


def test_distance_to_overlapping_bodies_is_negative_in_both() -> None:
    two = merge_meshes([box_mesh(HALF), box_mesh(HALF).transformed(make_transform_np(None, [0.03, 0, 0]))])
    expected = np.minimum(box_distance(POINTS), box_distance(POINTS - [0.03, 0, 0]))
    d = signed_distance(two, POINTS)
    np.testing.assert_array_equal(d < 0, expected < 0)
    np.testing.assert_allclose(d[d > 0], expected[d > 0], atol=1e-16)
    np.testing.assert_array_equal(contains(two, POINTS), expected < 0)


def test_closest_points_lie_on_the_named_face() -> None:
    squared, face, foot = closest_points(box_mesh(HALF), POINTS)
    np.testing.assert_allclose(np.sqrt(squared), np.linalg.norm(POINTS - foot, axis=1), atol=1e-15)
    np.testing.assert_allclose(np.sqrt(squared), unsigned_distance(box_mesh(HALF), POINTS), atol=1e-16)
    triangle = box_mesh(HALF).triangles[face]
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    assert np.abs(np.einsum("ij,ij->i", foot - triangle[:, 0], normal)).max() < 1e-15


def test_no_points_and_wrong_points() -> None:
    assert signed_distance(box_mesh(HALF), np.zeros((0, 3))).shape == (0,)
    with pytest.raises(ShapeError, match="points has shape"):
        signed_distance(box_mesh(HALF), np.zeros((5, 2)))


def test_hull_contains_its_points_and_is_wound_outward() -> None:
    points = np.random.default_rng(2).normal(size=(200, 3)) + np.array([10, 0, 0])
    vertices, faces = convex_hull(points)
    hull = Mesh(vertices, faces)
    assert is_manifold(hull) and mass_properties(hull).volume > 0
    assert signed_distance(hull, points).max() < 1e-14
    assert {tuple(v) for v in vertices} <= {tuple(p) for p in points}


@pytest.mark.parametrize(("points", "text"), [(np.eye(3), "got 3 points"), (np.eye(3)[[0, 1, 2, 0, 1]], "one plane")])
def test_hull_of_too_little_is_refused(points: np.ndarray, text: str) -> None:
    with pytest.raises(MeshError, match=text):
        convex_hull(points)


SCANS = ["002_master_chef_can", "005_tomato_soup_can", "006_mustard_bottle", "007_tuna_fish_can", "051_large_clamp"]


@pytest.mark.parametrize("name", SCANS)
def test_signs_on_real_scans_equal_the_exact_winding_number(assets: Path, name: str) -> None:
    """Solid angles summed over every triangle (van Oosterom & Strackee 1983) are the slow reference."""
    mesh = load_mesh(assets / "ycb" / f"{name}.ply").mesh
    rng = np.random.default_rng(0)
    near = mesh.vertices[rng.integers(len(mesh.vertices), size=150)] + rng.normal(0, 1e-3, (150, 3))
    points = np.concatenate([rng.uniform(*mesh.bounds, (150, 3)), near])
    a, b, c = np.moveaxis(mesh.triangles[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    numerator = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    dots = [np.einsum("pfi,pfi->pf", u, v) for u, v in ((a, b), (b, c), (c, a))]
    winding = np.arctan2(numerator, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum(axis=1) / (
        2 * math.pi
    )
    d = signed_distance(mesh, points)
    np.testing.assert_array_equal(d < 0, winding > 0.5)
    assert 30 < (d < 0).sum() < 270


def test_distances_equal_the_published_scene(assets: Path) -> None:
    scene = np.load(assets / "graspit" / "003_cracker_box-fetch_gripper.scene20.npz")
    mesh = load_mesh(assets / "ycb" / "003_cracker_box.ply").mesh
    d = signed_distance(mesh, scene["points"].astype(np.float64))
    np.testing.assert_allclose(d, scene["obj_exact"], atol=2e-7)
