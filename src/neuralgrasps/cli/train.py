"""`neuralgrasps train`: fit the latent space to a dataset."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from neuralgrasps.cli.models import dataset_hands, dataset_objects, source_text, write_sources
from neuralgrasps.cli.options import (
    Folder,
    Names,
    OptionalFloat,
    OptionalInt,
    OptionalText,
    PositionalFolder,
    check_seed,
)
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError


def train(
    terminal: Terminal,
    dataset: PositionalFolder,
    /,
    *,
    out: Folder = Path("run"),
    steps: int = 2000,
    batch: int = 64,
    learning_rate: float = 3e-3,
    seed: int = 0,
    threads: int = 2,
    compact: bool = False,
    hands: Names = (),
    field: Literal["kinematic", "mlp"] = "kinematic",
    object_: Annotated[OptionalText, tyro.conf.arg(name="object")] = None,
    preset: Literal["paper", "paper-fast", "paper-fast-codes"] = "paper-fast",
    minutes: OptionalFloat = None,
    epochs: OptionalInt = None,
    resume: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: go on from it)")] = True,
    checkpoint_minutes: float = 5.0,
    device: OptionalText = None,
) -> Outcome:
    """Fit the latent space that all hands of a dataset share.

    Training that was stopped goes on where it was, to the same weights. The default field knows all objects and poses
    exact hands; `--field mlp` is the published network, for one object. Under torchrun it trains on several GPUs.

    Args:
        dataset: folder that `dataset build` wrote.
        out: folder for the run: weights, codes of all grasps, configuration.
        steps: gradient steps.
        batch: grasps of every hand per step.
        learning_rate: peak of its schedule.
        seed: of weights, batches and noise.
        threads: of the training; with another number the weights differ in their last digits.
        compact: store contact maps to 1/255, for a run a quarter of the size.
        hands: files of hands that are not built in and have moved since the dataset was built.
        field: kinematic: one model of all objects; mlp: the published network and free codes of one object.
        object_: of the MLP field: the object to train on.
        preset: of the MLP field: the paper's schedule (1e10 samples), or one with a tenth of it or less, for
            shapes or for codes that retrieve well.
        minutes: of the MLP field: squeeze the schedule into so long; training that goes on stops after so long.
        epochs: of the MLP field: length of the schedule, 20,000 points per grasp each.
        resume: of the MLP field: start anew, even where `out` holds a checkpoint.
        checkpoint_minutes: of the MLP field: between checkpoints.
        device: of the MLP field: cpu or cuda; a GPU if there is one when not given.
    """
    check_seed(seed)
    if field == "mlp":
        from neuralgrasps.cli.train_mlp import MlpOptions, train_mlp_field

        options = MlpOptions(
            object_name=object_, preset=preset, minutes=minutes, epochs=epochs, resume=resume,
            checkpoint_minutes=checkpoint_minutes, device=device, seed=seed, threads=threads,
        )  # fmt: skip
        return train_mlp_field(terminal, dataset, out, options, hands=hands)
    _check_options(steps, learning_rate, mlp_only=(object_, minutes, epochs, device))
    from neuralgrasps.dataset.read import read_dataset
    from neuralgrasps.model.checkpoint import save_run
    from neuralgrasps.model.train import TrainConfig
    from neuralgrasps.model.train import train as fit

    check_writable(out, folder=True)
    config = TrainConfig(steps=steps, batch=batch, learning_rate=learning_rate, seed=seed, threads=threads)
    data = read_dataset(dataset)
    with terminal.progress("reading hands and objects"):
        models, objects = dataset_hands(data, hands), dataset_objects(data)
    terminal.kept = f"Training is kept in '{out}'; the same command goes on from there."
    wall, cpu = time.perf_counter(), time.process_time()
    with terminal.progress("training", "steps") as bar:
        result = fit(
            data, hands=models, objects=objects, config=config, folder=out,
            progress=lambda done, total, loss: bar(done, total, f"loss {loss:.4f}"),
        )  # fmt: skip
    wall_s, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
    save_run(out, result, grasps=[data.grasps(*pair) for pair in data.pairs], compact_maps=compact)
    sources = {name: source_text(spec) for name, spec in hand_sources(dataset, hands, list(models)).items()}
    write_sources(out, hands=sources, objects={}, dataset=str(dataset.resolve()))
    last = float(result.losses[-50:].mean()) if len(result.losses) else float("nan")
    whose = f"{counted(len(models), 'hand')} on {counted(len(objects), 'object')}"
    terminal.say(f"{counted(len(result.codebook), 'grasp')} of {whose}: {out}")
    terminal.facts(
        [
            ("steps", f"{steps} in {wall_s:.1f} s, CPU {cpu_s:.1f} s"),
            ("loss, last 50 steps", f"{last:.4f} m per code unit"),
            ("next", f"neuralgrasps evaluate {out}"),
        ]
    )
    result_figures = {"folder": str(out), "steps": steps, "seed": seed, "grasps": len(result.codebook)}
    result_figures |= {"hands": list(models), "objects": list(objects), "wall_s": wall_s, "cpu_s": cpu_s}
    return Outcome(result={**result_figures, "final_loss_m_per_code_unit": last})


def _check_options(steps: int, learning_rate: float, *, mlp_only: Sequence[object]) -> None:
    """Refuse options of the default field without sense, and those of the other."""
    if any(option is not None for option in mlp_only):
        raise InputError(
            "--object, --minutes, --epochs and --device belong to --field mlp; the default field has none."
        )
    if steps < 1:
        raise InputError(f"--steps is {steps}; expected at least 1.")
    if not 0.0 < learning_rate <= 1.0:
        raise InputError(f"--learning-rate is {learning_rate:g}; expected above 0, at most 1; 0.003 suits most data.")


def hand_sources(dataset: Path, given: tuple[str, ...], names: list[str]) -> dict[str, str]:
    """Name or file of each hand, as given now or recorded with the dataset."""
    from neuralgrasps.cli.models import open_hands, read_sources

    recorded = read_sources(dataset).get("hands", {})
    own = dict(zip(open_hands(given), given, strict=True))
    known: dict[str, str] = {**(recorded if isinstance(recorded, dict) else {}), **own}
    return {name: known.get(name, name) for name in names}
