"""The benchmark of the joint net: random scenes with hands that hold solids it was and was not trained with."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.joint_scenes import JointErrors, joint_scene, measure_scene
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.hands.fingerprint import fingerprint
from neuralgrasps.human.nets.joint_reader import JointReader
from neuralgrasps.human.scenes.grasp_bank import (
    GraspBank,
    joined_banks,
    load_bank,
    make_grasp_bank,
    random_solid,
    save_bank,
)
from neuralgrasps.human.scenes.kit import scene_kit
from neuralgrasps.human.skeleton import LARGEST, SMALLEST
from neuralgrasps.objects.builtin import STAND_INS
from neuralgrasps.objects.cache import home_folder
from neuralgrasps.parallel import available_cpus, run_tasks
from neuralgrasps.planning.grasp_cache import engine_versions
from neuralgrasps.seeds import child_rng

Progress = Callable[[int, int, str], None]
STAND_IN_SET, SOLID_SET, OBJECT_SET = "stand-ins", "solids", "objects"
_SEED = 99  # of solids and grasps; those of the training have others
_BLOCK = 20  # scenes of a task
_VERSION = 1  # of kept banks; raise it when what is made changes


@dataclass(frozen=True, slots=True, kw_only=True)
class JointBenchConfig:
    """How much is measured.

    Attributes:
        scenes: of each set of solids. solids: random ones, never seen in training. sizes: of hands that each other
            solid is held by. proposals: start poses of grasps per solid and size. seed: of the scenes.
    """

    scenes: int = 700
    solids: int = 16
    sizes: int = 3
    proposals: int = 300
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("scenes", "solids", "sizes", "proposals"):
            if getattr(self, name) < 1:
                raise InputError(f"joint benchmark: {name} is {getattr(self, name)}; expected at least 1.")


QUICK = JointBenchConfig(scenes=240, solids=10, sizes=1, proposals=200)
"""The amounts of `--quick`."""


@dataclass(slots=True, kw_only=True)
class JointBench:
    """All scenes by set, in an order that does not depend on the number of workers.

    Attributes:
        solids, grasps: how many there are in each set. without: objects that no grasp was found for.
    """

    scenes: dict[str, list[JointErrors]] = field(default_factory=dict)
    solids: dict[str, int] = field(default_factory=dict)
    grasps: dict[str, int] = field(default_factory=dict)
    without: list[str] = field(default_factory=list)
    workers: int = 1
    wall_s: float = 0.0


def bench_joints(
    objects: Mapping[str, Mesh],
    *,
    config: JointBenchConfig,
    workers: int | None = None,
    progress: Progress | None = None,
) -> JointBench:
    """Close hands on the solids of every set, then read random scenes with them.

    Args:
        objects: surfaces that no training has seen, metres, by name; may be empty.
        workers: processes, of one thread each; progress: called as (done, total, what was done last).
    """
    bench, begun = JointBench(workers=workers or available_cpus()), time.perf_counter()
    meshes = _solids(objects, config)
    made = _run(kept_bank, [(mesh, config.proposals) for _, _, mesh in meshes], workers, progress, "grasps")
    tasks: list[tuple[Any, ...]] = []
    for name in dict.fromkeys(of for of, _, _ in meshes):
        banks = [bank for (of, _, _), bank in zip(meshes, made, strict=True) if of == name and len(bank)]
        if not banks:
            raise InputError(f"no hand could be closed on any of the {name}; expected solids that a hand can hold.")
        bank = joined_banks(banks)
        bench.solids[name], bench.grasps[name] = bank.num_solids, len(bank)
        firsts = range(0, config.scenes, _BLOCK)
        tasks += [(bank, config, name, first, min(_BLOCK, config.scenes - first)) for first in firsts]
    held = {label for (_, label, _), bank in zip(meshes, made, strict=True) if len(bank)}
    bench.without = [label for label in dict.fromkeys(label for _, label, _ in meshes) if label not in held]
    for (_, _, name, *_), errors in zip(tasks, _run(_measure, tasks, workers, progress, "scenes"), strict=True):
        bench.scenes.setdefault(name, []).extend(errors)
    bench.wall_s = time.perf_counter() - begun
    return bench


def kept_bank(solid: Mesh, proposals: int) -> GraspBank:
    """Hands closed on one solid; kept in the home folder, and read from there the next time."""
    key = fingerprint((_VERSION, engine_versions(), solid.vertices, solid.faces, proposals, _SEED))
    file = home_folder() / "cache" / "joint_bench" / f"{key}.safetensors"
    try:
        return load_bank(file)
    except InputError:
        bank = make_grasp_bank([solid], proposals=proposals, seed=_SEED)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        save_bank(bank, file)
    except OSError:  # a folder that cannot be written costs time only
        return bank
    return bank


def _solids(objects: Mapping[str, Mesh], config: JointBenchConfig) -> list[tuple[str, str, Mesh]]:
    """Set, name and surface of every solid, as large as it is to hands of some sizes; random ones as they are."""
    sizes = np.linspace(SMALLEST + 0.05, LARGEST - 0.05, config.sizes) if config.sizes > 1 else [0.79]
    stand_ins = {name: made.build(made.size_m) for name, made in STAND_INS.items()}
    out = [
        (kind, name, Mesh(mesh.vertices / size, mesh.faces))
        for kind, meshes in ((STAND_IN_SET, stand_ins), (OBJECT_SET, objects))
        for name, mesh in meshes.items()
        for size in sizes
    ]
    random = [
        (SOLID_SET, f"solid {k}", random_solid(child_rng(_SEED, "joint benchmark", k))) for k in range(config.solids)
    ]
    return out + random


def _measure(bank: GraspBank, config: JointBenchConfig, name: str, first: int, count: int) -> list[JointErrors]:
    kit, once, reader = scene_kit(bank), JointReader.load(looks=1), JointReader.load()
    return [
        measure_scene(joint_scene(kit, config.seed, "joint benchmark", name, index), once, reader)
        for index in range(first, first + count)
    ]


def _run(
    work: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    workers: int | None,
    progress: Progress | None,
    what: str,
) -> list[Any]:
    """Results in the order of the tasks."""
    results: list[Any] = [None] * len(tasks)
    for done, (index, result) in enumerate(run_tasks(work, tasks, workers=workers), start=1):
        results[index] = result
        if progress is not None:
            progress(done, len(tasks), what)
    return results
