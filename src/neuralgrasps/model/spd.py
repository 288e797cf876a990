"""Small dense symmetric positive definite systems in compiled code, without allocation."""

from __future__ import annotations

import math

from neuralgrasps.compiled import njit


@njit(cache=True, error_model="numpy")
def add_damped(A, damping, least, out):  # type: ignore[no-untyped-def]
    """The lower triangle of A (n, n) with its diagonal raised by the share `damping`, and by `least`, into `out`."""
    for i in range(A.shape[0]):
        for j in range(i):
            out[i, j] = A[i, j]
        out[i, i] = A[i, i] * (1.0 + damping) + least


@njit(cache=True, error_model="numpy")
def solve_spd(A, b, out):  # type: ignore[no-untyped-def]
    """Solve A x = b by Cholesky from the lower triangle of A (n, n), which is overwritten; x into `out` (n,).

    Returns:
        False when A is not positive definite to rounding; `out` is then of no use.
    """
    n = A.shape[0]
    for j in range(n):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        if not s > 1e-300:
            return False
        pivot = math.sqrt(s)
        A[j, j] = pivot
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s / pivot
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= A[i, k] * out[k]
        out[i] = s / A[i, i]
    for i in range(n - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, n):
            s -= A[k, i] * out[k]
        out[i] = s / A[i, i]
    return True
