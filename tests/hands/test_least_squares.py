"""What fits of hands are made of, against plain references."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.hands.least_squares import (
    add_damped,
    add_row,
    add_sized_row,
    assemble,
    damped_step,
    hold_limits,
    link_twists,
    moved_hand,
    solve_spd,
)
from neuralgrasps.hands.packed import PackedHand, pack_shapes, pose_links
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.jacobian import link_jacobian

HANDS = ("allegro", "barrett", "fetch")


def posed(name: str, seed: int) -> tuple[PackedHand, np.ndarray, np.ndarray]:
    """A hand, joints (J,) within its limits, and its links X_HL (L, 4, 4)."""
    packed = pack_shapes(load_hand(name))
    q = np.random.default_rng(seed).uniform(packed.lower, packed.upper)
    X_HL = np.empty((len(packed.parents), 4, 4))
    pose_links(packed, q, X_HL)
    return packed, q, X_HL


@pytest.mark.parametrize("name", HANDS)
def test_link_twists_are_the_jacobian(name: str) -> None:
    packed, q, X_HL = posed(name, 0)
    tree = load_hand(name).tree
    twists = np.empty((len(packed.parents), len(q), 6))
    link_twists(packed, X_HL, twists)
    point_L = np.array([0.01, -0.02, 0.03])
    for link in range(len(packed.parents)):
        p = X_HL[link, :3, :3] @ point_L + X_HL[link, :3, 3]
        velocity = twists[link, :, :3] + np.cross(twists[link, :, 3:], p)
        np.testing.assert_allclose(velocity.T, link_jacobian(tree, q, link, point_L)[:3], atol=1e-12)


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("rows", [6, 7])
def test_sums_of_links_are_the_normal_equations(name: str, rows: int) -> None:
    packed, q, X_HL = posed(name, 1)
    links, joints, rng = len(packed.parents), len(q), np.random.default_rng(2)
    twists, G, h = np.empty((links, joints, 6)), np.zeros((links, rows, rows)), np.zeros((links, rows))
    link_twists(packed, X_HL, twists)
    unknowns = 6 + joints + (rows == 7)
    expected_A, expected_b = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for _ in range(30):
        link, p, n = rng.integers(links), 0.1 * rng.standard_normal(3), rng.standard_normal(3)
        r, w, more = rng.standard_normal(), rng.random(), 0.1 * rng.standard_normal()
        twist_row = np.append(n, np.cross(p, n))
        J = np.concatenate([twist_row, twists[link] @ twist_row, [n @ p + more] if rows == 7 else []])
        expected_A += w * np.outer(J, J)
        expected_b += w * r * J
        if rows == 7:
            add_sized_row(G[link], h[link], *n, *p, more, r, w)
        else:
            add_row(G[link], h[link], *n, *p, r, w)
    A, b = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    assemble(G, h, twists, A, b)
    np.testing.assert_allclose(np.tril(A), np.tril(expected_A), atol=1e-12)
    np.testing.assert_allclose(b, expected_b, atol=1e-12)


def test_a_step_solves_the_damped_equations_and_ends_within_the_limits() -> None:
    packed, q, _ = posed("allegro", 3)
    q[0], q[1] = packed.upper[0], packed.lower[1]
    size, rng = 6 + len(q), np.random.default_rng(4)
    root, b = rng.normal(size=(size, size)), rng.normal(size=size)
    b[6], b[7] = -1.0, 1.0  # both press against their limits
    A = np.tril(root @ root.T)
    hold_limits(packed, q, A, b)
    whole = A + np.tril(A, -1).T
    damped, step = np.zeros((size, size)), np.empty(size)
    assert damped_step(A, b, 0.5, 0.1, damped, step)
    np.testing.assert_allclose(step, -np.linalg.solve(whole + np.diag(0.5 * np.diag(whole) + 0.1), b), rtol=1e-7)
    assert step[6] == 0.0 and step[7] == 0.0
    X_new, q_new = np.eye(4), np.empty_like(q)
    moved_hand(packed, np.eye(4), q, 10.0 * step, X_new, q_new)
    np.testing.assert_array_equal(q_new, np.clip(q + 10.0 * step[6:], packed.lower, packed.upper))
    np.testing.assert_allclose(X_new[:3, :3] @ X_new[:3, :3].T, np.eye(3), atol=1e-12)


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
