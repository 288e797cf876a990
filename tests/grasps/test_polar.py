"""The search for the farthest vertex of a polar: the proof that it leaves behind, and its scratch."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.grasps.epsilon import LEAST, epsilon, epsilon_scratch, epsilon_with, epsilon_within
from neuralgrasps.grasps.polar import OVERFLOW, farthest_vertex, polar_scratch

CUBE = np.array(np.meshgrid(*[[-1.0, 1.0]] * 6)).reshape(6, -1).T.copy()
CROSS = np.concatenate([np.eye(6), -np.eye(6)])
INNER = 1e3


def search(wrenches, vertices=20_000):
    scratch = polar_scratch(len(wrenches), vertices)
    scratch.columns[:] = wrenches.T / np.abs(wrenches).max()
    return scratch, *farthest_vertex(scratch, len(wrenches), INNER, 0.0)


def facets(scratch):
    """(F,) vertices of the outer polytope in use, and the (F, 6) rows of their constraints."""
    used = int(scratch.counts[0])
    live = np.flatnonzero(scratch.squared[:used] > 0)
    return live, scratch.basis.reshape(-1, 8)[live, :6]


def points_of(wrenches, rows):
    """The hull's points that span the facets; the first simplex's are rows -1 - v, of length 1 / INNER."""
    start = polar_scratch(1, 16)
    start.columns[:] = 0.0
    farthest_vertex(start, 1, INNER, 0.0)  # nothing to cut: the first simplex itself
    simplex = -start.x[:, :7].T / (6 * INNER * INNER)
    return np.concatenate([wrenches, simplex[::-1]])[rows]


def cases(contacts):
    closed = [w for w in contacts.wrench_cases(21, 60) if epsilon(w) > 2e-3][:12]
    assert len(closed) == 12
    flat_twice = np.concatenate([CROSS, CROSS, 0.1 * CUBE, 0 * CROSS])
    return [CROSS, CUBE, flat_twice, np.concatenate([closed[0], closed[0]]), *closed]


def test_the_search_leaves_a_closed_surface_of_tight_facets_behind(contacts):
    for wrenches in cases(contacts):
        scratch, support, reach = search(wrenches)
        live, rows = facets(scratch)
        assert support == pytest.approx(1.0, abs=2e-10)  # the last vertex is in the polar
        mates = scratch.mates.reshape(-1, 8)[live, :6]
        edges = 8 * live[:, None] + np.arange(6)
        np.testing.assert_array_equal(scratch.mates[mates], edges)  # every rim is shared by exactly two facets
        for v in range(len(live)):
            for j in range(6):
                other = scratch.basis[8 * (mates[v, j] >> 3) : 8 * (mates[v, j] >> 3) + 6]
                shared = set(np.delete(rows[v], j))
                assert shared == set(np.delete(other, mates[v, j] & 7))
        spans = points_of(wrenches / np.abs(wrenches).max(), rows)  # (F, 6, 6)
        tight = np.einsum("fjk,kf->fj", spans, scratch.x[:, live])
        np.testing.assert_allclose(tight, 1.0, atol=1e-9)  # so each facet's plane is 1 / |x| from the origin
        assert np.sqrt(scratch.squared[live]).max() == reach


def test_the_surface_that_is_left_surrounds_the_origin_once(contacts):
    rng = np.random.default_rng(0)
    for wrenches in cases(contacts)[4:]:
        scratch, _, _ = search(wrenches)
        _, rows = facets(scratch)
        spans = points_of(wrenches / np.abs(wrenches).max(), rows)
        spans = spans[np.abs(np.linalg.det(spans)) > 1e-12 * np.abs(np.linalg.det(spans)).max()]
        directions = rng.standard_normal((6, 200))
        weights = np.linalg.solve(np.swapaxes(spans, 1, 2), np.broadcast_to(directions, (len(spans), 6, 200)))
        hits = (weights > 0).all(axis=1).sum(axis=0)
        assert (hits == 1).mean() > 0.97  # up to directions that meet a rim


def test_the_room_for_vertices_does_not_change_the_answer(contacts):
    wrenches = next(w for w in contacts.wrench_cases(11, 30) if epsilon(w) > 0.05)
    assert search(wrenches, 60)[2] == OVERFLOW
    tight = epsilon_scratch(len(wrenches), 60)
    assert epsilon_within(wrenches, len(wrenches), tight) == OVERFLOW
    assert epsilon_within(wrenches, len(wrenches), epsilon_scratch(len(wrenches) - 1)) == OVERFLOW
    assert epsilon_with(wrenches, len(wrenches), tight) == epsilon(wrenches)
    counts = search(wrenches)[0].counts
    assert counts[0] < 0.8 * counts[2]  # places of removed vertices are used again


def test_what_is_in_the_scratch_does_not_matter(contacts):
    sets = [w for w in contacts.wrench_cases(12, 20)]
    fresh = [epsilon(w) for w in sets]
    scratch = epsilon_scratch(max(map(len, sets)))
    for array in scratch:
        array.fill(np.nan if array.dtype == np.float64 else 77)
    assert [epsilon_with(w, len(w), scratch) for w in sets] == fresh
    assert [epsilon_with(w, len(w), scratch) for w in sets[::-1]] == fresh[::-1]


def test_a_floor_ends_the_search_early_without_changing_what_is_above_it(contacts):
    sets = [w for w in contacts.wrench_cases(13, 40) if epsilon(w) > 0.01]
    scratch = epsilon_scratch(max(map(len, sets)))
    full = early = 0
    for wrenches in sets:
        quality = epsilon(wrenches)
        assert epsilon_with(wrenches, len(wrenches), scratch) == quality
        full += scratch.counts[1]
        assert epsilon_with(wrenches, len(wrenches), scratch, 0.999 * quality) == quality
        assert epsilon_with(wrenches, len(wrenches), scratch, 1.5 * quality) == 0.0
        early += scratch.counts[1]
    assert early < 0.8 * full


@pytest.mark.parametrize("thin", [1e-2, 1e-3, 3e-4, 1e-5, 1e-6])
def test_thin_hulls(thin):
    wrenches = np.concatenate([CROSS, 0.1 * CUBE]) * [1.0, 1.0, 1.0, 1.0, 1.0, thin]
    expected = 1 / np.sqrt(5 + thin**-2)
    assert epsilon(wrenches) == pytest.approx(expected, rel=2e-7 if expected < 1e-3 else 2e-10)
    assert epsilon(wrenches * [1, 1, 1, 1, 1, 0.5 * LEAST / thin]) == 0.0


@pytest.mark.parametrize("bump", [1e-2, 1e-4, 1e-6, 1e-8])
def test_points_barely_outside_the_hull_of_the_others_count(bump):
    # a point above the middle of each face of a cube: planes through it and an edge of the face, (1, bump, 0, ...)
    wrenches = np.concatenate([CUBE, (1 + bump) * CROSS])
    assert epsilon(wrenches) == pytest.approx((1 + bump) / np.hypot(1, bump), rel=2e-10)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_numbers_that_are_not_finite_or_huge(value):
    rng = np.random.default_rng(0)
    for _ in range(20):
        wrenches = np.concatenate([CROSS, rng.standard_normal((20, 6))])
        wrenches[rng.integers(0, len(wrenches), 2), rng.integers(0, 6, 2)] = value
        quality = epsilon(wrenches)
        assert 0 <= quality < 10 if value == 1e200 else np.isnan(quality)


@pytest.mark.parametrize("scale", [1e-200, 1e-9, 1e9, 1e200])
def test_scaling_all_wrenches_scales_epsilon(scale):
    wrenches = np.concatenate([CROSS, 0.9 * CUBE]) * [1, 1, 1, 1, 1, 0.01]
    assert epsilon(scale * wrenches) == pytest.approx(scale * epsilon(wrenches), rel=1e-9)


def test_rounding_beyond_the_tolerance_ends_the_search():
    # unscaled: w . x = 1 is lost to rounding where x is 1e3 and w 1e200, and vertices violate what they lie on
    scratch = polar_scratch(32, 20_000)
    rng = np.random.default_rng(0)
    for _ in range(20):
        wrenches = np.concatenate([CROSS, rng.standard_normal((20, 6))])
        wrenches[rng.integers(0, 32, 2), rng.integers(0, 6, 2)] = 1e200
        scratch.columns[:] = wrenches.T
        support, reach = farthest_vertex(scratch, 32, INNER, 0.0)
        assert reach >= 0 or reach == OVERFLOW or np.isnan(support)
