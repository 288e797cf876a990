"""Weights of the hand networks in files: safetensors, in half precision."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import nn

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.files import write_whole
from neuralgrasps.model.train_state import numpy_arrays, read_tensors
from neuralgrasps.tensor_files import tensor_bytes

ASSETS = Path(__file__).parents[2] / "assets" / "human"
"""Where the weights are that come with the package."""


def save_weights(net: nn.Module, file: str | Path, *, notes: Mapping[str, str] | None = None) -> Path:
    """Write a network's weights; `notes` say how they were made."""
    arrays = {
        name: array.astype(np.float16) if array.dtype == np.float32 else array
        for name, array in numpy_arrays(net.state_dict()).items()
    }
    return write_whole(file, tensor_bytes(arrays, notes))


def read_weights(net: nn.Module, file: str | Path) -> None:
    """Put what `save_weights` wrote into a network of the same kind.

    Raises:
        InputError: no such file.
        DataFormatError: it is damaged or of another network.
    """
    file = Path(file)
    if not file.is_file():
        raise InputError(f"weights '{file}' do not exist; `human train` makes such files.")
    tensors, _ = read_tensors(file)
    try:
        net.load_state_dict({name: value.float() for name, value in tensors.items()})
    except RuntimeError as error:
        raise DataFormatError(f"'{file}' holds no weights of this network: {error}.") from error


def has_bf16() -> bool:
    """Whether this processor computes in bfloat16; where it does not, that is slower than float32."""
    return bool(torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported())
