"""The small page of `synthesise --report`: the grasps of one pair in pictures and numbers."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

import neuralgrasps
from neuralgrasps.cli.compiling import of_it_compiling
from neuralgrasps.cli.progress import ProgressBar
from neuralgrasps.cli.terminal import counted
from neuralgrasps.parallel import available_cpus
from neuralgrasps.report.contact_sheet import SheetPair, contact_sheets
from neuralgrasps.report.content import (
    ContactFigure,
    DemoReport,
    HandFigure,
    Histogram,
    KeyFigure,
    SynthesisRow,
    Table,
)
from neuralgrasps.report.figures import render_contact_map, render_hand
from neuralgrasps.report.page import write_report
from neuralgrasps.report.sections import pretty_name

if TYPE_CHECKING:
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.report.feasibility import PairSummary

SHOWN = 60
FEW = 12  # pictures that are drawn before other processes would have started
CONTACTS_SHOWN = 4
TOUCH_M = 0.004  # points of the object nearer than this to the hand count as touched


def write_grasp_page(
    path: Path,
    pair: SheetPair,
    figures: Mapping[str, Any],
    *,
    command: str,
    workers: int | None,
    progress: ProgressBar,
) -> Path:
    """Write the page of one pair: all its grasps, but no more than `SHOWN`; `figures` are those of the JSON result."""
    hand, obj, grasps = pair.hand, pair.obj, pair.grasps
    shown, maps = min(SHOWN, len(grasps)), min(CONTACTS_SHOWN, len(grasps))
    total = shown + maps + 1
    verdict = grasps.verdicts[grasps.protocol]
    sheets = contact_sheets(
        [pair], shown=shown, workers=workers if shown > FEW else 1, progress=lambda done, *_: progress(done, total)
    )
    contacts = _contact_figures(hand, obj, grasps[:maps], progress, shown, total)
    report = DemoReport(
        title=f"{pretty_name(hand.name)} on {pretty_name(obj.name)}",
        subtitle=f"{counted(len(grasps), 'diverse grasp')}, each held by the physics protocol '{grasps.protocol}'.",
        **about_this_run(command, grasps.seed),
        key_figures=_key_figures(figures),
        hands=(HandFigure(hand=hand.name, image=render_hand(hand), text=_hand_text(hand)),),
        sheets=sheets,
        contacts=contacts,
        synthesis=(_synthesis_row(figures),),
        tables=(trial_table(grasps.protocol, verdict.parameters),),
        histograms=(
            Histogram(
                title="Largest disturbance resisted", unit="epsilon", values={hand.name: np.array(grasps.epsilon)}
            ),
            Histogram(title="Overlap", unit="mm", values={hand.name: pair.depth_m * 1e3}, limit=1.0),
        ),
        notes=tuple(_notes(hand, obj, verdict.parameters)),
    )
    return write_report(report, path)


class RunFacts(TypedDict):
    """What a page says about the run that made it."""

    command: str
    machine: str
    seed: int
    version: str
    created: str


def about_this_run(command: str, seed: int) -> RunFacts:
    return RunFacts(
        command=command,
        machine=f"{platform.system()} {platform.machine()}, {available_cpus()} cores",
        seed=seed,
        version=neuralgrasps.__version__,
        created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )


def set_text(pair: PairSummary) -> str:
    """A line of figures of all grasps of a pair."""
    kinds = f", {pair.precision} precision and {pair.power} power" if pair.precision + pair.power else ""
    return (
        f"{pair.validated} of {pair.wanted} grasps{kinds}; {pair.held_text} of {pair.tried_in_physics} tried; "
        f"ε {pair.epsilon_median:.3f} (median); overlap {pair.penetration_p95_mm:.2f} mm (95th percentile), "
        f"{pair.penetration_max_mm:.2f} mm at most; {pair.cpu_s:.1f} CPU s."
    )


def _contact_figures(
    hand: Hand, obj: ObjectModel, grasps: GraspSet, progress: ProgressBar, done: int, total: int
) -> tuple[ContactFigure, ...]:
    from neuralgrasps.grasps.contact_map import contact_map_packed
    from neuralgrasps.hands.packed import pack_hand

    radius = 0.05 * float(np.linalg.norm(obj.points_O - obj.points_O.mean(axis=0), axis=1).max())
    values = contact_map_packed(
        obj.points_O, pack_hand(hand, spacing=0.009), np.array(grasps.X_OH), np.array(grasps.q), radius=radius
    )
    figures = []
    for i, row in enumerate(values):
        figures.append(
            ContactFigure(
                hand=hand.name,
                object=obj.name,
                image=render_contact_map(obj, row),
                area_share=float((row > math.exp(-TOUCH_M / radius)).mean()),
                note=f"grasp {i}, decay length {1e3 * radius:.1f} mm",
            )
        )
        progress(done + i + 1, total)
    return tuple(figures)


def _key_figures(figures: Mapping[str, Any]) -> tuple[KeyFigure, ...]:
    success = figures["physics_success_share"]
    return (
        KeyFigure(value=str(figures["validated"]), label="grasps held in physics", note=f"{figures['wanted']} wanted"),
        KeyFigure(
            value=f"{100 * success:.0f} %", label="of those tried held", note=f"{figures['tried_in_physics']} tried"
        ),
        KeyFigure(
            value=f"{figures['penetration_p95_mm']:.2f} mm",
            label="overlap, 95th percentile",
            note="of hand and object, against the true mesh",
        ),
        KeyFigure(
            value=f"{figures['grasps_per_minute']:.0f}",
            label="grasps per minute",
            note=f"{figures['cpu_s']:.1f} CPU seconds in all{of_it_compiling(figures['compile_s'])}",
        ),
    )


def _synthesis_row(figures: Mapping[str, Any]) -> SynthesisRow:
    return SynthesisRow(
        hand=figures["hand"],
        object=figures["object"],
        candidates=figures["candidates"],
        valid=figures["valid_candidates"],
        validated=figures["validated"],
        success_share=figures["physics_success_share"],
        penetration_p95_mm=figures["penetration_p95_mm"],
        epsilon_median=figures["epsilon_median"],
        cpu_s=figures["cpu_s"],
    )


def _hand_text(hand: Hand) -> str:
    joints = counted(hand.num_dofs, "joint")
    return joints if hand.licence in ("", "not stated") else f"{joints}, {hand.licence}"


def trial_table(protocol: str, numbers: Mapping[str, float]) -> Table:
    """Every number that decided whether a grasp held, in the units people read."""
    facts = (
        ("mass given to the object", "mass_kg", 1e3, "g"),
        ("friction of hand on object", "friction", 1.0, ""),
        ("torsional friction", "torsional_friction_m", 1e3, "mm"),
        ("force along each axis, both ways", "force_n", 1.0, "N"),
        ("each force lasts at most" if numbers.get("settled_speed") else "each force lasts", "hold_s", 1.0, "s"),
        ("largest displacement", "max_displacement_m", 1e3, "mm"),
        ("largest rotation", "max_rotation_rad", 180 / math.pi, "°"),
        ("weakest joint, N m or N", "min_joint_effort", 1.0, ""),
        ("strongest joint, N m or N", "max_joint_effort", 1.0, ""),
    )
    rows = tuple((name, f"{numbers[key] * scale:.3g} {unit}".strip()) for name, key, scale, unit in facts
                 if key in numbers)  # fmt: skip
    return Table(
        title=f"The physics trial '{protocol}'",
        columns=("what", "value"),
        rows=rows,
        meaning="A grasp is held when the object stays within both limits under forces along its own ±x, ±y and ±z. "
        "The hand base is fixed and gravity is off.",
    )


def _notes(hand: Hand, obj: ObjectModel, trial: Mapping[str, float]) -> list[str]:
    """What was mended and guessed on the way in."""
    notes = [
        f"Hand: {line}" for key in ("repairs", "annotated") for line in hand.extra.get(key, "").splitlines() if line
    ]
    notes += [f"Object, {k}: {v}" for k, v in obj.provenance.items() if k in ("unit", "repairs", "surface")]
    own = f"Object, its own mass: {1e3 * obj.mass_kg:.0f} g ({obj.provenance.get('mass', 'as given')})"
    used = trial.get("mass_kg", obj.mass_kg)
    same = math.isclose(used, obj.mass_kg, rel_tol=1e-6)
    return [
        *notes,
        f"{own}; " + ("the trial used it." if same else f"the trial did not use it but {1e3 * used:.0f} g."),
    ]
