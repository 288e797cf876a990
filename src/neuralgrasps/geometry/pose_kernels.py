"""Rigid transforms inside numba kernels: scalars in, scalars out, or the upper three rows written to an array.

Transforms are (4, 4) or (3, 4) arrays; the last row is never read. Each is tested against `se3_numpy`.
"""

from __future__ import annotations

from neuralgrasps.compiled import njit


@njit(cache=True, inline="always", error_model="numpy")
def moved_point(X, x, y, z):  # type: ignore[no-untyped-def]
    """(x, y, z) of the point X @ (x, y, z)."""
    return (
        X[0, 0] * x + X[0, 1] * y + X[0, 2] * z + X[0, 3],
        X[1, 0] * x + X[1, 1] * y + X[1, 2] * z + X[1, 3],
        X[2, 0] * x + X[2, 1] * y + X[2, 2] * z + X[2, 3],
    )


@njit(cache=True, inline="always", error_model="numpy")
def turned_vector(X, x, y, z):  # type: ignore[no-untyped-def]
    """(x, y, z) of the vector R @ (x, y, z), R the rotation of X."""
    return (
        X[0, 0] * x + X[0, 1] * y + X[0, 2] * z,
        X[1, 0] * x + X[1, 1] * y + X[1, 2] * z,
        X[2, 0] * x + X[2, 1] * y + X[2, 2] * z,
    )


@njit(cache=True, error_model="numpy")
def rigid_product(A, B, out):  # type: ignore[no-untyped-def]
    """out (3, 4) = A @ B."""
    for r in range(3):
        for c in range(4):
            out[r, c] = A[r, 0] * B[0, c] + A[r, 1] * B[1, c] + A[r, 2] * B[2, c]
        out[r, 3] += A[r, 3]


@njit(cache=True, error_model="numpy")
def rigid_inverse(A, out):  # type: ignore[no-untyped-def]
    """out (3, 4) = the inverse of A."""
    for r in range(3):
        for c in range(3):
            out[r, c] = A[c, r]
        out[r, 3] = -(A[0, r] * A[0, 3] + A[1, r] * A[1, 3] + A[2, r] * A[2, 3])
