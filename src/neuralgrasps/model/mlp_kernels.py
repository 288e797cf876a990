"""Batch norm, ReLU and dropout of bf16 activations in one pass each way, on processors.

Arrays of bf16 are uint16 views (N, C), rows contiguous; sums and arithmetic are float32. A dropout mask is never
stored: an output of exactly zero was dropped or cut off by the ReLU, and passes no gradient either way.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from neuralgrasps.compiled import njit

SUM_ROWS = 256  # rows summed in float32 before they join the float64 sums


@intrinsic
def _float_of_bits(typingctx: Any, bits: Any) -> Any:
    """float32 with the bits of an uint32."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(types.float32))

    return types.float32(types.uint32), codegen


@intrinsic
def _bits_of_float(typingctx: Any, value: Any) -> Any:
    """uint32 with the bits of a float32."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(types.uint32))

    return types.uint32(types.float32), codegen


@njit(cache=True, inline="always")
def _widen(value):  # type: ignore[no-untyped-def]
    return _float_of_bits(np.uint32(np.uint32(value) << np.uint32(16)))  # type: ignore[call-arg]


@njit(cache=True, inline="always")
def _narrow(value):  # type: ignore[no-untyped-def]
    """Nearest bf16, ties to even; finite values and infinities only."""
    bits = _bits_of_float(value)  # type: ignore[call-arg, var-annotated]
    odd = np.uint32((bits >> np.uint32(16)) & np.uint32(1))
    return np.uint16(np.uint32(bits + np.uint32(0x7FFF) + odd) >> np.uint32(16))


@njit(cache=True, inline="always")
def _mixed(counter):  # type: ignore[no-untyped-def]
    """A well spread 32-bit hash of a counter."""
    x = np.uint32(counter ^ (counter >> np.uint32(16)))
    x = np.uint32(x * np.uint32(0x21F0AAAD))
    x = np.uint32(x ^ (x >> np.uint32(15)))
    x = np.uint32(x * np.uint32(0x735A2D97))
    return np.uint32(x ^ (x >> np.uint32(15)))


@njit(cache=True, nogil=True)
def column_sums(y, start, stop, total, squares):  # type: ignore[no-untyped-def]
    """Add to `total` and `squares` (C,) float64 the sums of rows [start, stop) of y and of their squares."""
    columns = y.shape[1]
    a, b = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
    for block in range(start, stop, SUM_ROWS):
        a[:] = np.float32(0.0)
        b[:] = np.float32(0.0)
        for i in range(block, min(block + SUM_ROWS, stop)):
            for c in range(columns):
                v = _widen(y[i, c])
                a[c] += v
                b[c] += v * v
        for c in range(columns):
            total[c] += a[c]
            squares[c] += b[c]


@njit(cache=True, nogil=True)
def activate(y, start, stop, scale, shift, threshold, seed, out):  # type: ignore[no-untyped-def]
    """out = max(y scale + shift, 0) for rows [start, stop), zero with probability threshold / 2^32.

    `scale` and `shift` (C,) float32 hold batch norm, and 1 / (1 - p) of the dropout.
    """
    columns = y.shape[1]
    for i in range(start, stop):
        first = np.uint32(np.uint32(seed) + np.uint32(i * columns))
        for c in range(columns):
            v = _widen(y[i, c]) * scale[c] + shift[c]
            kept = _mixed(np.uint32(first + np.uint32(c))) >= np.uint32(threshold)
            v = v if (v > np.float32(0.0)) & kept else np.float32(0.0)
            out[i, c] = _narrow(v)


@njit(cache=True, nogil=True)
def gradient_sums(g, out, y, start, stop, mean, total, weighted):  # type: ignore[no-untyped-def]
    """Add to `total` and `weighted` (C,) float64 the sums of g and g (y - mean) where out is not zero."""
    columns = y.shape[1]
    a, b = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
    for block in range(start, stop, SUM_ROWS):
        a[:] = np.float32(0.0)
        b[:] = np.float32(0.0)
        for i in range(block, min(block + SUM_ROWS, stop)):
            for c in range(columns):
                v = _widen(g[i, c]) if out[i, c] != np.uint16(0) else np.float32(0.0)
                a[c] += v
                b[c] += v * (_widen(y[i, c]) - mean[c])
        for c in range(columns):
            total[c] += a[c]
            weighted[c] += b[c]


@njit(cache=True, nogil=True)
def normalise_gradient(g, out, y, start, stop, of_g, of_y, constant):  # type: ignore[no-untyped-def]
    """g <- of_g g + of_y y + constant for rows [start, stop), g taken as 0 where out is zero; in place."""
    columns = y.shape[1]
    for i in range(start, stop):
        for c in range(columns):
            v = _widen(g[i, c]) if out[i, c] != np.uint16(0) else np.float32(0.0)
            g[i, c] = _narrow(of_g[c] * v + of_y[c] * _widen(y[i, c]) + constant[c])


@njit(cache=True, nogil=True)
def first_layer(points, code_part, per_scene, weight, start, stop, y):  # type: ignore[no-untyped-def]
    """y[i] = points[i] @ weight + code_part[i // per_scene] for rows [start, stop).

    points (N, 3), code_part (S, C) and weight (3, C) are float32: bf16 would round positions to 0.4 %.
    """
    columns = y.shape[1]
    for i in range(start, stop):
        s = i // per_scene
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        for c in range(columns):
            y[i, c] = _narrow(code_part[s, c] + p0 * weight[0, c] + p1 * weight[1, c] + p2 * weight[2, c])


@njit(cache=True, nogil=True)
def first_layer_gradient(g, points, per_scene, start, stop, d_code, d_weight):  # type: ignore[no-untyped-def]
    """Fill d_code (S, C) for scenes [start, stop) with sums of g over their rows; add g points to d_weight (3, C)."""
    columns = g.shape[1]
    w0, w1, w2 = (np.zeros(columns, np.float32), np.zeros(columns, np.float32), np.zeros(columns, np.float32))
    for s in range(start, stop):
        d_code[s] = np.float32(0.0)
        w0[:] = np.float32(0.0)
        w1[:] = np.float32(0.0)
        w2[:] = np.float32(0.0)
        for i in range(s * per_scene, (s + 1) * per_scene):
            p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
            for c in range(columns):
                v = _widen(g[i, c])
                d_code[s, c] += v
                w0[c] += v * p0
                w1[c] += v * p1
                w2[c] += v * p2
        for c in range(columns):
            d_weight[0, c] += w0[c]
            d_weight[1, c] += w1[c]
            d_weight[2, c] += w2[c]
