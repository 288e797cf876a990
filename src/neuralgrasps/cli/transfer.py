"""`neuralgrasps transfer`: executable grasps of one hand that hold an object as another hand does, or as points say."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.options import Names, OptionalFile, OptionalText, PositionalFolder, check_seed
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.apply.constraints import GraspConstraints
    from neuralgrasps.apply.transfer import TransferConfig, TransferResult
    from neuralgrasps.cli.transfer_query import Asked, Known
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand

Name = Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
Regions = Annotated[tuple[str, ...], tyro.conf.arg(metavar="REGION ...", help_behavior_hint="(default: none)")]
OptionalSide = Annotated[str | None, tyro.conf.arg(metavar="SIDE", help_behavior_hint="(optional)")]
OptionalCone = Annotated[
    tuple[str, str] | None, tyro.conf.arg(metavar="AXIS ANGLE", help_behavior_hint="(optional), such as -z 30deg")
]
OptionalQuery = Annotated[str | None, tyro.conf.arg(metavar="FILE|HAND[:ROW]", help_behavior_hint="(optional)")]


def transfer(
    terminal: Terminal,
    run: PositionalFolder,
    /,
    *,
    hand: Name,
    object_name: Annotated[OptionalText, tyro.conf.arg(name="object")] = None,
    query: OptionalQuery = None,
    query_cloud: OptionalFile = None,
    contacts: OptionalFile = None,
    method: Literal["both", "retrieve", "generate"] = "both",
    count: int = 5,
    only_region: Regions = (),
    keep_free: Regions = (),
    margin: float = 0.005,
    approach: OptionalCone = None,
    up: OptionalSide = None,
    protocol: str = "dexgraspbench",
    seed: int = 0,
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: transferred_HAND_OBJECT.safetensors)"),
    ] = None,
    report: OptionalFile = None,
    hands: Names = (),
    objects: Names = (),
) -> Outcome:
    """Carry a grasp over to another hand: executable grasps that touch the object alike, the most alike first.

    The query is a grasp of any hand (--query), points all over a hand that was seen (--query-cloud), or a few contacts
    (--contacts). Known grasps of the target hand are ranked, new ones searched around the best, each tried in physics.
    A REGION is a side of the object (+x -x +y -y +z -z top bottom side), with its share of the extent if not the outer
    third (top:0.25), box:x0,y0,z0,x1,y1,z1 or sphere:x,y,z,r (metres, object frame), or file:points.ply.
    Exit code 1 when no grasp is left.

    Args:
        run: folder that `train` wrote, or the name of a shipped run, whose grasps are known; - for none: the target
            hand's are then made on the spot and kept.
        hand: target hand: a name, or a URDF or MJCF file.
        object_name: object held; default the query file's.
        query: grasp file, or hand of the run, and which of its grasps: grasps.safetensors:3, human:3.
        query_cloud: points of a hand: .ply, .npy or x y z text; metres, object frame.
        contacts: points to be touched, in the same formats.
        method: retrieve: known grasps; generate: new ones, searched; or both.
        count: grasps wanted.
        only_region: the hand touches the object only there.
        keep_free: no part of the hand comes near the object there.
        margin: how near, metres.
        approach: the palm comes along this axis of the object, at most so far off it: -z 30deg is from above. An axis
            may be x,y,z; world:-z or down is straight down when --up is given.
        up: side that faces up while the object stands on a table, +x to -z: the hand keeps clear of the table.
        protocol: physics trial that decides: dexgraspbench, dexgraspbench-quick, dexgraspbench-hard or shake.
        seed: the same seed gives the same grasps.
        out: file for the grasps.
        report: HTML page, the query beside the grasps, with contact maps.
        hands: files of hands that are not built in and have moved.
        objects: the same for objects.
    """
    from neuralgrasps.apply.constraint_text import constraint_fields
    from neuralgrasps.apply.constraints import GraspConstraints
    from neuralgrasps.apply.transfer import TransferConfig
    from neuralgrasps.cli.models import warn_of_damage
    from neuralgrasps.cli.transfer_query import ask_grasp, ask_points, open_known

    check_seed(seed)
    config = TransferConfig(method=method, count=count, protocol=protocol)
    wanted = constraint_fields(only_region=only_region, keep_free=keep_free, approach=approach, up=up, margin_m=margin)
    if sum(v is not None for v in (query, query_cloud, contacts)) != 1:
        raise InputError("give one query: --query FILE[:ROW] (or HAND:ROW), --query-cloud FILE or --contacts FILE.")
    for path in (out, report):
        if path is not None:
            check_writable(path)
    with terminal.progress("reading hands and objects"):
        known = open_known(run, hands, objects)
        if query is not None:
            asked = ask_grasp(known, query, object_name)
        else:
            file = query_cloud or contacts
            assert file is not None
            asked = ask_points(known, file, object_name, contacts=contacts is not None)
        target = known.hand(hand)
        out = out or Path(f"transferred_{target.name}_{asked.obj.name}.safetensors")
        check_writable(out)
        constraints = GraspConstraints(obj=asked.obj, **wanted)
    warn_of_damage(terminal, [asked.obj])
    if asked.note:
        terminal.complain(asked.note)
    result, stored, times = _timed(terminal, known, asked, target, config, constraints, seed)
    record = _record(asked, target, result, constraints, stored) | times
    if not len(result.grasps) and constraints:
        record["similarity_without_constraints"] = _without_constraints(asked, target, config, stored, seed)
    if len(result.grasps):
        _write(
            terminal,
            asked,
            target,
            result,
            record,
            constraints,
            sources=(hand, object_name),
            out=out,
            report=report,
            seed=seed,
        )
    _show(terminal, record)
    return Outcome(result=record, exit_code=0 if len(result.grasps) else 1)


def _timed(
    terminal: Terminal, known: Known, asked: Asked, hand: Hand, config: TransferConfig, constraints: GraspConstraints,
    seed: int,
) -> tuple[TransferResult, GraspSet, dict[str, float]]:  # fmt: skip
    """The result, the known grasps it started from, and wall, CPU and (of the wall) compiling seconds."""
    from neuralgrasps.apply.constrained_grasps import with_constrained
    from neuralgrasps.apply.transfer import made_grasps
    from neuralgrasps.apply.transfer import transfer as carry_over
    from neuralgrasps.cli.compiling import BEGINS, compile_clock

    wall, cpu = time.perf_counter(), time.process_time()
    with (
        terminal.progress(f"{hand.name} on {asked.obj.name}"),
        compile_clock(lambda: terminal.complain(BEGINS)) as clock,
    ):
        stored = known.grasps(hand, asked.obj)
        if stored is None:
            stored = made_grasps(hand, asked.obj, config, support=constraints.support, seed=seed)
        if constraints:
            stored = with_constrained(
                constraints, hand, stored, protocol=config.protocol, enough=config.count, seed=seed
            )
        result = carry_over(
            asked.query, hand, asked.obj, known=stored, config=config, support=constraints.support,
            constraints=constraints if constraints else None, seed=seed,
        )  # fmt: skip
    times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu, "compile_s": clock.seconds}
    return result, stored, times


def _without_constraints(asked: Asked, hand: Hand, config: TransferConfig, known: GraspSet, seed: int) -> float | None:
    """Similarity of the best known grasp, were there no constraints; None when there is none."""
    from neuralgrasps.apply.transfer import transfer as carry_over

    free = carry_over(asked.query, hand, asked.obj, known=known, config=replace(config, method="retrieve"), seed=seed)
    return float(free.similarity[0]) if len(free.grasps) else None


def _record(
    asked: Asked, hand: Hand, result: TransferResult, constraints: GraspConstraints, known: GraspSet
) -> dict[str, Any]:
    """The JSON object of one call, units in the names."""
    from neuralgrasps.apply.drawn_contacts import reach, touched_text

    grasps = result.grasps
    clearance = constraints.clearance(hand, grasps.X_OH, grasps.q)
    verdict = grasps.verdicts.get(grasps.protocol)
    points_O = asked.contacts_O
    reached = None if points_O is None else reach(hand, grasps.X_OH, grasps.q, points_O)
    rows = [
        {
            "rank": i + 1,
            "similarity": float(result.similarity[i]),
            "origin": result.origin[i],
            "epsilon": float(grasps.epsilon[i]),
            "held": None if verdict is None else bool(verdict.success[i]),
            "moved_mm": None if verdict is None else 1e3 * float(verdict.displacement_m[i]),
            "clearance_mm": None if clearance[i] == float("inf") else 1e3 * float(clearance[i]),
            "why": result.reasons[i],
        }
        | ({} if reached is None else {"touched": touched_text(reached[i]), "points_off_mm": 1e3 * reached[i].mean()})
        for i in range(len(grasps))
    ]
    short = bool(result.reason) and bool(constraints) and len(known) > 0
    return {
        "object": asked.obj.name,
        "hand": hand.name,
        "query": asked.title,
        "constraints": list(constraints.names),
        "constraints_on_known": constraints.describe(hand, known.X_OH, known.q, known.q_pregrasp) if short else "",
        "note": asked.note,
        "known": len(known),
        "oracle_similarity": result.oracle,
        "results": rows,
        "tried": result.tried,
        "reason": result.reason,
        "nearest_similarity": result.nearest_similarity,
    }


def _write(
    terminal: Terminal,
    asked: Asked,
    hand: Hand,
    result: TransferResult,
    record: dict[str, Any],
    constraints: GraspConstraints,
    *,
    sources: tuple[str, str | None],
    out: Path,
    report: Path | None,
    seed: int,
) -> None:
    """The grasp file, and the page when one is asked for; both are named in `record`."""
    from neuralgrasps.cli.models import source_text
    from neuralgrasps.dataset.collect import object_fingerprint
    from neuralgrasps.grasps.grasp_io import save_grasps

    grasps = result.grasps.with_config(
        hand_source=source_text(sources[0]), object_source=source_text(sources[1] or asked.obj.name),
        transferred_from=asked.title, constraints=str(constraints),
    )  # fmt: skip
    make_parent(out)
    save_grasps(out, grasps, hand=hand, object_fingerprint=object_fingerprint(asked.obj))
    record["file"] = str(out)
    if report is None:
        return
    from neuralgrasps.cli.transfer_page import write_transfer_page

    with terminal.progress("drawing", "pictures") as bar:
        write_transfer_page(
            report, asked, hand, result, record, constraints=constraints, command=terminal.command, seed=seed,
            progress=bar,
        )  # fmt: skip
    record["report"] = str(report)


def _show(terminal: Terminal, record: dict[str, Any]) -> None:
    from neuralgrasps.cli.compiling import of_it_compiling

    rows = record["results"]
    terminal.say(f"{record['hand']} on {record['object']}: {counted(len(rows), 'grasp')} for {record['query']}")
    if rows:
        free = any(r["clearance_mm"] is not None for r in rows)
        drawn = "touched" in rows[0]
        columns = (
            *("rank", "similarity", "from", "epsilon", "moved, mm"), *(("clear by, mm",) if free else ()),
            *(("drawn points touched", "off, mm") if drawn else ()),
        )  # fmt: skip
        terminal.table(
            columns,
            [
                (r["rank"], f"{r['similarity']:.3f}", r["origin"], f"{r['epsilon']:.3f}", f"{r['moved_mm']:.1f}",
                 *((f"{r['clearance_mm']:.0f}",) if free else ()),
                 *((r["touched"], f"{r['points_off_mm']:.1f}") if drawn else ()))
                for r in rows
            ],
        )  # fmt: skip
        terminal.say("Similarity of the contact maps: 1 = same, 0 = as the farthest of the known grasps.")
    facts: list[tuple[str, Any]] = [("known grasps", record["known"])]
    if math.isfinite(record["oracle_similarity"]):
        facts.append(
            (
                "best of these allowed" if record["constraints"] else "best of these",
                f"{record['oracle_similarity']:.3f}",
            )
        )
    facts += [("tried in physics", record["tried"])]
    facts += [("constraint", name) for name in record["constraints"]]
    facts.append(
        ("time", f"{record['wall_s']:.1f} s{of_it_compiling(record['compile_s'])}, CPU {record['cpu_s']:.1f} s")
    )
    terminal.facts(facts)
    if record["reason"]:
        terminal.say(f"Note: {record['reason']}")
    if record["constraints_on_known"]:
        terminal.say(f"Known grasps: {record['constraints_on_known']}.")
    if not rows and math.isfinite(record["nearest_similarity"]):
        terminal.say(f"The nearest that did not hold has similarity {record['nearest_similarity']:.3f}.")
    if record.get("similarity_without_constraints") is not None:
        best = record["similarity_without_constraints"]
        terminal.say(f"Without the constraints there is a grasp of similarity {best:.3f}: loosen one of them.")
    for key, name in (("file", "Grasps"), ("report", "Page")):
        if key in record:
            terminal.say(f"{name}: {record[key]}")
    if not rows:
        terminal.say("Nothing was written.")
