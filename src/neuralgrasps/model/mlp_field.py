"""`MlpField`: the published decoder of one object, codes to two signed distances, behind the `GraspField` protocol."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import weight_norm

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError, ShapeError, check_shape, unknown_name
from neuralgrasps.model.field import FieldOutput
from neuralgrasps.model.mlp_fused import FusedTrunk, TrunkCall, TrunkMemory


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpConfig:
    """Shape of the decoder. The default is the paper's; `PUBLISHED_SAMPLE` is the configuration its code ships.

    Attributes:
        layers: hidden fully connected layers; width: of each; code_size: numbers of a code.
        norm: batch norm or weight norm of every hidden layer, or none.
        dropout: share of hidden outputs dropped in training.
        skip_layers: hidden layers (first = 0) that see point and code again; the layer before is that much narrower.
    """

    layers: int = 12
    width: int = 512
    code_size: int = 128
    norm: Literal["batch", "weight", "none"] = "batch"
    dropout: float = 0.2
    skip_layers: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.layers < 1 or self.width < 1 or self.code_size < 1:
            raise InputError(f"layers {self.layers}, width {self.width}, code_size {self.code_size}; expected >= 1.")
        if not 0.0 <= self.dropout < 1.0:
            raise InputError(f"dropout is {self.dropout}; expected 0 <= dropout < 1.")
        if self.norm not in ("batch", "weight", "none"):
            raise InputError(f"norm is '{self.norm}'; expected 'batch', 'weight' or 'none'.")
        for layer in self.skip_layers:
            if not 0 < layer < self.layers:
                raise InputError(f"skip layer {layer}; expected 1 to {self.layers - 1}.")
            if self.width <= 3 + self.code_size:
                raise InputError(f"width {self.width} leaves no room for a skip of {3 + self.code_size} numbers.")


PUBLISHED_SAMPLE = MlpConfig(layers=9, code_size=256, norm="weight", skip_layers=(4,))


class MlpDecoder(nn.Module):
    """Points and codes to two distances, all in normalised units, outputs within (-1, 1).

    On processors, hidden layers with batch norm run in bf16 as one fused function while `fast` is set; everywhere else
    as plain operations that follow autocast, but for the first layer: positions are never rounded to bf16.
    """

    def __init__(self, config: MlpConfig | None = None, *, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.config = config = config or MlpConfig()
        given = 3 + config.code_size
        self.hidden = nn.ModuleList()
        self.norms = nn.ModuleList()
        for i in range(config.layers):
            inputs = given if i == 0 else config.width
            outputs = config.width - given if i + 1 in config.skip_layers else config.width
            linear = nn.Linear(inputs, outputs, bias=config.norm != "batch")  # batch norm would cancel a bias
            _fill(linear, generator)
            self.hidden.append(weight_norm(linear) if config.norm == "weight" else linear)
            if config.norm == "batch":
                self.norms.append(nn.BatchNorm1d(outputs))
        self.last = nn.Linear(config.width, 2)
        _fill(self.last, generator)
        with torch.no_grad():
            self.last.weight.mul_(0.1)  # outputs start near 0, inside the clamp: outside it tanh may never come back
            self.last.bias.zero_()
        self.dropout = config.dropout
        self.fast = False
        self.dropout_seed = 0
        self.dropout_step = 0
        self._memory: TrunkMemory | None = None

    def forward(self, points: Tensor, codes: Tensor) -> Tensor:
        """(N, M, 2) distances to object and hand of points (N, M, 3) for codes (N, D)."""
        check_shape("points", tuple(points.shape), (len(codes), None, 3))
        check_shape("codes", tuple(codes.shape), (self.config.code_size,))
        fused = self.fast and points.device.type == "cpu" and self.config.norm == "batch" and not points.requires_grad
        hidden = self._fused(points, codes) if fused and not self.config.skip_layers else self._plain(points, codes)
        with torch.autocast(points.device.type, enabled=False):
            out = functional.linear(hidden.to(points.dtype), self.last.weight, self.last.bias)
        return torch.tanh(out).reshape(*points.shape[:2], 2)

    def _layers(self) -> list[nn.Linear]:
        return [layer for layer in self.hidden if isinstance(layer, nn.Linear)]

    def _plain(self, points: Tensor, codes: Tensor) -> Tensor:
        config = self.config
        layers = self._layers()
        x = self._given(layers[0].weight, layers[0].bias, points, codes)
        for i, linear in enumerate(layers):
            if i in config.skip_layers:
                inside = x.shape[1]
                skipped = self._given(linear.weight[:, inside:], None, points, codes)
                x = functional.linear(x, linear.weight[:, :inside], linear.bias) + skipped
            elif i:
                x = linear(x)
            if config.norm == "batch":
                x = self.norms[i](x)
            x = functional.dropout(functional.relu(x), self.dropout, self.training)
        return x

    @staticmethod
    def _given(weight: Tensor, bias: Tensor | None, points: Tensor, codes: Tensor) -> Tensor:
        """The product of a layer with (point, code), the code's part computed once per scene, never in bf16."""
        with torch.autocast(points.device.type, enabled=False):
            per_scene = functional.linear(codes, weight[:, 3:], bias)
            both = functional.linear(points, weight[:, :3]) + per_scene[:, None]
        return both.flatten(0, 1)

    def _fused(self, points: Tensor, codes: Tensor) -> Tensor:
        config = self.config
        rows = points.shape[0] * points.shape[1]
        if self._memory is None or not self._memory.fits(rows, config.layers, config.width):
            self._memory = TrunkMemory(rows, config.layers, config.width)
        norms = [norm for norm in self.norms if isinstance(norm, nn.BatchNorm1d)]
        call = TrunkCall(
            self._memory,
            training=self.training,
            dropout=self.dropout,
            eps=norms[0].eps,
            seed=self.dropout_seed,
            step=self.dropout_step,
        )
        running = [(n.running_mean.double().numpy(), n.running_var.double().numpy()) for n in norms]  # type: ignore[union-attr]
        first, *others = (layer.weight for layer in self._layers())
        weights = [first[:, :3], *others]
        with torch.autocast("cpu", enabled=False):
            code_part = functional.linear(codes, first[:, 3:])
        gains, biases = [n.weight for n in norms], [n.bias for n in norms]
        out = FusedTrunk.apply(call, running, points.reshape(-1, 3), code_part, *weights, *gains, *biases)
        if self.training:
            _update_running(norms, call, rows)
        return out


