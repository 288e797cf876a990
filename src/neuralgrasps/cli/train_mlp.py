"""`neuralgrasps train --field mlp`: the published decoder and free codes of one object."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.models import dataset_hands, source_text, write_sources
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError, unknown_name

if TYPE_CHECKING:
    from neuralgrasps.dataset.read import GraspDataset
    from neuralgrasps.model.mlp_data import ObjectScenes
    from neuralgrasps.model.mlp_schedule import MlpTrainConfig
    from neuralgrasps.model.mlp_train import MlpResult


@dataclass(frozen=True, slots=True, kw_only=True)
class MlpOptions:
    """Options of `train` for this field; see there."""

    object_name: str | None
    preset: str
    minutes: float | None
    epochs: int | None
    resume: bool
    checkpoint_minutes: float
    device: str | None
    seed: int
    threads: int


def train_mlp_field(
    terminal: Terminal, dataset: Path, out: Path, options: MlpOptions, *, hands: tuple[str, ...]
) -> Outcome:
    """Train, infer codes of the unseen grasps, and write the run."""
    from neuralgrasps.dataset.read import read_dataset
    from neuralgrasps.model.mlp_checkpoint import stored_config
    from neuralgrasps.model.mlp_data import object_scenes
    from neuralgrasps.model.mlp_parallel import is_first_worker
    from neuralgrasps.model.mlp_train import train_mlp

    check_writable(out, folder=True)
    data = read_dataset(dataset)
    name = _object_of(data, options.object_name)
    packed = None if data.manifest.config.store_samples else _packed(data, hands)
    with terminal.progress("reading samples"):
        scenes = object_scenes(data, name, packed=packed)
    kept = stored_config(out) if options.resume else None
    config = kept or _config(terminal, options, scenes)
    stop = options.minutes if kept is not None and options.minutes is not None else float("inf")
    terminal.kept = f"Training is kept in '{out}'; the same command goes on from there."
    steps_now = 0
    wall, cpu = time.perf_counter(), time.process_time()
    with terminal.progress("training", "steps") as bar:

        def told(done: int, total: int, loss: float) -> None:
            nonlocal steps_now
            steps_now += 1
            bar(done, total, f"loss {loss:.4f}")

        result = train_mlp(
            scenes, config=config, folder=out, checkpoint_minutes=options.checkpoint_minutes, resume=options.resume,
            minutes=stop, device=options.device, progress=told,
        )  # fmt: skip
    wall_s, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
    share = steps_now / max(len(result.losses), 1)
    figures: dict[str, Any] = {"folder": str(out), "field": "mlp", "object": name, "preset": options.preset}
    figures |= _figures(config, scenes, result, wall_s=wall_s, share=share) | {"wall_s": wall_s, "cpu_s": cpu_s}
    if is_first_worker():
        figures |= _save(terminal, data, out, scenes, result, packed, figures)
        write_sources(out, hands=_sources(dataset, hands, scenes.hands), objects={}, dataset=str(dataset.resolve()))
        terminal.say(f"{counted(len(scenes), 'grasp')} on {name}, {result.samples:.3g} samples: {out}")
        steps = f"{len(result.losses)}, {steps_now} of them now in {wall_s:.1f} s, CPU {cpu_s:.1f} s"
        loss = f"{figures['final_sdf_loss']:.5f} (SDF, object and hand, normalised)"
        terminal.facts([("steps", steps), ("loss, last 50 steps", loss), ("next", f"neuralgrasps evaluate {out}")])
    return Outcome(result=figures)


def _figures(
    config: MlpTrainConfig, scenes: ObjectScenes, result: MlpResult, *, wall_s: float, share: float
) -> dict[str, Any]:
    """What was trained, and how fast; `share` of the steps were done in `wall_s`, others before."""
    return {
        "scenes": len(scenes),
        "epochs": config.epochs,
        "points_per_scene": config.points_per_scene,
        "samples": result.samples,
        "samples_per_s": share * result.samples / wall_s,
        "finished": result.finished,
        "threads": config.threads,
    }


def _object_of(data: GraspDataset, given: str | None) -> str:
    if given is None and len(data.objects) > 1:
        raise InputError(
            f"the dataset has {len(data.objects)} objects and this field knows one; choose with --object: "
            f"{', '.join(data.objects)}."
        )
    name = given or data.objects[0]
    if name not in data.objects:
        raise unknown_name("object", name, data.objects)
    return name


def _packed(data: GraspDataset, hands: tuple[str, ...]):  # type: ignore[no-untyped-def]
    from neuralgrasps.dataset.build import HAND_POINT_SPACING_M
    from neuralgrasps.hands.packed import pack_hand

    return {n: pack_hand(h, spacing=HAND_POINT_SPACING_M) for n, h in dataset_hands(data, hands).items()}


def _config(terminal: Terminal, options: MlpOptions, scenes: ObjectScenes) -> MlpTrainConfig:
    from neuralgrasps.model.mlp_bench import MEASURED, training_rate
    from neuralgrasps.model.mlp_parallel import chosen_device, worker_count
    from neuralgrasps.model.mlp_schedule import PRESETS, shortened

    if options.preset not in PRESETS:
        raise unknown_name("preset", options.preset, PRESETS)
    if options.minutes is not None and options.epochs is not None:
        raise InputError("--minutes and --epochs were both given; give the one that the schedule's length comes from.")
    if options.minutes is not None and not options.minutes > 0.0:
        raise InputError(f"--minutes is {options.minutes}; expected more than 0.")
    if options.minutes is not None and worker_count() > 1:
        raise InputError("--minutes measures the rate of one process; with several, give --epochs.")
    config = replace(PRESETS[options.preset], seed=options.seed, threads=options.threads)
    if options.epochs is not None:
        return replace(config, epochs=options.epochs)
    if options.minutes is None:
        return config
    measured = config
    if chosen_device(options.device).type == "cpu":  # a step of the published batch takes longer than the measurement
        measured = replace(config, step_points=min(config.step_points, MEASURED.step_points))
    with terminal.progress("measuring how fast training is here"):
        rate = training_rate(
            config=measured, scenes=len(scenes), seconds=min(5.0, 6.0 * options.minutes), device=options.device
        )
    return shortened(config, rate.mlp_samples_per_s * 60.0 * options.minutes, len(scenes))


def _save(terminal: Terminal, data, out: Path, scenes: ObjectScenes, result, packed, figures):  # type: ignore[no-untyped-def]
    """Codes of the unseen grasps, then the run; what to report of both."""
    from neuralgrasps.model.codes import join_codes
    from neuralgrasps.model.mlp_data import object_scenes
    from neuralgrasps.model.mlp_run import free_codebook, save_mlp_run

    books, placed = [free_codebook(scenes, result.codes)], None
    name = scenes.object_name
    notes = {k: v for k, v in figures.items() if k not in ("folder", "samples", "finished")}
    if any(len(data.split(hand, name).test) for hand in scenes.hands):
        unseen = object_scenes(data, name, part="test", packed=packed)
        codes, placed, how = _infer(terminal, result, scenes, unseen, data.object(name).points_O)
        books.append(free_codebook(unseen, codes, is_test=True))
        notes |= how
    last = result.losses[-50:].mean(axis=0) if len(result.losses) else [float("nan")] * 4
    grasps = [data.grasps(h, name) for h in scenes.hands]
    save_mlp_run(out, result, join_codes(books), placed=placed, grasps=grasps, notes=notes)
    return {"final_sdf_loss": float(last[1]), "final_triplet_loss": float(last[2])}


def _infer(terminal: Terminal, result, scenes: ObjectScenes, unseen: ObjectScenes, points_O):  # type: ignore[no-untyped-def]
    """Codes of unseen grasps by the published inference, those placed by contact maps too, and how both were found."""
    from neuralgrasps.model.mlp_infer import PLACED, infer_scenes, published_inference
    from neuralgrasps.model.train_state import torch_threads

    how = published_inference(result.field.device)
    codes = []
    with torch_threads(result.config.threads):
        for config, points in ((how, None), (PLACED, points_O)):
            what = "inferring unseen grasps" if points is None else "placing them by contact maps too"
            with terminal.progress(what, "steps") as bar:
                told = lambda done, total, loss: bar(done, total, f"loss {loss:.4f}")  # noqa: E731
                found = infer_scenes(
                    result.field, unseen, known=scenes, known_codes=result.codes, contact_points_O=points,
                    config=config, progress=told,
                )  # fmt: skip
            codes.append(found.codes)
    notes = {
        "test_codes": f"published inference from SDF samples alone: {how.steps} steps from near 0, {how.points:,} "
        "points a step (published: 8,000)",
        "placed_codes": "SDF loss, prior and triplets by the contact maps that the samples show; not published",
    }
    return *codes, notes


def _sources(dataset: Path, given: tuple[str, ...], names: tuple[str, ...]) -> dict[str, str]:
    from neuralgrasps.cli.train import hand_sources

    return {name: source_text(spec) for name, spec in hand_sources(dataset, given, list(names)).items()}
