"""Contact wrenches against the definition."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.grasps.wrench_space import characteristic_length, grasp_wrenches


def test_wrenches_push_inward_with_unit_normal_force_on_the_cone(contacts):
    rng = np.random.default_rng(1)
    points, normals = contacts.ball(rng, 5, 0.05)
    points, com, length = points + rng.normal(0, 0.01, (5, 3)), rng.normal(0, 0.01, 3), 0.07
    wrenches = grasp_wrenches(points, normals, com, 0.5, 8, 0.0, length).reshape(5, 8, 6)
    inward = -np.einsum("cek,ck->ce", wrenches[..., :3], normals)
    tangential = wrenches[..., :3] + inward[..., None] * normals[:, None]
    np.testing.assert_allclose(inward, 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(tangential, axis=-1), 0.5, atol=1e-12)
    np.testing.assert_allclose(
        wrenches[..., 3:], np.cross((points - com)[:, None], wrenches[..., :3]) / length, atol=1e-12
    )


def test_characteristic_length_is_the_farthest_point():
    assert characteristic_length(np.array([[1.0, 0, 0], [0, -3.0, 4.0]]), np.zeros(3)) == pytest.approx(5.0)
