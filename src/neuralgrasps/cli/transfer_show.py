"""What `transfer` prints and returns: the grasps in their order, and what was left out, with the reason."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.terminal import Terminal, counted

if TYPE_CHECKING:
    from neuralgrasps.apply.transfer import TransferResult
    from neuralgrasps.cli.transfer_query import TransferTask
    from neuralgrasps.grasps.grasp_set import GraspSet

SCALE_TEXT = "Similarity of the contact maps: 1 = same, 0 = as the farthest of the known grasps."


def transfer_record(task: TransferTask, result: TransferResult, known: GraspSet) -> dict[str, Any]:
    """The JSON object of one call, units in the names; `known`: the grasps of the target hand that it started from."""
    constraints = task.constraints
    short = bool(result.reason) and bool(constraints) and len(known) > 0
    said = constraints.describe(task.hand, known.X_OH, known.q, known.q_pregrasp) if short else ""
    return {
        "object": task.asked.obj.name,
        "hand": task.hand.name,
        "query": task.asked.title,
        "constraints": list(constraints.names),
        "constraints_on_known": said,
        "note": task.asked.note,
        "known": len(known),
        "oracle_similarity": result.oracle,
        "results": _rows(task, result),
        "tried": result.tried,
        "reason": result.reason,
        "nearest_similarity": result.nearest_similarity,
    }


def grasp_rows(result: TransferResult) -> list[dict[str, Any]]:
    """What is known of each grasp of a transfer, in their order; `weak` where it had a say."""
    grasps = result.grasps
    verdict = grasps.verdicts.get(grasps.protocol)
    return [
        {
            "rank": i + 1,
            "similarity": float(result.similarity[i]),
            **({"weak": float(result.weak[i])} if result.weak.any() else {}),
            "origin": result.origin[i],
            "epsilon": float(grasps.epsilon[i]),
            "held": None if verdict is None else bool(verdict.success[i]),
            "moved_mm": None if verdict is None else 1e3 * float(verdict.displacement_m[i]),
        }
        for i in range(len(grasps))
    ]


def _rows(task: TransferTask, result: TransferResult) -> list[dict[str, Any]]:
    """The grasps with how clear they are of what is to be kept free and, for drawn contacts, what they touch."""
    from neuralgrasps.apply.drawn_contacts import reach, touched_text

    hand, grasps, points_O = task.hand, result.grasps, task.asked.contacts_O
    clearance = task.constraints.clearance(hand, grasps.X_OH, grasps.q)
    reached = None if points_O is None else reach(hand, grasps.X_OH, grasps.q, points_O)
    rows = grasp_rows(result)
    for i, row in enumerate(rows):
        row["clearance_mm"] = None if clearance[i] == math.inf else 1e3 * float(clearance[i])
        row["why"] = result.reasons[i]
        if reached is not None:
            row |= {"touched": touched_text(reached[i]), "points_off_mm": 1e3 * reached[i].mean()}
    return rows


def show_transfer(terminal: Terminal, record: Mapping[str, Any]) -> None:
    """The grasps, the conditions, and what would help where there are few."""
    rows = record["results"]
    terminal.say(f"{record['hand']} on {record['object']}: {counted(len(rows), 'grasp')} for {record['query']}")
    if rows:
        _show_rows(terminal, rows)
        terminal.say(SCALE_TEXT)
    terminal.facts(_facts(record))
    for line in _remarks(record):
        terminal.say(line)
    for key, name in (("file", "Grasps"), ("report", "Page")):
        if key in record:
            terminal.say(f"{name}: {record[key]}")
    if not rows:
        terminal.say("Nothing was written.")


def _show_rows(terminal: Terminal, rows: Sequence[Mapping[str, Any]]) -> None:
    free = any(r["clearance_mm"] is not None for r in rows)
    drawn, weak = "touched" in rows[0], "weak" in rows[0]
    columns = (
        *("rank", "similarity"), *(("weak",) if weak else ()), *("from", "epsilon", "moved, mm"),
        *(("clear by, mm",) if free else ()), *(("drawn points touched", "off, mm") if drawn else ()),
    )  # fmt: skip
    cells = [
        (r["rank"], f"{r['similarity']:.3f}", *((f"{r['weak']:.3f}",) if weak else ()),
         r["origin"], f"{r['epsilon']:.3f}", f"{r['moved_mm']:.1f}",
         *((f"{r['clearance_mm']:.0f}",) if free else ()),
         *((r["touched"], f"{r['points_off_mm']:.1f}") if drawn else ()))
        for r in rows
    ]  # fmt: skip
    terminal.table(columns, cells)


def _facts(record: Mapping[str, Any]) -> list[tuple[str, Any]]:
    from neuralgrasps.cli.compiling import of_it_compiling

    facts: list[tuple[str, Any]] = [("known grasps", record["known"])]
    if math.isfinite(record["oracle_similarity"]):
        title = "best of these allowed" if record["constraints"] else "best of these"
        facts.append((title, f"{record['oracle_similarity']:.3f}"))
    facts.append(("tried in physics", record["tried"]))
    facts += [("constraint", name) for name in record["constraints"]]
    time = f"{record['wall_s']:.1f} s{of_it_compiling(record['compile_s'])}, CPU {record['cpu_s']:.1f} s"
    return [*facts, ("time", time)]


def _remarks(record: Mapping[str, Any]) -> list[str]:
    """Why there are no more grasps, and what there would be otherwise."""
    said = []
    if record["reason"]:
        said.append(f"Note: {record['reason']}")
    if record["constraints_on_known"]:
        said.append(f"Known grasps: {record['constraints_on_known']}.")
    if not record["results"] and math.isfinite(record["nearest_similarity"]):
        said.append(f"The nearest that did not hold has similarity {record['nearest_similarity']:.3f}.")
    best = record.get("similarity_without_constraints")
    if best is not None:
        said.append(f"Without the constraints there is a grasp of similarity {best:.3f}: loosen one of them.")
    return said
