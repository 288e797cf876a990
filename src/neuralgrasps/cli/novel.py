"""`neuralgrasps novel`: grasps that nobody has seen, from codes near and between known ones."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.evaluate import open_run
from neuralgrasps.cli.models import read_sources
from neuralgrasps.cli.options import Names, OptionalFile, PositionalFolder, Workers, check_seed
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.apply.novel import NovelResult
    from neuralgrasps.apply.novel_trial import NovelConfig
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.model.checkpoint import Run

Name = Annotated[str, tyro.conf.arg(metavar="NAME")]


def novel(
    terminal: Terminal,
    run: PositionalFolder,
    /,
    *,
    hand: Name,
    object_name: Annotated[str, tyro.conf.arg(name="object", metavar="NAME")],
    count: int = 20,
    kind: Annotated[Literal["noise", "midpoint", "sample", "gaussian"], tyro.conf.arg(name="from")] = "noise",
    spread: float = 0.1,
    search: int = 16,
    noise_level: float = 0.0,
    protocol: str = "dexgraspbench",
    seed: int = 0,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("novel.safetensors"),
    report: OptionalFile = None,
    hands: Names = (),
    objects: Names = (),
    workers: Workers = None,
) -> Outcome:
    """Make new grasps from a run's codes of one hand on one object, and keep those that hold in physics.

    Codes are sampled or interpolated, decoded, the hand closed on the object, and each grasp tried once. Exit code 1
    when none holds.

    Args:
        run: folder that `train` wrote, or the name of a shipped run.
        hand: a hand of the run, with training grasps of the object.
        object_name: an object of the run.
        count: codes; fewer grasps hold.
        kind: noise: known codes plus noise; midpoint: between neighbours; sample: from a kernel density over the known
            codes; gaussian: from one Gaussian over them.
        spread: of the noise, in standard deviations of the known codes.
        search: most small variations of a decoded hand that are closed too, where it closes poorly; the best by
            epsilon is tried. 0: as decoded.
        noise_level: above 0, the trained network first moves codes this far off towards known grasps.
        protocol: physics trial that decides: dexgraspbench, dexgraspbench-quick, dexgraspbench-hard or shake.
        seed: the same seed gives the same grasps.
        out: file for the grasps that hold.
        report: HTML page with pictures of them.
        hands: files of hands that are not built in and have moved.
        objects: the same for objects.
        workers: threads of the physics trials, processes of the pictures.
    """
    from neuralgrasps.apply.novel_trial import NovelConfig

    check_seed(seed)
    config = NovelConfig(
        kind=kind, count=count, spread=spread, search=search, noise_level=noise_level, protocol=protocol
    )
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}; expected at least 1.")
    check_writable(out)
    if report is not None:
        check_writable(report)
    with terminal.progress("reading the run"):
        model = open_run(run, hands, objects)
    result, wall_s, cpu_s, compile_s = _timed(terminal, model, hand, object_name, config, seed, workers)
    record = _figures(result, hand, object_name) | {"wall_s": wall_s, "cpu_s": cpu_s, "compile_s": compile_s}
    if len(result.grasps):
        _write(terminal, run, model, result, record, out=out, report=report, workers=workers)
    _show(terminal, record)
    return Outcome(result=record, exit_code=0 if len(result.grasps) else 1)


def _timed(
    terminal: Terminal, model: Run, hand: str, object_name: str, config: NovelConfig, seed: int, threads: int | None
) -> tuple[NovelResult, float, float, float]:
    """The result, and its wall, CPU and (of the wall) compiling seconds."""
    from neuralgrasps.apply.novel import novel_grasps
    from neuralgrasps.cli.compiling import BEGINS, compile_clock
    from neuralgrasps.parallel import available_cpus

    wall, cpu = time.perf_counter(), time.process_time()
    with (
        terminal.progress(f"{hand} on {object_name}", "codes") as bar,
        compile_clock(lambda: terminal.complain(BEGINS)) as clock,
    ):
        result = novel_grasps(
            model.field, model.codebook, hand=hand, object_name=object_name, config=config, seed=seed,
            threads=threads or available_cpus(), progress=bar,
        )  # fmt: skip
    return result, time.perf_counter() - wall, time.process_time() - cpu, clock.seconds


def _figures(result: NovelResult, hand: str, object_name: str) -> dict[str, Any]:
    """Numbers of one call, units in the names."""
    import numpy as np

    def median(values: np.ndarray, scale: float) -> float:
        held = values[result.code]
        return float(np.median(held) * scale) if len(held) else float("nan")

    config = result.config
    return {
        "hand": hand,
        "object": object_name,
        "from": config.kind,
        "spread": config.spread,
        "search": config.search,
        "noise_level": config.noise_level,
        "protocol": config.protocol,
        "seed": result.seed,
        "codes": len(result.outcome),
        "held": len(result.grasps),
        "held_share": result.held_share,
        "force_closure_share": result.force_closure_share,
        "outcomes": dict(result.counts),
        "contact_change_median": median(result.contact_change, 1.0),
        "palm_shift_median_mm": median(result.palm_shift_m, 1e3),
        "palm_turn_median_deg": median(result.palm_turn_rad, 180.0 / np.pi),
        "novelty_median_mm": median(result.novelty_m, 1e3),
        "codes_by_outcome": [
            {"code": i, "source": int(s), "neighbour": int(n), "outcome": list(result.counts)[int(o)]}
            for i, (s, n, o) in enumerate(zip(result.codes.source, result.codes.neighbour, result.outcome, strict=True))
        ],
    }


def _write(
    terminal: Terminal,
    folder: Path,
    model: Run,
    result: NovelResult,
    record: dict[str, Any],
    *,
    out: Path,
    report: Path | None,
    workers: int | None,
) -> None:
    """The grasp file, and the page when one is asked for; both are named in `record`."""
    from neuralgrasps.dataset.collect import object_fingerprint
    from neuralgrasps.grasps.grasp_io import save_grasps

    hand, obj = model.field.hand(result.grasps.hand), model.field.object(result.grasps.object)
    grasps = result.grasps.with_config(**_sources(folder, result.grasps))
    make_parent(out)
    save_grasps(out, grasps, hand=hand, object_fingerprint=object_fingerprint(obj))
    record["file"] = str(out)
    if report is None:
        return
    from neuralgrasps.cli.novel_page import write_novel_page
    from neuralgrasps.evaluate.grasps import measured_penetration
    from neuralgrasps.report.contact_sheet import SheetPair

    with terminal.progress("drawing", "pictures") as bar:
        pair = SheetPair(hand=hand, obj=obj, grasps=grasps, depth_m=measured_penetration(hand, obj, grasps))
        write_novel_page(report, pair, result, record, command=terminal.command, workers=workers, progress=bar)
    record["report"] = str(report)


def _sources(folder: Path, grasps: GraspSet) -> dict[str, str]:
    """Where the hand and the object were read from, so that other verbs find them."""
    recorded = read_sources(folder)
    found: dict[str, str] = {"novel_run": str(folder.resolve())}
    for kind, name in (("hand", grasps.hand), ("object", grasps.object)):
        known = recorded.get(f"{kind}s", {})
        found[f"{kind}_source"] = known.get(name, name) if isinstance(known, dict) else name
    return found


def _show(terminal: Terminal, record: dict[str, Any]) -> None:
    from neuralgrasps.cli.compiling import of_it_compiling

    whose = f"{record['hand']} on {record['object']}"
    terminal.say(f"{whose}: {record['held']} of {counted(record['codes'], 'code')} became grasps that hold")
    how = {
        "noise": f"known codes + {record['spread']:g} standard deviations",
        "midpoint": "midpoints of neighbours",
        "sample": "a kernel density over known codes",
        "gaussian": "a Gaussian over known codes",
    }[record["from"]]
    search = f"best of up to {record['search'] + 1} closings" if record["search"] else "one closing"
    facts: list[tuple[str, Any]] = [
        ("codes from", how),
        ("each code", f"{search}, one trial ({record['protocol']})"),
        ("force closure", f"{100 * record['force_closure_share']:.0f} %"),
        ("held", f"{100 * record['held_share']:.0f} %"),
    ]
    lost = {k: v for k, v in record["outcomes"].items() if v and k != "held"}
    if lost:
        facts.append(("others", ", ".join(f"{v} {k}" for k, v in lost.items())))
    if record["held"]:
        facts += [
            ("from the code", f"contacts {record['contact_change_median']:.3f}, "
             f"palm {record['palm_shift_median_mm']:.1f} mm and {record['palm_turn_median_deg']:.1f}° (medians)"),
            ("from known grasps", f"{record['novelty_median_mm']:.1f} mm (median)"),
        ]  # fmt: skip
    facts.append(
        ("time", f"{record['wall_s']:.1f} s{of_it_compiling(record['compile_s'])}, CPU {record['cpu_s']:.1f} s")
    )
    terminal.facts(facts)
    for key, name in (("file", "Grasps"), ("report", "Page")):
        if key in record:
            terminal.say(f"{name}: {record[key]}")
    if not record["held"]:
        terminal.say("Nothing was written.")
