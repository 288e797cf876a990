"""`neuralgrasps bench execute`: objects lifted in simulation, by pose method, robot and scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from neuralgrasps.cli.bench_library import open_library, paper_objects
from neuralgrasps.cli.bench_result import absent_figures, conditions, with_options
from neuralgrasps.cli.terminal import Terminal

_NOTES = {
    "scenes": "one object at a random place of the work area, turned at random, in a random stable pose; scenes that "
    "no plan solves, with the true pose and in a far longer run, are drawn again and counted (infeasible_share). "
    "All methods see the same scenes with the same sensor noise",
    "success": "lifted by 0.2 m at the first attempt, at least 0.16 m up after holding for 2 s, and neither hand nor "
    "arm touched the table, nor anything a neighbour, with more than 1 N; success_retry: within two attempts",
    "success_true": "planned with the simulator's own poses: the upper bound. success_baseline, success_contact: "
    "Khargonkar et al. 2022, supplement, Eq. 1 and 2, on our mask's points; Eq. 2 with the gripper at the planned "
    "grasp",
    "success_camera_off": "ours with the camera 5 mm and 0.5 degrees from where the robot believes it to be, depth "
    "0.3 % too far, with a smooth error of 3 mm and 2.5 mm more noise",
    "success_unproven": "ours without the proof that a grasp lifts the object, which is given in the same simulator",
    "success_of_all_drawn": "ours, scenes that nothing solves counted as failures",
    "plan_with_grasps_median_ms": "with the search for grasps that clear the table and the proofs; what earlier scenes "
    "of the run made or proved is at hand",
    "plan_median_ms": "processor time, one thread, until the first complete plan among all candidates, true poses, "
    "single scenes; making grasps for a table anew and proving in physics that they lift are not in it",
    "plan_found": "share of the scenes that some plan solves where the planner, as it is used, found one",
    "collisions": "of paths_checked executed motions (transfer, approach, lift), those that touch what they must not "
    "when checked again each millimetre with exact shapes in the world they were planned in; not of lifts whose object "
    "was believed to be more than 5 mm inside the table (wrong poses of the published methods)",
    "trials_per_min": "trials of ours with their retries, over the wall time of these and of drawing and solving their "
    "scenes (making and proving grasps), on all workers",
    "clutter": "five objects at least 15 mm apart, picked from near to far, each with a new look and then taken away."
    " The names of the objects are known, their places are not",
}


def bench_execute(
    terminal: Terminal,
    *,
    objects: Sequence[str],
    count: int | None,
    seed: int,
    workers: int | None,
    quick: bool,
) -> dict[str, Any]:
    """Config, figures, what is absent and why, notes and tables of the benchmark.

    Args:
        objects: names, files or folders; default the seven scans where they are, else the built-in seven.
        count: scenes per object for Fetch; default 50, quick 5.
    """
    from neuralgrasps.evaluate.execute_bench import QUICK, ExecuteBenchConfig
    from neuralgrasps.evaluate.execute_bench import bench_execute as measure
    from neuralgrasps.evaluate.execute_figures import FIGURES, execute_figures, execute_tables

    config = with_options(QUICK if quick else ExecuteBenchConfig(), seed=seed, scenes=count)
    library, models = open_library(terminal, paper_objects(objects))
    with terminal.progress("execute", "tasks") as bar:
        bench = measure(library, config=config, workers=workers, progress=bar)
    figures, tables = execute_figures(bench), execute_tables(bench)
    _show(terminal, tables)
    reasons = {f"success_{method}": why for method, why in bench.absent.items()}
    return {
        "config": conditions(config, models, quick=quick, workers=workers, wall_s=bench.wall_s, run=library.run),
        "figures": figures,
        "absent": absent_figures(terminal, figures, FIGURES, reasons),
        "notes": _NOTES,
        "table": tables,
        "failures": [asdict(t) for t in bench.trials if not t.success or t.collisions],
    }


def _show(terminal: Terminal, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    titles = {
        "success": ("pair", "method", "object", "count", "success", "low", "high", "with_retry", "pose_right"),
        "causes": ("pair", "method", "cause", "count"),
        "mcnemar": ("first", "second", "count", "only_first", "only_second", "p"),
        "scenes": ("pair", "object", "scenes", "drawn", "found", "plan_median_ms", "plan_p95_ms"),
    }
    for name, columns in titles.items():
        terminal.table(columns, [[row[c] for c in columns] for row in tables[name]])
