"""Rotations against scipy, group axioms, precision near the identity and half a turn, derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry import rotation, se3_numpy

EYE = torch.eye(3, dtype=torch.float64)
ANGLES = [0.0, 1e-12, 1e-7, 1e-4, 0.0999, 0.1, 0.1001, 1.0, 3.0, math.pi - 1e-3, math.pi - 1e-8, math.pi]


def axes(seed: int, count: int) -> torch.Tensor:
    v = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return v / v.norm(dim=-1, keepdim=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_equals_scipy_and_log_undoes_it(angle: float) -> None:
    w = angle * axes(0, 500)
    R = rotation.exp_so3(w)
    np.testing.assert_allclose(R, Rotation.from_rotvec(w.numpy()).as_matrix(), atol=2e-15)
    back = rotation.log_so3(R)
    error = torch.minimum(
        (back - w).abs().amax(-1), (back + w).abs().amax(-1) if angle == math.pi else math.inf * EYE[0, 0]
    )
    assert error.max() < 4e-15
    assert (rotation.geodesic_angle(EYE, R) - angle).abs().max() < 3e-15


@pytest.mark.parametrize("batch", [(), (1,), (7,), (2, 3)])
@pytest.mark.parametrize("seed", [0, 1])
def test_batch_equals_loop(batch: tuple[int, ...], seed: int) -> None:
    w = torch.randn(*batch, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    R = rotation.exp_so3(w)
    assert R.shape == (*batch, 3, 3)
    for index in np.ndindex(*batch):
        torch.testing.assert_close(R[index], rotation.exp_so3(w[index]), atol=1e-15, rtol=0)
        torch.testing.assert_close(rotation.log_so3(R)[index], rotation.log_so3(R[index]), atol=1e-15, rtol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.09, 0.11, 1.5, math.pi - 1e-4])
def test_derivatives_equal_finite_differences(angle: float) -> None:
    w = (angle * axes(1, 1)[0]).requires_grad_()
    assert torch.autograd.gradcheck(rotation.exp_so3, (w,), atol=1e-7)
    assert torch.autograd.gradcheck(lambda u: rotation.log_so3(rotation.exp_so3(u)), (w,), atol=1e-7)
    jacobian = torch.autograd.functional.jacobian(lambda u: rotation.log_so3(rotation.exp_so3(u)), w)
    torch.testing.assert_close(jacobian, EYE, atol=1e-9, rtol=0)


def test_gradients_are_finite_at_the_identity_in_float32() -> None:
    w = torch.zeros(3, requires_grad=True)
    R = rotation.exp_so3(w)
    (rotation.log_so3(R).sum() + rotation.geodesic_angle(torch.eye(3), R)).backward()
    assert w.grad is not None and R.dtype == torch.float32
    assert torch.isfinite(w.grad).all()


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(c * c for c in q) > 1e-2))
def test_quaternions_equal_scipy_and_come_back(wxyz: list[float]) -> None:
    q = torch.tensor(wxyz, dtype=torch.float64)
    R = rotation.matrix_from_quaternion(q)
    np.testing.assert_allclose(R, Rotation.from_quat([*wxyz[1:], wxyz[0]]).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(R, se3_numpy.quaternion_matrix(wxyz), atol=1e-14)
    back = rotation.quaternion_from_matrix(R)
    assert back[0] >= 0
    assert min((back - q / q.norm()).norm(), (back + q / q.norm()).norm()) < 1e-14


@given(st.lists(st.floats(-7, 7), min_size=3, max_size=3))
def test_rpy_equals_scipy(rpy: list[float]) -> None:
    expected = Rotation.from_euler("xyz", rpy).as_matrix()
    np.testing.assert_allclose(rotation.matrix_from_rpy(torch.tensor(rpy, dtype=torch.float64)), expected, atol=1e-14)
    np.testing.assert_allclose(se3_numpy.rpy_matrix(rpy), expected, atol=1e-14)


def test_six_numbers_are_the_first_two_columns() -> None:
    R = rotation.random_rotations(100, 3)
    r = rotation.matrix_to_6d(R)
    torch.testing.assert_close(r[:, 3:], R[:, :, 1])
    torch.testing.assert_close(rotation.matrix_from_6d(r), R)
    skewed = torch.cat([2 * r[:, :3], 3 * r[:, 3:] + r[:, :3]], dim=-1)  # Gram-Schmidt removes scale and shear
    torch.testing.assert_close(rotation.matrix_from_6d(skewed), R)


def test_hat_is_the_cross_product() -> None:
    a, b = axes(4, 20), axes(5, 20)
    torch.testing.assert_close((rotation.hat(a) @ b.unsqueeze(-1)).squeeze(-1), torch.linalg.cross(a, b))


def test_random_rotations_are_uniform_and_repeatable() -> None:
    R = rotation.random_rotations(20000, 7)
    torch.testing.assert_close(R, rotation.random_rotations(20000, 7), atol=0, rtol=0)
    assert not torch.equal(R[:10], rotation.random_rotations(10, 8))
    assert R.mean(dim=0).abs().max() < 0.02
    # Over SO(3) the angle has density (1 - cos t) / pi, so its mean is pi / 2 + 2 / pi.
    assert abs(rotation.geodesic_angle(EYE, R).mean() - (math.pi / 2 + 2 / math.pi)) < 0.02


def test_super_fibonacci_covers_so3_better_than_chance() -> None:
    spiral, chance, probes = rotation.super_fibonacci_rotations(2000), rotation.random_rotations(2000, 0), 500
    targets = rotation.random_rotations(probes, 1)

    def worst(grid: torch.Tensor) -> float:
        cosine = (torch.einsum("pij,gij->pg", targets, grid).amax(dim=1).min() - 1) / 2
        return math.degrees(math.acos(cosine))

    assert torch.det(spiral).sub(1).abs().max() < 1e-12
    assert worst(spiral) < 17.0 < worst(chance)


def test_wrong_shapes_say_what_is_expected() -> None:
    with pytest.raises(ShapeError, match=r"w has shape \(4,\); expected \(\.\.\., 3\)"):
        rotation.exp_so3(torch.zeros(4))
    with pytest.raises(ShapeError, match="R has shape"):
        rotation.log_so3(torch.zeros(3))
    with pytest.raises(InputError, match="count is 0"):
        rotation.super_fibonacci_rotations(0)
    with pytest.raises(InputError, match="zero or not finite"):
        se3_numpy.quaternion_matrix([0, 0, 0, 0])
