"""`neuralgrasps bench transfer`: grasps carried over between all hands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.bench_result import absent_figures, conditions
from neuralgrasps.cli.terminal import Terminal

if TYPE_CHECKING:
    from neuralgrasps.model.checkpoint import Run

QUICK_QUERIES = 2
_NOTES = {
    "queries": "grasps that the run was not fitted to, of each hand on each object, carried over to each of the hands; "
    "only grasps that the run was fitted to are searched and started from. Grasps of the target hand itself are among "
    "the sources (same hand): there the query's palm pose is told, so they are easier, and listed apart",
    "transfer_success": "first result holds in dexgraspbench, of all queries. The transfer tries its candidates in "
    "dexgraspbench-quick, whose forces end once nothing moves, until one holds; the whole trial judges what it gave. "
    "transfer_success_hard (half of the friction) and _shake (the object's own weight and friction) are the same "
    "grasps under protocols that chose nothing, beside the shares of the known grasps there. Where robust is above 0 "
    "the margin at half the friction has a say in the choice, and only _shake is independent",
    "similarity": "1 - d / D: d the mean absolute difference of contact maps at 2,048 points; D the largest d of the "
    "object's matrix of unseen and known grasps of all hands (the published normalisation)",
    "transfer_without_result": "number of queries for which nothing that holds was found; they are in "
    "transfer_success, but in no mean similarity, nor in transfer_similarity_minus_oracle; "
    "transfer_similarity_missing_as_zero_minus_oracle has them with similarity 0",
    "oracle": "the known grasp of the target hand most alike, in every orientation that the object's symmetry allows; "
    "no_symmetry: as it is. Whether the turned grasp holds is not asked of the oracle",
    "transfer_s": "processor time, one thread, mean, until the first result has held; what is kept per pair of hand "
    "and object is at hand, compiling is not in it; transfer_wall_s beside whatever else the machine does",
    "alone": "retrieve_alone and generate_alone: similarity of the first result that holds, by one method only",
}


def bench_transfer(
    terminal: Terminal,
    *,
    objects: Sequence[str],
    hands: Sequence[str],
    count: int | None,
    seed: int,
    workers: int | None,
    quick: bool,
) -> dict[str, Any]:
    """Config, figures, what is absent and why, notes and tables of the benchmark.

    Args:
        objects: names, files or folders of those of the shipped runs; default the seven scans where they are here,
            else the built-in seven.
        hands: of the run; default all. count: queries per hand and object; default 10, quick 2.
    """
    from neuralgrasps.cli.bench_library import paper_objects
    from neuralgrasps.evaluate.transfer_bench import TransferBenchConfig
    from neuralgrasps.evaluate.transfer_bench import bench_transfer as measure
    from neuralgrasps.evaluate.transfer_figures import FIGURES, transfer_figures, transfer_tables

    run, chosen, known = _open_run(terminal, paper_objects(objects))
    queries = count or (QUICK_QUERIES if quick else 10)
    config = TransferBenchConfig(queries=queries, hands=tuple(hands), seed=seed)
    with terminal.progress("transfer", "pairs") as bar:
        bench = measure(run, config=config, objects=known, workers=workers, progress=bar)
    figures, tables = transfer_figures(bench), transfer_tables(bench)
    _show(terminal, tables)
    objects_used = {name: run.field.object(name) for name in known}
    shown = conditions(
        config, objects_used, quick=quick, workers=workers, wall_s=bench.wall_s, transfers=len(bench.trials), run=chosen
    )
    failures = [
        {"object": t.object, "source": t.source, "target": t.target, "query": t.query}
        for t in bench.trials
        if not t.held
    ]
    absent = absent_figures(terminal, figures, FIGURES, {})
    return {
        "config": shown, "figures": figures, "absent": absent, "notes": _NOTES, "table": tables, "failures": failures,
    }  # fmt: skip


def _open_run(terminal: Terminal, sources: Sequence[str]) -> tuple[Run, str, list[str]]:
    """The shipped run that knows most of the objects, its name, and which of them it knows."""
    from neuralgrasps.cli.evaluate import open_run
    from neuralgrasps.cli.evaluate_run import grasps_of
    from neuralgrasps.cli.models import open_objects
    from neuralgrasps.errors import InputError
    from neuralgrasps.model.run_notes import read_notes, run_folder, shipped_runs

    with terminal.progress("reading the run"):
        models = open_objects(sources)
        names = {run: set(read_notes(run_folder(run)).objects) & set(models) for run in shipped_runs()}
        chosen = max(names, key=lambda run: len(names[run]))
        if not names[chosen]:
            raise InputError(f"no shipped run has grasps of {', '.join(models)}; expected objects of one of them.")
        given = tuple(s for s, model in zip(sources, models, strict=True) if model in names[chosen])
        run = open_run(run_folder(chosen), (), given)
    grasps_of(run, run_folder(chosen))
    return run, chosen, sorted(names[chosen])


def _show(terminal: Terminal, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    numbers = (
        "count", "success", "similarity", "oracle", "minus_oracle", "retrieved", "generated_alone", "generated_share",
        "hard", "shake", "cpu_s",
    )  # fmt: skip
    for labels, name in ((("source", "target"), "pairs"), (("target",), "targets"), (("object",), "objects")):
        columns = (*labels, *numbers)
        terminal.table(columns, [[row[c] for c in columns] for row in tables[name]])
