"""Resting poses of solids whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.objects.resting import resting_poses

HALF = np.array([0.02, 0.03, 0.05])


def _solid_angle(a: float, b: float, height: float) -> float:
    """Of a rectangle of half sizes a, b seen from `height` above its middle."""
    return 4 * np.arctan(a * b / (height * np.sqrt(a * a + b * b + height * height)))


def test_a_box_rests_on_its_six_faces_with_shares_by_solid_angle():
    X_WO, share = resting_poses(box_mesh(HALF).vertices, np.zeros(3))
    assert len(X_WO) == 6
    heights = X_WO[:, 2, 3]
    expected = {h: _solid_angle(*(x for x in HALF if x != h), h) / (4 * np.pi) for h in HALF}
    for h, s in zip(heights, share, strict=True):
        nearest = HALF[np.abs(HALF - h).argmin()]
        assert h == pytest.approx(nearest, abs=1e-9)
        assert s == pytest.approx(expected[nearest], rel=1e-6)
    assert share.sum() == pytest.approx(1.0)
    assert (np.diff(share) <= 1e-12).all()
    down = np.round(X_WO[:, 2, :3]).astype(int)  # the object's direction that points up, per pose
    assert len({tuple(d) for d in down}) == 6


def test_poses_are_rigid_touch_the_plane_and_centre_the_mass():
    rng = np.random.default_rng(0)
    points = rng.standard_normal((60, 3)) * HALF
    com = points.mean(axis=0)
    X_WO, _ = resting_poses(points, com)
    for X in X_WO:
        np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)
        placed = points @ X[:3, :3].T + X[:3, 3]
        assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose((X[:3, :3] @ com + X[:3, 3])[:2], 0.0, atol=1e-12)


def test_a_pose_is_stable_the_mass_lies_over_the_feet():
    rng = np.random.default_rng(1)
    points = rng.standard_normal((40, 3)) * HALF
    X_WO, _ = resting_poses(points, points.mean(axis=0), min_share=0.0)
    for X in X_WO:
        placed = points @ X[:3, :3].T + X[:3, 3]
        feet = placed[placed[:, 2] < 1e-9][:, :2]
        assert len(feet) >= 3
        # the origin is not on one side of all feet, in any direction
        for angle in np.linspace(0, 2 * np.pi, 64, endpoint=False):
            assert (feet @ [np.cos(angle), np.sin(angle)]).max() >= -1e-9


def test_a_displaced_mass_leaves_only_the_faces_below_it():
    # outside the box's middle by more than the small faces' half width: the two nearest the mass stay stable
    X_even, share_even = resting_poses(box_mesh(HALF).vertices, np.zeros(3))
    X_off, share_off = resting_poses(box_mesh(HALF).vertices, np.array([0.0, 0.0, -0.045]))
    bottom = [i for i, X in enumerate(X_off) if X[2, 2] > 0.99]
    top = [i for i, X in enumerate(X_off) if X[2, 2] < -0.99]
    assert bottom == [0]  # 5 mm below the mass: almost everything ends there
    assert share_off[0] > 0.4 > share_even.max()
    assert all(share_off[i] < 0.05 for i in top)
    assert len(X_even) == 6


def test_a_can_stands_on_both_ends_or_lies():
    X_WO, share = resting_poses(cylinder_mesh(0.03, 0.05, segments=48).vertices, np.zeros(3), min_share=0.0)
    standing = np.abs(X_WO[:, 2, 2]) > 0.99
    assert standing.sum() == 2
    np.testing.assert_allclose(X_WO[standing, 2, 3], 0.05, atol=1e-9)
    np.testing.assert_allclose(X_WO[~standing, 2, 3], 0.03, rtol=0.01)
    cap = 0.5 * (1 - 0.05 / np.hypot(0.03, 0.05))  # share of the sphere of a circular cap
    np.testing.assert_allclose(share[standing], cap, rtol=0.02)


def test_a_ball_with_many_small_facets_still_rests():
    X_WO, share = resting_poses(sphere_mesh(0.04, segments=64).vertices, np.zeros(3), min_share=0.05)
    assert len(X_WO) >= 1
    assert share.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(X_WO[:, 2, 3], 0.04, rtol=0.01)


def test_the_object_frame_does_not_matter():
    rng = np.random.default_rng(2)
    X = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    X *= np.sign(np.linalg.det(X))
    shift = np.array([0.3, -0.2, 0.1])
    vertices = box_mesh(HALF).vertices
    first, share = resting_poses(vertices, np.array([0.002, 0.001, 0.0]))
    other, other_share = resting_poses(vertices @ X.T + shift, X @ [0.002, 0.001, 0.0] + shift)
    np.testing.assert_allclose(np.sort(share), np.sort(other_share), atol=1e-9)
    np.testing.assert_allclose(
        np.sort(first[:, 2, 3] + first[:, 2, :3] @ [0.002, 0.001, 0.0]),
        np.sort(other[:, 2, 3] + other[:, 2, :3] @ (X @ [0.002, 0.001, 0.0] + shift)),
        atol=1e-9,
    )
