"""Exact epsilon against known polytopes, closed forms, invariances and Qhull."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from neuralgrasps.grasps.epsilon import epsilon, epsilon_qhull, epsilon_scratch, epsilon_with
from neuralgrasps.grasps.wrench_space import grasp_wrenches


def simplex_vertices() -> np.ndarray:
    """Seven unit vectors of a regular simplex in 6D."""
    corners = np.eye(7) - 1.0 / 7.0
    basis = np.linalg.svd(corners)[2][:6]
    vertices = corners @ basis.T
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True)


CUBE = np.array(np.meshgrid(*[[-1.0, 1.0]] * 6)).reshape(6, -1).T.copy()
CROSS = np.concatenate([np.eye(6), -np.eye(6)])


@pytest.mark.parametrize(
    ("wrenches", "radius"),
    [
        (CROSS, 1 / np.sqrt(6)),
        (CUBE, 1.0),
        (simplex_vertices(), 1 / 6),
        (CROSS * [1.0, 2.0, 3.0, 1.0, 0.5, 0.1], 1 / np.sqrt(1 + 1 / 4 + 1 / 9 + 1 + 4 + 100)),
        (np.concatenate([CROSS, CROSS, 0.1 * CUBE, 0 * CROSS]), 1 / np.sqrt(6)),  # repeated, interior and zero rows
        (np.concatenate([CROSS, 0.9 * CUBE]), 1 / np.hypot(1, 1 / 9)),
    ],
    ids=["cross", "cube", "simplex", "stretched cross", "redundant", "capped cube"],
)
def test_known_polytopes(wrenches, radius):
    assert epsilon(wrenches) == pytest.approx(radius, abs=1e-12)
    assert epsilon_qhull(wrenches) == pytest.approx(radius, abs=1e-8)


def test_a_hull_beside_or_touching_the_origin_is_not_force_closure():
    vertices = simplex_vertices()
    assert epsilon(vertices + 0.99 * vertices[0] / 6) > 0
    outside = vertices + 1.01 * vertices[0] / 6  # the facet opposite vertex 0 has passed the origin
    assert epsilon(outside) == 0.0
    assert epsilon(np.concatenate([outside, outside])) == 0.0
    assert epsilon(CROSS[:11]) == 0.0  # origin on a facet
    assert epsilon(CROSS[:6]) == 0.0
    assert epsilon(np.zeros((0, 6))) == 0.0
    flat = CROSS.copy()
    flat[:, 5] = 0.0
    assert epsilon(flat) == 0.0  # all wrenches in a 5D subspace


def test_an_unbounded_polar_is_found_however_thin():
    # a thin wedge of separating directions
    rng = np.random.default_rng(3)
    for _ in range(200):
        normal = rng.standard_normal(6)
        normal /= np.linalg.norm(normal)
        wrenches = rng.standard_normal((60, 6))
        wrenches -= np.outer(np.maximum(wrenches @ normal, 0) + 1e-3, normal)
        assert epsilon(wrenches) == 0.0


def test_two_soft_contacts_on_a_ball():
    # closed form: the octagons bound the tangential forces by friction cos(pi / 8), torsion by torsion / radius
    friction, torsion, radius = 0.6, 0.01, 0.05
    normals = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    soft = grasp_wrenches(radius * normals, normals, np.zeros(3), friction, 8, torsion, radius)
    expected = 1 / np.hypot(radius / torsion, 1 / (friction * np.cos(np.pi / 8)))
    assert soft.shape == (20, 6)
    assert epsilon(soft) == pytest.approx(expected, abs=1e-9)
    hard = grasp_wrenches(radius * normals, normals, np.zeros(3), friction, 8, 0.0, radius)
    assert epsilon(hard) == 0.0  # free to turn about the line through both contacts


@pytest.mark.parametrize("friction", [0.1, 0.3, 0.5])
def test_six_contacts_on_the_axes_of_a_ball(friction):
    # A torque b is held by the contacts on axis x up to friction o(b_y, b_z), o the octagon with corners at multiples
    # of 45 deg, so max(|y|, |z|, (|y| + |z|) / sqrt 2), and likewise on y and z; the largest of the three is least for
    # b = (1, 1, 1) / sqrt 3. Pushes are weaker only where friction is large.
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    wrenches = grasp_wrenches(0.05 * normals, normals, np.zeros(3), friction, 8, 0.0, 0.05)
    assert epsilon(wrenches) == pytest.approx(friction * np.sqrt(2 / 3), abs=1e-12)


def test_three_contacts_around_a_ball_against_linear_programmes():
    angle = np.array([0.0, 2 * np.pi / 3, 4 * np.pi / 3])
    normals = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    wrenches = grasp_wrenches(0.05 * normals, normals, np.zeros(3), 0.5, 8, 0.0, 0.05)
    rng, best = np.random.default_rng(0), np.inf
    for _ in range(12):
        # each time the polar's point that is farthest along the last one: linear programmes that climb |x|
        x = rng.standard_normal(6)
        for _ in range(8):
            x = linprog(-x, A_ub=wrenches, b_ub=np.ones(len(wrenches)), bounds=(None, None)).x
        best = min(best, 1 / np.linalg.norm(x))
    assert epsilon(wrenches) == pytest.approx(best, rel=1e-9)


def test_contacts_given_twice_change_nothing(contacts):
    points, normals = contacts.can(np.random.default_rng(4), 5, 0.033, 0.05)
    once = grasp_wrenches(points, normals, np.zeros(3), 0.6, 8, 0.005, 0.06)
    assert epsilon(once) > 0.01
    assert epsilon(np.concatenate([once, once[::-1]])) == pytest.approx(epsilon(once), abs=1e-12)


def test_frictionless_contacts_cannot_hold_a_ball(contacts):
    points, normals = contacts.ball(np.random.default_rng(0), 12, 0.04)
    assert epsilon(grasp_wrenches(points, normals, np.zeros(3), 1e-12, 8, 0.0, 0.04)) == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_moving_the_grasp_or_reordering_contacts_changes_nothing(seed, contacts):
    rng = np.random.default_rng(seed)
    points, normals = contacts.patches(rng, *contacts.box(rng, 7, np.array([0.03, 0.05, 0.09])))
    com = rng.normal(0, 0.01, 3)
    base = epsilon(grasp_wrenches(points, normals, com, 0.6, 8, 0.005, 0.1))
    R, t = Rotation.random(random_state=seed).as_matrix(), rng.normal(0, 1, 3)
    order = rng.permutation(len(points))
    moved = grasp_wrenches(points[order] @ R.T + t, normals[order] @ R.T, R @ com + t, 0.6, 8, 0.005, 0.1)
    assert epsilon(moved) == pytest.approx(base, abs=1e-9)


def test_scaling_and_adding_wrenches(contacts):
    wrenches = next(w for w in contacts.wrench_cases(11, 14) if epsilon(w) > 0.01)
    base = epsilon(wrenches)
    assert base > 0
    assert epsilon(3.0 * wrenches) == pytest.approx(3.0 * base, rel=1e-9)
    more = np.concatenate([wrenches, np.random.default_rng(0).standard_normal((10, 6))])
    assert epsilon(more) >= base - 1e-9


def test_epsilon_agrees_with_qhull_on_random_and_realistic_grasps(contacts):
    cases = contacts.wrench_cases(5, 126)
    fast = np.array([epsilon(w) for w in cases])
    slow = np.array([epsilon_qhull(w) for w in cases])
    assert 0.4 < (slow > 0).mean() < 0.95
    np.testing.assert_array_equal(fast > 0, slow > 0)
    np.testing.assert_allclose(fast, slow, atol=1e-8)


def test_scratch_that_was_used_before_and_rows_beyond_the_count_change_nothing(contacts):
    cases = contacts.wrench_cases(6, 14)
    counts = np.array([len(w) for w in cases])
    padded = np.full((len(cases), counts.max(), 6), np.nan)
    for row, wrenches in zip(padded, cases, strict=True):
        row[: len(wrenches)] = wrenches
    scratch = epsilon_scratch(counts.max())
    again = [epsilon_with(row, count, scratch) for row, count in zip(padded, counts, strict=True)]
    np.testing.assert_array_equal(again, [epsilon(w) for w in cases])
