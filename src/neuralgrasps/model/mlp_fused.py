"""The hidden layers of an `MlpDecoder` in bf16 on processors: fused passes between products, memory used again.

Two things make the plain modules slow there: every pass over the activations is a pass over memory, and every fresh
array of that size is mapped page by page. Here a layer is one product and two passes each way, into arrays that stay.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.model.mlp_kernels import (
    activate,
    column_sums,
    first_layer,
    first_layer_gradient,
    gradient_sums,
    normalise_gradient,
)
from neuralgrasps.seeds import child_seed

_pools: dict[int, ThreadPoolExecutor] = {}


def _pool(threads: int) -> ThreadPoolExecutor:
    return _pools.setdefault(threads, ThreadPoolExecutor(threads))


def _shares(count: int, parts: int) -> list[tuple[int, int]]:
    edges = [count * i // parts for i in range(parts + 1)]
    return [(a, b) for a, b in pairwise(edges) if b > a]


def _bits(tensor: Tensor) -> np.ndarray:
    return tensor.view(torch.uint16).numpy()


class TrunkMemory:
    """Arrays of a trunk for `rows` samples, `layers` hidden layers of `width`."""

    def __init__(self, rows: int, layers: int, width: int) -> None:
        def fresh(*shape: int) -> Tensor:
            return torch.zeros(shape, dtype=torch.bfloat16)

        self.rows, self.layers, self.width = rows, layers, width
        self.before = [fresh(rows, width) for _ in range(layers)]
        self.after = [fresh(rows, width) for _ in range(layers)]
        self.gradient = [fresh(rows, width) for _ in range(2)]
        self.weights = [fresh(width, width) for _ in range(layers - 1)]
        self.d_weight = fresh(width, width)

    def fits(self, rows: int, layers: int, width: int) -> bool:
        return (self.rows, self.layers, self.width) == (rows, layers, width)


class TrunkCall:
    """One forward pass of a trunk, and what its backward pass needs.

    Args:
        memory: arrays; a later call with the same memory overwrites this one's.
        training: batch norm by the batch, dropout on; else by the running figures, dropout off.
        seed: of the dropout, with `step`.
    """

    def __init__(
        self, memory: TrunkMemory, *, training: bool, dropout: float, eps: float, seed: int = 0, step: int = 0
    ) -> None:
        self.memory, self.training, self.eps = memory, training, eps
        self.keep = 1.0 - dropout if training else 1.0
        self.threshold = np.uint32(round((1.0 - self.keep) * 2**32))
        self.seeds = [np.uint32(child_seed(seed, "dropout", step, i) & 0xFFFFFFFF) for i in range(memory.layers)]
        self.shares = _shares(memory.rows, torch.get_num_threads())
        self.means: list[np.ndarray] = []
        self.inverse_stds: list[np.ndarray] = []
        self.variances: list[np.ndarray] = []

    def _each(self, kernel: Callable[..., None], *tasks: tuple[Any, ...]) -> None:
        if len(tasks) == 1:
            kernel(*tasks[0])
            return
        list(_pool(len(self.shares)).map(lambda task: kernel(*task), tasks))

    def forward(
        self,
        points: np.ndarray,
        code_part: np.ndarray,
        first_weight: np.ndarray,
        norms: list[tuple[np.ndarray, np.ndarray]],
        running: list[tuple[np.ndarray, np.ndarray]],
    ) -> Tensor:
        """Last activations (rows, width) bf16 from points (rows, 3), code_part (S, width) and first_weight (3, width).

        Args:
            norms: gain and bias per layer; running: mean and variance per layer, used when not training.
        """
        memory = self.memory
        per_scene = memory.rows // len(code_part)
        for i, (gain, bias) in enumerate(norms):
            y, out = memory.before[i], memory.after[i]
            bits, out_bits = _bits(y), _bits(out)
            if i == 0:
                first = (points, code_part, per_scene, first_weight)
                self._each(first_layer, *((*first, a, b, bits) for a, b in self.shares))
            else:
                torch.mm(memory.after[i - 1], memory.weights[i - 1].t(), out=y)
            mean, variance = self._moments(bits) if self.training else running[i]
            inverse = 1.0 / np.sqrt(variance + self.eps)
            self.means.append(mean)
            self.variances.append(variance)
            self.inverse_stds.append(inverse)
            scale = (gain * inverse / self.keep).astype(np.float32)
            shift = ((bias - mean * gain * inverse) / self.keep).astype(np.float32)
            rest = (scale, shift, self.threshold, self.seeds[i], out_bits)
            self._each(activate, *((bits, a, b, *rest) for a, b in self.shares))
        return memory.after[-1]

    def _moments(self, bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sums = np.zeros((2, len(self.shares), bits.shape[1]))
        self._each(column_sums, *((bits, a, b, sums[0, k], sums[1, k]) for k, (a, b) in enumerate(self.shares)))
        mean, square = sums.sum(axis=1) / len(bits)
        return mean, np.maximum(square - mean**2, 0.0)

    def backward(
        self, d_out: Tensor, points: np.ndarray, scenes: int, norms: list[tuple[np.ndarray, np.ndarray]]
    ) -> tuple[Tensor, Tensor, list[Tensor], list[Tensor], list[Tensor]]:
        """Gradients from that of the last activations (overwritten: rows, width, bf16).

        Returns:
            d_code_part (S, width), d_first_weight (3, width), then lists of d_weight, d_gain and d_bias. The last four
            mean something when training only; else they are zero or empty.
        """
        memory, g = self.memory, d_out
        d_weights: list[Tensor] = []
        d_gains: list[Tensor] = []
        d_biases: list[Tensor] = []
        for i in reversed(range(memory.layers)):
            d_gain, d_bias = self._through_norm(i, g, norms[i][0])
            d_gains.insert(0, torch.from_numpy(d_gain.astype(np.float32)))
            d_biases.insert(0, torch.from_numpy(d_bias.astype(np.float32)))
            if i:
                if self.training:
                    torch.mm(g.t(), memory.after[i - 1], out=memory.d_weight)
                    d_weights.insert(0, memory.d_weight.float())
                other = memory.gradient[0] if g is memory.gradient[1] else memory.gradient[1]
                g = torch.mm(g, memory.weights[i - 1], out=other)
        d_code = np.empty((scenes, memory.width), np.float32)
        shares = _shares(scenes, len(self.shares))
        d_first = np.zeros((len(shares), 3, memory.width))
        first = (_bits(g), points, memory.rows // scenes)
        self._each(first_layer_gradient, *((*first, a, b, d_code, d_first[k]) for k, (a, b) in enumerate(shares)))
        d_first_weight = torch.from_numpy(d_first.sum(axis=0).astype(np.float32))
        return torch.from_numpy(d_code), d_first_weight, d_weights, d_gains, d_biases

    def _through_norm(self, i: int, g: Tensor, gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn g from the gradient of a layer's output into that of its product, in place."""
        rows, width = g.shape
        bits, y, out = _bits(g), _bits(self.memory.before[i]), _bits(self.memory.after[i])
        mean, inverse = self.means[i], self.inverse_stds[i]
        zero = np.zeros(width)
        total, weighted = zero, zero
        if self.training:
            sums = np.zeros((2, len(self.shares), width))
            mean_f = mean.astype(np.float32)
            parts = ((bits, out, y, a, b, mean_f, sums[0, k], sums[1, k]) for k, (a, b) in enumerate(self.shares))
            self._each(gradient_sums, *parts)
            total, weighted = sums.sum(axis=1) / self.keep
        # d y = gain / std (d out / keep - mean(d out) - x mean(x d out)), x = (y - mean) / std
        of_g = (gain * inverse / self.keep).astype(np.float32)
        of_y = -gain * inverse**3 * weighted / rows
        constant = -gain * inverse * total / rows - of_y * mean
        rest = (of_g, of_y.astype(np.float32), constant.astype(np.float32))
        self._each(normalise_gradient, *((bits, out, y, a, b, *rest) for a, b in self.shares))
        return inverse * weighted, total