def _fill(linear: nn.Linear, generator: torch.Generator | None) -> None:
    """Uniform start weights within 1 / sqrt(inputs), from a generator of our own."""
    bound = linear.in_features**-0.5
    with torch.no_grad():
        for tensor in (linear.weight, linear.bias):
            if tensor is not None:
                tensor.uniform_(-bound, bound, generator=generator)


def _update_running(norms: list[nn.BatchNorm1d], call: TrunkCall, rows: int) -> None:
    for norm, mean, variance in zip(norms, call.means, call.variances, strict=True):
        assert norm.num_batches_tracked is not None and norm.running_mean is not None and norm.running_var is not None
        norm.num_batches_tracked += 1
        share = 1.0 / float(norm.num_batches_tracked) if norm.momentum is None else norm.momentum
        unbiased = variance * (rows / max(rows - 1, 1))
        norm.running_mean.lerp_(torch.as_tensor(mean, dtype=norm.running_mean.dtype), share)
        norm.running_var.lerp_(torch.as_tensor(unbiased, dtype=norm.running_var.dtype), share)


class MlpField:
    """A trained decoder of one object as a `GraspField`: metres in, metres out, dropout always off.

    Attributes:
        decoder: in normalised units. object_name: the object it knows. clamp_m: distances beyond it were not learned.
        fast: on processors, products in bf16: several times as fast, distances off by about 0.1 % of the clamp.
    """

    def __init__(
        self, decoder: MlpDecoder, *, object_name: str, normalisation: Normalisation, clamp: float = 0.05
    ) -> None:
        self.decoder = decoder.eval()
        self.object_name = object_name
        self.clamp = clamp
        self.fast = False
        self._normalisation = normalisation

    @property
    def clamp_m(self) -> float:
        return self.clamp * self._normalisation.scale_m

    @property
    def normalisation(self) -> Normalisation:
        """The frame that the decoder works in."""
        return self._normalisation

    @property
    def device(self) -> torch.device:
        return self.decoder.last.weight.device

    def __call__(self, points_O: Tensor, codes: Tensor, *, hand: str = "", object_name: str = "") -> FieldOutput:
        """Distances at points (M, 3) or (N, M, 3) for codes (N, D); `hand` is not needed, the code says it.

        Raises:
            UnknownNameError: another object than the field's; ShapeError: points or codes of a wrong shape.
        """
        if object_name and object_name != self.object_name:
            raise unknown_name("object", object_name, [self.object_name])
        if codes.ndim != 2 or codes.shape[1] != self.decoder.config.code_size:
            raise ShapeError(f"codes have shape {tuple(codes.shape)}; expected (N, {self.decoder.config.code_size}).")
        points = points_O if points_O.ndim == 3 else points_O.expand(len(codes), *points_O.shape)
        self.decoder.eval()
        self.decoder.fast = self.fast
        frame = self._normalisation
        offset = torch.as_tensor(frame.offset_O, dtype=points.dtype, device=points.device)
        unit = ((points - offset) / frame.scale_m).to(self.decoder.last.weight.dtype)
        out = self.decoder(unit, codes.to(unit.dtype)) * frame.scale_m
        return FieldOutput(sdf_object=out[..., 0], sdf_hand=out[..., 1])

    def distance(
        self, code: np.ndarray, shape: Literal["object", "hand"], *, batch: int = 16_384
    ) -> Callable[[np.ndarray], np.ndarray]:
        """The signed distance to one shape of a code (D,), as a function of points (M, 3) -> (M,), metres."""
        which = 0 if shape == "object" else 1
        both = self.distances(code, batch=batch)
        return lambda points_O: both(points_O)[which]

    def distances(self, code: np.ndarray, *, batch: int = 16_384) -> Callable[[np.ndarray], np.ndarray]:
        """The signed distances to object and hand of a code (D,), as a function of points (M, 3) -> (2, M), metres."""
        z = torch.as_tensor(np.asarray(code, np.float32), device=self.device)[None]

        def both(points_O: np.ndarray) -> np.ndarray:
            parts = []
            with torch.no_grad():
                for part in torch.as_tensor(np.asarray(points_O, np.float32), device=self.device).split(batch):
                    out = self(part, z)
                    parts.append(torch.stack([out.sdf_object[0], out.sdf_hand[0]]).cpu().numpy())
            return np.concatenate(parts, axis=1)

        return both
