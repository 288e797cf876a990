from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from neuralgrasps.geometry.mesh import Mesh, box_mesh, convex_hull, merge_meshes, sphere_mesh
from neuralgrasps.geometry.sdf_grid import build_sdf_grid
from neuralgrasps.geometry.se3_numpy import make_transform_np
from neuralgrasps.objects.convex_parts import MAX_PARTS, MAX_VERTICES, fewer_vertices, make_convex_parts
from neuralgrasps.objects.convex_split import clip_triangles, sample_triangles
from neuralgrasps.objects.loft import loft


def l_shape() -> Mesh:
    """An L of two 20 x 40 x 60 mm arms, as one closed surface."""
    # the points near the corner draw the mean, where the fan of a cap starts, to where it sees all corners
    outline = [
        (0, 0),
        (5, 0),
        (10, 0),
        (15, 0),
        (60, 0),
        (60, 20),
        (20, 20),
        (20, 60),
        (0, 60),
        (0, 15),
        (0, 10),
        (0, 5),
    ]
    corners = np.array(outline) * 1e-3 - 0.02
    return loft([corners, corners], [-0.02, 0.02])


def test_a_box_is_its_hull():
    mesh = box_mesh((0.03, 0.04, 0.05))
    parts = make_convex_parts(mesh, build_sdf_grid(mesh, cells=48))
    assert parts.method == "convex hull" and len(parts.vertices) == 1
    np.testing.assert_allclose(np.sort(parts.vertices[0], axis=0), np.sort(mesh.vertices, axis=0))
    assert parts.gap_max_m < 1e-6
    assert parts.protrusion_max_m < 1e-3  # the grid rounds the box's edges off


def test_an_l_is_two_boxes():
    mesh = l_shape()
    parts = make_convex_parts(mesh, build_sdf_grid(mesh, cells=60))
    assert len(parts.vertices) == 2
    assert parts.protrusion_max_m < 1e-3 and parts.gap_max_m < 1e-3
    volume = sum(ConvexHull(p).volume for p in parts.vertices)
    assert volume == pytest.approx((60 * 20 + 20 * 40) * 40e-9, rel=0.02)


def test_a_large_ball_is_halved_until_few_vertices_do():
    mesh = merge_meshes(
        [
            sphere_mesh(0.06, segments=64),
            box_mesh((0.01, 0.01, 0.04)).transformed(make_transform_np(None, [0, 0, 0.09])),
        ]
    )
    parts = make_convex_parts(mesh, build_sdf_grid(mesh, cells=64))
    assert max(len(p) for p in parts.vertices) <= MAX_VERTICES
    assert 2 < len(parts.vertices) <= MAX_PARTS
    assert parts.protrusion_p95_m < 1e-3 and parts.gap_p95_m < 1.5e-3


def test_fewer_vertices_shrinks_little_and_never_grows():
    corners, _ = convex_hull(sphere_mesh(0.03, segments=48).vertices)
    few, loss = fewer_vertices(corners, 64)
    assert len(few) <= 64
    planes = ConvexHull(corners).equations
    assert (few @ planes[:, :3].T + planes[:, 3]).max() < 1e-9
    reduced = ConvexHull(few).equations
    assert loss == pytest.approx((corners @ reduced[:, :3].T + reduced[:, 3]).max(), abs=1e-9)
    assert loss < 0.003


def test_clipping_keeps_the_area_and_the_sides():
    triangles = sphere_mesh(0.03).triangles
    normal = np.array([0.6, 0.0, 0.8])
    below, above = clip_triangles(triangles, normal, 0.011)

    def area(t: np.ndarray) -> float:
        return float(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum())

    assert area(below) + area(above) == pytest.approx(area(triangles), rel=1e-12)
    assert (below @ normal).max() < 0.011 + 1e-12 and (above @ normal).min() > 0.011 - 1e-12


def test_samples_spread_by_area():
    small = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)
    triangles = np.concatenate([small, 3.0 * small + 10.0])
    points = sample_triangles(triangles, 5000)
    assert (points[:, 0] < 5).mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(points[points[:, 0] < 5].mean(axis=0), [1 / 3, 1 / 3, 0], atol=0.02)


def test_fewer_vertices_of_a_wedge_whose_extremes_lie_in_a_plane():
    """A shallow frustum over a rectangle: along every axis and space diagonal the rectangle's corners go farthest."""
    along, across, up = np.array([1.0, -2.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.array([0.09, 0.045, 0.0])
    base = [a * along + b * across for a in (-1, 1) for b in (-1, 1)]
    top = [0.3 * corner + up for corner in base]
    kept, loss = fewer_vertices(0.05 * np.array(base + top), 7)
    assert 5 <= len(kept) <= 7 and 0 <= loss < 0.005
