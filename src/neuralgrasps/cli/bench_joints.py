"""`neuralgrasps bench joints`: the joint net alone, on random scenes with hands that hold something."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from neuralgrasps.cli.bench_library import paper_objects
from neuralgrasps.cli.models import open_objects, warn_of_damage
from neuralgrasps.cli.terminal import Terminal

_NOTES = {
    "scenes": "a right hand of a random size holds a solid, 0.35 to 1.2 m before a camera of 640 x 480 pixels with the "
    "noise of a structured-light sensor; a forearm, a table, a wall and other things are around. Training draws its "
    "scenes from other seeds. The hand is a scaled copy of our own model, also in training: upper bounds",
    "boxes": "the hand's true box, its middle off by up to 0.1 of its longer side and its size by up to 15 %; the "
    "second look is round the joints of the first, and the mean of both counts",
    "scene_joints_": "hands of which more than 0.4 of the outline is in view, over all sets that training has not seen "
    "(solids, objects); with the name of a set, of that set. stand_ins: seven objects of the training in grasps "
    "that it has not seen; solids: random ones; objects: those given",
    "root_relative": "mean distance of the 20 joints with the wrists put together; Procrustes: of 21, after the best "
    "rotation, shift and scale; absolute: in the camera frame",
    "grasps": "hands of the model closed on the solids by the synthesis, without physics; made on the spot the first "
    "time, then kept. A solid is drawn as large as it is to hands of several sizes",
    "ms": "processor time of one look and of a whole reading, median, one thread",
}


def bench_joints(
    terminal: Terminal, *, objects: Sequence[str], count: int | None, seed: int, workers: int | None, quick: bool
) -> dict[str, Any]:
    """Config, figures, what is absent and why, notes and tables of the benchmark.

    Args:
        objects: names, files or folders; default the seven scans where they are. Built-in stand-ins are measured
            anyway.
        count: scenes of each set of solids; default 700, quick 240.
    """
    from neuralgrasps.evaluate.joint_bench import QUICK, JointBenchConfig
    from neuralgrasps.evaluate.joint_bench import bench_joints as measure
    from neuralgrasps.evaluate.joint_figures import FIGURES, joint_figures, joint_tables
    from neuralgrasps.objects.builtin import STAND_INS
    from neuralgrasps.parallel import available_cpus

    config = replace(QUICK if quick else JointBenchConfig(), seed=seed)
    if count is not None:
        config = replace(config, scenes=count)
    sources = tuple(source for source in paper_objects(objects) if source not in STAND_INS)
    with terminal.progress("reading objects"):
        models = open_objects(sources) if sources else {}
    warn_of_damage(terminal, models.values())
    meshes = {name: obj.mesh for name, obj in models.items()}
    with terminal.progress("joints", "tasks") as bar:
        bench = measure(meshes, config=config, workers=workers, progress=bar)
    figures, tables = joint_figures(bench), joint_tables(bench)
    _show(terminal, tables)
    for name in bench.without:
        terminal.say(f"no grasp was found for {name}: no scene holds it")
    shown = {
        **asdict(config),
        "quick": quick,
        "workers": workers or available_cpus(),
        "wall_s": bench.wall_s,
        "objects": {name: obj.provenance.get("source", "") for name, obj in models.items()},
        "without_grasp": bench.without,
    }
    absent = {name: "not measured" for name in FIGURES if name not in figures}
    return {"config": shown, "figures": figures, "absent": absent, "notes": _NOTES, "table": tables}


def _show(terminal: Terminal, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    for rows in tables.values():
        if rows:
            columns = tuple(rows[0])
            terminal.table(columns, [[row[c] for c in columns] for row in rows])
