"""The main job, end to end: objects and hands in, proven grasps, a shared latent space, poses and a page out."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.collect import PairRecord, collect_grasps
from neuralgrasps.dataset.read import GraspDataset, read_dataset
from neuralgrasps.demo.compile import load_and_compile
from neuralgrasps.demo.latent import LatentMeasures, measure_latent
from neuralgrasps.demo.measure import GraspMeasures, PoseTrial, measure_grasps, pose_trials
from neuralgrasps.demo.meter import Meter, Stage
from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.model.checkpoint import save_run
from neuralgrasps.model.train import TrainResult, train
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import available_cpus
from neuralgrasps.synthesis.synthesise import SynthesisConfig

Progress = Callable[[str, int, int, str], None]
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".off")


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoConfig:
    """What `run_demo` works on.

    Attributes:
        objects: names of built-in or imported objects, or paths of mesh files.
        objects_dir: take the meshes of this folder instead of `objects`.
        hands: names or paths; the five built-in hands by default.
        count: validated grasps per hand and object.
        seed: root of every random number.
        workers: processes; all processors when None. No result depends on it.
        out: folder for the page, the grasps, the data set and the fitted field.
        pose_views: depth views per object.
    """

    objects: tuple[str, ...] = ("cracker_box", "tomato_soup_can", "mustard_bottle")
    objects_dir: Path | None = None
    hands: tuple[str, ...] = field(default_factory=hand_names)
    count: int = 24
    seed: int = 0
    workers: int | None = None
    out: Path = Path("out")
    pose_views: int = 10

    def __post_init__(self) -> None:
        if self.count < 6:
            raise InputError(
                f"count is {self.count}; expected at least 6 grasps per pair, to train on some and test on one."
            )
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers is {self.workers}; expected at least 1.")


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoResult:
    """Everything the demo made and measured.

    Attributes:
        report_path: the page. figures: the numbers of `neuralgrasps bench demo`. summary: lines for the terminal.
    """

    report_path: Path
    figures: Mapping[str, float]
    summary: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoData:
    """What the stages hand to the page."""

    config: DemoConfig
    hands: Mapping[str, Hand]
    objects: Mapping[str, ObjectModel]
    grasp_sets: Sequence[GraspSet]
    records: Sequence[PairRecord]
    grasps: GraspMeasures
    dataset: GraspDataset
    trained: TrainResult
    latent: LatentMeasures
    poses: Sequence[PoseTrial]

    def set_of(self, hand: str, object_name: str) -> GraspSet:
        """The grasps of a pair."""
        return next(g for g in self.grasp_sets if g.hand == hand and g.object == object_name)


def run_demo(config: DemoConfig | None = None, *, progress: Progress | None = None) -> DemoResult:
    """Run the whole path once and write `report.html`.

    Grasps that an earlier run left in `config.out` are used again when they were made from the same things.

    Args:
        config: what to work on. progress: called with (stage, done, total, text).
    Raises:
        InputError: an unknown or broken hand or object, or an output folder that cannot be written.
    """
    from neuralgrasps.demo.page import write_page  # noqa: PLC0415 - what draws is slow to import, and drawn last

    config = config or DemoConfig()
    say = progress or (lambda *_: None)
    workers = config.workers or available_cpus()
    with Meter(lambda stage: say(stage, 0, 0, "")) as meter:
        with meter.stage("hands and objects"):
            hands = {hand.name: hand for hand in map(load_hand, config.hands)}
            objects = _load_objects(object_sources(config), workers, say)
        with meter.stage("grasps"):
            grasp_sets, records = collect_grasps(
                config.out / "grasps", list(hands.values()), list(objects.values()),
                config=SynthesisConfig(count=config.count, batch=2048), seed=config.seed, workers=workers,
                progress=lambda *a: say("grasps", *a),
            )  # fmt: skip
        kept = [g for g in grasp_sets if len(g) >= 2]
        if not kept:
            raise InputError("no grasp was found on any object; " + "; ".join(sorted({r.reason for r in records})))
        with meter.stage("data set"):
            build_dataset(
                config.out / "dataset", kept, hands=hands, objects=objects, workers=workers,
                progress=lambda *a: say("data set", *a),
            )  # fmt: skip
            dataset = read_dataset(config.out / "dataset")
        with meter.stage("latent space"), training_threads():
            trained = train(
                dataset, hands=hands, objects=objects, progress=lambda d, t, *_: say("latent space", d, t, "")
            )
            save_run(config.out / "run", trained)
        with meter.stage("measuring"):
            grasps = measure_grasps(hands, objects, kept)
            latent = measure_latent(
                trained, dataset, seed=config.seed, workers=workers, progress=lambda *a: say("measuring", *a)
            )
        with meter.stage("object poses"):
            poses = pose_trials(
                list(objects.values()), views=config.pose_views, seed=config.seed,
                progress=lambda *a: say("object poses", *a),
            )  # fmt: skip
        data = DemoData(
            config=config, hands=hands, objects=objects, grasp_sets=kept, records=records, grasps=grasps,
            dataset=dataset, trained=trained, latent=latent, poses=poses,
        )  # fmt: skip
        path = write_page(data, meter, workers=workers, progress=lambda *a: say("pictures", *a))
    figures = demo_figures(data, meter.stages)
    return DemoResult(report_path=path, figures=figures, summary=summary_lines(data, figures))


@contextmanager
def training_threads(count: int = 2) -> Iterator[None]:
    """Train with the same number of threads on every machine, so that the weights do not depend on it."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def object_sources(config: DemoConfig) -> tuple[str, ...]:
    """Names or paths of the objects to load.

    Raises:
        InputError: `objects_dir` is not a folder or holds no mesh.
    """
    if config.objects_dir is None:
        return config.objects
    folder = Path(config.objects_dir)
    if not folder.is_dir():
        raise InputError(f"'{folder}' is not a folder; --objects takes a folder of mesh files.")
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in MESH_SUFFIXES)
    if not found:
        raise InputError(f"'{folder}' holds no mesh; expected files ending in {', '.join(MESH_SUFFIXES)}.")
    return tuple(map(str, found))


