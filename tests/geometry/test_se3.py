"""SE(3): group axioms over batch shapes and seeds, scipy's matrix exponential, derivatives, the numpy twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg
import torch

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry import se3, se3_numpy
from neuralgrasps.geometry.rotation import exp_so3, hat

BATCHES = [(), (1,), (5,), (2, 3)]


def twists(batch: tuple[int, ...], seed: int, scale: float = 1.0) -> torch.Tensor:
    return scale * torch.randn(*batch, 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("scale", [1e-9, 1e-3, 0.05, 0.8])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_group_axioms(batch: tuple[int, ...], scale: float, seed: int) -> None:
    X, Y, Z = (se3.exp_se3(twists(batch, 3 * seed + k, scale)) for k in range(3))
    eye = torch.eye(4, dtype=torch.float64).expand(*batch, 4, 4)
    torch.testing.assert_close(X @ se3.inverse(X), eye, atol=1e-14, rtol=0)
    torch.testing.assert_close(se3.inverse(X @ Y), se3.inverse(Y) @ se3.inverse(X), atol=1e-14, rtol=0)
    torch.testing.assert_close((X @ Y) @ Z, X @ (Y @ Z), atol=1e-14, rtol=0)
    points = torch.randn(*batch, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    through = se3.transform_points(X, se3.transform_points(Y, points))
    torch.testing.assert_close(se3.transform_points(X @ Y, points), through, atol=1e-13, rtol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-4, 0.0999, 0.1001, 1.0, 3.0, math.pi - 1e-6])
def test_exp_equals_the_matrix_exponential_and_log_undoes_it(angle: float) -> None:
    xi = twists((20,), 4)
    xi[:, 3:] *= angle / xi[:, 3:].norm(dim=-1, keepdim=True)
    X = se3.exp_se3(xi)
    algebra = torch.zeros(20, 4, 4, dtype=torch.float64)
    algebra[:, :3, :3], algebra[:, :3, 3] = hat(xi[:, 3:]), xi[:, :3]
    for k in range(20):
        np.testing.assert_allclose(X[k], scipy.linalg.expm(algebra[k].numpy()), atol=3e-14)
    torch.testing.assert_close(se3.log_se3(X), xi, atol=1e-13, rtol=0)


@pytest.mark.parametrize("scale", [0.0, 1e-8, 0.03, 0.7])
def test_derivatives_equal_finite_differences(scale: float) -> None:
    xi = twists((), 5, scale).requires_grad_()
    assert torch.autograd.gradcheck(se3.exp_se3, (xi,), atol=1e-7)
    jacobian = torch.autograd.functional.jacobian(lambda u: se3.log_se3(se3.exp_se3(u)), xi)
    torch.testing.assert_close(jacobian, torch.eye(6, dtype=torch.float64), atol=1e-9, rtol=0)


def test_pure_translation_and_a_quarter_turn_by_hand() -> None:
    xi = torch.tensor([[0.1, -0.2, 0.3, 0, 0, 0], [math.pi / 2, 0, 0, 0, 0, math.pi / 2]], dtype=torch.float64)
    X = se3.exp_se3(xi)
    torch.testing.assert_close(X[0, :3, 3], xi[0, :3])
    # Driving a quarter of a unit circle from the origin along x, turning left, ends at (1, 1).
    torch.testing.assert_close(X[1, :3, 3], torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64))
    moved = se3.transform_points(X[1], torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64))
    torch.testing.assert_close(moved, torch.tensor([[1.0, 2.0, 0.0]], dtype=torch.float64))
    turned = se3.rotate_vectors(X[1], torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64))
    torch.testing.assert_close(turned, torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64))


def test_make_transform_broadcasts_and_keeps_dtype() -> None:
    R = exp_so3(torch.randn(4, 1, 3))
    X = se3.make_transform(R, torch.randn(5, 3))
    assert X.shape == (4, 5, 4, 4) and X.dtype == torch.float32
    torch.testing.assert_close(X[2, 3, :3, :3], R[2, 0])


def test_numpy_twins_agree() -> None:
    X = se3.exp_se3(twists((3, 2), 6))
    points = torch.randn(3, 1, 7, 3, dtype=torch.float64)
    np.testing.assert_allclose(se3_numpy.inverse_np(X.numpy()), se3.inverse(X), atol=1e-15)
    moved = se3_numpy.transform_points_np(X.numpy(), points.numpy())
    np.testing.assert_allclose(moved, se3.transform_points(X, points), atol=1e-14)
    np.testing.assert_array_equal(se3_numpy.make_transform_np(X[..., :3, :3].numpy(), X[..., :3, 3].numpy()), X)
    np.testing.assert_array_equal(se3_numpy.make_transform_np(), np.eye(4))
    axis = np.array([0.0, 3.0, 4.0])
    expected = exp_so3(torch.tensor(axis / 5 * 0.7)).numpy()
    np.testing.assert_allclose(se3_numpy.axis_angle_matrix(axis, 0.7), expected, atol=1e-15)


def test_wrong_shapes_say_what_is_expected() -> None:
    with pytest.raises(ShapeError, match=r"xi has shape \(5,\)"):
        se3.exp_se3(torch.zeros(5))
    with pytest.raises(ShapeError, match="vectors or points"):
        se3.transform_points(torch.eye(4), torch.zeros(3))
