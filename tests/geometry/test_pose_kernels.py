"""Transforms inside kernels against their numpy twins."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.geometry.pose_kernels import moved_point, rigid_inverse, rigid_product, turned_vector
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, transform_points_np


def random_pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_transform_np(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))


@pytest.mark.parametrize("rows", [3, 4])
def test_kernels_agree_with_numpy(rows):
    A, B, p = random_pose(0), random_pose(1), np.array([0.3, -0.2, 0.7])
    out = np.full((3, 4), np.nan)
    np.testing.assert_allclose(moved_point(A[:rows], *p), transform_points_np(A, p[None])[0], atol=1e-15)
    np.testing.assert_allclose(turned_vector(A[:rows], *p), A[:3, :3] @ p, atol=1e-15)
    rigid_product(A[:rows], B[:rows], out)
    np.testing.assert_allclose(out, (A @ B)[:3], atol=1e-15)
    rigid_inverse(A[:rows], out)
    np.testing.assert_allclose(out, inverse_np(A)[:3], atol=1e-15)
