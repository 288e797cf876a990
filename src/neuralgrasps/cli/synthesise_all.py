"""`neuralgrasps synthesise --all`: every hand on every object, the table of what is feasible, and its page."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.models import (
    open_hands,
    open_readable,
    source_text,
    warn_of_damage,
    warn_of_guesses,
    warn_of_stand_ins,
    write_sources,
)
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, counted

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.report.contact_sheet import SheetPair
    from neuralgrasps.report.feasibility import PairSummary
    from neuralgrasps.synthesis.synthesise import SynthesisConfig


def synthesise_all(
    terminal: Terminal,
    hands: Sequence[str],
    objects: Sequence[str],
    *,
    config: SynthesisConfig,
    seed: int,
    folder: Path,
    report: Path | None,
    workers: int | None,
    unit: str,
    mass_kg: float | None,
) -> Outcome:
    """Fill `folder`, and write the table of every pair beside the grasps and, when asked for, the page `report`."""
    from neuralgrasps.dataset.collect import collect_grasps
    from neuralgrasps.report.feasibility import summarise_pair, write_feasibility

    check_writable(folder, folder=True)
    loaded, models, skipped = _opened(terminal, folder, hands, objects, unit=unit, mass_kg=mass_kg)
    warn_of_guesses(terminal, loaded.values(), power_share=config.power_share)
    terminal.kept = f"Finished pairs are kept in '{folder}'; the same command goes on from there."
    wall = time.perf_counter()
    with terminal.progress(f"{counted(len(loaded), 'hand')} on {counted(len(models), 'object')}", "pairs") as bar:
        sets, records = collect_grasps(
            folder, list(loaded.values()), list(models.values()), config=config, seed=seed, workers=workers,
            progress=bar,
        )  # fmt: skip
    depths = _overlaps(terminal, loaded, models, sets, workers)
    pairs = [summarise_pair(g, record, depth) for g, record, depth in zip(sets, records, depths, strict=True)]
    wall_s, total = time.perf_counter() - wall, sum(p.validated for p in pairs)
    about: dict[str, Any] = {"seed": seed, "protocol": config.protocol, "grasps": total, "wall_s": wall_s}
    about["cpu_s"] = sum(p.cpu_s for p in pairs)
    about["skipped"] = [{"object": file, "reason": reason} for file, reason in skipped.items()]
    table, sheet = write_feasibility(folder, pairs, about)
    result = {"folder": str(folder), "table": str(table), **about, "pairs": [asdict(p) for p in pairs]}
    _show(terminal, pairs)
    terminal.say(f"{counted(total, 'grasp')} of {counted(len(pairs), 'pair')} in {wall_s:.1f} s: {folder}")
    terminal.say(f"Table: {table}, {sheet.name}")
    terminal.notes([f"{file}: {reason}" for file, reason in skipped.items()], title="Skipped:")
    if report is not None:
        from neuralgrasps.report.contact_sheet import SheetPair

        drawn = [
            SheetPair(hand=loaded[g.hand], obj=models[g.object], grasps=g, depth_m=depth)
            for g, depth in zip(sets, depths, strict=True)
        ]
        _draw(terminal, report, drawn, pairs, seed=seed, protocol=config.protocol, workers=workers)
        result["report"] = str(report)
    return Outcome(result=result, exit_code=0 if total else 1)


def _opened(
    terminal: Terminal, folder: Path, hands: Sequence[str], objects: Sequence[str], *, unit: str, mass_kg: float | None
) -> tuple[dict[str, Hand], dict[str, ObjectModel], dict[str, str]]:
    """Hands and objects by name, their sources noted in the folder; and files that were skipped, with the reason."""
    from neuralgrasps.hands.zoo import hand_sources
    from neuralgrasps.objects.zoo import object_names, object_sources

    hand_specs, object_specs = hand_sources(hands), object_sources(objects or object_names())
    with terminal.progress("reading hands and objects"):
        loaded = open_hands(hand_specs)
        models, object_files, skipped = open_readable(
            object_specs, named=tuple(objects) or object_specs, unit=unit, mass_kg=mass_kg
        )
    warn_of_damage(terminal, models.values())
    warn_of_stand_ins(terminal, object_files, models)
    write_sources(
        folder,
        hands=dict(zip(loaded, map(source_text, hand_specs), strict=True)),
        objects={name: source_text(spec) for name, spec in object_files.items()},
    )
    return loaded, models, skipped


def _draw(
    terminal: Terminal,
    report: Path,
    drawn: Sequence[SheetPair],
    pairs: Sequence[PairSummary],
    *,
    seed: int,
    protocol: str,
    workers: int | None,
) -> None:
    """The page of all pairs."""
    from neuralgrasps.cli.feasibility_page import write_feasibility_page

    with terminal.progress("drawing", "pictures") as bar:
        write_feasibility_page(
            report, drawn, pairs, seed=seed, protocol=protocol, command=terminal.command, workers=workers, progress=bar
        )
    terminal.say(f"Page: {report}")


def _overlaps(
    terminal: Terminal,
    hands: dict[str, Hand],
    objects: dict[str, ObjectModel],
    sets: Sequence[GraspSet],
    workers: int | None,
) -> list[np.ndarray]:
    """Overlap of each grasp of each set, metres, as `evaluate` measures it; the sets name their hand and object."""
    from neuralgrasps.evaluate.grasps import measured_penetration
    from neuralgrasps.parallel import run_tasks

    depths: dict[int, np.ndarray] = {}
    tasks = [(hands[g.hand], objects[g.object], g) for g in sets]
    with terminal.progress("measuring overlap", "pairs") as bar:
        for i, depth in run_tasks(measured_penetration, tasks, workers=workers):
            depths[i] = depth
            bar(len(depths), len(sets), f"{sets[i].hand} on {sets[i].object}")
    return [depths[i] for i in range(len(sets))]


def _show(terminal: Terminal, pairs: Sequence[PairSummary]) -> None:
    """Objects down, hands across; then how good each hand's grasps are, and why there are fewer than wanted."""
    from neuralgrasps.report.feasibility import feasibility_matrix

    if not pairs:
        return
    columns, rows = feasibility_matrix(pairs)
    terminal.say("Grasps found / wanted, and the share of those tried that held:")
    terminal.table(columns, rows)
    by_hand = {name: [p for p in pairs if p.hand == name] for name in columns[1:]}
    terminal.say()
    terminal.table(
        ("hand", "grasps", "epsilon", "overlap mm", "worst mm", "precision", "power", "CPU s"),
        [
            (
                name,
                sum(p.validated for p in own),
                _middle([p.epsilon_median for p in own]),
                _largest([p.penetration_p95_mm for p in own]),
                _largest([p.penetration_max_mm for p in own]),
                sum(p.precision for p in own),
                sum(p.power for p in own),
                math.fsum(p.cpu_s for p in own),
            )
            for name, own in by_hand.items()
        ],
    )
    terminal.say("Epsilon: middle of the pairs' medians; overlap: largest 95th percentile of a pair, and the deepest.")
    terminal.notes([f"{p.hand} on {p.object}: {p.reason}" for p in pairs if p.reason], title="Fewer than wanted:")


def _middle(values: Sequence[float]) -> float | None:
    known = [v for v in values if not math.isnan(v)]
    return statistics.median(known) if known else None


def _largest(values: Sequence[float]) -> float | None:
    return max((v for v in values if not math.isnan(v)), default=None)
