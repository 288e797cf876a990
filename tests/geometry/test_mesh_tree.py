from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import (
    Mesh,
    box_mesh,
    cylinder_mesh,
    load_mesh,
    merge_meshes,
    signed_distance,
    sphere_mesh,
)
from neuralgrasps.geometry.mesh_tree import build_tree, tree_distance
from neuralgrasps.geometry.sampling import sample_surface


def cloud(mesh: Mesh, count: int, seed: int = 0) -> np.ndarray:
    """Points near the surface, and points far from it."""
    rng = np.random.default_rng(seed)
    near = sample_surface(mesh, count, seed)[0] + rng.normal(scale=0.001, size=(count, 3))
    return np.concatenate([near, rng.uniform(-0.2, 0.2, (count, 3))])


def test_box_distances_by_hand() -> None:
    box = box_mesh([0.1, 0.2, 0.3])
    points = np.array([[0, 0, 0], [0.15, 0, 0], [0.13, 0.24, 0], [0.1, 0.2, 0.3], [0.13, 0.24, 0.42], [0.05, 0, 0.29]])
    expected = [-0.1, 0.05, 0.05, 0.0, 0.13, -0.01]
    assert np.allclose(tree_distance(build_tree(box), box, points), expected, atol=1e-15)


@pytest.mark.parametrize("mesh", [sphere_mesh(0.05), cylinder_mesh(0.03, 0.06), box_mesh([0.01, 0.08, 0.04])])
def test_agrees_with_the_plain_reference(mesh: Mesh) -> None:
    points = cloud(mesh, 2000)
    assert np.allclose(tree_distance(build_tree(mesh), mesh, points), signed_distance(mesh, points), rtol=0, atol=1e-12)


def test_open_and_overlapping_surfaces_agree_with_the_plain_reference() -> None:
    ball = sphere_mesh(0.05)
    opened = Mesh(ball.vertices, ball.faces[6:])
    two = merge_meshes([ball, Mesh(ball.vertices + np.array([0.06, 0, 0]), ball.faces)])
    for mesh in (opened, two):
        points = cloud(mesh, 1500)
        ours, reference = tree_distance(build_tree(mesh), mesh, points), signed_distance(mesh, points)
        assert np.allclose(np.abs(ours), np.abs(reference), rtol=0, atol=1e-12)
        assert (np.sign(ours) == np.sign(reference)).mean() > 0.998  # beside the hole a sign is a matter of taste


def test_above_a_box_without_a_lid_is_outside() -> None:
    """The nearest feature is the rim, whose normals point sideways: they would say inside at any height."""
    box = box_mesh([0.05, 0.05, 0.05])
    bare = Mesh(box.vertices, box.faces[(box.vertices[box.faces, 2] < 0.05).any(axis=1)])
    points = np.array([[0, 0, 0.1], [0.01, 0.02, 0.06], [0, 0, 0.02], [0.01, 0, -0.04], [0, 0, -0.06]])
    assert len(bare.faces) == 10
    assert np.sign(tree_distance(build_tree(bare), bare, points)).tolist() == [1, 1, -1, -1, 1]


def test_the_order_of_points_does_not_matter() -> None:
    mesh = sphere_mesh(0.05)
    tree, points = build_tree(mesh), cloud(mesh, 500)
    order = np.random.default_rng(1).permutation(len(points))
    assert np.array_equal(tree_distance(tree, mesh, points)[order], tree_distance(tree, mesh, points[order]))


@pytest.mark.parametrize("name", ["003_cracker_box", "005_tomato_soup_can", "051_large_clamp"])
def test_scans_agree_with_the_plain_reference(assets: Path, name: str) -> None:
    mesh = load_mesh(assets / "ycb" / f"{name}.ply", unit="m").mesh
    points = cloud(mesh, 3000)
    assert np.allclose(tree_distance(build_tree(mesh), mesh, points), signed_distance(mesh, points), rtol=0, atol=1e-12)
