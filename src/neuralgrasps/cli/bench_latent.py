"""`neuralgrasps bench latent`: what the shared latent space costs and yields."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.bench_result import absent_figures, object_origins
from neuralgrasps.cli.terminal import Terminal
from neuralgrasps.errors import InputError, NeuralGraspsError

if TYPE_CHECKING:
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.model.checkpoint import Run
    from neuralgrasps.objects.object_model import ObjectModel

FIGURES = (
    "scene_cpu_s", "train_wall_s", "hand_surface_mean_mm", "hand_surface_p95_mm", "observed_surface_median_mm",
    "observed_wrong_basins", "chamfer_over_oracle", "retrieval_gap", "retrieval_gap_observed", "retrieval_gap_reranked",
    "encode_ms", "infer_ms", "novel_success", "retrieve_1m_ms", "mlp_samples_per_s",
)  # fmt: skip
QUICK_OBJECTS = ("003_cracker_box", "005_tomato_soup_can", "cracker_box", "tomato_soup_can")
SCANS_RUN, STAND_INS_RUN = "ycb7", "standins7"
_NOTES = {
    "field": "all figures belong to the default field (KinematicField), but mlp_samples_per_s, which is of MlpField",
    "scene_cpu_s": "one scene, one process: 40,000 exact signed distances to hand and object, contact map, and the "
    "clouds "
    "that 128 virtual cameras see, all written to disk; scene_samples_cpu_s without the clouds",
    "train_wall_s": "of training alone, once contact maps are there",
    "hand_surface": "unseen grasps, encoded from the known pose and joints: exact by construction, nothing is "
    "inferred; "
    "both ways, all surface points pooled",
    "observed": "unseen grasps found again from at most 1,024 points that one depth camera sees, 3 mm noise along "
    "its rays, "
    "neither noise nor camera told; wrong: mean surface error above 10 mm",
    "chamfer_over_oracle": "published Chamfer of the hands over what a perfect field scores on the same queries, "
    "mean over "
    "the columns of the table; known grasps",
    "retrieval_gap": "Near GT - Near Z, mean over the objects; known grasps, _observed as above; re-ranked by the "
    "contact "
    "maps of the first 20",
    "encode_ms": "wall-clock, one grasp, one thread, contact map included",
    "infer_ms": "processor time, median, one view",
    "novel_success": "sampled codes that hold the object in physics (dexgraspbench) after closing: codes of training "
    "grasps "
    "+ 0.1 standard deviations; novel_success_midpoint: half way to a neighbour; of all sampled",
    "retrieve_1m_ms": "exact L1 search among 1,000,000 jittered copies of real codes, all cores, median over 20 "
    "queries of "
    "the best of 3",
    "mlp_samples_per_s": "whole training steps of the published network, batches of 16 scenes x 1,024 points "
    "(published: 16 x 16,384)",
}


@dataclass(slots=True)
class _Bench:
    """Figures so far, why others are missing, and conditions."""

    figures: dict[str, float] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)

    def measure(self, names: Sequence[str], work: Callable[[], dict[str, float]]) -> None:
        """Add what `work` gives; what it cannot give, because of an error of ours, is absent with the reason."""
        try:
            self.figures |= work()
        except NeuralGraspsError as error:
            self.absent |= dict.fromkeys(names, str(error))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Material:
    """Grasps with their hands and objects, and the run that is evaluated when one was given."""

    hands: dict[str, Hand]
    objects: dict[str, ObjectModel]
    grasps: list[GraspSet]
    run: Run | None
    origin: str


def bench_latent(
    terminal: Terminal,
    *,
    objects: Sequence[str],
    hands: Sequence[str],
    count: int | None,
    seed: int,
    workers: int | None,
    quick: bool,
    run: str | None,
    grasps: Path | None,
) -> dict[str, Any]:
    """Config, figures, notes of the benchmark, and which figures are absent, with the reason.

    `quick`: the shipped run (or `run`), two objects trained anew; else everything is made from `grasps`, or from
    grasps synthesised into that folder (a temporary one when None).
    """
    from neuralgrasps.parallel import available_cpus

    workers = workers or available_cpus()
    bench = _Bench()
    bench.config = {"seed": seed, "workers": workers, "quick": quick}
    with tempfile.TemporaryDirectory(prefix="neuralgrasps-bench-") as temporary:
        folder = Path(temporary)
        material = (
            _from_run(terminal, run, objects, hands)
            if run is not None or quick
            else _from_grasps(terminal, grasps or folder / "grasps", objects, hands, count, seed, workers)
        )
        bench.config |= {
            "origin": material.origin,
            "objects": object_origins(material.objects),
            "hands": list(material.hands),
            "grasps": sum(len(g) for g in material.grasps),
        }
        trained = _cost(terminal, bench, material, folder, seed=seed, workers=workers, whole=not quick and run is None)
        evaluated = material.run or trained
        if evaluated is not None:
            _evaluate(terminal, bench, evaluated, seed=seed, workers=workers, quick=quick)
        _rate(terminal, bench, quick=quick)
    absent = absent_figures(terminal, bench.figures, FIGURES, bench.absent)
    return {"config": bench.config, "figures": bench.figures, "absent": absent, "notes": _NOTES}


def _from_run(terminal: Terminal, name: str | None, objects: Sequence[str], hands: Sequence[str]) -> _Material:
    """The grasps, hands and objects of a run: by name or folder, else a shipped one."""
    from neuralgrasps.cli.evaluate import open_run
    from neuralgrasps.cli.evaluate_run import grasps_of
    from neuralgrasps.model.checkpoint import run_folder
    from neuralgrasps.objects.zoo import object_sources

    sources = object_sources(objects) if objects else ()
    name = name or (SCANS_RUN if sources or _scans_are_here() else STAND_INS_RUN)
    folder = run_folder(name)
    with terminal.progress("reading the run"):
        run = open_run(folder, tuple(hands), tuple(sources))
        sets = grasps_of(run, folder)
        run = replace(run, grasps=sets)
    return _Material(
        hands=run.field.hands, objects=run.field.objects, grasps=[g for g in sets.values() if len(g)], run=run,
        origin=f"run {name}",
    )  # fmt: skip


def _scans_are_here() -> bool:
    """Whether the seven scans were imported or downloaded."""
    from neuralgrasps.objects.zoo import OBJECT_GROUPS, object_names

    return set(OBJECT_GROUPS["ycb7"]) <= set(object_names())


def _from_grasps(
    terminal: Terminal,
    folder: Path,
    objects: Sequence[str],
    hands: Sequence[str],
    count: int | None,
    seed: int,
    workers: int,
) -> _Material:
    """Grasps of a folder, else made into it; a run that was killed goes on where it was."""
    from neuralgrasps.cli.dataset import read_grasp_files
    from neuralgrasps.cli.models import open_hands, open_objects
    from neuralgrasps.dataset.collect import collect_grasps
    from neuralgrasps.hands.zoo import hand_names
    from neuralgrasps.objects.builtin import STAND_INS
    from neuralgrasps.objects.zoo import OBJECT_GROUPS, object_sources
    from neuralgrasps.synthesis.synthesise import SynthesisConfig

    default = OBJECT_GROUPS["ycb7"] if _scans_are_here() else tuple(STAND_INS)
    with terminal.progress("reading hands and objects"):
        loaded, models = (
            open_hands(tuple(hands) or hand_names()),
            open_objects(object_sources(tuple(objects) or default)),
        )
    found = any(folder.rglob("*.safetensors")) if folder.is_dir() else False
    pairs = len(loaded) * len(models)
    if found and len(list(folder.rglob("*.safetensors"))) >= pairs:
        sets = [g for g in read_grasp_files([folder])[0] if g.hand in loaded and g.object in models]
        origin = f"grasps of {folder}"
    else:
        with terminal.progress("synthesis", "pairs") as bar:
            config = SynthesisConfig(count=count or 60)
            sets, _ = collect_grasps(
                folder, list(loaded.values()), list(models.values()), config=config, seed=seed, workers=workers,
                progress=bar,
            )  # fmt: skip
        origin = f"grasps synthesised here, {count or 60} a pair"
    sets = [g for g in sets if len(g)]
    if not sets:
        raise InputError(f"'{folder}' holds no grasps of these hands and objects; expected some of {sorted(models)}.")
    return _Material(hands=loaded, objects=models, grasps=sets, run=None, origin=origin)


def _cost(
    terminal: Terminal, bench: _Bench, material: _Material, folder: Path, *, seed: int, workers: int, whole: bool
) -> Run | None:
    """Data stage and training; the trained run, when it is of all objects or no other is given."""
    import numpy as np

    from neuralgrasps.evaluate.latent_bench import measure_scenes, measure_training, some_objects
    from neuralgrasps.model.checkpoint import Run

    sets = material.grasps if whole else some_objects(material.grasps, QUICK_OBJECTS)
    common: dict[str, Any] = {"hands": material.hands, "objects": material.objects, "seed": seed}
    with terminal.progress("data stage"):
        cost = measure_scenes(folder / "scenes", some_objects(material.grasps, QUICK_OBJECTS), per_pair=4, **common)
    bench.figures |= {"scene_cpu_s": cost.clouds_cpu_s, "scene_samples_cpu_s": cost.samples_cpu_s}
    with terminal.progress("training", "steps") as bar:
        done = measure_training(folder / "dataset", sets, workers=workers, progress=bar, **common)
    bench.figures |= {"train_wall_s": done.wall_s, "train_cpu_s": done.cpu_s}
    bench.config |= {
        "scenes_measured": cost.scenes,
        "trained_on": sorted({g.object for g in sets}),
        "trained_grasps": done.grasps,
        "training_threads": done.threads,
    }
    if material.run is not None:
        return None
    return Run(
        field=done.result.field, codebook=done.result.codebook, losses=np.asarray(done.result.losses), config={},
        grasps={(g.hand, g.object): g for g in sets},
    )  # fmt: skip


def _evaluate(terminal: Terminal, bench: _Bench, run: Run, *, seed: int, workers: int, quick: bool) -> None:
    """Everything that is measured of a run."""
    from neuralgrasps.evaluate.latent_bench import figures_of_scores, measure_search
    from neuralgrasps.evaluate.novel_bench import measure_novel
    from neuralgrasps.evaluate.run_evaluate import evaluate_run
    from neuralgrasps.evaluate.run_pairs import MeasureConfig

    def scores() -> dict[str, float]:
        with terminal.progress("measuring") as bar:
            found = evaluate_run(
                run.field,
                run.codebook,
                run.grasps,
                config=MeasureConfig(seed=seed),
                workers=workers,
                progress=bar.stage,
            )
        bench.config |= {f"evaluated: {name}": text for name, text in found.conditions.items()}
        return figures_of_scores(found)

    def novel(kind: str, name: str) -> dict[str, float]:
        per_pair = 4 if quick else 20
        with terminal.progress(f"novel grasps, {kind}", "pairs") as bar:
            total = measure_novel(
                run.field, run.codebook, kind=kind, per_pair=per_pair, seed=seed, workers=workers, progress=bar
            ).total
        bench.config[f"{name}_codes"] = total.codes
        return {name: total.held_share, f"{name}_force_closure": total.force_closure_share}

    def search() -> dict[str, float]:
        with terminal.progress("searching"):
            cost = measure_search(run.codebook, seed=seed)
        bench.config |= {"index_rows": cost.rows, "index_exact": cost.exact}
        return {"retrieve_1m_ms": cost.median_ms, "retrieve_1m_least_ms": cost.least_ms}

    bench.measure([n for n in FIGURES if n.startswith(("hand", "obs", "chamfer", "retrieval", "enc", "inf"))], scores)
    bench.measure(["novel_success"], lambda: novel("noise", "novel_success"))
    if not quick:
        bench.measure(["novel_success_midpoint"], lambda: novel("midpoint", "novel_success_midpoint"))
    bench.measure(["retrieve_1m_ms"], search)


def _rate(terminal: Terminal, bench: _Bench, *, quick: bool) -> None:
    from neuralgrasps.model.mlp_bench import training_rate
    from neuralgrasps.parallel import available_cpus

    def rate() -> dict[str, float]:
        with terminal.progress("training the published network"):
            found = training_rate(seconds=10.0 if quick else 30.0, threads=available_cpus())
        bench.config |= {"mlp_batch": found.batch, "mlp_threads": found.threads, "mlp_device": found.device}
        return {"mlp_samples_per_s": found.mlp_samples_per_s}

    bench.measure(["mlp_samples_per_s"], rate)
