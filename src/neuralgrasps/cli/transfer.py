"""`neuralgrasps transfer`: executable grasps of one hand that hold an object as another hand does, or as points say."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.options import Cone, Names, OptionalFile, OptionalText, PositionalFolder, check_seed, read_cone
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.apply.transfer import TransferResult
    from neuralgrasps.cli.transfer_query import Asked, Known, TransferTask
    from neuralgrasps.grasps.grasp_set import GraspSet

Name = Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
Regions = Annotated[tuple[str, ...], tyro.conf.arg(metavar="REGION ...", help_behavior_hint="(default: none)")]
OptionalSide = Annotated[str | None, tyro.conf.arg(metavar="SIDE", help_behavior_hint="(optional)")]
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
    approach: Cone = (),
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
    from neuralgrasps.cli.transfer_query import TransferTask, open_known
    from neuralgrasps.cli.transfer_show import show_transfer, transfer_record

    check_seed(seed)
    config = TransferConfig(method=method, count=count, protocol=protocol)
    wanted = constraint_fields(
        only_region=only_region, keep_free=keep_free, approach=read_cone(approach), up=up, margin_m=margin
    )
    if sum(v is not None for v in (query, query_cloud, contacts)) != 1:
        raise InputError("give one query: --query FILE[:ROW] (or HAND:ROW), --query-cloud FILE or --contacts FILE.")
    _check_outputs(out, report)
    with terminal.progress("reading hands and objects"):
        known = open_known(run, hands, objects)
        asked = _asked(known, object_name, query=query, query_cloud=query_cloud, contacts=contacts)
        target = known.hand(hand)
        out = out or Path(f"transferred_{target.name}_{asked.obj.name}.safetensors")
        _check_outputs(out)
        constraints = GraspConstraints(obj=asked.obj, **wanted)
    task = TransferTask(asked=asked, hand=target, config=config, constraints=constraints, seed=seed)
    warn_of_damage(terminal, [asked.obj])
    if asked.note:
        terminal.complain(asked.note)
    result, stored, times = _timed(terminal, known, task)
    record = transfer_record(task, result, stored) | times
    if len(result.grasps):
        record |= _write(terminal, task, result, record, sources=(hand, object_name), out=out, report=report)
    elif constraints:
        record["similarity_without_constraints"] = _without_constraints(task, stored)
    show_transfer(terminal, record)
    return Outcome(result=record, exit_code=0 if len(result.grasps) else 1)


def _check_outputs(*paths: Path | None) -> None:
    for path in paths:
        if path is not None:
            check_writable(path)


def _asked(
    known: Known, object_name: str | None, *, query: str | None, query_cloud: Path | None, contacts: Path | None
) -> Asked:
    """The one query that was given."""
    from neuralgrasps.cli.transfer_query import ask_grasp, ask_points

    if query is not None:
        return ask_grasp(known, query, object_name)
    file = query_cloud or contacts
    assert file is not None
    return ask_points(known, file, object_name, contacts=contacts is not None)


def _timed(terminal: Terminal, known: Known, task: TransferTask) -> tuple[TransferResult, GraspSet, dict[str, float]]:
    """The result, the known grasps it started from, and wall, CPU and (of the wall) compiling seconds."""
    from neuralgrasps.apply.constrained_grasps import with_constrained
    from neuralgrasps.apply.transfer import made_grasps
    from neuralgrasps.apply.transfer import transfer as carry_over
    from neuralgrasps.cli.compiling import BEGINS, compile_clock

    hand, obj, config, constraints, seed = task.hand, task.asked.obj, task.config, task.constraints, task.seed
    wall, cpu = time.perf_counter(), time.process_time()
    with terminal.progress(f"{hand.name} on {obj.name}"), compile_clock(lambda: terminal.complain(BEGINS)) as clock:
        stored = known.grasps(hand, obj)
        if stored is None:
            stored = made_grasps(hand, obj, config, support=constraints.support, seed=seed)
        if constraints:
            stored = with_constrained(
                constraints, hand, stored, protocol=config.protocol, enough=config.count, seed=seed
            )
        result = carry_over(
            task.asked.query, hand, obj, known=stored, config=config, support=constraints.support,
            constraints=constraints if constraints else None, seed=seed,
        )  # fmt: skip
    times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu, "compile_s": clock.seconds}
    return result, stored, times


def _without_constraints(task: TransferTask, known: GraspSet) -> float | None:
    """Similarity of the best known grasp, were there no constraints; None when there is none."""
    from neuralgrasps.apply.transfer import transfer as carry_over

    config = replace(task.config, method="retrieve")
    free = carry_over(task.asked.query, task.hand, task.asked.obj, known=known, config=config, seed=task.seed)
    return float(free.similarity.max()) if len(free.grasps) else None


def _write(
    terminal: Terminal, task: TransferTask, result: TransferResult, record: dict[str, Any], *,
    sources: tuple[str, str | None], out: Path, report: Path | None,
) -> dict[str, str]:  # fmt: skip
    """The grasp file, and the page when one is asked for; returns their paths. `sources`: hand, object as typed."""
    from neuralgrasps.cli.models import source_text
    from neuralgrasps.dataset.collect import object_fingerprint
    from neuralgrasps.grasps.grasp_io import save_grasps

    obj = task.asked.obj
    grasps = result.grasps.with_config(
        hand_source=source_text(sources[0]), object_source=source_text(sources[1] or obj.name),
        transferred_from=task.asked.title, constraints=str(task.constraints),
    )  # fmt: skip
    make_parent(out)
    save_grasps(out, grasps, hand=task.hand, object_fingerprint=object_fingerprint(obj))
    written = {"file": str(out)}
    if report is None:
        return written
    from neuralgrasps.cli.transfer_page import write_transfer_page

    with terminal.progress("drawing", "pictures") as bar:
        write_transfer_page(report, task, result, record, command=terminal.command, progress=bar)
    return written | {"report": str(report)}
