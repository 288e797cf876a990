"""`neuralgrasps human train`: the networks that find hands and their joints in depth images."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from neuralgrasps.cli.options import File, OptionalFile, OptionalInt, check_seed
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.human.scenes.grasp_bank import GraspBank

_BANK_SOLIDS, _BANK_PROPOSALS = 132, 640
_TEST_IMAGES, _TEST_SEED = 1500, 777
Net = Annotated[
    Literal["detector", "side", "joints"], tyro.conf.Positional, tyro.conf.arg(metavar="detector|side|joints")
]


def human_train(
    terminal: Terminal,
    net: Net,
    /,
    *,
    out: File,
    images: OptionalInt = None,
    seed: int = 0,
    threads: int = 2,
    start: OptionalFile = None,
    bank: OptionalFile = None,
) -> Outcome:
    """Train a network on depth images of random hands, drawn meanwhile.

    Training of the detector and of the joints that was stopped goes on where it was, from a file beside `out`. How the
    shipped weights were made, README.md beside them says.

    Args:
        net: detector: boxes of hands in a whole frame; side: whether the hand in a box is a right one; joints: its 21
            joints and mask.
        out: file for the weights, such as detector.safetensors.
        images: to learn from; the default is what the shipped weights saw.
        seed: of the start weights and of the images.
        threads: of the training, drawing included.
        start: weights to start from: of a detector, for it; of the joints, for them and for side (there the shipped
            ones by default).
        bank: file of hands closed on random solids, to draw; made first (3 minutes) where it does not exist, beside
            `out` when not given.
    """
    _check(images, seed, threads)
    check_writable(out)
    make_parent(out)
    state = out.with_suffix(".training")
    if net != "side":
        terminal.kept = f"Training is kept in '{state}'; the same command goes on from there."
    hands = _bank(terminal, bank or out.with_name("hands.bank"))
    plan = _Plan(bank=hands, out=out, state=state, images=images, seed=seed, threads=threads, start=start)
    wall, cpu = time.perf_counter(), time.process_time()
    figures = {"detector": _train_detector, "side": _train_side, "joints": _train_joints}[net](terminal, plan)
    spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    terminal.say(f"Weights of the {net} network: {out}")
    terminal.facts([(name.replace("_", " "), f"{value:.4g}") for name, value in figures.items()])
    return Outcome(result={"net": net, "file": str(out), "seed": seed, **figures, **spent})


def _check(images: int | None, seed: int, threads: int) -> None:
    check_seed(seed)
    if images is not None and images < 1:
        raise InputError(f"--images is {images}; expected at least 1.")
    if threads < 1:
        raise InputError(f"--threads is {threads}; expected at least 1.")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """What to train with; see `human_train`."""

    bank: GraspBank
    out: Path
    state: Path
    images: int | None
    seed: int
    threads: int
    start: Path | None

    @property
    def length(self) -> dict[str, int]:
        """The option `images` of a training, where one was given."""
        return {} if self.images is None else {"images": self.images}


def _bank(terminal: Terminal, file: Path) -> GraspBank:
    """The bank of a file, made and kept there when it is not there yet."""
    from neuralgrasps.human.scenes.grasp_bank import load_bank, make_grasp_bank, save_bank, training_solids

    if not file.exists():
        with terminal.progress("closing hands on solids"):
            save_bank(make_grasp_bank(training_solids(_BANK_SOLIDS), proposals=_BANK_PROPOSALS), file)
    return load_bank(file)


def _train_detector(terminal: Terminal, plan: _Plan) -> dict[str, float]:
    """Train, write, and measure on images that were not seen."""
    from neuralgrasps.human.nets.detect import HandDetector
    from neuralgrasps.human.nets.detector_figures import detector_figures
    from neuralgrasps.human.nets.detector_images import ImageMaker
    from neuralgrasps.human.nets.detector_net import DetectorNet
    from neuralgrasps.human.nets.detector_train import DetectorTrainConfig, train_detector
    from neuralgrasps.human.nets.net_files import read_weights, save_weights

    start = None
    if plan.start is not None:
        start = DetectorNet()
        read_weights(start, plan.start)
    config = DetectorTrainConfig(**plan.length, seed=plan.seed, threads=max(plan.threads - 1, 1))
    with terminal.progress("training", "steps") as bar:
        trained = train_detector(
            plan.bank, config=config, start=start, state=plan.state,
            progress=lambda done, total, loss: bar(done, total, f"loss {loss:.3f}"),
        )  # fmt: skip
    save_weights(trained, plan.out, notes={"images": str(config.images), "seed": str(plan.seed)})
    with terminal.progress("testing"):
        test = ImageMaker(plan.bank).draw(_TEST_SEED, 0, _TEST_IMAGES)
        return asdict(detector_figures(HandDetector(trained), test))


def _train_side(terminal: Terminal, plan: _Plan) -> dict[str, float]:
    from neuralgrasps.human.nets.joint_net import JointNet
    from neuralgrasps.human.nets.joint_reader import WEIGHTS
    from neuralgrasps.human.nets.net_files import read_weights, save_weights
    from neuralgrasps.human.nets.side_train import side_accuracy, side_crops, train_side
    from neuralgrasps.human.scenes.kit import scene_kit

    kit, joints = scene_kit(plan.bank), JointNet()
    read_weights(joints, plan.start or WEIGHTS)
    with terminal.progress("training", "crops") as bar:
        trained = train_side(
            kit, joints, **plan.length, seed=plan.seed,
            progress=lambda done, total, loss: bar(done, total, f"loss {loss:.3f}"),
        )  # fmt: skip
    save_weights(trained, plan.out, notes={"seed": str(plan.seed)})
    return asdict(side_accuracy(trained, side_crops(kit, _TEST_IMAGES, _TEST_SEED)))


def _train_joints(terminal: Terminal, plan: _Plan) -> dict[str, float]:
    from neuralgrasps.human.nets.joint_net import JointNet
    from neuralgrasps.human.nets.joint_train import FINE_RATE, JointTrainConfig, train_joints
    from neuralgrasps.human.nets.net_files import read_weights, save_weights

    start, config = None, JointTrainConfig(images=plan.images or JointTrainConfig().images, workers=plan.threads)
    if plan.start is not None:
        start, config = JointNet(), replace(config, rate=FINE_RATE)
        read_weights(start, plan.start)
    last: dict[str, float] = {}
    with terminal.progress("training", "images") as bar:

        def report(figures: dict[str, float]) -> None:
            last.update(figures)
            bar(int(figures["images"]), config.images, f"root-relative {figures['root_relative_mm']:.1f} mm")

        trained = train_joints(plan.bank, config, seed=plan.seed, start=start, report=report, checkpoint=plan.state)
    save_weights(trained, plan.out, notes={"images": str(config.images), "seed": str(plan.seed)})
    return last
