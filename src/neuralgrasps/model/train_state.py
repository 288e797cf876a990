"""What trainings share: checkpoints in one file (weights, Adam's moments, tensors beside them), and torch's threads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from neuralgrasps.errors import DataFormatError
from neuralgrasps.files import write_whole
from neuralgrasps.tensor_files import tensor_bytes

STATE_FILE = "training.safetensors"


def save_training(
    path: Path,
    model: nn.Module,
    optimiser: torch.optim.Optimizer,
    *,
    tensors: Mapping[str, Tensor],
    notes: Mapping[str, str],
) -> Path:
    """Write a checkpoint.

    Args:
        tensors: what else is needed to go on (random states, losses). notes: texts to recognise the training by.
    """
    everything = {f"model.{name}": value for name, value in model.state_dict().items()}
    for k, values in optimiser.state_dict()["state"].items():
        everything |= {f"adam.{k}.{name}": value for name, value in values.items()}
    everything |= {f"other.{name}": value for name, value in tensors.items()}
    return write_whole(path, tensor_bytes(numpy_arrays(everything), dict(notes)))


def load_training(path: Path, model: nn.Module, optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Put a checkpoint into model and optimiser; the other tensors, on the processor.

    Raises:
        DataFormatError: it is damaged, or of another model.
    """
    tensors, _ = read_tensors(path)
    device = next(model.parameters()).device
    try:
        model.load_state_dict({k.removeprefix("model."): v for k, v in tensors.items() if k.startswith("model.")})
        moments: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, k, part = name.split(".")
                moments.setdefault(int(k), {})[part] = value.to(device)
        optimiser.load_state_dict({"state": moments, "param_groups": optimiser.state_dict()["param_groups"]})
    except (KeyError, ValueError, RuntimeError) as error:
        raise DataFormatError(f"'{path}' lacks an entry: {error}. Train again.") from error
    return {k.removeprefix("other."): v for k, v in tensors.items() if k.startswith("other.")}


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and notes of a checkpoint.

    Raises:
        DataFormatError: it is damaged.
    """
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise DataFormatError(f"'{path}' is damaged: {error}. Delete it or give another folder.") from error


def numpy_arrays(tensors: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    """Tensors as arrays on the processor."""
    return {name: tensor.detach().cpu().contiguous().numpy() for name, tensor in tensors.items()}


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Run torch on so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
