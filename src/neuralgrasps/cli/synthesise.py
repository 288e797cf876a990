"""`neuralgrasps synthesise`: grasps of one hand on one object, or of many on many."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from neuralgrasps.cli.models import open_hands, open_objects, source_text, warn_of_damage, write_sources
from neuralgrasps.cli.options import AllNames, Folder, OptionalFile, OptionalFloat, OptionalText, Unit, Workers
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.dataset.collect import PairRecord
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.synthesis.synthesise import SynthesisConfig, SynthesisResult

OUT = Path("grasps.safetensors")
OutFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint=f"(default: {OUT})")]


def synthesise(
    terminal: Terminal,
    /,
    *,
    hand: OptionalText = None,
    object_name: Annotated[OptionalText, tyro.conf.arg(name="object")] = None,
    count: int = 60,
    seed: int = 0,
    protocol: str = "dexgraspbench",
    out: OutFile = None,
    report: OptionalFile = None,
    unit: Unit = "auto",
    mass_kg: OptionalFloat = None,
    max_rounds: int = 12,
    every: Annotated[bool, tyro.conf.arg(name="all")] = False,
    hands: AllNames = (),
    objects: AllNames = (),
    out_dir: Folder = Path("grasps"),
    workers: Workers = None,
) -> Outcome:
    """Make diverse grasps, each of which held the object in a physics simulation.

    One pair: --hand and --object, to one file. Many pairs: --all, to a folder, on all cores, and a run that was
    stopped goes on where it was. Exit code 1 when not one grasp was found.

    Args:
        hand: name of a hand, or any URDF or MJCF file.
        object_name: name of an object, or a mesh file.
        count: grasps wanted per pair.
        seed: the same seed gives the same grasps.
        protocol: physics trial that decides: dexgraspbench, dexgraspbench-hard or shake.
        out: file for the grasps of one pair.
        report: HTML page with pictures of the grasps of one pair.
        unit: length unit of mesh files; auto takes over 3 units for mm.
        mass_kg: mass of every object, for the protocols that use it.
        max_rounds: rounds of a few thousand start poses before giving up.
        every: every hand on every object, to a folder.
        hands: with --all, these hands.
        objects: with --all, these objects.
        out_dir: with --all, the folder for the grasps.
        workers: with --all, processes.
    """
    from neuralgrasps.sim.protocols import get_protocol
    from neuralgrasps.synthesis.synthesise import SynthesisConfig

    get_protocol(protocol)
    config = SynthesisConfig(count=count, protocol=protocol, max_rounds=max_rounds)
    if every or hands or objects:
        if hand is not None or object_name is not None:
            raise InputError("--hand and --object make one pair; --all, --hands and --objects many. Choose one way.")
        ignored = [name for name, given in (("--out", out), ("--report", report)) if given is not None]
        if ignored:
            raise InputError(f"{' and '.join(ignored)} is of one pair; many pairs go into the folder --out-dir.")
        return _many(
            terminal, hands, objects,
            config=config, seed=seed, folder=out_dir, workers=workers, unit=unit, mass_kg=mass_kg,
        )  # fmt: skip
    if hand is None or object_name is None:
        missing = " and ".join(n for n, v in (("--hand", hand), ("--object", object_name)) if v is None)
        raise InputError(
            f"{missing} is missing; expected --hand NAME|FILE --object NAME|FILE, or --all for every pair."
        )
    out = out or OUT
    for path in (out, report):
        if path is not None:
            check_writable(path)
    with terminal.progress("reading hand and object"):
        from neuralgrasps.hands.zoo import load_hand
        from neuralgrasps.objects.zoo import load_object

        model, obj = load_hand(hand), load_object(object_name, unit=unit, mass_kg=mass_kg)
    warn_of_damage(terminal, [obj])
    result, wall_s, cpu_s = _timed(terminal, model, obj, config, seed)
    grasps = result.grasps.with_config(hand_source=source_text(hand), object_source=source_text(object_name))
    depth_m = _overlaps(terminal, [model], [obj], [grasps])[0]
    record = pair_figures(result, config, depth_m, wall_s=wall_s, cpu_s=cpu_s)
    if len(grasps):
        from neuralgrasps.grasps.grasp_io import save_grasps

        make_parent(out)
        save_grasps(out, grasps)
        record["file"] = str(out)
        if report is not None:
            from neuralgrasps.cli.grasp_page import write_grasp_page

            with terminal.progress("drawing", "pictures") as bar:
                write_grasp_page(report, model, obj, grasps, depth_m, record, command=terminal.command, progress=bar)
            record["report"] = str(report)
    _show_pair(terminal, record)
    return Outcome(result=record, exit_code=0 if len(grasps) else 1)


def _timed(
    terminal: Terminal, hand: Hand, obj: ObjectModel, config: SynthesisConfig, seed: int
) -> tuple[SynthesisResult, float, float]:
    """The result, and its wall and CPU seconds."""
    from neuralgrasps.synthesis.synthesise import synthesise as run

    wall, cpu = time.perf_counter(), time.process_time()
    with terminal.progress(f"{hand.name} on {obj.name}", "grasps") as bar:
        result = run(hand, obj, config=config, seed=seed, progress=bar)
    return result, time.perf_counter() - wall, time.process_time() - cpu


def _overlaps(
    terminal: Terminal, hands: Sequence[Hand], objects: Sequence[ObjectModel], sets: Sequence[GraspSet]
) -> list[np.ndarray]:
    """Overlap of each grasp of each set, metres, as `evaluate` measures it; the sets name their hand and object."""
    from neuralgrasps.evaluate.grasps import measured_penetration

    by_hand, by_object = {h.name: h for h in hands}, {o.name: o for o in objects}
    depths = []
    with terminal.progress("measuring overlap", "pairs") as bar:
        for i, grasps in enumerate(sets):
            depths.append(measured_penetration(by_hand[grasps.hand], by_object[grasps.object], grasps))
            bar(i + 1, len(sets), f"{grasps.hand} on {grasps.object}")
    return depths


def _p95_mm(depth_m: np.ndarray) -> float:
    import numpy as np

    return float(np.percentile(depth_m, 95) * 1e3) if len(depth_m) else float("nan")


def pair_figures(
    result: SynthesisResult, config: SynthesisConfig, depth_m: np.ndarray, *, wall_s: float, cpu_s: float
) -> dict[str, Any]:
    """Numbers of one pair, units in the names; `depth_m` (N,) is what `measured_penetration` found."""
    import numpy as np

    grasps = result.grasps
    some = len(grasps) > 0
    return {
        "hand": grasps.hand,
        "object": grasps.object,
        "seed": result.seed,
        "protocol": config.protocol,
        "wanted": config.count,
        "validated": len(grasps),
        "converged": result.converged,
        "reason": result.reason,
        "candidates": result.proposals,
        "valid_candidates": result.outcomes["valid"],
        "tried_in_physics": result.tried,
        "physics_success_share": result.physics_success,
        "epsilon_median": float(np.median(grasps.epsilon)) if some else float("nan"),
        "penetration_p95_mm": _p95_mm(depth_m),
        "penetration_max_mm": float(depth_m.max() * 1e3) if some else float("nan"),
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "grasps_per_minute": 60 * len(grasps) / wall_s,
        "stage_cpu_s": dict(result.cpu_s),
        "outcomes": dict(result.outcomes),
    }


def _show_pair(terminal: Terminal, record: Mapping[str, Any]) -> None:
    success = record["physics_success_share"]
    held = f", {100 * success:.0f} % held" if record["tried_in_physics"] else ""
    terminal.say(f"{record['hand']} on {record['object']}: {record['validated']} of {record['wanted']} grasps")
    facts: list[tuple[str, Any]] = [
        ("start poses", record["candidates"]),
        ("geometrically valid", record["valid_candidates"]),
        ("tried in physics", f"{record['tried_in_physics']}{held} ({record['protocol']})"),
    ]
    if record["validated"]:
        facts += [
            ("epsilon, median", f"{record['epsilon_median']:.3f}"),
            ("overlap, 95th percentile", f"{record['penetration_p95_mm']:.2f} mm"),
        ]
    speed = f", {record['grasps_per_minute']:.0f} grasps per minute" if record["validated"] else ""
    facts.append(("time", f"{record['wall_s']:.1f} s, CPU {record['cpu_s']:.1f} s{speed}"))
    terminal.facts(facts)
    if record["reason"]:
        terminal.say(f"Fewer than wanted: {record['reason']}.")
    for key, name in (("file", "Grasps"), ("report", "Page")):
        if key in record:
            terminal.say(f"{name}: {record[key]}")
    if not record["validated"]:
        terminal.say("Nothing was written.")


def _many(
    terminal: Terminal,
    hands: Sequence[str],
    objects: Sequence[str],
    *,
    config: SynthesisConfig,
    seed: int,
    folder: Path,
    workers: int | None,
    unit: str,
    mass_kg: float | None,
) -> Outcome:
    from neuralgrasps.dataset.collect import collect_grasps
    from neuralgrasps.hands.zoo import hand_names
    from neuralgrasps.objects.zoo import object_names

    check_writable(folder, folder=True)
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}; expected at least 1.")
    hand_specs, object_specs = tuple(hands) or hand_names(), tuple(objects) or object_names()
    with terminal.progress("reading hands and objects"):
        loaded, models = open_hands(hand_specs), open_objects(object_specs, unit=unit, mass_kg=mass_kg)
    warn_of_damage(terminal, models.values())
    write_sources(
        folder,
        hands=dict(zip(loaded, map(source_text, hand_specs), strict=True)),
        objects=dict(zip(models, map(source_text, object_specs), strict=True)),
    )
    terminal.kept = f"Finished pairs are kept in '{folder}'; the same command goes on from there."
    wall = time.perf_counter()
    with terminal.progress(f"{counted(len(loaded), 'hand')} on {counted(len(models), 'object')}", "pairs") as bar:
        sets, records = collect_grasps(
            folder, list(loaded.values()), list(models.values()), config=config, seed=seed, workers=workers,
            progress=bar,
        )  # fmt: skip
    depths = _overlaps(terminal, list(loaded.values()), list(models.values()), sets)
    rows = [_collected(g, record, depth) for g, record, depth in zip(sets, records, depths, strict=True)]
    _show_many(terminal, rows)
    total = sum(r["validated"] for r in rows)
    wall_s = time.perf_counter() - wall
    terminal.say(f"{counted(total, 'grasp')} of {counted(len(rows), 'pair')} in {wall_s:.1f} s: {folder}")
    result = {"folder": str(folder), "seed": seed, "protocol": config.protocol, "pairs": rows, "grasps": total}
    result |= {"wall_s": wall_s, "cpu_s": sum(r["cpu_s"] for r in rows)}
    return Outcome(result=result, exit_code=0 if total else 1)


def _collected(grasps: GraspSet, record: PairRecord, depth_m: np.ndarray) -> dict[str, Any]:
    import numpy as np

    some = len(grasps) > 0
    return {
        "hand": record.hand,
        "object": record.object,
        "wanted": record.wanted,
        "validated": record.validated,
        "candidates": record.proposals,
        "valid_candidates": record.valid,
        "tried_in_physics": record.tried,
        "physics_success_share": record.physics_success,
        "epsilon_median": float(np.median(grasps.epsilon)) if some else float("nan"),
        "penetration_p95_mm": _p95_mm(depth_m),
        "cpu_s": record.cpu_s,
        "reason": record.reason,
    }


def _show_many(terminal: Terminal, rows: Sequence[Mapping[str, Any]]) -> None:
    columns = ("hand", "object", "tried", "held", "grasps", "epsilon", "overlap mm", "CPU s")
    terminal.table(
        columns,
        [
            (
                r["hand"],
                r["object"],
                r["tried_in_physics"],
                f"{100 * r['physics_success_share']:.0f} %" if r["tried_in_physics"] else None,
                r["validated"],
                f"{r['epsilon_median']:.3f}" if r["validated"] else None,
                f"{r['penetration_p95_mm']:.2f}" if r["validated"] else None,
                f"{r['cpu_s']:.1f}",
            )
            for r in rows
        ],
    )
    terminal.notes(
        [f"{r['hand']} on {r['object']}: {r['reason']}" for r in rows if r["reason"]], title="Fewer than wanted:"
    )
