"""What `execute` prints: a line per trial, and how sure the share of successes is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from neuralgrasps.cli.terminal import Cell, Terminal, counted

COLUMNS = ("object", "trial", "pose off mm", "°", "candidate", "plan ms", "lifted", "cause")


def success_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts and shares; trials without any plan are counted apart as infeasible."""
    from neuralgrasps.evaluate.shares import wilson_interval

    counted_ones = [r for r in records if r["cause"] != "infeasible"]
    lifted = sum(r["success"] for r in counted_ones)
    low, high = wilson_interval(lifted, len(counted_ones))
    return {
        "count": len(counted_ones),
        "lifted": lifted,
        "lifted_with_retry": sum(r["success_retry"] for r in counted_ones),
        "success": lifted / len(counted_ones) if counted_ones else float("nan"),
        "success_low": low,
        "success_high": high,
        "infeasible": len(records) - len(counted_ones),
        "scenes_without_plan": sum(r["scenes_without_plan"] for r in records),
        "causes": dict(Counter(r["cause"] for r in records if r["cause"])),
    }


def show_trials(terminal: Terminal, records: Sequence[Mapping[str, Any]], figures: Mapping[str, Any]) -> None:
    """The table and what it comes to."""
    terminal.table(COLUMNS, [trial_row(record) for record in records])
    terminal.say()
    for line in summary_lines(figures):
        terminal.say(line)
    terminal.notes(
        [f"{r['object']} {r['trial'] + 1}: {r['detail']}" for r in records if r["detail"]], title="Failures:"
    )


def trial_row(record: Mapping[str, Any]) -> list[Cell]:
    """One row of the table."""
    first = record["attempts"][0] if record["attempts"] else {}
    plan_ms = first.get("plan_ms")
    return [
        record["object"],
        record["trial"] + 1,
        _rounded(first.get("pose_error_mm"), 1),
        _rounded(first.get("pose_error_deg"), 1),
        first.get("candidate"),
        _rounded(plan_ms, 0),
        "yes" if record["success"] else "2nd attempt" if record["success_retry"] else "no",
        record["cause"],
    ]


def summary_lines(figures: Mapping[str, Any]) -> list[str]:
    """How many were lifted, how sure that is, and what is counted apart."""
    count, lifted = figures["count"], figures["lifted"]
    if not count:
        return ["No trial had a plan to carry out."]
    sure = f"95 % interval {100 * figures['success_low']:.0f} to {100 * figures['success_high']:.0f} %, Wilson"
    lines = [f"Lifted at the first attempt: {lifted} of {count} ({100 * figures['success']:.0f} %; {sure})."]
    if figures["lifted_with_retry"] > lifted:
        lines.append(f"With one retry: {figures['lifted_with_retry']} of {count}.")
    if figures["scenes_without_plan"]:
        scenes = counted(figures["scenes_without_plan"], "scene")
        lines.append(f"{scenes} drawn again: no plan exists there even with the true pose (a long run says so).")
    return lines


def _rounded(value: float | None, digits: int) -> Cell:
    return None if value is None else f"{value:.{digits}f}"
