"""The main job, end to end: objects and hands in, proven grasps, a shared latent space, poses and a page out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack

from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.collect import collect_grasps
from neuralgrasps.dataset.read import read_dataset
from neuralgrasps.demo.compile import load_and_compile
from neuralgrasps.demo.data import DemoConfig, DemoData, DemoResult, demo_figures, summary_lines
from neuralgrasps.demo.demonstration import show_by_hand
from neuralgrasps.demo.execution import lift_objects
from neuralgrasps.demo.latent import measure_latent
from neuralgrasps.demo.measure import measure_grasps, pose_trials
from neuralgrasps.demo.meter import Meter
from neuralgrasps.demo.page import write_page
from neuralgrasps.errors import InputError
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.checkpoint import save_run
from neuralgrasps.model.train import TrainConfig, train
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import object_sources
from neuralgrasps.parallel import available_cpus, beside
from neuralgrasps.synthesis.synthesise import SynthesisConfig

Progress = Callable[[str, int, int, str], None]

STEPS = 400  # of training: a fifth of the default, for a page within minutes


def run_demo(config: DemoConfig | None = None, *, progress: Progress | None = None) -> DemoResult:
    """Run the whole path once and write `report.html`.

    Grasps that an earlier run left in `config.out` are used again when they were made from the same things.

    Args:
        config: what to work on. progress: called with (stage, done, total, text).
    Raises:
        InputError: an unknown or broken hand or object, or an output folder that cannot be written.
    """

    config = config or DemoConfig()
    say = progress or (lambda *_: None)
    workers = config.workers or available_cpus()
    sources = object_sources(config.objects)
    with Meter(lambda stage: say(stage, 0, 0, "")) as meter, ExitStack() as stack:
        with meter.stage("hands and objects"):
            hands = {hand.name: hand for hand in map(load_hand, config.hands)}
            objects = _load_objects(sources, workers, say)
        with meter.stage("grasps"):
            grasp_sets, records = collect_grasps(
                config.out / "grasps", list(hands.values()), list(objects.values()),
                config=SynthesisConfig(count=config.count, batch=2048), seed=config.seed, workers=workers,
                progress=lambda *a: say("grasps", *a),
            )  # fmt: skip
        kept = [g for g in grasp_sets if len(g) >= 2]
        if not kept:
            raise InputError("no grasp was found on any object; " + "; ".join(sorted({r.reason for r in records})))
        # beside the stages that follow, for training and poses leave processors free
        show = beside(show_by_hand, hands, objects, kept, config.seed, workers=workers)
        shown = stack.enter_context(show) if config.demonstration else None
        with meter.stage("data set"):
            build_dataset(
                config.out / "dataset", kept, hands=hands, objects=objects, workers=workers,
                progress=lambda *a: say("data set", *a),
            )  # fmt: skip
            dataset = read_dataset(config.out / "dataset")
        with meter.stage("latent space"):
            trained = train(
                dataset, hands=hands, objects=objects, config=TrainConfig(steps=STEPS), folder=config.out / "run",
                progress=lambda d, t, *_: say("latent space", d, t, ""),
            )  # fmt: skip
            save_run(config.out / "run", trained, grasps=kept)
        with meter.stage("measuring"):
            grasps = measure_grasps(hands, objects, kept, workers=workers)
            latent = measure_latent(
                trained, dataset, seed=config.seed, workers=workers, progress=lambda *a: say("measuring", *a)
            )
        with meter.stage("object poses"):
            poses = pose_trials(
                list(objects.values()), views=config.pose_views, seed=config.seed,
                progress=lambda *a: say("object poses", *a),
            )  # fmt: skip
        with meter.stage("lifting"):
            lifts = lift_objects(
                objects, kept, seed=config.seed, workers=workers, progress=lambda *a: say("lifting", *a)
            )
        demonstration = None
        if shown is not None:
            with meter.stage("demonstration"):
                demonstration = shown()
        data = DemoData(
            config=config, hands=hands, objects=objects, grasp_sets=kept, records=records, grasps=grasps,
            dataset=dataset, trained=trained, latent=latent, poses=poses, lifts=lifts,
            shown=demonstration,
        )  # fmt: skip
        path = write_page(data, meter, workers=workers, progress=lambda *a: say("pictures", *a))
    figures = demo_figures(data, meter.stages)
    return DemoResult(report_path=path, figures=figures, summary=summary_lines(data, figures))


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
