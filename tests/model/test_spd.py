import numpy as np

from neuralgrasps.model.spd import add_damped, solve_spd


def test_solves_like_numpy_and_refuses_what_is_not_definite() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(9, 9))
    A, b, x = root @ root.T, rng.normal(size=9), np.empty(9)
    lower = np.tril(A)
    damped = np.zeros((9, 9))
    add_damped(lower, 0.5, 0.1, damped)
    assert solve_spd(damped, b, x)
    np.testing.assert_allclose(x, np.linalg.solve(A + np.diag(0.5 * np.diag(A) + 0.1), b), rtol=1e-9)
    A[0, 0] = -1.0
    assert not solve_spd(np.tril(A), b, x)
