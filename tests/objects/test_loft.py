from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import is_closed, is_manifold, mass_properties, signed_distance
from neuralgrasps.objects.loft import loft, rounded_box, rounded_rectangle, superellipse


def test_rounded_box_has_the_volume_of_its_formula():
    half, r = np.array([0.03, 0.05, 0.08]), 0.01
    mesh = rounded_box(half, r, arc_steps=24, flat_steps=2)
    a, b, c = 2 * (half - r)
    # inner box + slabs + quarter cylinders + sphere
    exact = a * b * c + 2 * r * (a * b + b * c + c * a) + np.pi * r**2 * (a + b + c) + 4 / 3 * np.pi * r**3
    assert is_closed(mesh) and is_manifold(mesh)
    assert mass_properties(mesh).volume == pytest.approx(exact, rel=1e-4)


def test_rounded_box_points_lie_on_the_rounded_surface():
    half, r = np.array([0.03, 0.05, 0.08]), 0.01
    vertices = rounded_box(half, r).vertices
    outside = np.maximum(np.abs(vertices) - (half - r), 0.0)
    np.testing.assert_allclose(np.linalg.norm(outside, axis=1), r, atol=1e-6)


def test_loft_of_circles_is_a_cylinder_facing_outward():
    circle = superellipse(0.02, 0.02, 2.0, 64)
    mesh = loft([circle, circle], [-0.05, 0.05])
    area = 0.5 * 64 * 0.02**2 * np.sin(2 * np.pi / 64)
    assert is_closed(mesh)
    assert mass_properties(mesh).volume == pytest.approx(area * 0.1, rel=1e-5)
    assert signed_distance(mesh, [[0.0, 0.0, 0.0]])[0] == pytest.approx(-0.02, abs=1e-4)


@pytest.mark.parametrize("exponent", [2.0, 3.0, 5.0])
def test_superellipse_reaches_its_half_widths_and_satisfies_its_equation(exponent: float):
    points = superellipse(0.03, 0.05, exponent, 48)
    np.testing.assert_allclose(np.abs(points).max(axis=0), (0.03, 0.05), atol=1e-12)
    np.testing.assert_allclose((np.abs(points / (0.03, 0.05)) ** exponent).sum(axis=1), 1.0, atol=1e-9)


def test_rounded_rectangle_encloses_its_area_counter_clockwise():
    p = rounded_rectangle(0.03, 0.05, 0.01, 400)
    q = np.roll(p, -1, axis=0)
    area = 0.5 * float((p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]).sum())
    assert area == pytest.approx(0.06 * 0.1 - (4 - np.pi) * 0.01**2, rel=1e-4)
