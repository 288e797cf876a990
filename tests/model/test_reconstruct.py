import numpy as np
import pytest

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.field_surface import FieldSurface, level_mesh
from neuralgrasps.model.reconstruct import (
    ChamferScene,
    f_score,
    hand_bounds,
    posed_hands,
    published_chamfer,
    squared_chamfer,
    surface_distances,
    surface_errors,
)

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


def test_f_score_by_hand() -> None:
    """Three of four reconstructed points and one of two true points are within 1: 2 * .75 * .5 / 1.25."""
    there, back = np.array([0.0, 0.5, 1.0, 3.0]), np.array([0.5, 2.0])
    assert f_score(there, back, 1.0) == pytest.approx(0.6)
    assert f_score(there, back, 0.1) == 0.0  # nothing of the true surface is found
    assert f_score(there, back, 3.0) == 1.0
    with pytest.raises(InputError, match="threshold above 0"):
        f_score(there, back, 0.0)
    with pytest.raises(InputError, match="expected some points"):
        f_score(there, np.zeros(0), 1.0)


def test_a_hollow_shape_scores_below_a_perfect_one() -> None:
    """Why the paper's objects can be below what a perfect field scores: holes inside lower the measure."""

    def shell(p: np.ndarray) -> np.ndarray:
        d = np.linalg.norm(p, axis=1) - 0.3
        return np.where(d < -0.1, 1.0, d)

    score = published_chamfer(shell, ball(0.3), sphere_points(0.3), normalisation=UNIT, seed=0, queries=20_000)
    assert score.chamfer < 0.8 * score.oracle


def test_a_box_around_the_shape_changes_nothing_but_the_time() -> None:
    box = np.array([[-0.3, -0.3, -0.3], [0.3, 0.3, 0.3]])
    asked: list[int] = []

    def counted_ball(p: np.ndarray) -> np.ndarray:
        asked.append(len(p))
        return ball(0.3)(p)

    arguments = {"normalisation": UNIT, "seed": 3, "queries": 20_000}
    plain = ChamferScene(counted_ball, sphere_points(0.3), **arguments)
    boxed = ChamferScene(counted_ball, sphere_points(0.3), bounds_O=box, **arguments)
    assert plain.oracle == boxed.oracle and asked[0] == 20_000 and asked[1] < 2_000
    assert plain.score(ball(0.25)) == boxed.score(ball(0.25), bounds_O=box)
    far = box + 5.0
    assert boxed.score(ball(0.3), bounds_O=far).chamfer == np.inf  # nothing is asked outside the box


@pytest.mark.parametrize("name", ["fetch", "human"])
def test_a_hand_lies_in_its_box_and_on_its_own_surface(name: str) -> None:
    packed = pack_hand(load_hand(name), spacing=0.006)
    rng = np.random.default_rng(0)
    X_OH = np.eye(4)
    X_OH[:3, :3] = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    X_OH[:3, 3] = [0.1, -0.2, 0.3]
    (shape,) = posed_hands(packed, X_OH[None], rng.uniform(packed.lower, packed.upper)[None])
    points = shape.surface_points(3000, rng)
    low, high = hand_bounds(packed, X_OH, shape.q)
    assert (points > low - 1e-9).all() and (points < high + 1e-9).all()
    assert (high - low < 4.0 * np.ptp(points, axis=0)).all()  # and not in a far larger one
    assert shape.surface_distance(points).max() < 1e-5


def test_distances_between_a_hand_and_the_same_hand_moved_along_x() -> None:
    packed = pack_hand(load_hand("fetch"), spacing=0.006)
    q = 0.5 * (packed.lower + packed.upper)
    moved = np.eye(4)
    moved[0, 3] = 0.004
    same, shifted = posed_hands(packed, np.stack([np.eye(4), moved]), np.stack([q, q]))
    there, back = surface_distances(shifted, same, points=4000, rng=np.random.default_rng(0))
    assert there.max() <= 0.004 + 2e-6 and back.max() <= 0.004 + 2e-6 and 0.0005 < there.mean() < 0.004
    assert f_score(there, back, 0.001) < f_score(there, back, 0.0041) == 1.0


def test_the_zero_surface_of_a_field_with_a_stray_part() -> None:
    """Two balls, one of them a stray one: the mesh has both, so that it is measured as the user would meet it."""
    frame = Normalisation(offset_O=np.array([0.1, 0.0, 0.0]), scale_m=0.2)
    middle, stray = np.array([0.12, 0.0, 0.0]), np.array([-0.02, 0.0, 0.0])

    def field(p: np.ndarray) -> np.ndarray:
        return np.minimum(np.linalg.norm(p - middle, axis=1) - 0.05, np.linalg.norm(p - stray, axis=1) - 0.02)

    surface = FieldSurface(field, normalisation=frame, cells=40)
    points = surface.surface_points(4000, np.random.default_rng(0))
    assert np.abs(field(points)).max() < 0.0005
    assert (np.linalg.norm(points - stray, axis=1) < 0.021).mean() == pytest.approx(
        0.02**2 / (0.05**2 + 0.02**2), rel=0.2
    )
    assert surface.surface_distance(middle[None])[0] == pytest.approx(0.05, rel=0.01)
    assert signed_distance(surface.mesh, np.stack([middle, stray, middle + 0.1]))[:2].max() < 0  # facing outwards
    with pytest.raises(InputError, match="positive everywhere"):
        level_mesh(lambda p: np.ones(len(p)), frame, cells=8)