class FusedTrunk(torch.autograd.Function):
    """The hidden layers as one differentiable function of the code part and, when training, of all weights."""

    @staticmethod
    def forward(ctx: Any, call: TrunkCall, running: Any, points: Tensor, code_part: Tensor, *weights: Tensor) -> Tensor:
        """weights: (width, 3) of the points, then width x width ones, then gains, then biases."""
        memory = call.memory
        layers = memory.layers
        first, products = weights[0], weights[1:layers]
        for mine, given in zip(memory.weights, products, strict=True):
            mine.copy_(given)
        gains, biases = weights[layers : 2 * layers], weights[2 * layers :]
        norms = [(a.numpy().astype(float), b.numpy().astype(float)) for a, b in zip(gains, biases, strict=True)]
        points_array = np.ascontiguousarray(points.numpy())
        ctx.call, ctx.norms, ctx.points, ctx.scenes = call, norms, points_array, len(code_part)
        first_weight = np.ascontiguousarray(first.numpy().T)
        return call.forward(points_array, np.ascontiguousarray(code_part.numpy()), first_weight, norms, running)

    @staticmethod
    def backward(ctx: Any, *outputs: Any) -> tuple[Tensor | None, ...]:
        call: TrunkCall = ctx.call
        buffer = call.memory.gradient[0]
        buffer.copy_(outputs[0])
        d_code, d_first, d_weights, d_gains, d_biases = call.backward(buffer, ctx.points, ctx.scenes, ctx.norms)
        if not call.training:
            return (None, None, None, d_code, *([None] * (3 * call.memory.layers)))
        return (None, None, None, d_code, d_first.t(), *d_weights, *d_gains, *d_biases)
