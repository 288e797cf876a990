"""Exact distances: values by hand, torch against numba against the mesh of the same solid, gradients."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from neuralgrasps.geometry import shape_kernels, shapes
from neuralgrasps.geometry.mesh import Mesh, box_mesh, convex_hull, hull_planes, signed_distance

HALF, R, H = (0.03, 0.05, 0.02), 0.03, 0.04
POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (3000, 3))
HULL = convex_hull(np.random.default_rng(1).normal(size=(40, 3)) * 0.04)


def torch_hull(p: torch.Tensor) -> torch.Tensor:
    return shapes.sdf_convex(p, torch.tensor(HULL[0]), torch.tensor(HULL[1]))


def numba_hull(x: float, y: float, z: float) -> float:
    return shape_kernels.convex_sdf(x, y, z, hull_planes(*HULL), HULL[0][HULL[1]])


PAIRS: dict[str, tuple[Callable[..., torch.Tensor], Callable[..., float]]] = {
    "box": (
        lambda p: shapes.sdf_box(p, torch.tensor(HALF, dtype=p.dtype)),
        lambda x, y, z: shape_kernels.box_sdf(x, y, z, *HALF),
    ),
    "sphere": (lambda p: shapes.sdf_sphere(p, R), lambda x, y, z: shape_kernels.sphere_sdf(x, y, z, R)),
    "capsule": (lambda p: shapes.sdf_capsule(p, R, H), lambda x, y, z: shape_kernels.capsule_sdf(x, y, z, R, H)),
    "cylinder": (lambda p: shapes.sdf_cylinder(p, R, H), lambda x, y, z: shape_kernels.cylinder_sdf(x, y, z, R, H)),
    "convex": (torch_hull, numba_hull),
}


@pytest.mark.parametrize(
    ("name", "point", "expected"),
    [
        ("box", (0, 0, 0), -0.02),
        ("box", (0.04, 0, 0), 0.01),
        ("box", (0.06, 0.09, 0.02), 0.05),  # 3-4-5 from an edge
        ("box", (0.03, 0, 0), 0.0),
        ("sphere", (0, 0.03, 0.04), 0.02),
        ("sphere", (0, 0, 0), -0.03),
        ("capsule", (0, 0, 0.08), 0.01),
        ("capsule", (0.01, 0, 0.02), -0.02),
        ("capsule", (0.03, 0, 0.08), 0.02),
        ("cylinder", (0, 0, 0), -0.03),
        ("cylinder", (0.01, 0, 0.035), -0.005),
        ("cylinder", (0.06, 0, 0.08), 0.05),
    ],
)
def test_values_by_hand(name: str, point: tuple[float, float, float], expected: float) -> None:
    in_torch, in_numba = PAIRS[name]
    assert in_torch(torch.tensor(point, dtype=torch.float64)).item() == pytest.approx(expected, abs=1e-16)
    assert in_numba(*(float(c) for c in point)) == pytest.approx(expected, abs=1e-16)


@pytest.mark.parametrize("name", PAIRS)
def test_torch_equals_numba(name: str) -> None:
    in_torch, in_numba = PAIRS[name]
    d = in_torch(torch.tensor(POINTS)).numpy()
    np.testing.assert_allclose(d, [in_numba(*p) for p in POINTS], atol=2e-16)
    assert (d < 0).sum() > 20 < (d > 0).sum()


@pytest.mark.parametrize("name", PAIRS)
def test_gradients_are_unit_and_equal_finite_differences(name: str) -> None:
    in_torch, _ = PAIRS[name]
    p = torch.tensor(POINTS[:500], requires_grad=True)
    (gradient,) = torch.autograd.grad(in_torch(p).sum(), p)
    step = 1e-7
    numeric = torch.stack(
        [(in_torch(p + step * e) - in_torch(p - step * e)) / (2 * step) for e in torch.eye(3, dtype=p.dtype)], dim=-1
    )
    smooth = (numeric.detach().norm(dim=-1) - 1).abs() < 1e-6  # away from the medial axis
    assert smooth.float().mean() > 0.95
    torch.testing.assert_close(gradient[smooth], numeric.detach()[smooth], atol=2e-7, rtol=0)


@pytest.mark.parametrize("name", PAIRS)
def test_gradients_are_finite_at_special_points(name: str) -> None:
    special = torch.tensor([[0, 0, 0], [0, 0, H], [R, 0, 0], [0.03, 0.05, 0.02], [0, 0, 1.0]], dtype=torch.float64)
    special.requires_grad_()
    PAIRS[name][0](special).sum().backward()
    assert special.grad is not None
    assert torch.isfinite(special.grad).all()


def test_convex_equals_the_mesh_distance() -> None:
    expected = signed_distance(Mesh(*HULL), POINTS)
    np.testing.assert_allclose(torch_hull(torch.tensor(POINTS)), expected, atol=1e-15)


def test_a_box_as_a_convex_solid_is_a_box_even_with_slivers() -> None:
    box = box_mesh(HALF)
    vertices = np.concatenate([box.vertices, [[0.03, 0.05, 0.0]]])  # on an edge: a face without area
    faces = np.concatenate([box.faces, [[6, 8, 7]]])
    p = torch.tensor(POINTS)
    expected = shapes.sdf_box(p, torch.tensor(HALF, dtype=p.dtype))
    torch.testing.assert_close(
        shapes.sdf_convex(p, torch.tensor(vertices), torch.tensor(faces)), expected, atol=1e-16, rtol=0
    )
    planes, triangles = hull_planes(vertices, faces), vertices[faces]
    assert len(planes) == 6
    numba_values = [shape_kernels.convex_sdf(*q, planes, triangles) for q in POINTS]
    np.testing.assert_allclose(numba_values, expected, atol=1e-16)


def test_sizes_broadcast_and_carry_gradients() -> None:
    radius = torch.tensor([[0.01], [0.02]], dtype=torch.float64, requires_grad=True)
    d = shapes.sdf_capsule(torch.tensor(POINTS[:7]), radius, 0.05)
    assert d.shape == (2, 7)
    d.sum().backward()
    torch.testing.assert_close(radius.grad, torch.full_like(radius, -7.0))
    half = torch.rand(2, 1, 3, dtype=torch.float64)
    assert shapes.sdf_box(torch.tensor(POINTS[:7]), half).shape == (2, 7)


def test_triangle_distance_of_degenerate_triangles() -> None:
    point = np.zeros((1, 3, 3))
    assert shape_kernels.triangle_distance_squared(0.0, 3.0, 4.0, point, 0) == 25.0
    segment = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]])
    assert shape_kernels.triangle_distance_squared(3.0, 1.0, 0.0, segment, 0) == pytest.approx(2.0)
    assert math.sqrt(shape_kernels.triangle_distance_squared(1.5, 0.5, 0.0, segment, 0)) == pytest.approx(0.5)
