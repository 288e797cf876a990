import numpy as np
import pytest

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError
from neuralgrasps.model.reconstruct import published_chamfer, squared_chamfer, surface_errors

UNIT = Normalisation(offset_O=np.zeros(3), scale_m=1.0)


def sphere_points(radius: float, count: int = 20_000) -> np.ndarray:
    p = np.random.default_rng(0).normal(size=(count, 3))
    return radius * p / np.linalg.norm(p, axis=1, keepdims=True)


def test_oracle_of_a_ball_is_the_known_integral() -> None:
    """Mean squared distance of a filled ball of radius a to its surface: 3 int r^2 (a - r)^2 dr / a^3 = a^2 / 10."""
    radius = 0.3

    def ball(p: np.ndarray) -> np.ndarray:
        return np.linalg.norm(p, axis=1) - radius

    score = published_chamfer(ball, ball, sphere_points(radius), normalisation=UNIT, seed=0)
    assert score.chamfer == score.oracle
    back = score.oracle - radius**2 / 10  # from the surface to the nearest query inside: small, never zero
    assert 0 < back < 0.0012
    assert score.inside == pytest.approx(100_000 * radius**3, rel=0.05)


def ball(r: float, x: float = 0.0):
    return lambda p: np.linalg.norm(p - [x, 0, 0], axis=1) - r


def test_the_published_measure_can_prefer_a_wrong_shape() -> None:
    """The trap: a ball a third too large beats the true one, so the measure means nothing without surface errors."""
    score = published_chamfer(ball(0.4), ball(0.3), sphere_points(0.3), normalisation=UNIT, seed=0, queries=20_000)
    assert score.chamfer < score.oracle


def test_a_shifted_shape_scores_worse_than_the_oracle_and_an_empty_one_infinite() -> None:
    score = published_chamfer(
        ball(0.3, x=0.2), ball(0.3), sphere_points(0.3), normalisation=UNIT, seed=0, queries=20_000
    )
    assert score.chamfer > 1.2 * score.oracle
    nothing = published_chamfer(
        lambda p: np.ones(len(p)), ball(0.3), sphere_points(0.3), normalisation=UNIT, seed=0, queries=1000
    )
    assert nothing.chamfer == np.inf and nothing.inside == 0
    with pytest.raises(InputError, match="0 surface points"):
        published_chamfer(ball(0.3), ball(0.3), np.zeros((0, 3)), normalisation=UNIT, seed=0)


def test_squared_chamfer_and_surface_errors_by_hand() -> None:
    a, b = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 2]])
    assert squared_chamfer(a, b) == pytest.approx((4 + 5) / 2 + 4)
    errors = surface_errors(np.array([[-1.0, 1.0], [3.0, 0.0]]))
    assert (errors.mean_m, errors.max_m) == (1.25, 3.0)
