"""`neuralgrasps synthesise`: grasps of one hand on one object, or of many on many."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.models import source_text, warn_of_damage, warn_of_guesses
from neuralgrasps.cli.options import (
    AllNames,
    OptionalFile,
    OptionalFloat,
    OptionalText,
    Protocols,
    Unit,
    Workers,
    check_seed,
)
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.synthesis.synthesise import SynthesisConfig, SynthesisResult

OUT, OUT_DIR = Path("grasps.safetensors"), Path("grasps")
OutFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint=f"(default: {OUT})")]
OutFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint=f"(default: {OUT_DIR})")]


def synthesise(
    terminal: Terminal,
    /,
    *,
    hand: OptionalText = None,
    object_name: Annotated[OptionalText, tyro.conf.arg(name="object")] = None,
    count: int = 60,
    seed: int = 0,
    protocol: str = "dexgraspbench",
    also: Protocols = ("dexgraspbench-hard", "shake"),
    power_share: OptionalFloat = None,
    device: Literal["cpu", "cuda"] = "cpu",
    out: OutFile = None,
    report: OptionalFile = None,
    unit: Unit = "auto",
    mass_kg: OptionalFloat = None,
    max_rounds: int = 12,
    every: Annotated[bool, tyro.conf.arg(name="all")] = False,
    hands: AllNames = (),
    objects: AllNames = (),
    out_dir: OutFolder = None,
    workers: Workers = None,
) -> Outcome:
    """Make diverse grasps, each of which held the object in a physics simulation.

    One pair: --hand and --object, to one file. Many pairs: --all, to a folder, on all cores, with a table of how many,
    how good and why not (feasibility.json and .csv); a run that was stopped goes on where it was. Exit code 1 when not
    one grasp was found.

    Args:
        hand: name of a hand, or any URDF or MJCF file.
        object_name: name of an object, or a mesh file.
        count: grasps wanted per pair.
        seed: the same seed gives the same grasps.
        protocol: physics trial that decides: dexgraspbench, dexgraspbench-quick, dexgraspbench-hard or shake.
        also: other trials whose verdicts are stored with the grasps; --also alone stores none.
        power_share: share of power grasps, 0 to 1, of hands with fingers; the others touch with fingertips only.
        device: where candidates are closed and judged; cuda needs an NVIDIA GPU and the extra 'gpu'.
        out: file for the grasps of one pair.
        report: HTML page with pictures of the grasps.
        unit: length unit of mesh files; auto takes over 3 units for mm.
        mass_kg: mass of every object, for the protocols that use it.
        max_rounds: rounds of a few thousand start poses before giving up.
        every: every hand on every object, to a folder.
        hands: with --all, these hands.
        objects: with --all, these objects: names, mesh files, folders of mesh files.
        out_dir: with --all, the folder for the grasps.
        workers: processes; of one pair, threads.
    """
    from neuralgrasps.sim.protocols import get_protocol
    from neuralgrasps.synthesis.synthesise import SynthesisConfig

    get_protocol(protocol)
    check_seed(seed)
    others = tuple(dict.fromkeys(name for name in also if name != protocol))
    config = SynthesisConfig(
        count=count, protocol=protocol, also=others, power_share=power_share, device=device, max_rounds=max_rounds
    )
    many = every or bool(hands) or bool(objects)
    _check_choice(many, hand=hand, object_name=object_name, out=out, out_dir=out_dir, workers=workers)
    if report is not None:
        check_writable(report)
    if many:
        from neuralgrasps.cli.synthesise_all import synthesise_all

        return synthesise_all(
            terminal, hands, objects, config=config, seed=seed, folder=out_dir or OUT_DIR, report=report,
            workers=workers, unit=unit, mass_kg=mass_kg,
        )  # fmt: skip
    assert hand is not None and object_name is not None
    out = out or OUT
    check_writable(out)
    with terminal.progress("reading hand and object"):
        from neuralgrasps.hands.zoo import load_hand
        from neuralgrasps.objects.zoo import load_object

        model, obj = load_hand(hand), load_object(object_name, unit=unit, mass_kg=mass_kg)
    warn_of_damage(terminal, [obj])
    warn_of_guesses(terminal, [model], power_share=power_share)
    result, wall_s, cpu_s, compile_s = _timed(terminal, model, obj, config, seed, workers)
    depth_m = _overlap(terminal, model, obj, result)
    record = _pair_figures(result, config, depth_m, wall_s=wall_s, cpu_s=cpu_s, compile_s=compile_s)
    if len(result.grasps):
        grasps = result.grasps.with_config(hand_source=source_text(hand), object_source=source_text(object_name))
        _write(out, grasps, model, obj)
        record["file"] = str(out)
        if report is not None:
            _draw(terminal, report, (model, obj, grasps, depth_m), record, workers)
            record["report"] = str(report)
    _show_pair(terminal, record, obj)
    return Outcome(result=record, exit_code=0 if len(result.grasps) else 1)


def _write(out: Path, grasps: GraspSet, hand: Hand, obj: ObjectModel) -> None:
    from neuralgrasps.dataset.collect import object_fingerprint
    from neuralgrasps.grasps.grasp_io import save_grasps

    make_parent(out)
    save_grasps(out, grasps, hand=hand, object_fingerprint=object_fingerprint(obj))


def _draw(
    terminal: Terminal, report: Path, made: tuple[Hand, ObjectModel, GraspSet, np.ndarray], record: dict[str, Any],
    workers: int | None,
) -> None:  # fmt: skip
    """The page of a pair: hand, object, grasps, and (N,) how deep each overlaps."""
    from neuralgrasps.cli.grasp_page import write_grasp_page
    from neuralgrasps.report.contact_sheet import SheetPair

    hand, obj, grasps, depth_m = made
    pair = SheetPair(hand=hand, obj=obj, grasps=grasps, depth_m=depth_m)
    with terminal.progress("drawing", "pictures") as bar:
        write_grasp_page(report, pair, record, command=terminal.command, workers=workers, progress=bar)


def _check_choice(
    many: bool,
    *,
    hand: str | None,
    object_name: str | None,
    out: Path | None,
    out_dir: Path | None,
    workers: int | None,
) -> None:
    """Refuse options of one pair beside options of many."""
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}; expected at least 1.")
    if many and (hand is not None or object_name is not None):
        raise InputError("--hand and --object make one pair; --all, --hands and --objects many. Choose one way.")
    if many and out is not None:
        raise InputError("--out is of one pair; many pairs go into the folder --out-dir.")
    if many:
        return
    if hand is None or object_name is None:
        names = [n for n, v in (("--hand", hand), ("--object", object_name)) if v is None]
        missing = f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'}"
        raise InputError(f"{missing} missing; expected --hand NAME|FILE --object NAME|FILE, or --all for every pair.")
    if out_dir is not None:
        raise InputError("--out-dir is of many pairs (--all); one pair goes to the file --out.")


def _timed(
    terminal: Terminal, hand: Hand, obj: ObjectModel, config: SynthesisConfig, seed: int, threads: int | None
) -> tuple[SynthesisResult, float, float, float]:
    """The result, and its wall, CPU and (of the wall) compiling seconds."""
    from neuralgrasps.cli.compiling import BEGINS, compile_clock
    from neuralgrasps.parallel import available_cpus
    from neuralgrasps.synthesis.synthesise import synthesise as run

    wall, cpu = time.perf_counter(), time.process_time()
    with (
        terminal.progress(f"{hand.name} on {obj.name}", "grasps") as bar,
        compile_clock(lambda: terminal.complain(BEGINS)) as clock,
    ):
        result = run(hand, obj, config=config, seed=seed, threads=threads or available_cpus(), progress=bar)
    return result, time.perf_counter() - wall, time.process_time() - cpu, clock.seconds


def _overlap(terminal: Terminal, hand: Hand, obj: ObjectModel, result: SynthesisResult) -> np.ndarray:
    """Overlap (N,) of each grasp, metres, as `evaluate` measures it."""
    from neuralgrasps.evaluate.grasps import measured_penetration

    with terminal.progress("measuring overlap"):
        return measured_penetration(hand, obj, result.grasps)


def _pair_figures(
    result: SynthesisResult,
    config: SynthesisConfig,
    depth_m: np.ndarray,
    *,
    wall_s: float,
    cpu_s: float,
    compile_s: float,
) -> dict[str, Any]:
    """Numbers of one pair, units in the names; the rate leaves compilation out."""
    from neuralgrasps.dataset.collect import record_of
    from neuralgrasps.report.feasibility import summarise_pair

    summary = summarise_pair(result.grasps, record_of(result, config.count), depth_m)
    return asdict(summary) | {
        "seed": result.seed,
        "protocol": config.protocol,
        "converged": result.converged,
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "compile_s": compile_s,
        "grasps_per_minute": 60 * len(result.grasps) / max(wall_s - compile_s, 1e-3),
        "stage_cpu_s": dict(result.cpu_s),
        "outcomes": dict(result.outcomes),
    }


def _show_pair(terminal: Terminal, record: Mapping[str, Any], obj: ObjectModel) -> None:
    from neuralgrasps.cli.compiling import of_it_compiling

    success = record["physics_success_share"]
    held = f", {100 * success:.0f} % held" if record["tried_in_physics"] else ""
    terminal.say(f"{record['hand']} on {record['object']}: {record['validated']} of {record['wanted']} grasps")
    facts: list[tuple[str, Any]] = [
        ("start poses", record["candidates"]),
        ("geometrically valid", record["valid_candidates"]),
        ("tried in physics", f"{record['tried_in_physics']}{held} ({record['protocol']})"),
    ]
    if record["also_held"]:
        facts.append(("of these also held", ", ".join(f"{100 * v:.0f} % {n}" for n, v in record["also_held"].items())))
    if record["validated"]:
        if record["precision"] + record["power"]:
            facts.append(("precision, power", f"{record['precision']}, {record['power']}"))
        facts += [
            ("epsilon, median", f"{record['epsilon_median']:.3f}"),
            ("overlap, 95th percentile", f"{record['penetration_p95_mm']:.2f} mm"),
        ]
    speed = f", {record['grasps_per_minute']:.0f} grasps per minute" if record["validated"] else ""
    compiling = of_it_compiling(record["compile_s"])
    facts.append(("time", f"{record['wall_s']:.1f} s{compiling}, CPU {record['cpu_s']:.1f} s{speed}"))
    terminal.facts(facts)
    if repairs := obj.provenance.get("repairs"):
        terminal.say(f"Repaired '{obj.name}': {repairs}.")
    if record["reason"]:
        terminal.say(f"Fewer than wanted: {record['reason']}.")
    for key, name in (("file", "Grasps"), ("report", "Page")):
        if key in record:
            terminal.say(f"{name}: {record[key]}")
    if not record["validated"]:
        terminal.say("Nothing was written.")
