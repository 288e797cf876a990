"""`neuralgrasps evaluate`: tables on a trained run, a dataset, or grasp files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.dataset import read_grasp_files
from neuralgrasps.cli.models import (
    dataset_hands,
    dataset_objects,
    open_hands,
    open_objects,
    run_objects,
    warn_of_damage,
)
from neuralgrasps.cli.options import Names, OptionalFile, PositionalFolder, Workers
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.model.checkpoint import Run
    from neuralgrasps.objects.object_model import ObjectModel


def evaluate(
    terminal: Terminal,
    path: PositionalFolder,
    /,
    *,
    part: Literal["test", "train", "both"] = "test",
    queries: int = 100_000,
    observed: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: they are found)")] = True,
    report: OptionalFile = None,
    seed: int = 0,
    workers: Workers = None,
    hands: Names = (),
    objects: Names = (),
) -> Outcome:
    """Measure a trained run, a dataset, or grasp files.

    A run: the published tables, beside the paper's figures and those of a perfect field; surface errors in mm; how
    similar the grasps are that its codes find (1 = the same contacts); times. For grasps whose pose and joints are
    known, and for unseen grasps found again from observed points. A dataset or grasps: quality of the grasps,
    measured against the true mesh.

    Args:
        path: folder of a run or dataset, name of a shipped run, or a grasp file or folder of them.
        part: of a run: unseen grasps, training grasps, or both.
        queries: of a run: points asked per grasp by the published Chamfer measure.
        observed: of a run: leave out finding the unseen grasps again from observed points, which takes longest.
        report: of a run: also write a page with tables, pictures and t-SNE.
        seed: of a run: of queries, surface points and observations.
        workers: of a run: processes.
        hands: files of hands that are not built in and have moved.
        objects: files of objects that are not built in and have moved.
    """
    run = _run_at(path)
    if run is not None:
        from neuralgrasps.cli.evaluate_run import RunOptions, evaluate_run

        options = RunOptions(part=part, queries=queries, observed=observed, report=report, seed=seed, workers=workers)
        return evaluate_run(terminal, run, options, hands=hands, objects=objects)
    if report is not None:
        raise InputError(f"--report is of runs; '{path}' holds no run.json. Give the folder that `train` wrote.")
    if (path / "manifest.json").is_file():
        return _evaluate_dataset(terminal, path, hands)
    if not path.exists():
        from neuralgrasps.model.run_notes import hint_of_runs

        raise InputError(
            f"'{path}' does not exist; expected the folder of a run or dataset, a grasp file, or "
            f"{hint_of_runs(str(path))}"
        )
    return _evaluate_grasps(terminal, path, hands, objects)


def _run_at(path: Path) -> Path | None:
    """The folder of a run, or of the shipped run of that name; None when it is something else."""
    if (path / "run.json").is_file():
        return path
    if path.exists():
        return None
    from neuralgrasps.model.run_notes import run_folder, shipped_runs

    return run_folder(path) if str(path) in shipped_runs() else None


def open_run(folder: Path, hands: tuple[str, ...], objects: tuple[str, ...]) -> Run:
    """A run, by folder or by the name of a shipped one, with its hands and objects: given, or found where they were."""
    from neuralgrasps.cli.models import hands_of
    from neuralgrasps.model.checkpoint import load_run
    from neuralgrasps.model.run_notes import read_notes, run_folder

    folder = run_folder(folder)
    notes = read_notes(folder)
    return load_run(
        folder, hands=hands_of(notes.hands, folder, hands), objects=run_objects(folder, notes.objects, objects)
    )


def _evaluate_dataset(terminal: Terminal, folder: Path, hands: tuple[str, ...]) -> Outcome:
    from neuralgrasps.dataset.read import read_dataset

    data = read_dataset(folder)
    with terminal.progress("reading hands and objects"):
        models, objects = dataset_hands(data, hands), dataset_objects(data)
    sets = [data.grasps(hand, name) for hand, name in data.pairs]
    return _quality(terminal, folder, sets, models, objects)


def _evaluate_grasps(terminal: Terminal, path: Path, hands: tuple[str, ...], objects: tuple[str, ...]) -> Outcome:
    sets, recorded = read_grasp_files([path])
    given_hands, given_objects = open_hands(hands), open_objects(objects)
    with terminal.progress("reading hands and objects"):
        models = dict(given_hands)
        for name in dict.fromkeys(g.hand for g in sets if g.hand not in given_hands):
            models |= {name: next(iter(open_hands([recorded["hands"].get(name, name)]).values()))}
        things = dict(given_objects)
        for name in dict.fromkeys(g.object for g in sets if g.object not in given_objects):
            things |= {name: next(iter(open_objects([recorded["objects"].get(name, name)]).values()))}
    warn_of_damage(terminal, things.values())
    return _quality(terminal, path, sets, models, things)


def _quality(
    terminal: Terminal,
    path: Path,
    sets: list[GraspSet],
    hands: dict[str, Hand],
    objects: dict[str, ObjectModel],
) -> Outcome:
    """Table of what the grasps are worth."""
    import numpy as np

    from neuralgrasps.evaluate.grasps import measured_penetration

    rows: list[dict[str, Any]] = []
    with terminal.progress("measuring", "pairs") as bar:
        for i, grasps in enumerate(sets):
            if len(grasps):
                hands[grasps.hand].check_q(grasps.q)
                depth = measured_penetration(hands[grasps.hand], objects[grasps.object], grasps)
                rows.append(_pair_quality(grasps, depth))
            bar(i + 1, len(sets), f"{grasps.hand} on {grasps.object}")
    if not rows:
        raise InputError(f"'{path}' holds no grasps.")
    columns = ("object", "hand", "grasps", "held", "epsilon", "overlap mm", "slip mm")
    terminal.table(
        columns,
        [
            (r["object"], r["hand"], r["grasps"], f"{100 * r['held_share']:.0f} %", f"{r['epsilon_median']:.3f}",
             f"{r['penetration_p95_mm']:.2f}", f"{r['displacement_median_mm']:.1f}")
            for r in rows
        ],
    )  # fmt: skip
    count = sum(r["grasps"] for r in rows)
    terminal.say(f"{counted(count, 'grasp')}. Overlap: 95th percentile, against the true mesh. Others: medians.")
    worst = float(np.max([r["penetration_p95_mm"] for r in rows]))
    return Outcome(result={"path": str(path), "grasps": count, "pairs": rows, "worst_penetration_p95_mm": worst})


def _pair_quality(grasps: GraspSet, depth_m: np.ndarray) -> dict[str, Any]:
    import numpy as np

    verdict = grasps.verdicts.get(grasps.protocol)
    return {
        "object": grasps.object,
        "hand": grasps.hand,
        "grasps": len(grasps),
        "protocol": grasps.protocol,
        "held_share": float(grasps.validated.mean()),
        "epsilon_median": float(np.median(grasps.epsilon)),
        "contacts_median": float(np.median(grasps.num_contacts)),
        "penetration_p95_mm": float(np.percentile(depth_m, 95) * 1e3),
        "displacement_median_mm": float(np.median(verdict.displacement_m) * 1e3) if verdict else float("nan"),
        "rotation_median_deg": float(np.rad2deg(np.median(verdict.rotation_rad))) if verdict else float("nan"),
    }
