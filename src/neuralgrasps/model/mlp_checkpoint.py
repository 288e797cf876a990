"""Keep the training of an `MlpField`: checkpoints that resume exactly, and dumps that replay a bad step."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.errors import DataFormatError
from neuralgrasps.files import write_whole
from neuralgrasps.model.mlp_data import ObjectScenes
from neuralgrasps.model.mlp_field import MlpConfig, MlpDecoder
from neuralgrasps.model.mlp_loss import Batch, LatentModel
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.train_state import STATE_FILE, load_training, numpy_arrays, read_tensors, save_training
from neuralgrasps.tensor_files import tensor_bytes

_VERSION = "1"


def config_of(values: dict[str, Any]) -> MlpTrainConfig:
    """A training configuration from the JSON form of `dataclasses.asdict`."""
    rest = dict(values)
    decoder = dict(rest.pop("decoder"))
    decoder["skip_layers"] = tuple(decoder["skip_layers"])
    return MlpTrainConfig(**rest, decoder=MlpConfig(**decoder))


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
    workers: int,
) -> Path:
    """Write weights, codes, Adam's moments, the step and the losses; whole or not at all.

    Args:
        workers: processes that train together; steps, draws and schedule depend on it.
    """
    notes = {
        "version": _VERSION,
        "config": json.dumps(asdict(model.config), sort_keys=True),
        "step": str(step),
        "scenes": _fingerprint(scenes),
        "workers": str(workers),
    }
    return save_training(folder / STATE_FILE, model, optimiser, tensors={"losses": losses}, notes=notes)


def load_state(
    folder: Path, model: LatentModel, optimiser: torch.optim.Optimizer, *, scenes: ObjectScenes, workers: int
) -> tuple[int, Tensor] | None:
    """Put a checkpoint into model and optimiser.

    Returns:
        step and (step, 4) losses; None when the folder has no checkpoint.
    Raises:
        DataFormatError: it is damaged, or belongs to other scenes, another configuration or number of processes.
    """
    path = folder / STATE_FILE
    if not path.is_file():
        return None
    notes = read_tensors(path)[1]
    config = json.dumps(asdict(model.config), sort_keys=True)
    for what, stored, given in (
        ("configuration", notes.get("config"), config),
        ("scenes", notes.get("scenes"), _fingerprint(scenes)),
    ):
        if stored != given:
            raise DataFormatError(
                f"'{path}' was trained with another {what} than given; resume with the same, or train anew elsewhere."
            )
    if notes.get("workers") != str(workers):
        raise DataFormatError(
            f"'{path}' was trained by {notes.get('workers', 'an unknown number of')} processes together, now there are "
            f"{workers}: steps, draws and rates would be others. Resume with as many, or train anew elsewhere."
        )
    losses = load_training(path, model, optimiser)["losses"]
    return int(notes["step"]), losses


def stored_config(folder: Path) -> MlpTrainConfig | None:
    """The configuration of the training whose checkpoint a folder has; None when it has none.

    Raises:
        DataFormatError: the checkpoint is damaged, or of a training of another field.
    """
    path = folder / STATE_FILE
    if not path.is_file():
        return None
    try:
        return config_of(json.loads(read_tensors(path)[1]["config"]))
    except (KeyError, TypeError, ValueError) as error:
        raise DataFormatError(
            f"'{path}' is not the checkpoint of an MLP field's training; give another folder."
        ) from error


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
    return write_whole(folder / f"bad_step_{step}_{rank}.safetensors", tensor_bytes(numpy_arrays(tensors), metadata))


def replay_dump(path: str | Path) -> Tensor:
    """Compute the loss of a dumped step again, on the processor: (4,) total, SDF, triplet, norm of the codes.

    Raises:
        DataFormatError: it is not a dump, or damaged.
    """
    path = Path(path)
    tensors, metadata = read_tensors(path)
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
