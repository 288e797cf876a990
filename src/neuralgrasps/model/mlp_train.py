"""Train an `MlpField`: one decoder and one free code per training scene of one object."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from neuralgrasps.errors import DivergedError
from neuralgrasps.model.mlp_checkpoint import load_state, save_dump, save_state
from neuralgrasps.model.mlp_data import ObjectScenes
from neuralgrasps.model.mlp_field import MlpDecoder, MlpField
from neuralgrasps.model.mlp_loss import Batch, LatentModel, LossParts
from neuralgrasps.model.mlp_parallel import Workers, workers_here
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.train_state import torch_threads
from neuralgrasps.seeds import child_seed

Progress = Callable[[int, int, float], None]
"""Called as progress(steps done, all steps, latest loss)."""

RECALIBRATION_BATCHES, RECALIBRATION_POINTS = 40, 1_024


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpResult:
    """A trained field.

    Attributes:
        field: decodes codes; codes: (S, D) float32, one per training scene.
        losses: (steps, 4) total, SDF, triplet and norm of the codes, by step.
        samples: points seen; config: how; finished: whether the whole schedule was run.
        contact_decay: length of the closeness in the contact maps, normalised units.
    """

    field: MlpField
    codes: np.ndarray
    losses: np.ndarray
    samples: int
    config: MlpTrainConfig
    finished: bool
    contact_decay: float


def train_mlp(
    scenes: ObjectScenes,
    *,
    config: MlpTrainConfig | None = None,
    folder: Path | None = None,
    checkpoint_minutes: float = 5.0,
    resume: bool = False,
    minutes: float = math.inf,
    device: torch.device | str | None = None,
    progress: Progress | None = None,
) -> MlpResult:
    """Train on all scenes given.

    The same scenes, config and threads give the same weights on the same machine, however often training was killed
    and resumed. Under torchrun every process draws batches of its own and gradients are averaged.

    Args:
        folder: gets a checkpoint every `checkpoint_minutes` and at the end, and a dump if the loss turns NaN.
        resume: go on from the checkpoint in `folder`, if there is one.
        minutes: stop, with a checkpoint, after so long.
        device: where to train; a GPU of this process under torchrun if there is one, else the processor, when None.
    Raises:
        DivergedError: the loss became NaN or infinite.
        DataFormatError: the checkpoint is damaged or belongs to another training or number of processes.
        DeviceError: the device is not there.
    """
    config = config or MlpTrainConfig()
    with workers_here(device) as workers, torch_threads(config.threads), workers.own_randomness():
        trainer = MlpTrainer(scenes, config, workers)
        if resume and folder is not None:
            trainer.restore(folder)
        trainer.run(folder, checkpoint_s=60.0 * checkpoint_minutes, stop_s=60.0 * minutes, progress=progress)
        return trainer.result()


def new_model(scenes: int, config: MlpTrainConfig) -> LatentModel:
    """Start weights and codes, on the processor."""
    generator = torch.Generator().manual_seed(child_seed(config.seed, "decoder"))
    decoder = MlpDecoder(config.decoder, generator=generator)
    generator.manual_seed(child_seed(config.seed, "codes"))
    codes = config.code_std * torch.randn(scenes, config.decoder.code_size, generator=generator)
    return LatentModel(decoder, codes, config)


class MlpTrainer:
    """The state of a training: model, optimiser, step. All draws depend on seed, worker and step alone."""

    def __init__(self, scenes: ObjectScenes, config: MlpTrainConfig, workers: Workers) -> None:
        self.scenes, self.config, self.workers = scenes, config, workers
        self.samples = scenes.samples.to(workers.device)
        self.model = new_model(len(scenes), config).to(workers.device)
        maps = torch.as_tensor(scenes.contact_maps, device=workers.device)
        self.map_distances = torch.cdist(maps, maps, compute_mode="donot_use_mm_for_euclid_dist")
        self.optimiser = torch.optim.Adam(
            [
                {"params": list(self.model.decoder.parameters()), "rate": config.net_rate},
                {"params": [self.model.codes], "rate": config.code_rate},
            ],
            fused=True,
        )
        self.generator = torch.Generator(device=workers.device)
        self.per_epoch = max(1, round(config.steps_per_epoch(len(scenes)) / workers.count))
        self.steps = config.epochs * self.per_epoch
        self.step = 0
        self.losses: list[Tensor] = []
        self.parallel: nn.Module = workers.wrapped(self.model)

    @property
    def finished(self) -> bool:
        return self.step >= self.steps

    def batch(self, step: int) -> Batch:
        """The batch of this worker at a step."""
        config, count, rank = self.config, len(self.scenes), self.workers.rank
        taken = config.scenes_of_step(count)
        generator = self.generator.manual_seed(child_seed(config.seed, "epoch", rank, step // self.per_epoch))
        order = torch.randperm(count, generator=generator, device=self.workers.device)
        place = (step % self.per_epoch) * taken + torch.arange(taken, device=self.workers.device)
        scenes = order[place % count]
        generator.manual_seed(child_seed(config.seed, "draw", rank, step))
        places = self.samples.draw(scenes, config.step_points, generator, far_share=config.far_share)
        rows = self.samples.gather(scenes, places)
        anchor = scenes.repeat_interleave(config.triplets_per_anchor)
        shape = (2, len(anchor))
        others = torch.randint(max(count - 1, 1), shape, generator=generator, device=self.workers.device)
        first, second = (others + (others >= anchor)).clamp(max=count - 1)  # never the anchor itself
        return Batch(
            scenes=scenes,
            rows=rows,
            anchor=anchor,
            first=first,
            second=second,
            map_first=self.map_distances[anchor, first],
            map_second=self.map_distances[anchor, second],
        )

    def one_step(self, folder: Path | None = None) -> LossParts:
        """One update of weights and codes.

        Raises:
            DivergedError: the loss is not finite; nothing was updated, and `folder` holds the dump.
        """
        config, count = self.config, len(self.scenes)
        batch = self.batch(self.step)
        # the step of one process at the same share of the schedule
        whole = self.step * config.epochs * config.steps_per_epoch(count) // max(self.steps, 1)
        factor, prior = config.rate_factor(whole, count), config.prior_factor(whole, count)
        self.model.train()
        loss: LossParts = self.parallel(batch, self.step, self.workers.rank, prior)
        if not math.isfinite(float(loss.total.detach())):
            self._stop(batch, prior, folder)
        for group in self.optimiser.param_groups:
            group["lr"] = group["rate"] * factor
        self.optimiser.zero_grad(set_to_none=True)
        loss.total.backward()
        self.optimiser.step()
        self.step += 1
        self.losses.append(loss.stacked())
        return loss

    def _stop(self, batch: Batch, prior: float, folder: Path | None) -> None:
        where = "give a folder to get a dump of the step"
        if folder is not None:
            path = save_dump(folder, self.model, batch, step=self.step, rank=self.workers.rank, prior_weight=prior)
            where = f"replay_dump('{path}') computes it again"
        raise DivergedError(
            f"the loss of step {self.step} is not finite; expected a number. Lower the rates or look for NaN in the "
            f"data; {where}."
        )

    def run(
        self,
        folder: Path | None = None,
        *,
        checkpoint_s: float = 300.0,
        stop_s: float = math.inf,
        progress: Progress | None = None,
    ) -> None:
        """Steps until the schedule ends or the time is up, with checkpoints."""
        started = saved = time.monotonic()
        while not self.finished:
            loss = self.one_step(folder)
            now = time.monotonic()
            if progress is not None:
                progress(self.step, self.steps, float(loss.total.detach()))
            if folder is not None and now - saved >= checkpoint_s:
                self.save(folder)
                saved = now
            if self.workers.any(now - started >= stop_s):
                break
        if folder is not None:
            self.save(folder)

    def save(self, folder: Path) -> None:
        """Write a checkpoint; the first worker alone does."""
        if self.workers.rank == 0:
            losses = torch.stack(self.losses).cpu() if self.losses else torch.zeros(0, 4)
            save_state(
                folder,
                self.model,
                self.optimiser,
                step=self.step,
                losses=losses,
                scenes=self.scenes,
                workers=self.workers.count,
            )

    def restore(self, folder: Path) -> bool:
        """Take up the checkpoint of a folder; False when there is none."""
        state = load_state(folder, self.model, self.optimiser, scenes=self.scenes, workers=self.workers.count)
        if state is None:
            return False
        self.step, losses = state
        self.losses = list(losses)
        return True

    def result(self) -> MlpResult:
        """The field as trained so far. Figures of batch norm are taken anew with dropout off, as the field is used."""
        decoder = self._recalibrated()
        field = MlpField(
            decoder,
            object_name=self.scenes.object_name,
            normalisation=self.scenes.normalisation,
            clamp=self.config.clamp,
        )
        per_step = self.config.scenes_of_step(len(self.scenes)) * self.config.step_points * self.workers.count
        return MlpResult(
            field=field,
            codes=self.model.codes.detach().cpu().numpy().copy(),
            losses=torch.stack(self.losses).cpu().double().numpy() if self.losses else np.zeros((0, 4)),
            samples=self.step * per_step,
            config=self.config,
            finished=self.finished,
            contact_decay=self.scenes.contact_decay,
        )

    def _recalibrated(self) -> MlpDecoder:
        decoder = MlpDecoder(self.config.decoder).to(self.workers.device)
        decoder.load_state_dict(self.model.decoder.state_dict())
        norms = [norm for norm in decoder.norms if isinstance(norm, nn.BatchNorm1d)]
        if norms and self.losses:
            for norm in norms:
                norm.reset_running_stats()
                norm.momentum = None  # plain mean over the batches
            decoder.dropout = 0.0
            decoder.train()
            with torch.no_grad():
                for k in range(RECALIBRATION_BATCHES):
                    batch = self.batch(self.steps + k)
                    every = max(1, self.config.step_points // RECALIBRATION_POINTS)  # some of each kind of point
                    decoder(batch.rows[:, ::every, :3], self.model.codes[batch.scenes])
        return decoder.eval().requires_grad_(False)
