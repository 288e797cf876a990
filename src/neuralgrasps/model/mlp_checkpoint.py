"""Keep the training of an `MlpField`: checkpoints that resume exactly, and dumps that replay a bad step."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from neuralgrasps.errors import DataFormatError
from neuralgrasps.files import write_whole
from neuralgrasps.model.mlp_data import ObjectScenes
from neuralgrasps.model.mlp_field import MlpConfig, MlpDecoder
from neuralgrasps.model.mlp_loss import Batch, LatentModel
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.tensor_files import tensor_bytes

STATE_FILE = "training.safetensors"
_VERSION = "1"


def config_of(values: dict[str, Any]) -> MlpTrainConfig:
    """A training configuration from the JSON form of `dataclasses.asdict`."""
    rest = dict(values)
    decoder = dict(rest.pop("decoder"))
    decoder["skip_layers"] = tuple(decoder["skip_layers"])
    return MlpTrainConfig(**rest, decoder=MlpConfig(**decoder))


def _arrays(tensors: dict[str, Tensor]) -> dict[str, np.ndarray]:
    return {name: tensor.detach().cpu().contiguous().numpy() for name, tensor in tensors.items()}


def _fingerprint(scenes: ObjectScenes) -> str:
    """sha256 over what the scenes are: the order of codes must not change under a checkpoint."""
    digest = hashlib.sha256(json.dumps([scenes.object_name, *scenes.hands]).encode())
    for array in (scenes.hand_index, scenes.grasp_index, scenes.contact_maps):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def save_state(
    folder: Path,
    model: LatentModel,
    optimiser: torch.optim.Optimizer,
    *,
    step: int,
    losses: Tensor,
    scenes: ObjectScenes,
) -> Path:
    """Write weights, codes, Adam's moments, the step and the losses; whole or not at all."""
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    for k, values in optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{k}.{name}": value for name, value in values.items()}
    tensors["losses"] = losses
    metadata = {
        "version": _VERSION,
        "config": json.dumps(asdict(model.config), sort_keys=True),
        "step": str(step),
        "scenes": _fingerprint(scenes),
    }
    return write_whole(folder / STATE_FILE, tensor_bytes(_arrays(tensors), metadata))


def load_state(
    folder: Path, model: LatentModel, optimiser: torch.optim.Optimizer, *, scenes: ObjectScenes
) -> tuple[int, Tensor] | None:
    """Put a checkpoint into model and optimiser.

    Returns:
        step and (step, 4) losses; None when the folder has no checkpoint.
    Raises:
        DataFormatError: it is damaged, or belongs to other scenes or another configuration.
    """
    path = folder / STATE_FILE
    if not path.is_file():
        return None
    tensors, metadata = _read(path)
    device = model.codes.device
    config = json.dumps(asdict(model.config), sort_keys=True)
    for what, stored, given in (
        ("configuration", metadata.get("config"), config),
        ("scenes", metadata.get("scenes"), _fingerprint(scenes)),
    ):
        if stored != given:
            raise DataFormatError(
                f"'{path}' was trained with another {what} than given; resume with the same, or train anew elsewhere."
            )
    try:
        model.load_state_dict({k.removeprefix("model."): v for k, v in tensors.items() if k.startswith("model.")})
        moments: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, k, part = name.split(".")
                moments.setdefault(int(k), {})[part] = value.to(device)
        optimiser.load_state_dict({"state": moments, "param_groups": optimiser.state_dict()["param_groups"]})
        return int(metadata["step"]), tensors["losses"]
    except (KeyError, ValueError, RuntimeError) as error:
        raise DataFormatError(f"'{path}' lacks an entry: {error}. Train again.") from error


def save_dump(folder: Path, model: LatentModel, batch: Batch, *, step: int, rank: int, prior_weight: float) -> Path:
    """Write all that the loss of a step is computed from: weights, codes, the batch, and what seeds its noise."""
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    tensors |= {f"batch.{name}": value for name, value in batch.tensors().items()}
    metadata = {
        "version": _VERSION,
        "config": json.dumps(asdict(model.config), sort_keys=True),
        "step": str(step),
        "rank": str(rank),
        "prior_weight": repr(prior_weight),
        "threads": str(torch.get_num_threads()),
    }
    return write_whole(folder / f"bad_step_{step}_{rank}.safetensors", tensor_bytes(_arrays(tensors), metadata))


def replay_dump(path: str | Path) -> Tensor:
    """Compute the loss of a dumped step again, on the processor: (4,) total, SDF, triplet, norm of the codes.

    Raises:
        DataFormatError: it is not a dump, or damaged.
    """
    path = Path(path)
    tensors, metadata = _read(path)
    try:
        config = config_of(json.loads(metadata["config"]))
        codes = tensors["model.codes"]
        model = LatentModel(MlpDecoder(config.decoder), codes, config).to(codes.dtype)
        model.load_state_dict({k.removeprefix("model."): v for k, v in tensors.items() if k.startswith("model.")})
        batch = Batch(**{k.removeprefix("batch."): v for k, v in tensors.items() if k.startswith("batch.")})
        step, rank, prior = int(metadata["step"]), int(metadata["rank"]), float(metadata["prior_weight"])
    except (KeyError, ValueError, TypeError, RuntimeError) as error:
        raise DataFormatError(f"'{path}' is not a dump of a training step: {error}.") from error
    with torch.random.fork_rng():
        return model.train()(batch, step, rank, prior).stacked()


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118 - no dict
    except (SafetensorError, OSError) as error:
        raise DataFormatError(f"'{path}' is damaged: {error}. Delete it or give another folder.") from error
