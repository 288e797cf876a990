from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import Mesh, box_mesh, cylinder_mesh, load_mesh, merge_meshes, sphere_mesh
from neuralgrasps.geometry.sdf_grid import SdfGrid, build_sdf_grid, query_grid_numpy
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix, make_transform_np
from neuralgrasps.objects.build import surface_points
from neuralgrasps.objects.symmetry import SymmetryGroup, _Axis, _combinations, _sampled_group, find_symmetry

X_TILTED = make_transform_np(axis_angle_matrix([1.0, 2.0, 3.0], 0.7), [0.02, -0.05, 0.04])


def group_of(mesh: Mesh) -> tuple[SymmetryGroup, np.ndarray]:
    points, _ = surface_points(mesh, 1024)
    sdf = build_sdf_grid(mesh, cells=64)
    group = find_symmetry(points, sdf)
    off = [np.quantile(np.abs(query_grid_numpy(sdf, points @ X[:3, :3].T + X[:3, 3])), 0.95) for X in group.rotations]
    return group, np.array(off)


def _off(points: np.ndarray, sdf: SdfGrid, X: np.ndarray) -> float:
    return float(np.quantile(np.abs(query_grid_numpy(sdf, points @ X[:3, :3].T + X[:3, 3])), 0.95))


def is_closed_group(group: SymmetryGroup) -> bool:
    known = group.rotations
    products = np.einsum("aij,bjk->abik", known, known).reshape(-1, 4, 4)
    return all(np.abs(known - p).reshape(len(known), -1).max(axis=1).min() < 1e-6 for p in products)


@pytest.mark.parametrize("X", [np.eye(4), X_TILTED], ids=["aligned", "tilted"])
@pytest.mark.parametrize(
    "half, size",
    [((0.03, 0.05, 0.08), 4), ((0.03, 0.03, 0.08), 8), ((0.05, 0.05, 0.05), 24)],
    ids=["box", "square prism", "cube"],
)
def test_boxes_have_their_known_groups(half: tuple[float, float, float], size: int, X: np.ndarray):
    group, off = group_of(box_mesh(half).transformed(X))
    assert len(group) == size
    assert group.continuous_axis is None
    np.testing.assert_allclose(group.rotations[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(group.centre, X[:3, 3], atol=5e-4)
    assert off.max() < 1e-3
    assert is_closed_group(group)


def test_cylinder_is_continuous_about_its_axis_and_flips():
    group, off = group_of(cylinder_mesh(0.03, 0.05).transformed(X_TILTED))
    assert len(group) == 72
    assert group.continuous_axis is not None
    assert abs(float(group.continuous_axis @ X_TILTED[:3, 2])) == pytest.approx(1.0, abs=1e-5)
    assert off.max() < 1e-3
    assert is_closed_group(group)


def test_cone_like_object_does_not_flip():
    mesh = merge_meshes(
        [cylinder_mesh(0.03, 0.03), cylinder_mesh(0.012, 0.02).transformed(make_transform_np(None, [0, 0, 0.045]))]
    )
    group, _ = group_of(mesh)
    assert len(group) == 36 and group.continuous_axis is not None


def test_an_odd_object_has_none():
    mesh = merge_meshes(
        [
            box_mesh((0.03, 0.05, 0.08)),
            box_mesh((0.02, 0.02, 0.02)).transformed(make_transform_np(None, [0.03, 0.03, 0.06])),
        ]
    )
    group, _ = group_of(mesh)
    assert len(group) == 1 and group.deviation_m == 0.0


def test_sphere_is_sampled_over_all_orientations():
    group, off = group_of(sphere_mesh(0.04))
    assert len(group) > 500
    assert group.continuous_axis is None  # no single one
    assert off.max() < 1e-3


def test_tolerance_decides():
    mesh = box_mesh((0.030, 0.034, 0.08))
    points, _ = surface_points(mesh, 1024)
    sdf = build_sdf_grid(mesh, cells=64)
    assert len(find_symmetry(points, sdf, tolerance_m=0.001)) == 4
    assert len(find_symmetry(points, sdf, tolerance_m=0.006)) == 8


# two generators fit within the tolerance and their product does not: the cracker box and one can of the scans
@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("002_master_chef_can", 72),
        ("003_cracker_box", 2),
        ("005_tomato_soup_can", 36),
    ],
)
def test_every_rotation_of_a_scan_is_within_the_tolerance(assets: Path, name: str, size: int):
    mesh = load_mesh(assets / "ycb" / f"{name}.ply").mesh
    points, _ = surface_points(mesh, 2048)
    sdf = build_sdf_grid(mesh, cells=128, padding=0.02)
    group = find_symmetry(points, sdf)
    off = [_off(points, sdf, X) for X in group.rotations]
    assert max(off) <= group.tolerance_m
    assert len(group) == 1 or group.deviation_m == pytest.approx(max(off), abs=1e-12)
    assert len(group) == size and is_closed_group(group)


def test_axes_that_generate_no_finite_group_are_not_taken_together():
    axes = [_Axis(np.eye(3)[k], order, np.zeros(3), 0.001) for k, order in ((2, 6.0), (0, 4.0))]
    assert _sampled_group(axes) is None
    sizes = [len(_sampled_group(c)) for c in _combinations(axes)]
    assert sizes[0] == 12 and sizes == sorted(sizes, reverse=True)  # 6-fold, and the 4-fold one as a half turn
