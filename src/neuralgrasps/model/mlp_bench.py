"""How many samples per second an `MlpField` is trained on, on made-up scenes."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import torch

from neuralgrasps.dataset.samples import Normalisation, SdfSamples
from neuralgrasps.model.mlp_data import ObjectScenes, scene_samples
from neuralgrasps.model.mlp_parallel import workers_here
from neuralgrasps.model.mlp_schedule import PAPER, MlpTrainConfig
from neuralgrasps.model.mlp_train import MlpTrainer
from neuralgrasps.model.train_state import torch_threads

WARM_UP_STEPS = 2
MEASURED = replace(PAPER, step_points=1_024)
"""The published network in a batch of 16 x 1,024, which processors do in a second; published: 16 x 16,384."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingRate:
    """Points that training sees per second of wall time and of processor time, and on what."""

    mlp_samples_per_s: float
    per_cpu_s: float
    batch: int
    steps: int
    threads: int
    device: str


def made_up_scenes(count: int = 16, points: int = 4_096, *, seed: int = 0) -> ObjectScenes:
    """Scenes of a ball and of a second one beside it, the "hand", in another place in each."""
    rng = np.random.default_rng(seed)
    points_O = rng.uniform(-0.1, 0.1, (count, points, 3)).astype(np.float32)
    centres = rng.normal(size=(count, 1, 3))
    centres *= 0.06 / np.linalg.norm(centres, axis=2, keepdims=True)
    samples = SdfSamples(
        points_O=points_O,
        sdf_object=(np.linalg.norm(points_O, axis=2) - 0.04).astype(np.float32),
        sdf_hand=(np.linalg.norm(points_O - centres, axis=2) - 0.03).astype(np.float32),
        hand_index=np.zeros(count, np.int32),
    )
    frame = Normalisation(offset_O=np.zeros(3), scale_m=0.12)
    surface = rng.normal(size=(64, 3))
    surface *= 0.04 / np.linalg.norm(surface, axis=1, keepdims=True)
    near = np.maximum(np.linalg.norm(surface - centres, axis=2) - 0.03, 0.0)
    return ObjectScenes(
        object_name="ball",
        normalisation=frame,
        samples=scene_samples([samples], frame),
        contact_maps=np.exp(-near / 0.006).astype(np.float32),
        contact_decay=0.05,
        hands=("ball",),
        hand_index=np.zeros(count, np.int32),
        grasp_index=np.arange(count, dtype=np.int32),
    )


def training_rate(
    *,
    config: MlpTrainConfig = MEASURED,
    scenes: int = 16,
    seconds: float = 10.0,
    threads: int | None = None,
    device: torch.device | str | None = None,
) -> TrainingRate:
    """Whole training steps (draw, loss, gradients, update) for about so many seconds, after two to warm up.

    Args:
        scenes: how many there are to train on.
        threads: of torch on processors; the config's when None.
    """
    config = replace(config, threads=threads or config.threads)
    with workers_here(device) as workers, torch_threads(config.threads), workers.own_randomness():
        trainer = MlpTrainer(made_up_scenes(scenes), config, workers)
        for _ in range(WARM_UP_STEPS):
            trainer.one_step()
        wall, cpu, steps = time.perf_counter(), time.process_time(), 0
        while time.perf_counter() - wall < seconds:
            trainer.one_step()  # reads the loss, so that a GPU has finished
            steps += 1
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        batch = config.scenes_of_step(len(trainer.scenes)) * config.step_points
        return TrainingRate(
            mlp_samples_per_s=steps * batch / wall,
            per_cpu_s=steps * batch / cpu,
            batch=batch,
            steps=steps,
            threads=config.threads,
            device=str(workers.device),
        )