def _load_objects(sources: Sequence[str], workers: int, say: Progress) -> dict[str, ObjectModel]:
    loaded: dict[int, ObjectModel] = {}
    for index, obj in load_and_compile(sources, workers=workers):
        if obj is not None:
            loaded[index] = obj
            say("hands and objects", len(loaded), len(sources), obj.name)
    objects = {loaded[i].name: loaded[i] for i in range(len(sources))}
    if len(objects) < len(sources):
        raise InputError(f"two of the objects have the same name: {', '.join(o.name for o in loaded.values())}.")
    return objects


def demo_figures(data: DemoData, stages: Sequence[Stage]) -> dict[str, float]:
    """The measured numbers, units in the keys."""
    errors = [trial.errors for trial in data.poses]
    return {
        "demo_wall_s": sum(s.wall_s for s in stages),
        "demo_cpu_s": sum(s.cpu_s for s in stages),
        "peak_rss_gb": max(s.peak_rss_bytes for s in stages) / 1e9,
        "grasps_min_per_pair": float(min(r.validated for r in data.records)),
        "grasps_total": float(sum(len(g) for g in data.grasp_sets)),
        "physics_success_before_filter": sum(r.validated for r in data.records) / sum(r.tried for r in data.records),
        "penetration_p95_mm": float(np.percentile(data.grasps.penetration_m, 95) * 1e3),
        "penetration_max_mm": float(data.grasps.penetration_m.max() * 1e3),
        "retrieval_gap": data.latent.gap_observed,
        "retrieval_gap_encoded": data.latent.gap_encoded,
        "hand_surface_mean_mm": data.latent.encoded_error_m.mean() * 1e3,
        "hand_surface_observed_mean_mm": data.latent.observed_error_m.mean() * 1e3,
        "pose_add_s_median_mm": float(np.median([e.add_s_m for e in errors]) * 1e3),
        "pose_rotation_median_deg": float(np.rad2deg(np.median([e.rotation_rad for e in errors]))),
        "pose_wall_median_s": float(np.median([t.wall_s for t in data.poses])),
    }


def summary_lines(data: DemoData, figures: Mapping[str, float]) -> tuple[str, ...]:
    """A few lines for the terminal."""
    short = [r for r in data.records if r.reason]
    lines = [
        f"{figures['grasps_total']:.0f} grasps of {len(data.hands)} hands on {len(data.objects)} objects, "
        f"at least {figures['grasps_min_per_pair']:.0f} per pair, each held in physics",
        f"overlap of hand and object, 95th percentile: {figures['penetration_p95_mm']:.2f} mm",
        f"retrieval: {figures['retrieval_gap_encoded']:.4f} below the best possible from known grasps, "
        f"{figures['retrieval_gap']:.4f} from observed points (published: 0.071)",
        f"object pose from one depth view: {figures['pose_add_s_median_mm']:.2f} mm, "
        f"{figures['pose_rotation_median_deg']:.2f} degrees (median of {len(data.poses)})",
        f"{figures['demo_wall_s']:.0f} s on {data.config.workers or available_cpus()} processes, "
        f"{figures['peak_rss_gb']:.1f} GB, on {platform.machine()}",
    ]
    return (*lines, *(f"{r.hand} on {r.object}: {r.validated} of {r.wanted} grasps: {r.reason}" for r in short))
